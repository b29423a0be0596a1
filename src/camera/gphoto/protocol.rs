//! The recorder and its camera process talk over a pipe.
//!
//! A message: `WGC2`, header length, body length (u32 each, low byte first), header (JSON), body (the
//! bytes of a picture, or none). The `2` is the version: both ends are the same program, but an upgrade
//! may replace it while it runs.

use std::io::{self, Read, Write};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::camera::CameraError;
use crate::camera::gphoto::GphotoSection;

const MAGIC: [u8; 4] = *b"WGC2";
/// Longer headers are not ours.
const MAX_HEADER_BYTES: u32 = 1 << 20;
/// Longer pictures are not ours either.
const MAX_BODY_BYTES: u32 = 1 << 29;

/// Asked by the recorder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "ask", rename_all = "snake_case")]
pub enum Request {
    /// Find the camera, set it up, look for leftovers.
    Open {
        /// The configuration.
        section: GphotoSection,
    },
    /// Next leftover of the card.
    Recover,
    /// Files that appeared without having been asked for.
    Drain,
    /// One shot.
    Shoot {
        /// s, for trigger, exposure and download.
        deadline_s: f64,
        /// False where something else releases the shutter.
        trigger: bool,
    },
    /// The last picture is safe: delete it on the card.
    Release,
}

/// Answered by the camera process: what was asked for, or why not. `Open` gets a [`crate::camera::CameraInfo`], `Recover` a
/// picture or `null`, `Drain` paths on the card, `Shoot` a picture, `Release` nothing.
pub type Answer<T> = Result<T, CameraError>;

/// What is said of the picture that the message's body is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// Path on the card.
    pub path: String,
    /// What the camera says of it.
    pub settings: Map<String, Value>,
}

/// Why a message could not be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ProtocolError {
    /// The other end is gone.
    #[error("the pipe was closed")]
    Closed,
    /// The pipe failed.
    #[error("the pipe failed: {0}")]
    Pipe(String),
    /// Not our message, or of another version.
    #[error("not a message of this version")]
    Foreign,
    /// A length that cannot be true.
    #[error("a message of {header} + {body} bytes is too long")]
    TooLong {
        /// Bytes.
        header: u32,
        /// Bytes.
        body: u32,
    },
    /// The header is not understood.
    #[error("the header is not understood: {0}")]
    Header(String),
}

/// Writes one message and flushes.
pub fn write(out: &mut impl Write, header: &impl Serialize, body: &[u8]) -> io::Result<()> {
    let header = serde_json::to_vec(header).map_err(io::Error::other)?;
    let length = |bytes: &[u8]| u32::try_from(bytes.len()).map_err(io::Error::other);
    out.write_all(&MAGIC)?;
    out.write_all(&length(&header)?.to_le_bytes())?;
    out.write_all(&length(body)?.to_le_bytes())?;
    out.write_all(&header)?;
    out.write_all(body)?;
    out.flush()
}

/// Reads one message, whole.
pub fn read<T: DeserializeOwned>(input: &mut impl Read) -> Result<(T, Vec<u8>), ProtocolError> {
    let mut start = [[0; 4]; 3];
    input.read_exact(start.as_flattened_mut()).map_err(pipe)?;
    let [magic, header, body] = start;
    let (header, body) = (u32::from_le_bytes(header), u32::from_le_bytes(body));
    if magic != MAGIC {
        return Err(ProtocolError::Foreign);
    }
    if header > MAX_HEADER_BYTES || body > MAX_BODY_BYTES {
        return Err(ProtocolError::TooLong { header, body });
    }
    let head = exactly(input, header)?;
    let head = serde_json::from_slice(&head).map_err(|error| ProtocolError::Header(error.to_string()))?;
    Ok((head, exactly(input, body)?))
}

/// Memory grows with what comes, not with what is announced.
fn exactly(input: &mut impl Read, length: u32) -> Result<Vec<u8>, ProtocolError> {
    let mut bytes = Vec::new();
    input.take(u64::from(length)).read_to_end(&mut bytes).map_err(pipe)?;
    if bytes.len() == length as usize { Ok(bytes) } else { Err(ProtocolError::Closed) }
}

fn pipe(error: io::Error) -> ProtocolError {
    match error.kind() {
        io::ErrorKind::UnexpectedEof | io::ErrorKind::BrokenPipe => ProtocolError::Closed,
        _ => ProtocolError::Pipe(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Shot = Answer<Picture>;

    fn sample() -> (Shot, Vec<u8>) {
        let settings = Map::from_iter([("iso".to_owned(), Value::from("100"))]);
        (Ok(Picture { path: "/DCIM/1.JPG".to_owned(), settings }), (0..=255).collect())
    }

    fn written() -> Vec<u8> {
        let (header, body) = sample();
        let mut bytes = Vec::new();
        write(&mut bytes, &header, &body).unwrap();
        bytes
    }

    #[test]
    fn messages_come_back_one_after_the_other() {
        let stream = [written(), written()].concat();
        let mut input = stream.as_slice();
        assert_eq!(read(&mut input), Ok(sample()));
        assert_eq!(read(&mut input), Ok(sample()));
        assert_eq!(read::<Shot>(&mut input), Err(ProtocolError::Closed));
    }

    #[test]
    fn every_cut_is_noticed() {
        let bytes = written();
        for length in 0..bytes.len() {
            assert_eq!(read::<Shot>(&mut &bytes[..length]), Err(ProtocolError::Closed), "{length}");
        }
    }

    #[test]
    fn another_version_and_lying_lengths_are_refused() {
        let mut bytes = written();
        bytes[3] = b'1';
        assert_eq!(read::<Shot>(&mut bytes.as_slice()), Err(ProtocolError::Foreign));
        bytes[3] = b'2';
        bytes[4..12].fill(0xFF);
        let result = read::<Shot>(&mut bytes.as_slice());
        assert_eq!(result, Err(ProtocolError::TooLong { header: u32::MAX, body: u32::MAX }));
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = read::<Shot>(&mut bytes.as_slice());
            let _ = read::<Request>(&mut [MAGIC.as_slice(), &bytes].concat().as_slice());
        }

        #[test]
        fn any_flipped_byte_is_survived(at in 0usize..600, with in any::<u8>()) {
            let mut bytes = written();
            let length = bytes.len();
            bytes[at % length] = with;
            if let Ok((_, body)) = read::<Shot>(&mut bytes.as_slice()) {
                prop_assert!(body.len() <= length);
            }
        }
    }
}
