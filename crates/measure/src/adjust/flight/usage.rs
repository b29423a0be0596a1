//! Observations of a flight that are in use.

use crate::adjust::snooping::{Suspect, SuspectTarget};

/// An observation removed by data snooping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RemovedObservation {
    /// Group in which it was found: a frame, or survey and ground frame after the last one.
    pub group: usize,
    pub suspect: Suspect,
}

/// Observations in use.
#[derive(Clone, Debug)]
pub struct FlightUsage {
    /// Flight images, per frame and marker.
    pub frames: Vec<Vec<bool>>,
    /// Ground-frame images, per marker.
    pub ground: Vec<bool>,
}

impl FlightUsage {
    /// Uses all observations.
    pub fn all_used(frames: usize, markers: usize) -> Self {
        Self {
            frames: vec![vec![true; markers]; frames],
            ground: vec![true; markers],
        }
    }

    /// Uses all observations except the removed ones.
    pub fn reset_except(&mut self, removed: &[RemovedObservation]) {
        self.frames.iter_mut().for_each(|frame| frame.fill(true));
        self.ground.fill(true);
        removed.iter().for_each(|removed| self.remove(removed));
    }

    /// Removes an observation: a wrong image, or with a wrong surveyed position all images of its marker.
    pub fn remove(&mut self, RemovedObservation { group, suspect }: &RemovedObservation) {
        let (marker, target) = (suspect.marker, suspect.target);
        if target != SuspectTarget::Flight {
            self.ground[marker] = false;
        }
        for (index, frame) in self.frames.iter_mut().enumerate() {
            if target == SuspectTarget::Survey || target == SuspectTarget::Flight && index == *group
            {
                frame[marker] = false;
            }
        }
    }
}
