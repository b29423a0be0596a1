//! Checks captured frames: completeness, freshness, time of exposure; and names the kinds of failure.

use crate::camera::freshness::Freshness;
use crate::camera::{CameraError, CameraFrame, CameraInfo, jpeg};
use wingd_base::clock::exposure;
use wingd_base::clock::exposure::Exposure;
use wingd_base::clock::{Clock, Stamp};
use wingd_evaluation::exif;
use wingd_evaluation::frame_format::Format;
use wingd_store::manifest::ShotFailure;

/// Maximum step of the camera's clock against UTC between two frames, s. It shows whole seconds, so a step of 1 s is
/// normal.
const MAX_CAMERA_CLOCK_JUMP_S: f64 = 2.0;

/// Checks each frame against the preceding ones. It is kept when the camera is replaced.
pub(super) struct FrameChecker {
    freshness: Freshness,
    /// Camera clock minus UTC at the last frame that has the camera's time, s.
    camera_clock_offset_s: Option<f64>,
}

impl FrameChecker {
    /// Creates a checker that compares each frame with the preceding `stale_window` frames.
    pub fn new(stale_window: usize) -> Self {
        Self {
            freshness: Freshness::with_capacity(stale_window),
            camera_clock_offset_s: None,
        }
    }

    /// Limits the history to the loop of a camera that repeats its frames.
    pub fn limit_to_loop(&mut self, info: &CameraInfo) {
        self.freshness.limit_to_loop(info.repeats_after);
    }

    /// Returns a failure if the frame, although delivered without an error, is incomplete or old.
    pub fn check(&mut self, frame: &CameraFrame) -> Result<(), ShotFailure> {
        let whole = match &frame.format {
            Format::Jpeg => jpeg::check_complete(&frame.bytes).map_err(|why| why.to_string()),
            _ if frame.bytes.is_empty() => Err("the file is empty".to_owned()),
            _ => Ok(()),
        };
        whole.map_err(|reason| shot_failure(&CameraError::BadFrame(reason)))?;
        let fresh = self.freshness.check(&frame.bytes);
        fresh.map_err(|error| ShotFailure {
            kind: STALE.to_owned(),
            ..shot_failure(&error)
        })
    }

    /// Determines the time of exposure of a frame just delivered, and adds a warning to its settings if the camera's own
    /// clock disagrees.
    pub fn determine_exposure(
        &mut self,
        frame: &mut CameraFrame,
        asked: &Stamp,
        clock: &dyn Clock,
    ) -> Exposure {
        let (now, quality) = (clock.stamp(), clock.quality());
        let mut exposure = match &frame.exposed {
            Some(evidence) => Exposure::new(&exposure::exposure_instant(evidence), &now, quality),
            None => Exposure::from_request(asked, now.since_boot_s, quality),
        };
        if frame.format != Format::Jpeg {
            return exposure;
        }
        exposure.camera_clock_offset_s =
            exif::camera_clock_offset_s(&frame.bytes, exposure.exposure_time);
        let last = std::mem::replace(
            &mut self.camera_clock_offset_s,
            exposure.camera_clock_offset_s,
        );
        let jump_s = exposure
            .camera_clock_offset_s
            .zip(last)
            .map(|(now, last)| now - last);
        if let Some(jump_s) = jump_s.filter(|jump| jump.abs() > MAX_CAMERA_CLOCK_JUMP_S) {
            let what = format!(
                "the camera's clock jumped by {jump_s:.0} s since the previous frame: an old frame, or a clock was set"
            );
            tracing::warn!(what);
            frame
                .settings
                .insert("clock_warning".to_owned(), what.into());
        }
        exposure
    }
}

/// Failure kind of a frame that was already delivered before.
pub(crate) const STALE: &str = "stale";

/// Converts a camera error to an entry of `series.json`.
pub(super) fn shot_failure(error: &CameraError) -> ShotFailure {
    let kind = match error {
        CameraError::Busy(_) => "busy",
        CameraError::Gone(_) => "gone",
        CameraError::Timeout { .. } => "timeout",
        CameraError::Refused(_) => "refused",
        CameraError::BadFrame(_) => "bad_frame",
    };
    ShotFailure {
        kind: kind.to_owned(),
        reason: error.to_string(),
        kept_as: None,
    }
}
