//! Normal equations of a part of a solved problem.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::error::EstimationResult;
use super::fit::Fit;
use super::problem::{Group, GroupPoint, Prior, Problem};
use super::state::EstimationState;
use super::system::NormalEquations;

/// Returns normal matrix and right side of some groups and priors of a solved problem at its solution, with the groups' own
/// parameters eliminated. `indices`: of the groups in the problem.
///
/// # Errors
/// Returns an error if a matrix is singular.
pub fn normal_equations_at(
    fit: &Fit,
    indices: Range<usize>,
    groups: &[Group],
    priors: Vec<Prior>,
) -> EstimationResult<(DMatrix<f64>, DVector<f64>)> {
    let problem = Problem {
        start: fit.global.clone(),
        missing: vec![],
        priors,
        known: None,
        groups: groups.to_vec(),
    };
    let solved = &fit.groups[indices.clone()];
    let mut state = EstimationState::initial(&problem, &fit.residuals()[indices]);
    state.local = solved.iter().map(|group| group.local.clone()).collect();
    let mut system = NormalEquations::new(&problem)?;
    system.assemble(&problem, &state, &|at: &GroupPoint, blocks: &mut Vec<_>| {
        let own = solved[at.group].blocks.iter();
        blocks.extend(own.map(|block| block.linearised.clone()));
        Ok(())
    })?;
    Ok((system.normal, system.right))
}
