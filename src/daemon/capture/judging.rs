//! A frame is judged: whether it is good, when it was exposed, and what a failure is called.

use crate::camera::freshness::Freshness;
use crate::camera::{CameraError, Format, CameraFrame, exif, jpeg};
use crate::clock::exposure::{self, Exposure};
use crate::clock::{Clock, Stamp};
use crate::store::manifest::ShotFailure;

/// A camera's clock shows whole seconds, so that it may seem to go off by one; more is a sign, s.
const CAMERA_CLOCK_JUMP_S: f64 = 2.0;

/// What the frames before say of the next one. It outlives the camera, which may be made anew.
pub(super) struct Judge {
    freshness: Freshness,
    /// The camera's own clock less UTC by the last frame that has its time, s.
    camera_clock_offset_s: Option<f64>,
}

impl Judge {
    /// A frame that equals one of `stale_window` before it is stale.
    pub fn remembering(stale_window: usize) -> Self {
        Self { freshness: Freshness::with_capacity(stale_window), camera_clock_offset_s: None }
    }

    /// A frame that came without an error may still be half or old.
    pub fn judge(&mut self, frame: &CameraFrame) -> Result<(), ShotFailure> {
        let whole = match &frame.format {
            Format::Jpeg => jpeg::check_complete(&frame.bytes).map_err(|why| why.to_string()),
            _ if frame.bytes.is_empty() => Err("it is empty".to_owned()),
            _ => Ok(()),
        };
        whole.map_err(|reason| failure_of(&CameraError::BadFrame(reason)))?;
        let fresh = self.freshness.check(&frame.bytes);
        fresh.map_err(|error| ShotFailure { kind: STALE.to_owned(), ..failure_of(&error) })
    }

    /// When a frame was exposed that has just been delivered; a camera whose own clock disagrees is noted with it.
    pub fn exposure(&mut self, frame: &mut CameraFrame, asked: &Stamp, clock: &dyn Clock) -> Exposure {
        let (now, quality) = (clock.stamp(), clock.quality());
        let mut exposure = match &frame.exposed {
            Some(evidence) => Exposure::new(&exposure::exposure_instant(evidence), &now, quality),
            None => Exposure::from_request(asked, now.since_boot_s, quality),
        };
        if frame.format != Format::Jpeg {
            return exposure;
        }
        exposure.camera_clock_offset_s = exif::camera_clock_offset_s(&frame.bytes, exposure.exposure_time);
        let last = std::mem::replace(&mut self.camera_clock_offset_s, exposure.camera_clock_offset_s);
        let jump_s = exposure.camera_clock_offset_s.zip(last).map(|(now, last)| now - last);
        if let Some(jump_s) = jump_s.filter(|jump| jump.abs() > CAMERA_CLOCK_JUMP_S) {
            let what = format!(
                "by the camera's own clock this frame is {jump_s:.0} s off the one before: an old picture, or a clock was set"
            );
            tracing::warn!(what);
            frame.settings.insert("clock_warning".to_owned(), what.into());
        }
        exposure
    }
}

/// The kind of a frame that was delivered before.
pub(crate) const STALE: &str = "stale";

/// As `series.json` keeps it.
pub(super) fn failure_of(error: &CameraError) -> ShotFailure {
    let kind = match error {
        CameraError::Busy(_) => "busy",
        CameraError::Gone(_) => "gone",
        CameraError::Timeout { .. } => "timeout",
        CameraError::Refused(_) => "refused",
        CameraError::BadFrame(_) => "bad_frame",
    };
    ShotFailure { kind: kind.to_owned(), reason: error.to_string(), kept_as: None }
}
