//! Result of one frame from a flight's solution.

use super::frames::Flight;
use super::solving::SolvedFlight;
use super::tuning::STEADY_ROTATION_RAD;
use super::usage::RemovedObservation;
use crate::adjust::budget;
use crate::adjust::snooping::{SuspectTarget, fixed_target_remark};
use crate::adjust::terms::mount_drift_rad;
use crate::adjust::{Estimate, Parameter, ParameterKind, Solution};
use crate::estimation::{AttributedInformation, VarianceSources};

/// Ratio of the estimated to the configured drift from which a remark is added.
const REMARKED_DRIFT_RATIO: f64 = 3.0;

/// Builds the result of one frame of a flight: its part of the solution and the observations removed from it or from all
/// frames. `remarks` come first. A result of the flight method has the parameters that only several frames determine.
pub fn frame_solution(
    flight: &Flight,
    solved: &SolvedFlight,
    removed: &[RemovedObservation],
    frame: usize,
    of_flight: bool,
    mut remarks: Vec<String>,
    sources: &VarianceSources,
) -> Solution {
    let SolvedFlight {
        flight_problem,
        fit,
        ..
    } = solved;
    let stayed = flight.hyperparameters.mountings.is_ground_mounting(0);
    let outcome = solved
        .frame_outcome(&flight.input, frame)
        .with_causes(&flight.widened, stayed);
    let of_frame = removed
        .iter()
        .filter(|r| r.group == frame || r.suspect.target == SuspectTarget::Survey);
    let mut solution = outcome.solution(of_frame.map(|r| &r.suspect), sources);
    if of_flight {
        let unmeasured = |kind, value| Parameter {
            kind,
            values: vec![Estimate { value, sigma: None }],
        };
        solution.parameters.push(unmeasured(
            ParameterKind::ShapeDeparture,
            flight.hyperparameters.departure,
        ));
        solution.parameters.push(unmeasured(
            ParameterKind::MountDrift,
            flight.hyperparameters.drift_rad,
        ));
    }
    remarks.extend(solution.remarks);
    remarks.extend(fixed_target_remark(flight.prior_scales.fixed_targets));
    let displacement = flight
        .common_displacement
        .as_ref()
        .zip(flight_problem.displacement_column);
    remarks
        .extend(displacement.map(|(displacement, column)| displacement.remark(fit.global[column])));
    remarks.extend(flight.exceedance_remarks());
    Solution {
        remarks,
        ..solution
    }
}

/// Calls `with` with the error sources of a flight's solution.
pub fn with_flight_sources<T>(
    SolvedFlight {
        flight_problem,
        fit,
        ..
    }: &SolvedFlight,
    attributed: Option<&AttributedInformation>,
    with: impl FnOnce(&VarianceSources) -> T,
) -> T {
    budget::with_variance_sources(
        flight_problem.block_members(),
        &flight_problem.problem,
        fit,
        attributed,
        with,
    )
}

/// Remarks about the prior from earlier flights.
pub fn prior_remarks(flight: &Flight, solved: &SolvedFlight) -> Vec<String> {
    let prior = flight.input.options.flight_prior.as_deref();
    prior
        .map(|prior| prior.remark(solved.flight_problem.problem.known.is_some()))
        .into_iter()
        .collect()
}

/// Remarks about a frame in relation to the flight.
pub fn flight_remarks(flight: &Flight, frame: usize) -> Vec<String> {
    let hyperparameters = &flight.hyperparameters;
    let mountings = &hyperparameters.mountings;
    let origin = if mountings.are_specified() {
        "as specified"
    } else {
        "detected from the frames"
    };
    let mut remarks = vec![format!(
        "adjusted jointly: {} frames in {} mounting(s) ({origin}), this one in mounting {}; shapes differ from the shared one by {:.1} % of the prior spread",
        flight.frames.len(),
        mountings.count(),
        mountings.mounting_of_frame(frame) + 1,
        1e2 * hyperparameters.departure
    )];
    if flight.prior_scales.stabilised_px > 0.0 {
        remarks.push(
            "the image shifted from frame to frame as no rotation of the camera explains: stabilisation of lens or sensor. \
             Switch it off, or set camera.stabilised_px; here 50 px were used"
                .into(),
        );
    }
    let mut exceed = |motion, rad: f64, remedy| {
        remarks.push(format!(
            "{motion} by about {:.2} mrad, more than camera.mount_drift_mrad; the larger drift was used. Check {remedy}",
            1e3 * rad
        ));
    };
    if hyperparameters.sags {
        let trend = hyperparameters.pitch_trend_rad();
        exceed(
            "the camera's pitch drifted through the flight",
            trend,
            "whether its mount sags",
        );
    }
    let configured = mount_drift_rad(flight.input.setup).max(STEADY_ROTATION_RAD);
    if hyperparameters.drift_rad > REMARKED_DRIFT_RATIO * configured {
        let rotated = "the camera rotated from frame to frame within its mountings";
        exceed(rotated, hyperparameters.drift_rad, "its mount");
    }
    remarks
}
