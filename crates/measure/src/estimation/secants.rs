//! Quasi-Newton steps from the second derivatives observed along previous steps.

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector};

use super::error::EstimationResult;
use super::problem::Problem;
use super::system::NormalEquations;

/// A step and the change of the right side along it.
type SecantPair = (DVector<f64>, DVector<f64>);

/// Second derivatives that Gauss's method neglects, observed along previous steps: limited-memory steps after Broyden,
/// Fletcher, Goldfarb and Shanno (Nocedal 1980) that begin with the normal matrix. If two unknowns are poorly separable
/// (principal point and rotation), or if amplitudes of many frames enter their own weights, the neglected derivatives are
/// as large as the others, and Gauss's steps repeat themselves, too long or too short.
#[derive(Default)]
pub(super) struct Secants {
    /// Global parameters and right side before the last step.
    from: Option<(DVector<f64>, DVector<f64>)>,
    /// Pairs in order of the steps.
    pairs: VecDeque<SecantPair>,
}

impl Secants {
    /// Maximum number of pairs: more than there are poorly determined directions.
    const MAX_PAIRS: usize = 8;
    /// Smallest curvature along a step over that of the normal matrix (Powell's damping): a step is too short by the
    /// inverse at most.
    const MIN_CURVATURE_RATIO: f64 = 0.05;
    /// Squared length, in standard deviations, beyond which a step contains no information about the next one.
    const MAX_SQUARED_LENGTH: f64 = 100.0;
    /// Relative deviation from the normal matrix' curvature below which a pair is ignored: Gauss's steps converge quickly
    /// then.
    const MIN_DEVIATION: f64 = 0.2;

    /// Removes all pairs, after a step that increased the sum of squares.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Computes the next step.
    pub(super) fn next_step(
        &mut self,
        system: &NormalEquations,
        problem: &Problem,
        global: &DVector<f64>,
    ) -> EstimationResult<DVector<f64>> {
        if let Some((before, right)) = self.from.take() {
            self.add_secant_pair(&system.normal, global - before, right - &system.right);
        }
        self.from = Some((global.clone(), system.right.clone()));
        let mut step = system.right.clone();
        let mut parts = Vec::with_capacity(self.pairs.len());
        for (moved, change) in self.pairs.iter().rev() {
            let part = moved.dot(&step) / moved.dot(change);
            step.axpy(-part, change, 1.0);
            parts.push(part);
        }
        step = system.solve_right_side(problem, &step)?;
        for ((moved, change), part) in self.pairs.iter().zip(parts.into_iter().rev()) {
            let back = change.dot(&step) / moved.dot(change);
            step.axpy(part - back, moved, 1.0);
        }
        Ok(step)
    }

    /// Returns the step, one standard deviation long, along which the normal matrix exceeds the observed curvature most.
    /// Returns `None` if no curvature is below it.
    pub(super) fn max_deviation_direction(&self, normal: &DMatrix<f64>) -> Option<DVector<f64>> {
        let own = |moved: &DVector<f64>| moved.dot(&(normal * moved));
        let share = |(moved, change): &SecantPair| moved.dot(change) / own(moved);
        let least = self
            .pairs
            .iter()
            .min_by(|a, b| share(a).total_cmp(&share(b)))?;
        (share(least) < 1.0).then(|| &least.0 / own(&least.0).sqrt())
    }

    /// Returns true if there are no pairs: the next step is Gauss's.
    pub(super) fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    fn add_secant_pair(
        &mut self,
        normal: &DMatrix<f64>,
        moved: DVector<f64>,
        mut change: DVector<f64>,
    ) {
        let expected = normal * &moved;
        let (observed, own) = (moved.dot(&change), moved.dot(&expected));
        if own <= 0.0
            || own > Self::MAX_SQUARED_LENGTH
            || (observed / own - 1.0).abs() < Self::MIN_DEVIATION
        {
            return;
        }
        let least = Self::MIN_CURVATURE_RATIO * own;
        if observed < least {
            let share = (own - least) / (own - observed);
            change = change * share + expected * (1.0 - share);
        }
        if self.pairs.len() == Self::MAX_PAIRS {
            self.pairs.pop_front();
        }
        self.pairs.push_back((moved, change));
    }
}
