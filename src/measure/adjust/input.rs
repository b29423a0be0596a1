//! What the spatial methods start from.

use super::scene::Scene;
use super::{AdjustError, Observation, Options};
use crate::setup::{Orientation, Setup};

/// What a frame is set up from.
#[derive(Clone, Copy)]
pub struct Input<'a> {
    /// The installation.
    pub setup: &'a Setup,
    /// The ground frames' rotation and sights.
    pub orientation: &'a Orientation,
    /// The installation, prepared.
    pub scene: &'a Scene,
    /// Choices.
    pub options: &'a Options,
}

/// A frame's observations, per marker of the survey.
pub type Sights<'a> = Vec<Option<&'a Observation>>;

/// Reads observations into the survey's order.
pub fn by_marker<'a>(setup: &Setup, observations: &'a [Observation]) -> Result<Sights<'a>, AdjustError> {
    let mut list = vec![None; setup.markers.len()];
    for o in observations {
        let finite = o.pixel.iter().chain(o.covariance_px2.iter()).all(|v| v.is_finite());
        if !finite || o.covariance_px2.cholesky().is_none() {
            return Err(AdjustError::Input(
                "an image coordinate or its standard deviation is not a finite, positive number".into(),
            ));
        }
        let slot = list.get_mut(o.marker).ok_or_else(|| {
            AdjustError::Input("an observation names a marker that the survey does not list".into())
        })?;
        *slot = Some(o);
    }
    Ok(list)
}

/// How many of a frame's observations are of markers on the wing.
pub fn on_the_wing(setup: &Setup, frame: &[Option<&Observation>]) -> usize {
    setup.markers.iter().zip(frame).filter(|(m, seen)| !m.fixed && seen.is_some()).count()
}
