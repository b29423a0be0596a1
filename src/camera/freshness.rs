//! A camera may answer well and deliver an old picture; its bytes and its name say whether a frame is new.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use sha2::{Digest, Sha256};

use crate::camera::CameraError;

/// How many frames are remembered. Two views of a real scene never agree in every byte.
const REMEMBERED: usize = 16;

/// The last frames of a camera. Clones share them, so that they outlive one camera object.
#[derive(Clone, Debug)]
pub struct Freshness(Arc<Mutex<Memory>>);

#[derive(Debug)]
struct Memory {
    hashes: VecDeque<[u8; 32]>,
    last_name: Option<String>,
    remembered: usize,
}

impl Default for Freshness {
    fn default() -> Self {
        Self::remembering(REMEMBERED)
    }
}

impl Freshness {
    /// Remembers so many frames.
    pub fn remembering(remembered: usize) -> Self {
        Self(Arc::new(Mutex::new(Memory { hashes: VecDeque::new(), last_name: None, remembered })))
    }

    /// Accepts a frame that differs from all that are remembered. `name` is the camera's own name or
    /// counter for the shot, where there is one: it must change too.
    pub fn check(&self, bytes: &[u8], name: Option<&str>) -> Result<(), CameraError> {
        if bytes.is_empty() {
            return Err(CameraError::BadFrame("it is empty".to_owned()));
        }
        let mut memory = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let hash: [u8; 32] = Sha256::digest(bytes).into();
        if let Some(age) = memory.hashes.iter().position(|old| *old == hash) {
            return Err(CameraError::BadFrame(format!(
                "it is the same, byte for byte, as the one taken {} before; the camera repeats itself",
                if age == 0 { "just".to_owned() } else { format!("{} shots", age + 1) }
            )));
        }
        if let Some(name) = name.filter(|name| memory.last_name.as_deref() == Some(name)) {
            return Err(CameraError::BadFrame(format!("the camera names it {name}, as the shot before")));
        }
        memory.hashes.push_front(hash);
        let remembered = memory.remembered;
        memory.hashes.truncate(remembered);
        memory.last_name = name.map(str::to_owned);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeats_are_refused_and_new_frames_pass() {
        let freshness = Freshness::default();
        assert!(freshness.check(b"one", Some("1.jpg")).is_ok());
        assert!(freshness.check(b"two", Some("1.jpg")).is_err(), "same name");
        assert!(freshness.check(b"two", Some("2.jpg")).is_ok());
        assert!(freshness.check(b"one", Some("3.jpg")).is_err(), "same bytes");
        assert!(freshness.check(b"", None).is_err());
        assert!(freshness.check(b"three", None).is_ok());
    }
}
