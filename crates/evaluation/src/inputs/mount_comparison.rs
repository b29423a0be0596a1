//! Movement of the camera between frames of a static scene.

use nalgebra::Vector3;

use crate::pipeline::ProcessedFrame;
use crate::record::Reason;
use wingd_measure::identify;
use wingd_measure::mount;
use wingd_measure::mount::{CameraMovement, MarkerShift};
use wingd_measure::observation::Observation;
use wingd_measure::setup::Setup;
use wingd_measure::setup::Width;

/// Maximum ratio of a movement's component to its standard deviation that is expected.
const MAX_NORMALIZED: f64 = 3.0;

/// A frame's marker images, and the surveyed markers in camera coordinates.
pub struct MountFrame {
    pub name: String,
    observations: Vec<Observation>,
    points_m: Vec<Vector3<f64>>,
}

/// Orients a ground frame.
///
/// # Errors
/// Returns the reason why the frame has no orientation.
pub fn orient_frame(setup: &Setup, processed: &ProcessedFrame) -> Result<MountFrame, Reason> {
    if let Some(reason) = &processed.failure {
        return Err(reason.clone().with_context(&processed.image));
    }
    let detections = vec![processed.detections.markers.clone()];
    let fit = identify::estimate_orientation(setup, &detections)
        .map_err(|e| Reason::from_error(e).with_context(&processed.image))?;
    let into_camera = |k: usize| {
        let from_centre = setup.markers[k].position_m - setup.projection_centre_m;
        fit.orientation.camera_from_survey * from_centre
    };
    Ok(MountFrame {
        name: processed.image.clone(),
        observations: fit.ground_observations(setup, &detections),
        points_m: (0..setup.markers.len()).map(into_camera).collect(),
    })
}

/// Estimates the movement of the camera from the first frame to the other.
///
/// # Errors
/// Returns an error if the frames have fewer than three markers in common.
pub fn compare_frames(
    setup: &Setup,
    first: &MountFrame,
    other: &MountFrame,
) -> Result<CameraMovement, Reason> {
    let pair = |before: &Observation| {
        let after = other
            .observations
            .iter()
            .find(|s| s.marker == before.marker)?;
        Some(MarkerShift {
            point_m: first.points_m[before.marker],
            moved_px: after.pixel - before.pixel,
            covariance_px2: before.covariance_px2 + after.covariance_px2,
        })
    };
    let pairs: Vec<MarkerShift> = first.observations.iter().filter_map(pair).collect();
    // The prior is so wide that the frames alone determine any real shift.
    mount::estimate_movement(&setup.lens, &pairs, SHIFT_PRIOR_SIGMA_M).ok_or_else(|| {
        let (first, other) = (&first.name, &other.name);
        format!(
            "{first} and {other} have {} markers in common, but 3 are needed",
            pairs.len()
        )
        .into()
    })
}

/// Prior standard deviation of the shift between two frames, m: wider than any real one.
const SHIFT_PRIOR_SIGMA_M: f64 = 0.1;

/// Verdict on a movement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MountVerdict {
    /// No more than the drift within one mounting.
    OneMounting,
    /// No more than the tolerance between two mountings.
    Remounted,
    /// More than the installation expects.
    Moved,
}

impl MountVerdict {
    /// Compares a movement with the expectations of the setup.
    pub fn new(m: &CameraMovement, setup: &Setup) -> Self {
        let priors = &setup.uncertainty;
        let turned = setup.mount_repeatability_px / setup.lens.focal_px();
        let is_within = |rotation_rad: f64, shift_m: f64| {
            is_within(&m.rotation_rad, &m.rotation_sigma_rad, rotation_rad)
                && is_within(&m.shift_m, &m.shift_sigma_m, shift_m)
        };
        match (
            is_within(priors[Width::MountDrift], 0.0),
            is_within(turned, priors[Width::MountShift]),
        ) {
            (true, _) => Self::OneMounting,
            (false, true) => Self::Remounted,
            _ => Self::Moved,
        }
    }
}

/// Returns whether a movement is consistent with its standard deviation and the expected one.
fn is_within(value: &Vector3<f64>, sigma: &Vector3<f64>, expected: f64) -> bool {
    value
        .iter()
        .zip(sigma.iter())
        .all(|(v, s)| v.abs() <= MAX_NORMALIZED * s.hypot(expected))
}
