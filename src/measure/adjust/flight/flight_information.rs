//! What a flight's images tell of all that stays the same from flight to flight.

use nalgebra::{DMatrix, DVector};

use super::flight_problem::FlightProblem;
use super::joint::Joint;
use super::solving::Solved;
use crate::adjust::flight_prior::{FlightContribution, InvariantParameter, ReducedNormals, SURVEY};
use crate::adjust::{AdjustError, Estimate, GlobalTest, Observation, Options};
use crate::estimation::quality::global_test;
use crate::estimation::{Block, BlockFit, Fit, Group, GroupFit, Prior};
use crate::setup::{Orientation, Setup};

/// A flight's normal equations for what flights have in common, reduced by all else; at the joint solution of its frames.
///
/// # Errors
/// Where the flight cannot be solved, or its global test rejects: what contradicts the model teaches nothing.
pub fn learn(
    setup: &Setup,
    orientation: &Orientation,
    frames: &[Vec<Observation>],
    options: &Options,
) -> Result<FlightContribution, AdjustError> {
    let scene = crate::adjust::scene::Scene::new(setup, orientation)?;
    let input = crate::adjust::input::Input { setup, orientation, scene: &scene, options };
    let Joint { solved, .. } = Joint::new(input, frames)?;
    let Solved { setting, fit, judged } = &solved;
    let (omega, redundancy) = judged.map_or((fit.omega, fit.redundancy), |j| (j.omega, j.redundancy));
    if global_test(omega, redundancy, options.global_alpha) == GlobalTest::Rejected {
        let beside = if options.flight_prior.is_some() { " beside what other flights taught" } else { "" };
        return Err(AdjustError::Input(format!(
            "the global test rejects it{beside} (variance factor {:.1}); what contradicts the model, or was flown with a \
             changed installation, teaches nothing",
            omega / redundancy.max(1) as f64
        )));
    }
    let singular = || AdjustError::Input("the flight's normal equations are singular".into());
    let normals = reduced(setting, fit).ok_or_else(singular)?;
    let known = |(_, column): &(InvariantParameter, usize)| Estimate {
        value: fit.global[*column] - setting.stated[*column],
        sigma: Some(fit.covariance[(*column, *column)].max(0.0).sqrt()),
    };
    Ok(FlightContribution { normals, known: setting.lasting.iter().map(known).collect() })
}

fn reduced(setting: &FlightProblem, fit: &Fit) -> Option<ReducedNormals> {
    let p = fit.global.len();
    let (mut normal, mut gradient) = (DMatrix::zeros(p, p), DVector::zeros(p));
    let frames = setting.problem.groups.iter().zip(&fit.groups).take(setting.layouts.len());
    for (group, solved) in frames {
        add_frame(group, solved, &mut normal, &mut gradient)?;
    }
    let lasting: Vec<usize> = setting.lasting.iter().map(|(_, column)| *column).collect();
    let own: Vec<usize> = (0..p).filter(|column| !lasting.contains(column)).collect();
    let is_own = |prior: &&Prior| prior.columns.iter().all(|column| own.contains(column));
    for prior in setting.problem.priors.iter().filter(is_own) {
        let weight = prior.covariance.clone().cholesky()?.inverse();
        for (i, row) in prior.columns.iter().enumerate() {
            prior.columns.iter().enumerate().for_each(|(j, c)| normal[(*row, *c)] += weight[(i, j)]);
        }
    }
    let of_own = normal.select_columns(&own);
    let factor = of_own.select_rows(&own).cholesky()?;
    let coupling = of_own.select_rows(&lasting);
    let kept = normal.select_columns(&lasting).select_rows(&lasting);
    let normal = kept - &coupling * factor.solve(&coupling.transpose());
    let normal = (&normal + normal.transpose()) * 0.5;
    // The gradient by what is the flight's own is 0 at the solution.
    let value = fit.global.select_rows(&lasting) - setting.stated.select_rows(&lasting);
    let right = &normal * value - gradient.select_rows(&lasting);
    let unknowns: Vec<InvariantParameter> =
        setting.lasting.iter().map(|(lasting, _)| lasting.clone()).collect();
    Some(ReducedNormals { unknowns, normal, right, sigmas: sigmas(setting, fit) })
}

/// Of what flights have in common without their images, as stated; of the rotation on ground, which only the ground frames
/// tell, as solved.
fn sigmas(setting: &FlightProblem, fit: &Fit) -> DVector<f64> {
    let mut sigmas = fit.covariance.diagonal().map(|variance| variance.max(f64::MIN_POSITIVE).sqrt());
    for prior in &setting.problem.priors {
        let own = prior.columns.iter().enumerate();
        own.for_each(|(k, column)| sigmas[*column] = prior.covariance[(k, k)].sqrt());
    }
    let ground = setting.problem.groups.last().into_iter().flat_map(|group| &group.blocks);
    for (member, block) in setting.ground_members.iter().zip(ground) {
        let of = |(lasting, _): &&(InvariantParameter, usize)| {
            lasting.term == SURVEY && lasting.marker == Some(member.marker)
        };
        for (lasting, column) in setting.lasting.iter().filter(of) {
            sigmas[*column] = block.covariance[(lasting.index, lasting.index)].sqrt();
        }
    }
    let lasting: Vec<usize> = setting.lasting.iter().map(|(_, column)| *column).collect();
    sigmas.select_rows(&lasting)
}

/// Adds a frame's normal equations, reduced by its own unknowns, and the gradient of half its sum of squares.
fn add_frame(
    group: &Group,
    solved: &GroupFit,
    normal: &mut DMatrix<f64>,
    gradient: &mut DVector<f64>,
) -> Option<()> {
    let (p, q) = (normal.nrows(), solved.local.len());
    let mut all = DMatrix::zeros(p + q, p + q);
    for (block, fit) in group.blocks.iter().zip(&solved.blocks) {
        let (rows, right) = whitened(block, fit, p)?;
        all.gemm_tr(1.0, &rows, &rows, 1.0);
        gradient.gemv_tr(1.0, &rows.columns(0, p), &right, 1.0);
    }
    for prior in &group.priors {
        let weight = prior.covariance.clone().cholesky()?.inverse();
        for (i, row) in prior.columns.iter().enumerate() {
            prior.columns.iter().enumerate().for_each(|(j, c)| all[(p + row, p + c)] += weight[(i, j)]);
        }
    }
    let coupling = all.view((0, p), (p, q)).into_owned();
    let local = all.view((p, p), (q, q)).into_owned().cholesky()?;
    *normal += all.view((0, 0), (p, p)) - &coupling * local.solve(&coupling.transpose());
    Some(())
}

/// A block's conditions, each of unit variance: derivatives by global, then by local parameters, and what is open.
fn whitened(block: &Block, fit: &BlockFit, p: usize) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let lin = &fit.linearised;
    let covariance = &lin.observations * &block.covariance * lin.observations.transpose();
    let lower = covariance.cholesky()?.l();
    let mut rows = DMatrix::zeros(lin.misclosure.len(), p + lin.local.ncols());
    for (column, by) in lin.columns.iter().zip(lin.global.column_iter()) {
        rows.column_mut(*column).axpy(1.0, &by, 1.0);
    }
    rows.columns_mut(p, lin.local.ncols()).copy_from(&lin.local);
    let open = &lin.misclosure - &lin.observations * &fit.residuals;
    Some((lower.solve_lower_triangular(&rows)?, lower.solve_lower_triangular(&open)?))
}
