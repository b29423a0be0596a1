//! Freeing of the causes that a flight's solution asks for.

use super::frames::Flight;
use super::solving::SolvedFlight;
use super::usage::RemovedObservation;
use crate::adjust::AdjustResult;
use crate::adjust::causes::{WidenedPriors, asked_causes};
use crate::adjust::snooping::ResidualSum;
use crate::estimation::quality;

/// Largest number of solutions that free causes.
const FREEING_PASSES: usize = 4;

/// A flight with its rough solution, and the observations that were removed.
pub type RoughFlight<'a> = (Flight<'a>, SolvedFlight, Vec<RemovedObservation>);

/// Frees the causes that a solution without outliers asks for, as long as there is a solution. If the global test rejects it,
/// their significance is relative to its variance factor. Level 0 of the test: nothing is tested.
pub fn free_causes(mut rough: RoughFlight) -> RoughFlight {
    let alpha = rough.0.input.options.global_alpha;
    for _ in 0..FREEING_PASSES {
        let (flight, solved, _) = &rough;
        let (omega, redundancy) = ResidualSum::tested(flight.tested_sum, &solved.fit);
        let factor = quality::rejected_factor(omega, redundancy, alpha);
        let parts = (&solved.flight_problem.problem, &solved.fit);
        let asked = asked_causes(parts, &flight.widened, factor);
        if alpha <= 0.0 || !asked.differs_from(&flight.widened) {
            break;
        }
        let Ok(wider) = flight.solve_with_causes(asked) else {
            break;
        };
        rough = wider;
    }
    rough
}

impl<'a> Flight<'a> {
    /// Solves with these causes free, and finds the outliers again.
    fn solve_with_causes(&self, widened: WidenedPriors) -> AdjustResult<RoughFlight<'a>> {
        let mut flight = Flight {
            widened,
            ..self.clone()
        };
        flight.usage.reset_except(&[]);
        let rough = flight.solve_rough(None)?;
        let (found, outliers) = flight.remove_outliers(rough)?;
        flight.solve_converged(&found.fit)?;
        Ok((flight, found, outliers))
    }

    /// Computes a rough solution with all observations, and again with the causes in the image that they ask for: outliers
    /// may be consequences. Without a solution, these may be the reason. Level 0 of the global test: nothing is tested.
    ///
    /// # Errors
    /// Returns an error if there is no solution.
    pub fn solve_with_image_causes(&mut self) -> AdjustResult<SolvedFlight> {
        let is_tested = self.input.options.global_alpha > 0.0;
        let solved = match self.solve_rough(None) {
            Err(_) if is_tested => {
                self.widened = WidenedPriors::widest_image();
                return self.solve_rough(None);
            }
            solved => solved?,
        };
        let parts = (&solved.flight_problem.problem, &solved.fit);
        let asked = asked_causes(parts, &self.widened, 1.0);
        if !is_tested || !asked.has_image_cause() {
            return Ok(solved);
        }
        self.widened = asked;
        self.solve_rough(Some(&solved.fit))
    }
}
