//! Steps that follow what the steps behind showed of the second derivatives.

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector};

use super::error::EstimationError;
use super::problem::Problem;
use super::system::System;

/// A step, and what it changed of the right side.
type Pair = (DVector<f64>, DVector<f64>);

/// What Gauss's method leaves out of the second derivatives, as the steps behind show it: limited-memory steps after Broyden,
/// Fletcher, Goldfarb and Shanno (Nocedal 1980) that begin with the normal matrix. Where little tells two unknowns apart, as
/// principal point and rotation, or amplitudes of many frames enter their own weights, what is left out is as large as what is
/// taken, and the steps of the method repeat themselves, too long or too short.
#[derive(Default)]
pub(super) struct Secants {
    /// Global parameters and right side that the last step began with.
    from: Option<(DVector<f64>, DVector<f64>)>,
    /// The last one last.
    pairs: VecDeque<Pair>,
}

impl Secants {
    /// Pairs that are kept: more than there are directions that little tells.
    const MAX_PAIRS: usize = 8;
    /// Curvature along a step over that of the normal matrix, at least (Powell's damping): no step is more than the inverse too
    /// short.
    const MIN_CURVATURE_RATIO: f64 = 0.05;
    /// Squared length in standard deviations beyond which a step says nothing of the next.
    const MAX_SQUARED_LENGTH: f64 = 100.0;
    /// Departure from the normal matrix' curvature, as a share of it, that says nothing: its own steps end quickly then.
    const MIN_DEVIATION: f64 = 0.2;

    /// Forgets them: a step led up.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// The next step.
    pub(super) fn next_step(
        &mut self,
        system: &System,
        problem: &Problem,
        global: &DVector<f64>,
    ) -> Result<DVector<f64>, EstimationError> {
        if let Some((before, right)) = self.from.take() {
            self.add_pair(&system.normal, global - before, right - &system.right);
        }
        self.from = Some((global.clone(), system.right.clone()));
        let mut step = system.right.clone();
        let mut parts = Vec::with_capacity(self.pairs.len());
        for (moved, turned) in self.pairs.iter().rev() {
            let part = moved.dot(&step) / moved.dot(turned);
            step.axpy(-part, turned, 1.0);
            parts.push(part);
        }
        step = system.solve_right_side(problem, &step)?;
        for ((moved, turned), part) in self.pairs.iter().zip(parts.into_iter().rev()) {
            let back = turned.dot(&step) / moved.dot(turned);
            step.axpy(part - back, moved, 1.0);
        }
        Ok(step)
    }

    /// The step along which the normal matrix is farthest above what the steps showed, a standard deviation long; `None` where
    /// it is near.
    pub(super) fn max_deviation_direction(&self, normal: &DMatrix<f64>) -> Option<DVector<f64>> {
        let own = |moved: &DVector<f64>| moved.dot(&(normal * moved));
        let share = |(moved, turned): &Pair| moved.dot(turned) / own(moved);
        let least = self.pairs.iter().min_by(|a, b| share(a).total_cmp(&share(b)))?;
        (share(least) < 1.0).then(|| &least.0 / own(&least.0).sqrt())
    }

    /// Whether the next step is Gauss's.
    pub(super) fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    fn add_pair(&mut self, normal: &DMatrix<f64>, moved: DVector<f64>, mut turned: DVector<f64>) {
        let usual = normal * &moved;
        let (curved, own) = (moved.dot(&turned), moved.dot(&usual));
        if own <= 0.0 || own > Self::MAX_SQUARED_LENGTH || (curved / own - 1.0).abs() < Self::MIN_DEVIATION {
            return;
        }
        let least = Self::MIN_CURVATURE_RATIO * own;
        if curved < least {
            let share = (own - least) / (own - curved);
            turned = turned * share + usual * (1.0 - share);
        }
        if self.pairs.len() == Self::MAX_PAIRS {
            self.pairs.pop_front();
        }
        self.pairs.push_back((moved, turned));
    }
}
