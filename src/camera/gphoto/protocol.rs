//! Protocol between the recorder and its camera process over a pipe.
//!
//! A message: `WGC2`, header length, body length (u32 each, low byte first), header (JSON), body (the bytes of an image, or
//! none). The `2` is the version: both ends are the same program, but an upgrade may replace it while it runs.

use std::io::{self, Read, Write};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::camera::CameraError;
use crate::camera::gphoto::GphotoSection;

const MAGIC: [u8; 4] = *b"WGC2";
/// Maximum length of a header.
const MAX_HEADER_BYTES: u32 = 1 << 20;
/// Maximum length of a body.
const MAX_BODY_BYTES: u32 = 1 << 29;

/// Request of the recorder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "ask", rename_all = "snake_case")]
pub enum Request {
    /// Find the camera, set it up, look for leftovers.
    Open { section: GphotoSection },
    /// Next leftover image on the card.
    Recover,
    /// Files that appeared without a request.
    Drain,
    /// Take a shot.
    Shoot {
        /// Deadline for trigger, exposure and download, s.
        deadline_s: f64,
        /// False for an external release of the shutter.
        trigger: bool,
    },
    /// Delete the last image on the card, whose copy is durable.
    Release,
}

/// Answer of the camera process: the result, or an error. `Open` gets a [`crate::camera::CameraInfo`], `Recover` an image
/// or `null`, `Drain` paths on the card, `Shoot` an image, `Release` nothing.
pub type CameraAnswer<T> = Result<T, CameraError>;

/// Description of the image in the message's body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CardImage {
    /// Path on the card.
    pub path: String,
    /// Settings reported by the camera.
    pub settings: Map<String, Value>,
}

/// Writes one message and flushes.
pub fn write_message(out: &mut impl Write, header: &impl Serialize, body: &[u8]) -> io::Result<()> {
    let header = serde_json::to_vec(header).map_err(io::Error::other)?;
    let length = |bytes: &[u8]| u32::try_from(bytes.len()).map_err(io::Error::other);
    out.write_all(&MAGIC)?;
    out.write_all(&length(&header)?.to_le_bytes())?;
    out.write_all(&length(body)?.to_le_bytes())?;
    out.write_all(&header)?;
    out.write_all(body)?;
    out.flush()
}

/// Reads one complete message.
///
/// # Errors
/// Returns an error if the pipe ends within it, or it is not a message of this version.
pub fn read_message<T: DeserializeOwned>(input: &mut impl Read) -> io::Result<(T, Vec<u8>)> {
    let mut start = [[0; 4]; 3];
    input
        .read_exact(start.as_flattened_mut())
        .map_err(pipe_error)?;
    let [magic, header, body] = start;
    let (header, body) = (u32::from_le_bytes(header), u32::from_le_bytes(body));
    if magic != MAGIC {
        return Err(io::Error::other("not a message of this version"));
    }
    if header > MAX_HEADER_BYTES || body > MAX_BODY_BYTES {
        return Err(io::Error::other(format!(
            "a message of {header} + {body} bytes is too long"
        )));
    }
    let head = serde_json::from_slice(&read_exactly(input, header)?)
        .map_err(|error| io::Error::other(format!("the header is invalid: {error}")))?;
    Ok((head, read_exactly(input, body)?))
}

/// Reads `length` bytes; allocates only as much as arrives.
fn read_exactly(input: &mut impl Read, length: u32) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    input
        .take(u64::from(length))
        .read_to_end(&mut bytes)
        .map_err(pipe_error)?;
    if bytes.len() == length as usize {
        Ok(bytes)
    } else {
        Err(pipe_error(io::ErrorKind::UnexpectedEof.into()))
    }
}

fn pipe_error(error: io::Error) -> io::Error {
    match error.kind() {
        io::ErrorKind::UnexpectedEof | io::ErrorKind::BrokenPipe => {
            io::Error::new(io::ErrorKind::UnexpectedEof, "the pipe was closed")
        }
        _ => io::Error::other(format!("the pipe failed: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type ShotAnswer = CameraAnswer<CardImage>;

    fn sample() -> (ShotAnswer, Vec<u8>) {
        let settings = Map::from_iter([("iso".to_owned(), Value::from("100"))]);
        (
            Ok(CardImage {
                path: "/DCIM/1.JPG".to_owned(),
                settings,
            }),
            (0..=255).collect(),
        )
    }

    fn written() -> Vec<u8> {
        let (header, body) = sample();
        let mut bytes = Vec::new();
        write_message(&mut bytes, &header, &body).unwrap();
        bytes
    }

    fn fault_of(mut bytes: &[u8]) -> io::Error {
        read_message::<ShotAnswer>(&mut bytes).unwrap_err()
    }

    #[test]
    fn messages_come_back_one_after_the_other() {
        let stream = [written(), written()].concat();
        let mut input = stream.as_slice();
        assert_eq!(read_message(&mut input).unwrap(), sample());
        assert_eq!(read_message(&mut input).unwrap(), sample());
        assert_eq!(fault_of(input).kind(), io::ErrorKind::UnexpectedEof);
    }

    #[test]
    fn every_truncation_is_detected() {
        let bytes = written();
        for length in 0..bytes.len() {
            assert_eq!(
                fault_of(&bytes[..length]).kind(),
                io::ErrorKind::UnexpectedEof,
                "{length}"
            );
        }
    }

    #[test]
    fn another_version_and_lying_lengths_are_refused() {
        let mut bytes = written();
        bytes[3] = b'1';
        assert_eq!(
            fault_of(&bytes).to_string(),
            "not a message of this version"
        );
        bytes[3] = b'2';
        bytes[4..12].fill(0xFF);
        assert!(fault_of(&bytes).to_string().ends_with("is too long"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = read_message::<ShotAnswer>(&mut bytes.as_slice());
            let _ = read_message::<Request>(&mut [MAGIC.as_slice(), &bytes].concat().as_slice());
        }

        #[test]
        fn any_flipped_byte_is_survived(at in 0usize..600, with in any::<u8>()) {
            let mut bytes = written();
            let length = bytes.len();
            bytes[at % length] = with;
            if let Ok((_, body)) = read_message::<ShotAnswer>(&mut bytes.as_slice()) {
                prop_assert!(body.len() <= length);
            }
        }
    }
}
