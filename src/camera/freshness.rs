//! Detection of repeated frames by their bytes and names: a camera may answer normally and deliver an old image.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use sha2::{Digest, Sha256};

use crate::camera::CameraError;

/// Number of frames that are remembered. Two images of a real scene never agree in every byte.
const FRAME_HISTORY: usize = 16;

/// Hashes of the last frames.
#[derive(Debug)]
pub struct Freshness {
    hashes: VecDeque<[u8; 32]>,
    capacity: usize,
    /// Number of frames to compare with; at most the capacity.
    limit: usize,
}

impl Default for Freshness {
    fn default() -> Self {
        Self::with_capacity(FRAME_HISTORY)
    }
}

impl Freshness {
    /// Creates a history of `remembered` frames.
    pub fn with_capacity(remembered: usize) -> Self {
        Self {
            hashes: VecDeque::new(),
            capacity: remembered,
            limit: remembered,
        }
    }

    /// Limits the history to fewer frames than the camera delivers before it repeats by its configuration.
    pub fn limit_to_loop(&mut self, repeats_after: Option<usize>) {
        let limit = repeats_after.map_or(usize::MAX, |count| count.saturating_sub(1));
        self.limit = self.capacity.min(limit);
        self.hashes.truncate(self.limit);
    }

    /// Accepts a frame that differs from all remembered ones.
    ///
    /// # Errors
    /// Returns an error if the frame is empty or a repetition.
    pub fn check(&mut self, bytes: &[u8]) -> Result<(), CameraError> {
        if bytes.is_empty() {
            return Err(CameraError::BadFrame("it is empty".to_owned()));
        }
        let hash: [u8; 32] = Sha256::digest(bytes).into();
        if let Some(age) = self.hashes.iter().position(|old| *old == hash) {
            return Err(CameraError::BadFrame(format!(
                "it is the same, byte for byte, as the one taken {} before; the camera repeats an old frame",
                if age == 0 {
                    "just".to_owned()
                } else {
                    format!("{} shots", age + 1)
                }
            )));
        }
        self.hashes.push_front(hash);
        self.hashes.truncate(self.limit);
        Ok(())
    }
}

/// Camera's own name for its last shot. Clones share it, so that it outlives one camera object.
#[derive(Clone, Debug, Default)]
pub struct LastName(Arc<Mutex<String>>);

impl LastName {
    /// Accepts a shot whose name differs from that of the previous one.
    ///
    /// # Errors
    /// Returns an error if the name is the same.
    pub fn check(&self, name: &str) -> Result<(), CameraError> {
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if *last == name {
            return Err(CameraError::BadFrame(format!(
                "it has the name of the previous shot, {name}; the camera repeats an old frame"
            )));
        }
        name.clone_into(&mut last);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeats_are_refused_and_new_frames_pass() {
        let mut freshness = Freshness::with_capacity(2);
        assert!(freshness.check(b"one").is_ok() && freshness.check(b"two").is_ok());
        assert!(freshness.check(b"one").is_err() && freshness.check(b"two").is_err());
        assert!(freshness.check(b"").is_err() && freshness.check(b"three").is_ok());
        assert!(
            freshness.check(b"one").is_ok(),
            "older than what is remembered"
        );
        let (name, of_a_new_camera) = (LastName::default(), LastName::default());
        assert!(name.check("1.jpg").is_ok() && name.clone().check("1.jpg").is_err());
        assert!(name.check("2.jpg").is_ok() && of_a_new_camera.check("2.jpg").is_ok());
    }
}
