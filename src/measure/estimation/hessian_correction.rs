//! Second derivatives of what is left of the sum of squares when the groups' own parameters have settled.
//!
//! Where a derivative by a shared parameter goes with a group's own parameters, as the answer to the root's place goes with the
//! bending, their noise is in it, and its square counts in the normal matrix as if it were signal: errors in variables (Fuller
//! 1987). In one group that is nothing; in many of them it adds up where little else tells. It concerns few directions, which
//! Lanczos' iteration finds from one of them on.

use nalgebra::{DMatrix, DVector};

use super::error::EstimationError;
use super::problem::{GroupPoint, Linearised, Problem};
use super::state::State;
use super::system::System;

/// Directions that are looked at: in flights two or three differ from the normal matrix.
const MAX_DIRECTIONS: usize = 4;
/// Differences are taken so many standard deviations to either side.
const DIFFERENCE_STEP: f64 = 0.3;
/// A direction of which those before leave less than this is spanned by them.
const MIN_NEW_LENGTH: f64 = 1e-3;
/// Share of the normal matrix that may be lost along a direction, so that what is left is regular.
const MAX_LOSS: f64 = 0.98;

/// Half the second derivative: the normal matrix `N` but for Lanczos' directions, in which it is found by differences of the
/// gradient. `start`: one that differs, `start' N start = 1`; `system`: at the state.
pub(super) fn half_hessian<L>(
    system: &System,
    problem: &Problem,
    state: &State,
    start: DVector<f64>,
    linearise: &L,
) -> Result<DMatrix<f64>, EstimationError>
where
    L: Fn(&GroupPoint, &mut Vec<Linearised>) -> Result<(), EstimationError>,
{
    let normal = &system.normal;
    let mut directions: Vec<DVector<f64>> = vec![];
    // What the normal matrix has too much along them.
    let mut feigned: Vec<DVector<f64>> = vec![];
    let mut next = start;
    let mut there = System::new(problem)?;
    while directions.len() < MAX_DIRECTIONS {
        for direction in &directions {
            let along = direction.dot(&(normal * &next));
            next.axpy(-along, direction, 1.0);
        }
        let length = next.dot(&(normal * &next)).max(0.0).sqrt();
        if length < MIN_NEW_LENGTH {
            break;
        }
        next /= length;
        let too_much = normal * &next - half_gradient_change((system, &mut there), problem, state, &next, linearise)?;
        directions.push(next);
        next = system.solve_right_side(problem, &too_much)?;
        feigned.push(too_much);
    }
    let n = directions.len();
    let both = |i: usize, j: usize| directions[i].dot(&feigned[j]);
    let lost = DMatrix::from_fn(n, n, |i, j| 0.5 * (both(i, j) + both(j, i))).symmetric_eigen();
    let kept = DMatrix::from_diagonal(&lost.eigenvalues.map(|share| share.clamp(0.0, MAX_LOSS)));
    let spanned = normal * DMatrix::from_columns(&directions) * lost.eigenvectors;
    Ok(normal - &spanned * kept * spanned.transpose())
}

/// Half of what a direction changes of the gradient, the groups' own parameters settled; `there`: room.
fn half_gradient_change<L>(
    (system, there): (&System, &mut System),
    problem: &Problem,
    state: &State,
    direction: &DVector<f64>,
    linearise: &L,
) -> Result<DVector<f64>, EstimationError>
where
    L: Fn(&GroupPoint, &mut Vec<Linearised>) -> Result<(), EstimationError>,
{
    let (mut near, mut settled) = (state.clone(), state.clone());
    let mut side = |by: f64| {
        system.apply_step(problem, state, &(direction * by), &mut near);
        there.assemble(problem, &near, linearise)?;
        there.apply_step(problem, &near, &(direction * 0.0), &mut settled);
        there.assemble(problem, &settled, linearise)?;
        Ok::<_, EstimationError>(there.right.clone())
    };
    let (ahead, behind) = (side(DIFFERENCE_STEP)?, side(-DIFFERENCE_STEP)?);
    Ok((behind - ahead) / (2.0 * DIFFERENCE_STEP))
}
