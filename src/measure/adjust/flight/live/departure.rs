//! How far a frame's shape leaves the one that frames share, learnt as they come.

use super::Attempt;
use crate::measure::adjust::flight::{DEPARTURE, DEPARTURE_BOUNDS, departure_shown};

/// The departure from the shared shape is learnt from this time's frames, s.
const DEPARTURE_MEMORY_S: f64 = 600.0;
/// The departure to begin with counts as so many observations: with fewer, the first frames' chance would rule.
const DEPARTURE_WEIGHT: f64 = 2.0;

/// Sums that the departure from the shared shape is learnt from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Departure {
    square: f64,
    redundancy: f64,
}

impl Departure {
    /// Before the first frame.
    pub(super) fn assumed() -> Self {
        Self { square: DEPARTURE_WEIGHT * DEPARTURE * DEPARTURE, redundancy: DEPARTURE_WEIGHT }
    }

    /// As a share of the usual spread of shapes.
    pub(super) fn value(&self) -> f64 {
        (self.square / self.redundancy).sqrt().clamp(DEPARTURE_BOUNDS.0, DEPARTURE_BOUNDS.1)
    }

    /// Adds this share of what a frame's departures show (Koch's estimate of one variance component), solved with `used`.
    pub(super) fn learn(&mut self, attempt: &Attempt, used: f64, elapsed_s: f64, share: f64) {
        let Some((square, redundancy)) = departure_shown(&attempt.setting, &attempt.fit, 0) else { return };
        let kept = (-elapsed_s / DEPARTURE_MEMORY_S).exp();
        self.square = self.square * kept + share * square * used * used;
        self.redundancy = self.redundancy * kept + share * redundancy;
    }
}
