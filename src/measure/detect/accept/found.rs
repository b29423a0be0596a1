//! What a search has found so far.

use nalgebra::Vector2;

use super::verdict::MeasuredMarker;
use crate::detect::detection::{RejectReason, Rejected};

/// What a search yields, in order of discovery.
#[derive(Default)]
pub struct FoundMarkers {
    pub measured: Vec<MeasuredMarker>,
    pub rejected: Vec<Rejected>,
}

impl FoundMarkers {
    /// Whether a place, px, lies in something that was measured.
    pub fn contains(&self, at: Vector2<f64>) -> bool {
        self.measured.iter().any(|m| m.detection.ellipse().contains(at))
    }

    /// Puts an answer in the place of a former one, or beside all of them.
    pub fn replace_or_add(&mut self, own: Option<usize>, new: MeasuredMarker) {
        match own.and_then(|i| self.measured.get_mut(i)) {
            Some(old) => *old = new,
            None => self.measured.push(new),
        }
    }

    /// Moves a detection to those turned down.
    pub fn reject(&mut self, index: usize, reason: RejectReason) {
        let ellipse = self.measured.remove(index).detection.ellipse();
        self.rejected.push(Rejected::of(&ellipse, reason));
    }

    /// Moves those with these indices, in ascending order.
    pub fn reject_indices(&mut self, reason: RejectReason, indices: &[usize]) {
        indices.iter().rev().for_each(|&i| self.reject(i, reason));
    }

    /// Moves all that are not wanted.
    pub fn reject_matching(&mut self, reason: RejectReason, unwanted: impl Fn(&MeasuredMarker) -> bool) {
        let all = self.measured.iter().enumerate();
        let indices: Vec<usize> = all.filter(|(_, m)| unwanted(m)).map(|(i, _)| i).collect();
        self.reject_indices(reason, &indices);
    }
}
