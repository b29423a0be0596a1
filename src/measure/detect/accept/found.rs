//! What a search has found so far.

use nalgebra::Vector2;

use super::verdict::Measured;
use crate::detect::detection::{RejectReason, Rejected};

/// What a search yields, in order of discovery.
#[derive(Default)]
pub struct Found {
    pub measured: Vec<Measured>,
    pub rejected: Vec<Rejected>,
}

impl Found {
    /// Whether a place, px, lies in something that was measured.
    pub fn holds(&self, at: Vector2<f64>) -> bool {
        self.measured.iter().any(|m| m.detection.ellipse().contains(at))
    }

    /// Puts an answer in the place of a former one, or beside all of them.
    pub fn put(&mut self, own: Option<usize>, new: Measured) {
        match own.and_then(|i| self.measured.get_mut(i)) {
            Some(old) => *old = new,
            None => self.measured.push(new),
        }
    }

    /// Moves a detection to those turned down.
    pub fn turn_down(&mut self, index: usize, reason: RejectReason) {
        let ellipse = self.measured.remove(index).detection.ellipse();
        self.rejected.push(Rejected::of(&ellipse, reason));
    }

    /// Moves those with these indices, in ascending order.
    pub fn turn_down_these(&mut self, reason: RejectReason, indices: &[usize]) {
        indices.iter().rev().for_each(|&i| self.turn_down(i, reason));
    }

    /// Moves all that are not wanted.
    pub fn turn_down_all(&mut self, reason: RejectReason, unwanted: impl Fn(&Measured) -> bool) {
        let all = self.measured.iter().enumerate();
        let indices: Vec<usize> = all.filter(|(_, m)| unwanted(m)).map(|(i, _)| i).collect();
        self.turn_down_these(reason, &indices);
    }
}
