//! Solution of one live frame under one hypothesis, with the prior from earlier frames.

use crate::adjust::flight::frames::Flight;
use crate::adjust::flight::knowledge::{EarlierFrames, Knowledge};
use crate::adjust::flight::solving::SolvedFlight;
use crate::adjust::flight::usage::RemovedObservation;
use crate::adjust::{AdjustResult, GlobalTest};
use crate::estimation::quality::{self, chi_square_limit};

/// Significance level of a mount disturbance and of a removed marker: each must reduce the sum of squares by the
/// corresponding chi-square quantile.
pub const DISTURBANCE_ALPHA: f64 = 1e-6;

/// A frame solved under one hypothesis.
pub struct FrameAttempt {
    /// Solution with the remaining observations.
    pub solved: SolvedFlight,
    /// Observations removed by data snooping.
    pub removed: Vec<RemovedObservation>,
    /// True if all markers together passed the global test.
    pub passed: bool,
}

impl FrameAttempt {
    /// Solves the frame without the markers with a wrong surveyed position, and without outliers.
    ///
    /// # Errors
    /// Returns an error if the frame has no solution.
    pub fn new(flight: &Flight, earlier: &EarlierFrames) -> AdjustResult<Self> {
        let mut flight = Flight {
            knowledge: Knowledge::After(earlier),
            ..flight.clone()
        };
        let wrong = earlier.model.wrong.iter();
        wrong
            .clone()
            .for_each(|suspect| flight.frames[0][suspect.marker] = None);
        let all = flight.solve_rough(None)?;
        let (omega, redundancy) = (all.fit.omega, all.fit.redundancy);
        let test = quality::global_test(omega, redundancy, flight.input.options.global_alpha);
        let (rough, found) = flight.remove_outliers(all)?;
        let removed = wrong.map(|suspect| RemovedObservation {
            group: 0,
            suspect: *suspect,
        });
        Ok(Self {
            solved: flight.solve_converged(&rough.fit)?,
            removed: removed.chain(found).collect(),
            passed: test != Some(GlobalTest::Rejected),
        })
    }

    /// Returns whether the residuals are consistent with standard deviations increased by the square root of `factor`.
    pub fn is_explained(&self, factor: f64) -> bool {
        let fit = &self.solved.fit;
        quality::global_test(fit.omega / factor, fit.redundancy, DISTURBANCE_ALPHA)
            != Some(GlobalTest::Rejected)
    }

    /// Sum of squares, plus the required gain for each removed marker.
    pub fn penalized_misfit(&self) -> f64 {
        self.solved.fit.omega + self.removed.len() as f64 * chi_square_limit(2.0, DISTURBANCE_ALPHA)
    }
}
