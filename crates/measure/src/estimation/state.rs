//! Values of all unknowns during the iteration.

use nalgebra::DVector;

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
    /// Creates the start of a problem, with earlier residuals by group and block where they fit.
    pub(super) fn initial(problem: &Problem, earlier: &[Vec<DVector<f64>>]) -> Self {
        let residuals = |(index, group): (usize, &Group)| -> Vec<DVector<f64>> {
            let earlier = earlier.get(index);
            let earlier = earlier.filter(|e| e.len() == group.blocks.len());
            let of_block = |(k, block): (usize, &Block)| {
                let zero = DVector::zeros(block.observed.len());
                let old = earlier.map_or(&zero, |e| &e[k]);
                if old.len() == zero.len() {
                    old.clone()
                } else {
                    zero
                }
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
