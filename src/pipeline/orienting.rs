//! Ground frames become an orientation, and with it what was not found at first is sought again.

use super::guard::BROKE_OFF;
use super::located::LOOKS;
use super::stages::{self, Sighting};
use crate::installation::Installation;
use crate::measure::detect::{self, Detection};
use crate::measure::identify::{self, IdentifyError, OrientationFit};
use crate::measure::raster::Raster;
use crate::measure::setup::Setup;
use crate::record::Reason;

/// A frame of the wing on ground.
pub struct GroundFrame {
    /// What was seen in it.
    pub sighting: Sighting,
    raster: Raster,
}

/// Decodes a ground frame and detects.
///
/// # Errors
/// The reason, where the frame cannot be read or is not of the calibrated camera's size.
pub fn sight(name: &str, bytes: &[u8], installation: &Installation) -> Result<GroundFrame, Reason> {
    let (mut sighting, raster) = stages::detect_only(name, bytes, None);
    let fault = raster.as_ref().and_then(|raster| stages::size_fault(raster, installation));
    match (sighting.failure.take().or(fault), raster) {
        (None, Some(raster)) => Ok(GroundFrame { sighting, raster }),
        (reason, _) => Err(reason.unwrap_or_else(|| BROKE_OFF.into())),
    }
}

/// The markers seen in each frame.
pub fn markers(frames: &[GroundFrame]) -> Vec<Vec<Detection>> {
    frames.iter().map(|frame| frame.sighting.detections.markers.clone()).collect()
}

/// The orientation with what the frames show of each marker, perspective bias removed. As in flight, a first orientation
/// foretells every marker's image, and what is missing there or hardly seen is looked at more closely: only what that
/// look does not find either is left out, with a reason. The frames get what was found.
///
/// # Errors
/// Where the frames fit the survey in no orientation.
pub fn orient(setup: &Setup, frames: &mut [GroundFrame]) -> Result<OrientationFit, IdentifyError> {
    let mut fit = identify::orient(setup, &markers(frames))?;
    for _ in 0..LOOKS {
        let before: Vec<_> = frames.iter().map(|frame| frame.sighting.detections.clone()).collect();
        let mut changed = false;
        for (frame, identities) in frames.iter_mut().zip(&fit.identities) {
            let found = &mut frame.sighting.detections;
            let expected = identify::expect_on_ground(setup, &fit.orientation, &found.markers, identities);
            changed |= detect::look_closer(&frame.raster, found, &expected);
        }
        // A look that leaves everything in its place may have made it less sure.
        match identify::orient(setup, &markers(frames)) {
            Ok(again) => fit = again,
            Err(_) => {
                for (frame, before) in frames.iter_mut().zip(before) {
                    frame.sighting.detections = before;
                }
                break;
            }
        }
        if !changed {
            break;
        }
    }
    fit.orientation.ground = stages::ground_sights(setup, &markers(frames), &fit);
    Ok(fit)
}
