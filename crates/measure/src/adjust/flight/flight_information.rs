//! Information of a flight's images about the flight-invariant parameters.

use nalgebra::DVector;

use super::flight_problem::FlightProblem;
use super::joint::JointSolution;
use super::solving::SolvedFlight;
use crate::adjust::flight_prior::{FlightContribution, InvariantParameter, ReducedNormals};
use crate::adjust::snooping::ResidualSum;
use crate::adjust::{AdjustError, AdjustResult, Estimate, GlobalTest, Observation, Options};
use crate::estimation::quality::global_test;
use crate::estimation::{Fit, Prior, normal_equations_at};
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
    let invariant: Vec<usize> = flight_problem
        .invariant
        .iter()
        .map(|(_, column)| *column)
        .collect();
    let flight_own: Vec<usize> = (0..fit.global.len())
        .filter(|column| !invariant.contains(column))
        .collect();
    let is_own = |prior: &&Prior| {
        prior
            .columns
            .iter()
            .all(|column| flight_own.contains(column))
    };
    let (problem, frames) = (&flight_problem.problem, flight_problem.layouts.len());
    let (normal, right) = normal_equations_at(
        fit,
        0..frames,
        &problem.groups[..frames],
        problem.priors.iter().filter(is_own).cloned().collect(),
    )
    .ok()?;
    let of_own = normal.select_columns(&flight_own);
    let factor = of_own.select_rows(&flight_own).cholesky()?;
    let coupling = of_own.select_rows(&invariant);
    let invariant_block = normal.select_columns(&invariant).select_rows(&invariant);
    let normal = invariant_block - &coupling * factor.solve(&coupling.transpose());
    let normal = (&normal + normal.transpose()) * 0.5;
    // The gradient with respect to the flight's own unknowns is 0 at the solution.
    let value = fit.global.select_rows(&invariant) - flight_problem.nominal.select_rows(&invariant);
    let right = &normal * value + right.select_rows(&invariant);
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
