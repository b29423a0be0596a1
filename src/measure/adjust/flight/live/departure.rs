//! How far a frame's shape leaves the one that frames share, learnt as they come.

use crate::adjust::flight::hyperparameters::{DEPARTURE, FlightHyperparameters};
use crate::adjust::flight::shape::SharedShape;
use crate::adjust::flight::solving::Solved;
use crate::adjust::flight::tuning::{VarianceEvidence, bounded_departure};

/// The departure from the shared shape is learnt from this time's frames, s.
const DEPARTURE_MEMORY_S: f64 = 600.0;
/// The departure to begin with counts as so many observations: with fewer, the first frames' chance would rule.
const DEPARTURE_WEIGHT: f64 = 2.0;
/// A swing to begin with, a share of what no fleet explains: 1 mm at the tip of 30 m in the second mode.
const SWING: f64 = 0.05;
/// Bounds of it: 0.05 mm, below what any frame shows, and 80 mm.
const SWING_BOUNDS: (f64, f64) = (0.002, 3.0);

/// Sums that the departures from the shared shape are learnt from.
#[derive(Clone, Copy, Debug)]
pub struct Departure {
    loads: VarianceEvidence,
    swings: VarianceEvidence,
}

impl Departure {
    /// Before the first frame.
    pub fn assumed() -> Self {
        let of = |share: f64| VarianceEvidence {
            square: DEPARTURE_WEIGHT * share * share,
            redundancy: DEPARTURE_WEIGHT,
        };
        Self { loads: of(DEPARTURE), swings: of(SWING) }
    }

    /// Takes for granted of the next frame what is learnt.
    pub fn taken<'a>(&self, assumed: FlightHyperparameters<'a>) -> FlightHyperparameters<'a> {
        let share = |VarianceEvidence { square, redundancy }: VarianceEvidence| (square / redundancy).sqrt();
        let (least, most) = SWING_BOUNDS;
        assumed.departing(bounded_departure(share(self.loads)), share(self.swings).clamp(least, most))
    }

    /// Adds this share of what a frame's departures show, solved with what was `assumed`.
    pub fn learn(&mut self, solved: &Solved, assumed: &FlightHyperparameters, elapsed_s: f64, share: f64) {
        let terms = solved.setting.layouts[0].curvature_terms;
        let [loads, swings] = SharedShape::components(terms, assumed, 0);
        let Some([of_loads, of_swings]) = solved.departure_shown(0, [&loads, &swings]) else { return };
        let kept = (-elapsed_s / DEPARTURE_MEMORY_S).exp();
        let add = |sum: &mut VarianceEvidence, shown: VarianceEvidence, used: f64| {
            sum.square = sum.square * kept + share * shown.square * used * used;
            sum.redundancy = sum.redundancy * kept + share * shown.redundancy;
        };
        add(&mut self.loads, of_loads, assumed.departure);
        add(&mut self.swings, of_swings, assumed.swing);
    }
}
