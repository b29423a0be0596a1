//! Input of the spatial methods.

use super::scene::WingScene;
use super::{AdjustError, AdjustResult, Observation, Options};
use crate::setup::{Orientation, Setup};

/// Installation, orientation and options of an adjustment.
#[derive(Clone, Copy)]
pub struct AdjustmentInput<'a> {
    pub setup: &'a Setup,
    /// Rotation and image observations of the ground frames.
    pub orientation: &'a Orientation,
    /// Model of the installation, prepared for evaluation.
    pub scene: &'a WingScene,
    pub options: &'a Options,
}

/// Observations of one frame, one entry per marker of the survey.
pub type FrameObservations<'a> = Vec<Option<&'a Observation>>;

/// Sorts observations into the survey's order.
///
/// # Errors
/// Returns an error if an observation is not finite and positive definite, or its marker is not in the survey.
pub fn order_by_marker<'a>(
    setup: &Setup,
    observations: &'a [Observation],
) -> AdjustResult<FrameObservations<'a>> {
    let mut list = vec![None; setup.markers.len()];
    for o in observations {
        let finite = o
            .pixel
            .iter()
            .chain(o.covariance_px2.iter())
            .all(|v| v.is_finite());
        if !finite || o.covariance_px2.cholesky().is_none() {
            return Err(AdjustError::Input(
                "an image coordinate or its standard deviation is not a finite, positive number"
                    .into(),
            ));
        }
        let slot = list.get_mut(o.marker).ok_or_else(|| {
            AdjustError::Input("an observation names a marker that the survey does not list".into())
        })?;
        *slot = Some(o);
    }
    Ok(list)
}

/// Counts a frame's observations of markers on the wing.
pub fn count_wing_markers(setup: &Setup, frame: &[Option<&Observation>]) -> usize {
    setup
        .markers
        .iter()
        .zip(frame)
        .filter(|(m, seen)| !m.fixed && seen.is_some())
        .count()
}
