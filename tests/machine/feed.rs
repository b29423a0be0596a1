//! Plays images into a video loopback device, as a camera would; sets a control of a video device.
//!
//! `feed DEVICE FOURCC CONTROL SENT FRAME.jpg…`: the file CONTROL selects the output: `auto`, one image
//! after the other; `slow`, the same, one per second; `N`, image N repeatedly; `hold`, the present one; `once N`, image N in a
//! burst of eight; `stop`. The hash of every image is added to the file SENT before it is shown.
//! `feed set DEVICE ID VALUE`
//! `feed lines SOCKET`: prints the lines of a Unix socket.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs::OpenOptions;
use std::io::Write;
use std::time::Duration;

use sha2::{Digest, Sha256};
use v4l::control::{Control, Value};
use v4l::video::Output;
use v4l::{Device, Format, FourCC};
use wingd::pipeline::decode::decode_image;

/// Pause between two frames, in addition to their own time.
const PAUSE: Duration = Duration::from_millis(20);

/// Pause if images are shown slowly: the device has few buffers, and overwrites those that are read for longer.
const SLOW: Duration = Duration::from_millis(980);

/// Images to show; no two numbers give the same image.
struct Pictures {
    /// Complete JPEG files, or bare samples.
    payloads: Vec<Vec<u8>>,
    jpeg: bool,
    size: (u32, u32),
}

impl Pictures {
    fn read(files: &[String], jpeg: bool) -> Self {
        let mut size = (0, 0);
        let read = |file: &String| {
            let bytes = std::fs::read(file).expect("a frame");
            let picture = decode_image(&bytes, None).expect("an image");
            size = (picture.width() as u32, picture.height() as u32);
            if jpeg { bytes } else { picture.luma().to_vec() }
        };
        Self {
            payloads: files.iter().map(read).collect(),
            jpeg,
            size,
        }
    }

    /// The number is written into a JPEG comment, or into the first pixels.
    fn number(&self, number: usize) -> Vec<u8> {
        let file = &self.payloads[number % self.payloads.len()];
        let digits = (number as u32).to_be_bytes();
        match self.jpeg {
            true => [&file[..2], &[0xFF, 0xFE, 0, 6], &digits, &file[2..]].concat(),
            false => [&digits, &file[4..]].concat(),
        }
    }
}

fn play(device: &str, fourcc: &str, control: &str, sent: &str, files: &[String]) {
    let code: [u8; 4] = fourcc
        .as_bytes()
        .try_into()
        .expect("a FourCC has four letters");
    let pictures = Pictures::read(files, fourcc == "MJPG");
    let mut device = Device::with_path(device).expect("the loopback device");
    let format = Format::new(pictures.size.0, pictures.size.1, FourCC::new(&code));
    let got = device.set_format(&format).expect("the format");
    assert_eq!(
        (got.width, got.height, got.fourcc),
        (format.width, format.height, format.fourcc),
        "the device gives {got}"
    );
    let mut log = OpenOptions::new()
        .create(true)
        .append(true)
        .open(sent)
        .expect("the list of sent images");
    let (mut number, mut bytes, mut shown) = (0, Vec::new(), None);
    loop {
        let text = std::fs::read_to_string(control).unwrap_or_default();
        let once = text
            .strip_prefix("once ")
            .and_then(|number| number.trim().parse().ok());
        let next = match (text.trim(), once) {
            ("stop", _) => return,
            ("hold" | "", _) if !bytes.is_empty() => Some(number),
            (text, None) if text.parse::<usize>().is_ok() => text.parse().ok(),
            (_, Some(wanted)) => (shown != Some(wanted)).then_some(wanted),
            _ => Some(number + 1),
        };
        if let Some(next) = next {
            if next != number || bytes.is_empty() {
                (number, bytes) = (next, pictures.number(next));
                writeln!(log, "{}", hex::encode(Sha256::digest(&bytes)))
                    .expect("the list of sent images");
            }
            for _ in 0..if once.is_some() { 8 } else { 1 } {
                device
                    .write_all(&bytes)
                    .expect("the loopback device takes a frame");
                std::thread::sleep(PAUSE);
            }
            shown = Some(next);
            if text.trim() == "slow" {
                std::thread::sleep(SLOW);
            }
        }
        std::thread::sleep(PAUSE);
    }
}

fn set(device: &str, id: &str, value: &str) {
    let id = u32::from_str_radix(id.trim_start_matches("0x"), 16).expect("the control's id");
    let value = Value::Integer(value.parse().expect("a number"));
    Device::with_path(device)
        .expect("the device")
        .set_control(Control { id, value })
        .expect("the control");
}

fn lines(socket: &str) {
    let mut stream = std::os::unix::net::UnixStream::connect(socket).expect("the socket");
    std::io::copy(&mut stream, &mut std::io::stdout()).expect("lines");
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.as_slice() {
        [set_, device, id, value] if set_ == "set" => set(device, id, value),
        [lines_, socket] if lines_ == "lines" => lines(socket),
        [device, fourcc, control, sent, frames @ ..] => play(device, fourcc, control, sent, frames),
        _ => panic!(
            "feed DEVICE FOURCC CONTROL SENT FRAME.jpg…, feed set DEVICE ID VALUE, or feed lines SOCKET"
        ),
    }
}
