//! Which of a flight's observations take part.

use crate::adjust::snooping::{Suspect, Target};

/// A suspect that was taken out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Removed {
    /// The group that it was found in: a frame, or behind the last one survey and ground frame.
    pub group: usize,
    /// What of it.
    pub suspect: Suspect,
}

/// What takes part.
#[derive(Clone, Debug)]
pub struct Usage {
    /// Images in flight, per frame and marker.
    pub frames: Vec<Vec<bool>>,
    /// Images on ground, per marker.
    pub ground: Vec<bool>,
}

impl Usage {
    /// Everything that there is.
    pub fn all(frames: usize, markers: usize) -> Self {
        Self { frames: vec![vec![true; markers]; frames], ground: vec![true; markers] }
    }

    /// Everything but what was removed.
    pub fn all_but(&mut self, removed: &[Removed]) {
        self.frames.iter_mut().for_each(|frame| frame.fill(true));
        self.ground.fill(true);
        removed.iter().for_each(|removed| self.remove(removed));
    }

    /// A wrong image leaves its frame, a wrong surveyed position takes its marker out everywhere.
    pub fn remove(&mut self, Removed { group, suspect }: &Removed) {
        match self.frames.get_mut(*group) {
            Some(frame) => frame[suspect.marker] = false,
            None => self.ground[suspect.marker] = false,
        }
        if suspect.target == Target::Survey {
            self.frames.iter_mut().for_each(|frame| frame[suspect.marker] = false);
        }
    }
}
