//! Departure of live frames from the shared shape, estimated continuously.

use crate::adjust::flight::hyperparameters::{FlightHyperparameters, INITIAL_DEPARTURE};
use crate::adjust::flight::shape::SharedShape;
use crate::adjust::flight::solving::SolvedFlight;
use crate::adjust::flight::tuning::{VarianceEvidence, bounded_departure};

/// Time constant of the estimate of the departure, s.
const DEPARTURE_MEMORY_S: f64 = 600.0;
/// Weight of the initial departure as a number of observations; with less, the first frames would dominate.
const DEPARTURE_WEIGHT: f64 = 2.0;
/// Initial vibration, as a fraction of the spread that the fleet does not explain: 1 mm at the tip of a 30 m wing in the
/// second mode.
const INITIAL_OSCILLATION: f64 = 0.05;
/// Bounds of the vibration: 0.05 mm, below what a frame can show, and 80 mm.
const OSCILLATION_BOUNDS: (f64, f64) = (0.002, 3.0);

/// Evidence for the departures from the shared shape.
#[derive(Clone, Copy, Debug)]
pub struct ShapeDeparture {
    loads: VarianceEvidence,
    oscillations: VarianceEvidence,
}

impl ShapeDeparture {
    /// Evidence before the first frame.
    pub fn initial() -> Self {
        let prior_evidence = |share: f64| VarianceEvidence {
            square: DEPARTURE_WEIGHT * share * share,
            redundancy: DEPARTURE_WEIGHT,
        };
        Self {
            loads: prior_evidence(INITIAL_DEPARTURE),
            oscillations: prior_evidence(INITIAL_OSCILLATION),
        }
    }

    /// Sets the departures of the next frame to the current estimates.
    pub fn apply_to(&self, hyperparameters: &mut FlightHyperparameters) {
        let share = |VarianceEvidence { square, redundancy }: VarianceEvidence| {
            (square / redundancy).sqrt()
        };
        let (least, most) = OSCILLATION_BOUNDS;
        hyperparameters.departure = bounded_departure(share(self.loads));
        hyperparameters.oscillation = share(self.oscillations).clamp(least, most);
    }

    /// Adds the fraction `share` of the evidence of a frame that was solved with `hyperparameters`.
    pub fn update(
        &mut self,
        solved: &SolvedFlight,
        hyperparameters: &FlightHyperparameters,
        elapsed_s: f64,
        share: f64,
    ) {
        let terms = solved.flight_problem.layouts[0].curvature_terms;
        let [loads, oscillations] = SharedShape::departure_covariances(terms, hyperparameters, 0);
        let Some([of_loads, of_oscillations]) =
            solved.departure_evidence(0, [&loads, &oscillations])
        else {
            return;
        };
        let decay = (-elapsed_s / DEPARTURE_MEMORY_S).exp();
        let add = |sum: &mut VarianceEvidence, evidence: VarianceEvidence, used: f64| {
            sum.square = sum.square * decay + share * evidence.square * used * used;
            sum.redundancy = sum.redundancy * decay + share * evidence.redundancy;
        };
        add(&mut self.loads, of_loads, hyperparameters.departure);
        add(
            &mut self.oscillations,
            of_oscillations,
            hyperparameters.oscillation,
        );
    }
}
