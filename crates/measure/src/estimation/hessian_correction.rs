//! Second derivatives of the sum of squares that remains after the groups' own parameters are eliminated.
//!
//! If a derivative with respect to a shared parameter depends on a group's own parameters (for example, root position and
//! bending), it contains their noise, and its square counts in the normal matrix as if it were signal: errors in variables
//! (Fuller 1987). The effect is negligible in one group and adds up over many if few other observations constrain the
//! parameter. It concerns few directions, which a Lanczos iteration finds from a first one.

use nalgebra::{DMatrix, DVector};

use super::error::{EstimationError, EstimationResult};
use super::problem::{GroupPoint, Linearised, Problem};
use super::state::EstimationState;
use super::system::NormalEquations;

/// Maximum number of directions; in flights two or three differ from the normal matrix.
const MAX_DIRECTIONS: usize = 4;
/// Step of the differences to either side, in standard deviations.
const DIFFERENCE_STEP: f64 = 0.3;
/// Length below which a direction counts as spanned by the directions before it.
const MIN_NEW_LENGTH: f64 = 1e-3;
/// Largest fraction of the normal matrix that may be lost along a direction, so that the rest stays regular.
const MAX_LOSS: f64 = 0.98;

/// Returns half the Hessian of the sum: the normal matrix `N`, corrected along Lanczos directions by differences of
/// the gradient. `start`: a direction with a known difference, `start' N start = 1`; `system`: the equations at the state.
pub(super) fn half_hessian<L>(
    system: &NormalEquations,
    problem: &Problem,
    state: &EstimationState,
    start: DVector<f64>,
    linearise: &L,
) -> EstimationResult<DMatrix<f64>>
where
    L: Fn(&GroupPoint, &mut Vec<Linearised>) -> EstimationResult<()>,
{
    let normal = &system.normal;
    let mut directions: Vec<DVector<f64>> = vec![];
    // Excess of the normal matrix along the directions.
    let mut excess: Vec<DVector<f64>> = vec![];
    let mut next = start;
    let mut there = NormalEquations::new(problem)?;
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
        let difference = normal * &next
            - half_gradient_change((system, &mut there), problem, state, &next, linearise)?;
        directions.push(next);
        next = system.solve_right_side(problem, &difference)?;
        excess.push(difference);
    }
    let n = directions.len();
    let both = |i: usize, j: usize| directions[i].dot(&excess[j]);
    let lost = DMatrix::from_fn(n, n, |i, j| 0.5 * (both(i, j) + both(j, i))).symmetric_eigen();
    let kept = DMatrix::from_diagonal(&lost.eigenvalues.map(|share| share.clamp(0.0, MAX_LOSS)));
    let spanned = normal * DMatrix::from_columns(&directions) * lost.eigenvectors;
    Ok(normal - &spanned * kept * spanned.transpose())
}

/// Returns half the change of the gradient along a direction, with the groups' own parameters settled; `there` is
/// workspace.
fn half_gradient_change<L>(
    (system, there): (&NormalEquations, &mut NormalEquations),
    problem: &Problem,
    state: &EstimationState,
    direction: &DVector<f64>,
    linearise: &L,
) -> EstimationResult<DVector<f64>>
where
    L: Fn(&GroupPoint, &mut Vec<Linearised>) -> EstimationResult<()>,
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
