//! What a shot gave: whether the frame is good, when it was exposed, and what to do about a failure.

use serde_json::{Map, Value};

use super::recorder::Recorder;
use crate::camera::{CameraError, CameraInfo, Format, Frame, exif, jpeg};
use crate::clock::Stamp;
use crate::clock::exposure::{self, Exposure};
use crate::store::Recovery;
use crate::store::manifest::Failure;

/// A camera's clock shows whole seconds, so that it may seem to go off by one; more is a sign, s.
const CAMERA_CLOCK_JUMP_S: f64 = 2.0;

impl Recorder {
    /// When a frame was exposed that has just been delivered; a camera whose own clock disagrees is noted with it.
    pub(super) fn exposure(&mut self, frame: &mut Frame, asked: &Stamp) -> Exposure {
        let (now, clock) = (self.clock.stamp(), self.clock.quality());
        let mut exposure = match &frame.exposed {
            Some(evidence) => Exposure::new(&exposure::instant(evidence), &now, clock),
            None => Exposure::asked(asked, now.since_boot_s, clock),
        };
        if frame.format != Format::Jpeg {
            return exposure;
        }
        exposure.camera_clock_offset_s = exif::offset_s(&frame.bytes, exposure.exposure_time);
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

    /// A frame that came without an error may still be half or old.
    pub(super) fn judge(&mut self, frame: &Frame) -> Result<(), Failure> {
        let whole = match &frame.format {
            Format::Jpeg => jpeg::whole(&frame.bytes).map_err(|why| why.to_string()),
            _ if frame.bytes.is_empty() => Err("it is empty".to_owned()),
            _ => Ok(()),
        };
        let bad = |kind: &str, reason: String| Failure { kind: kind.to_owned(), reason, kept_as: None };
        whole.map_err(|reason| bad("bad_frame", format!("camera delivered a bad frame: {reason}")))?;
        self.freshness.check(&frame.bytes, None).map_err(|error| bad("stale", error.to_string()))
    }

    pub(super) fn note_failure(&mut self, failure: &Failure) {
        self.board.fault(&failure.reason);
        self.board.update(|status| {
            status.counts.failed_attempts += 1;
            status.counts.stale_frames += u64::from(failure.kind == "stale");
        });
    }
}

/// Writes into the log what was recovered.
pub(crate) fn log_recovery(recovery: &Recovery) {
    for series in &recovery.series {
        tracing::warn!(series, "recovered");
    }
    for name in &recovery.set_aside {
        tracing::warn!(name, "half data kept under partial/");
    }
    for remark in &recovery.remarks {
        tracing::warn!(remark, "recovery");
    }
}

/// As a series keeps it.
pub(crate) fn camera_map(info: &CameraInfo) -> Map<String, Value> {
    let mut camera = Map::new();
    camera.insert("name".to_owned(), Value::from(info.name.clone()));
    camera.insert("settings".to_owned(), Value::Object(info.settings.clone()));
    camera.insert("warnings".to_owned(), Value::from(info.warnings.clone()));
    camera
}

/// Another attempt at the same shot may help. A camera that did not answer has cost its time already.
pub(super) fn worth_another(error: &CameraError) -> bool {
    matches!(error, CameraError::Busy(_) | CameraError::Gone(_) | CameraError::BadFrame(_))
}

pub(super) fn failure_of(error: &CameraError) -> Failure {
    let kind = match error {
        CameraError::Busy(_) => "busy",
        CameraError::Gone(_) => "gone",
        CameraError::Timeout { .. } => "timeout",
        CameraError::Refused(_) => "refused",
        CameraError::BadFrame(_) => "bad_frame",
    };
    Failure { kind: kind.to_owned(), reason: error.to_string(), kept_as: None }
}
