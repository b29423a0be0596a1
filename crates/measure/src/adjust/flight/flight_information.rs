//! Information of a flight's images about the flight-invariant parameters.

use nalgebra::{DMatrix, DVector};

use super::flight_problem::FlightProblem;
use super::joint::JointSolution;
use super::solving::SolvedFlight;
use crate::adjust::flight_prior::{FlightContribution, InvariantParameter, ReducedNormals};
use crate::adjust::snooping::ResidualSum;
use crate::adjust::{AdjustError, AdjustResult, Estimate, GlobalTest, Observation, Options};
use crate::estimation::quality::global_test;
use crate::estimation::{Block, BlockFit, Fit, Group, GroupFit, Prior};
use crate::setup::{Orientation, Setup};
use crate::widths::Unknown;

/// Computes a flight's normal equations for the flight-invariant parameters, reduced by all other unknowns, at the joint
/// solution of its frames.
///
/// # Errors
/// Returns an error if the flight cannot be solved, or if its global test rejects the model, if the images have another scale, or stated
/// widths are contradicted given the prior from other flights: a flight that contradicts the model must not contribute to the prior.
pub fn learn_from_flight(
    setup: &Setup,
    orientation: &Orientation,
    frames: &[Vec<Observation>],
    options: &Options,
) -> AdjustResult<FlightContribution> {
    let scene = crate::adjust::scene::WingScene::new(setup, orientation)?;
    let input = crate::adjust::input::AdjustmentInput {
        setup,
        orientation,
        scene: &scene,
        options,
    };
    let JointSolution { flight, solved, .. } = JointSolution::new(input, frames)?;
    let SolvedFlight {
        flight_problem,
        fit,
        tested_sum,
    } = &solved;
    let (omega, redundancy) = ResidualSum::tested(*tested_sum, fit);
    let causes = &flight.widened;
    let is_other = causes.has_image_cause() || options.flight_prior.is_some() && !causes.is_empty();
    if global_test(omega, redundancy, options.global_alpha) == Some(GlobalTest::Rejected)
        || is_other
    {
        let test = if is_other {
            "the flight contradicts configured prior standard deviations"
        } else {
            "the global test rejects the flight"
        };
        let given = if options.flight_prior.is_some() {
            " given the prior from other flights"
        } else {
            ""
        };
        return Err(AdjustError::Input(format!(
            "{test}{given} (variance factor {:.1}): it contradicts the model or was flown with a changed installation, and \
             was not used",
            omega / redundancy.max(1) as f64
        )));
    }
    let singular = || AdjustError::Input("the flight's normal equations are singular".into());
    let normals = reduce_to_invariant_parameters(flight_problem, fit).ok_or_else(singular)?;
    let known = |(_, column): &(InvariantParameter, usize)| Estimate {
        value: fit.global[*column] - flight_problem.nominal[*column],
        sigma: Some(fit.covariance[(*column, *column)].max(0.0).sqrt()),
    };
    Ok(FlightContribution {
        normals,
        posterior: flight_problem.invariant.iter().map(known).collect(),
    })
}

fn reduce_to_invariant_parameters(
    flight_problem: &FlightProblem,
    fit: &Fit,
) -> Option<ReducedNormals> {
    let p = fit.global.len();
    let (mut normal, mut gradient) = (DMatrix::zeros(p, p), DVector::zeros(p));
    let frames = flight_problem
        .problem
        .groups
        .iter()
        .zip(&fit.groups)
        .take(flight_problem.layouts.len());
    for (group, solved) in frames {
        add_frame_normals(group, solved, &mut normal, &mut gradient)?;
    }
    let invariant: Vec<usize> = flight_problem
        .invariant
        .iter()
        .map(|(_, column)| *column)
        .collect();
    let flight_own: Vec<usize> = (0..p)
        .filter(|column| !invariant.contains(column))
        .collect();
    let is_own = |prior: &&Prior| {
        prior
            .columns
            .iter()
            .all(|column| flight_own.contains(column))
    };
    for prior in flight_problem.problem.priors.iter().filter(is_own) {
        add_weight(prior, 0, &mut normal)?;
    }
    let of_own = normal.select_columns(&flight_own);
    let factor = of_own.select_rows(&flight_own).cholesky()?;
    let coupling = of_own.select_rows(&invariant);
    let invariant_block = normal.select_columns(&invariant).select_rows(&invariant);
    let normal = invariant_block - &coupling * factor.solve(&coupling.transpose());
    let normal = (&normal + normal.transpose()) * 0.5;
    // The gradient with respect to the flight's own unknowns is 0 at the solution.
    let value = fit.global.select_rows(&invariant) - flight_problem.nominal.select_rows(&invariant);
    let right = &normal * value - gradient.select_rows(&invariant);
    let unknowns: Vec<InvariantParameter> = flight_problem
        .invariant
        .iter()
        .map(|(invariant, _)| *invariant)
        .collect();
    Some(ReducedNormals {
        unknowns,
        normal,
        right,
        sigmas: invariant_sigmas(flight_problem, fit),
    })
}

/// Standard deviations of the invariant parameters without the flight's images: prior values; for the rotation on the
/// ground, which only the ground frames determine, the solved values.
fn invariant_sigmas(flight_problem: &FlightProblem, fit: &Fit) -> DVector<f64> {
    let mut sigmas = fit
        .covariance
        .diagonal()
        .map(|variance| variance.max(f64::MIN_POSITIVE).sqrt());
    for prior in &flight_problem.problem.priors {
        let flight_own = prior.columns.iter().enumerate();
        flight_own.for_each(|(k, column)| sigmas[*column] = prior.covariance[(k, k)].sqrt());
    }
    let ground = flight_problem
        .problem
        .groups
        .last()
        .into_iter()
        .flat_map(|group| &group.blocks);
    for (member, block) in flight_problem.ground_members.iter().zip(ground) {
        let of_marker = |(invariant, _): &&(InvariantParameter, usize)| {
            invariant.unknown == Unknown::Survey && invariant.marker == Some(member.marker)
        };
        for (invariant, column) in flight_problem.invariant.iter().filter(of_marker) {
            sigmas[*column] = block.covariance[(invariant.index, invariant.index)].sqrt();
        }
    }
    let invariant: Vec<usize> = flight_problem
        .invariant
        .iter()
        .map(|(_, column)| *column)
        .collect();
    sigmas.select_rows(&invariant)
}

/// Adds a frame's normal equations, reduced by its own unknowns, and the gradient of half its sum of squares.
pub(super) fn add_frame_normals(
    group: &Group,
    solved: &GroupFit,
    normal: &mut DMatrix<f64>,
    gradient: &mut DVector<f64>,
) -> Option<()> {
    let (p, q) = (normal.nrows(), solved.local.len());
    let mut all = DMatrix::zeros(p + q, p + q);
    for (block, fit) in group.blocks.iter().zip(&solved.blocks) {
        let (rows, right) = whiten_block(block, fit, p)?;
        all.gemm_tr(1.0, &rows, &rows, 1.0);
        gradient.gemv_tr(1.0, &rows.columns(0, p), &right, 1.0);
    }
    for prior in &group.priors {
        add_weight(prior, p, &mut all)?;
    }
    let coupling = all.view((0, p), (p, q)).into_owned();
    let local = all.view((p, p), (q, q)).into_owned().cholesky()?;
    *normal += all.view((0, 0), (p, p)) - &coupling * local.solve(&coupling.transpose());
    Some(())
}

/// Adds the weight of a prior to a normal matrix in which its parameters begin at column `first`.
fn add_weight(prior: &Prior, first: usize, normal: &mut DMatrix<f64>) -> Option<()> {
    let weight = prior.covariance.clone().cholesky()?.inverse();
    for (i, row) in prior.columns.iter().enumerate() {
        for (j, column) in prior.columns.iter().enumerate() {
            normal[(first + row, first + column)] += weight[(i, j)];
        }
    }
    Some(())
}

/// Scales a block's conditions to unit variance; returns the derivatives with respect to global and local parameters, and
/// the misclosures.
fn whiten_block(block: &Block, fit: &BlockFit, p: usize) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let lin = &fit.linearised;
    let covariance = &lin.observations * &block.covariance * lin.observations.transpose();
    let lower = covariance.cholesky()?.l();
    let mut rows = DMatrix::zeros(lin.misclosure.len(), p + lin.local.ncols());
    for (column, by) in lin.columns.iter().zip(lin.global.column_iter()) {
        rows.column_mut(*column).axpy(1.0, &by, 1.0);
    }
    rows.columns_mut(p, lin.local.ncols()).copy_from(&lin.local);
    let open = &lin.misclosure - &lin.observations * &fit.residuals;
    Some((
        lower.solve_lower_triangular(&rows)?,
        lower.solve_lower_triangular(&open)?,
    ))
}
