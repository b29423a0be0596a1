//! How far a frame's shape leaves the one that frames share, learnt as they come.

use crate::adjust::flight::assumed::DEPARTURE;
use crate::adjust::flight::solving::Solved;
use crate::adjust::flight::tuning::{Shown, bounded_departure};

/// The departure from the shared shape is learnt from this time's frames, s.
const DEPARTURE_MEMORY_S: f64 = 600.0;
/// The departure to begin with counts as so many observations: with fewer, the first frames' chance would rule.
const DEPARTURE_WEIGHT: f64 = 2.0;

/// Sums that the departure from the shared shape is learnt from.
#[derive(Clone, Copy, Debug)]
pub struct Departure {
    square: f64,
    redundancy: f64,
}

impl Departure {
    /// Before the first frame.
    pub fn assumed() -> Self {
        Self { square: DEPARTURE_WEIGHT * DEPARTURE * DEPARTURE, redundancy: DEPARTURE_WEIGHT }
    }

    /// As a share of the usual width of shapes.
    pub fn value(&self) -> f64 {
        bounded_departure((self.square / self.redundancy).sqrt())
    }

    /// Adds this share of what a frame's departures show (Koch's estimate of one variance component), solved with `used`.
    pub fn learn(&mut self, solved: &Solved, used: f64, elapsed_s: f64, share: f64) {
        let Some(Shown { square, redundancy }) = solved.departure_shown(0) else { return };
        let kept = (-elapsed_s / DEPARTURE_MEMORY_S).exp();
        self.square = self.square * kept + share * square * used * used;
        self.redundancy = self.redundancy * kept + share * redundancy;
    }
}
