//! Plan of an installation: that of a wing of which only the main dimensions are known, precision with several frames or
//! a prior, and the layout to be written.

use std::path::Path;

use serde::Serialize;

use wingd_base::failure::{CHECK_WRITE_ACCESS, Failure, TaskResult};
use wingd_evaluation::installation;
use wingd_evaluation::installation::{DEFAULT_CENTRE_SIGMA_M, Installation};
use wingd_measure::plan;
use wingd_measure::plan::LayoutDraft;
use wingd_measure::plan::LayoutPrecision;
use wingd_measure::plan::PlanOptions;
use wingd_measure::setup::SetupUncertainty;
use wingd_measure::setup::{Setup, WingSide};

/// Creates the failure of a plan.
pub fn plan_failure(error: impl std::fmt::Display) -> Failure {
    Failure::Failed(format!("no plan: {error}"))
}

/// Predicted precision of several frames adjusted jointly, or of frames with the prior from earlier flights.
#[derive(Serialize)]
pub struct FlightPrecision {
    /// Number of flights of the prior; `None` without a prior.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flights: Option<usize>,
    pub frames: usize,
    pub expected: LayoutPrecision,
}

/// Predicts the precision of several frames; `None` for a single frame.
///
/// # Errors
/// Returns an error if the layout cannot be adjusted.
pub fn flight_precision(
    installation: &Installation,
    options: &PlanOptions,
    frames: usize,
) -> TaskResult<Option<FlightPrecision>> {
    if frames == 1 {
        return Ok(None);
    }
    let Installation {
        setup, orientation, ..
    } = installation;
    let expected = plan::predict_precision(setup, orientation.as_ref(), options, frames, None)
        .map_err(plan_failure)?;
    Ok(Some(FlightPrecision {
        flights: None,
        frames,
        expected,
    }))
}

/// Predicts the precision with the flight prior; `None` without a prior.
///
/// # Errors
/// Returns an error if the layout cannot be adjusted.
pub fn prior_precision(
    installation: &Installation,
    options: &PlanOptions,
    frames: usize,
) -> TaskResult<Option<FlightPrecision>> {
    let Installation {
        setup,
        orientation,
        flight_prior: stored,
        ..
    } = installation;
    let Some(stored) = stored else {
        return Ok(None);
    };
    let Some(prior) = stored.prior_without(&[], setup) else {
        return Ok(None);
    };
    let expected =
        plan::predict_precision(setup, orientation.as_ref(), options, frames, Some(&prior));
    Ok(Some(FlightPrecision {
        flights: Some(stored.flights.len()),
        frames,
        expected: expected.map_err(plan_failure)?,
    }))
}

/// Creates an installation of a wing with the best layout of those tried.
///
/// # Errors
/// Returns an error if no layout can be adjusted.
pub fn draft_installation(
    draft: &LayoutDraft,
    options: &PlanOptions,
    frames: usize,
) -> TaskResult<Installation> {
    let folder = tempfile::tempdir()
        .map_err(|e| Failure::Failed(format!("no temporary folder: {e}; {CHECK_WRITE_ACCESS}")))?;
    let mut first = setup_without_markers(draft);
    first.markers = plan::even_layout(draft, options.tip_deflection_m);
    write_setup(folder.path(), &first, None, [""; 2])?;
    let mut installation = installation::load(folder.path()).map_err(|faults| {
        let why = faults.first().map_or("", |fault| fault.problem.as_str());
        let (count, span_m) = (first.markers.len(), draft.span_m);
        let remedy = "plan fewer --markers, or smaller ones";
        Failure::Failed(format!(
            "{count} markers do not fit on a wing of {span_m} m: one {why}; {remedy}"
        ))
    })?;
    installation.setup =
        plan::best_layout(draft, &installation.setup, options, frames).map_err(plan_failure)?;
    Ok(installation)
}

/// Returns the setup of the wing without its markers; other values are the defaults of an installation.
fn setup_without_markers(draft: &LayoutDraft) -> Setup {
    Setup {
        name: format!("plan of a wing of {} m", draft.span_m),
        lens: draft.lens,
        projection_centre_m: nalgebra::Vector3::zeros(),
        projection_centre_sigma_m: 0.002,
        mount_repeatability_px: 10.0,
        span_direction: nalgebra::Vector2::new(1.0, 0.0),
        flow_direction: None,
        configured_side: Some(draft.side),
        root_offset_m: DEFAULT_ROOT_OFFSET_M.min(0.1 * draft.span_m),
        axis_chord_offset_m: None,
        breaks: vec![],
        skin_height: None,
        uncertainty: SetupUncertainty::default_for(draft.span_m),
        thermal: None,
        torsion: vec![],
        markers: vec![],
        window: None,
    }
}

/// Distance from the camera to the bending root, as in the template of `wingd init`.
const DEFAULT_ROOT_OFFSET_M: f64 = 0.6;

/// Returns the setup of a drafted wing with the values that are known: of its layout, those that the user gave.
pub fn drafted_facts(layout: &Setup, side: Option<WingSide>) -> Setup {
    Setup {
        configured_side: side,
        projection_centre_sigma_m: DEFAULT_CENTRE_SIGMA_M,
        uncertainty: SetupUncertainty::default_for(layout.reach_m()),
        thermal: None,
        ..layout.clone()
    }
}

/// Writes a layout: `installation.toml`, in which values of the plan that are not `facts` are comments, `camera.toml`,
/// and `survey.csv` to be replaced by the true survey.
///
/// # Errors
/// Returns an error if a file cannot be written.
pub fn write_layout(folder: &Path, setup: &Setup, facts: &Setup) -> TaskResult<()> {
    let fixed = if setup.markers.iter().any(|m| m.fixed) {
        "# F01 and so on: near these directions from the lens, as far as something rigid to the cabin is in view and sharp\n\
         # (wing-body fairing, root fillet; not pylon or nacelle), without those for which there is no place.\n"
    } else {
        ""
    };
    let heads = [
        "# Written by wingd plan. The survey frame has its origin in the lens, x outboard, z up: replace projection_centre_m,\n\
         # root_offset_m and mount_repeatability_px by yours. Lines that begin with # are assumptions of the plan: if one is\n\
         # true, delete its # and \"assumed\"; without them results are less precise than planned.\n",
        &format!(
            "# A template: glue the markers near these positions, then replace the numbers by those of the total station.\n{fixed}"
        ),
    ];
    write_setup(folder, setup, Some(facts), heads)
}

fn write_setup(
    folder: &Path,
    setup: &Setup,
    facts: Option<&Setup>,
    heads: [&str; 2],
) -> TaskResult<()> {
    installation::write_installation(folder, setup, facts, heads)
        .map_err(|(file, error)| Failure::from_write_error(&file, &error, CHECK_WRITE_ACCESS))
}
