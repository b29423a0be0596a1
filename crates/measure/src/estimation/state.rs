//! Values of all unknowns during the iteration.

use nalgebra::DVector;

use super::fit::Fit;
use super::problem::{Block, Group, Problem};

/// Current values of all unknowns.
#[derive(Clone)]
pub(super) struct EstimationState {
    pub(super) global: DVector<f64>,
    pub(super) local: Vec<DVector<f64>>,
    pub(super) residuals: Vec<Vec<DVector<f64>>>,
    /// Adjusted observations.
    pub(super) observed: Vec<Vec<DVector<f64>>>,
}

impl EstimationState {
    pub(super) fn initial(problem: &Problem, before: Option<&Fit>) -> Self {
        let residuals = |(index, group): (usize, &Group)| -> Vec<DVector<f64>> {
            let before = before.and_then(|fit| fit.groups.get(index));
            let before = before.filter(|b| b.blocks.len() == group.blocks.len());
            let of_block = |(k, block): (usize, &Block)| {
                let old = before
                    .map(|b| &b.blocks[k].residuals)
                    .filter(|v| v.len() == block.observed.len());
                old.cloned()
                    .unwrap_or_else(|| DVector::zeros(block.observed.len()))
            };
            group.blocks.iter().enumerate().map(of_block).collect()
        };
        let residuals: Vec<_> = problem.groups.iter().enumerate().map(residuals).collect();
        let observed = |(group, residuals): (&Group, &Vec<DVector<f64>>)| {
            group
                .blocks
                .iter()
                .zip(residuals)
                .map(|(b, v)| &b.observed + v)
                .collect()
        };
        Self {
            global: problem.start.clone(),
            local: problem.groups.iter().map(|g| g.local.clone()).collect(),
            observed: problem
                .groups
                .iter()
                .zip(&residuals)
                .map(observed)
                .collect(),
            residuals,
        }
    }
}

/// Returns the squared change of the residuals, in standard deviations. The conditions are linearised at the adjusted
/// observations, so constant parameters are not enough for convergence.
pub(super) fn residual_change(problem: &Problem, a: &EstimationState, b: &EstimationState) -> f64 {
    let mut sum = 0.0;
    for (group, (ra, rb)) in problem
        .groups
        .iter()
        .zip(a.residuals.iter().zip(&b.residuals))
    {
        for (block, (va, vb)) in group.blocks.iter().zip(ra.iter().zip(rb)) {
            for k in 0..va.len() {
                sum += (va[k] - vb[k]).powi(2) / block.covariance[(k, k)];
            }
        }
    }
    sum
}
