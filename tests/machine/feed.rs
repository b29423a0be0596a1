//! Plays pictures into a video loopback device, as a camera would: the picture whose number stands in a
//! control file, again and again.
//!
//! `feed DEVICE FOURCC CONTROL SENT FRAME.jpg…`; what is written goes to the folder SENT too, as 00, 01, …
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::io::Write;
use std::time::Duration;

use v4l::video::Output;
use v4l::{Device, Format, FourCC};
use wingd::pipeline::decode::decode;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [device, fourcc, control, sent, frames @ ..] = arguments.as_slice() else {
        panic!("feed DEVICE FOURCC CONTROL SENT FRAME.jpg…");
    };
    let code: [u8; 4] = fourcc.as_bytes().try_into().expect("a FourCC has four letters");
    let files: Vec<Vec<u8>> = frames.iter().map(|frame| std::fs::read(frame).expect("a frame")).collect();
    let first = decode(&files[0], None).expect("a picture");
    let (width, height) = (first.width() as u32, first.height() as u32);
    // Each number gives another picture, even where there are fewer files: a comment segment in a JPEG,
    // the first pixel of bare samples.
    let payload = |number: usize| {
        let file = &files[number % files.len()];
        if fourcc == "GREY" {
            let mut luma = decode(file, None).expect("a picture").luma().to_vec();
            luma[0] = number as u8;
            return luma;
        }
        let comment = [0xFF, 0xFE, 0, 3, number as u8];
        [&file[..2], &comment, &file[2..]].concat()
    };
    let mut device = Device::with_path(device).expect("the loopback device");
    let format = Format::new(width, height, FourCC::new(&code));
    let got = device.set_format(&format).expect("the format");
    assert_eq!((got.width, got.height, got.fourcc), (width, height, format.fourcc), "the device gives {got}");
    let (mut number, mut bytes) = (usize::MAX, Vec::new());
    loop {
        let text = std::fs::read_to_string(control).unwrap_or_default();
        if text.trim() == "stop" {
            return;
        }
        let wanted = text.trim().parse().unwrap_or(0);
        if wanted != number {
            (number, bytes) = (wanted, payload(wanted));
            std::fs::write(format!("{sent}/{number:02}"), &bytes).expect("the folder for what is sent");
        }
        device.write_all(&bytes).expect("the loopback device takes a frame");
        std::thread::sleep(Duration::from_millis(60));
    }
}
