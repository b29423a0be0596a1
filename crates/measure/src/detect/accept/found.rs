//! Accepted and rejected detections during a search.

use nalgebra::Vector2;

use super::verdict::MeasuredMarker;
use crate::detect::detection::{RejectReason, Rejected};

/// Result of a search, in order of discovery.
#[derive(Default)]
pub struct FoundMarkers {
    pub measured: Vec<MeasuredMarker>,
    pub rejected: Vec<Rejected>,
}

impl FoundMarkers {
    /// Returns whether a position, px, lies in a measured marker.
    pub fn contains(&self, at: Vector2<f64>) -> bool {
        self.measured
            .iter()
            .any(|m| m.detection.ellipse().contains(at))
    }

    /// Replaces the marker of an index, or adds a new one.
    pub fn replace_or_add(&mut self, own: Option<usize>, new: MeasuredMarker) {
        match own.and_then(|i| self.measured.get_mut(i)) {
            Some(old) => *old = new,
            None => self.measured.push(new),
        }
    }

    /// Moves a marker to the rejected ones.
    pub fn reject(&mut self, index: usize, reason: RejectReason) {
        let ellipse = self.measured.remove(index).detection.ellipse();
        self.rejected.push(Rejected::from_ellipse(&ellipse, reason));
    }

    /// Rejects the markers of some indices, given in ascending order.
    pub fn reject_indices(&mut self, reason: RejectReason, indices: &[usize]) {
        indices.iter().rev().for_each(|&i| self.reject(i, reason));
    }

    /// Rejects all markers that match a condition.
    pub fn reject_matching(
        &mut self,
        reason: RejectReason,
        unwanted: impl Fn(&MeasuredMarker) -> bool,
    ) {
        let all = self.measured.iter().enumerate();
        let indices: Vec<usize> = all.filter(|(_, m)| unwanted(m)).map(|(i, _)| i).collect();
        self.reject_indices(reason, &indices);
    }
}
