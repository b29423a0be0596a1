//! Cameras behind one interface, [`Camera`]: replayed files, Video for Linux, a still camera on USB, and any of them on a
//! remote release.

pub mod deadline;
mod delay;
pub mod freshness;
#[cfg(feature = "gphoto")]
pub mod gphoto;
pub mod jpeg;
pub mod release;
pub mod replay;
pub mod section;
#[cfg(feature = "v4l")]
pub mod v4l;

use std::sync::Arc;
use std::time::Duration;

use serde_json::{Map, Value};

use wingd_base::clock::Clock;
use wingd_base::clock::exposure::ExposureEvidence;
use wingd_base::fault::KeyFault;
use wingd_evaluation::frame_format::Format;

/// Frame as delivered by the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraFrame {
    /// Bytes of the camera, unchanged.
    pub bytes: Vec<u8>,
    pub format: Format,
    /// Settings of the shot from the camera: exposure, counter, its own time. Stored in `series.json`.
    pub settings: Map<String, Value>,
    /// Evidence for the time of exposure; `None`: between request and delivery.
    pub exposed: Option<ExposureEvidence>,
}

/// Reason why a camera did not deliver, classified by the caller's action.
#[derive(Clone, Debug, PartialEq, thiserror::Error, serde::Serialize, serde::Deserialize)]
pub enum CameraError {
    /// Temporary; try again soon.
    #[error("camera is busy: {0}")]
    Busy(String),
    /// Disconnected; search and reopen.
    #[error("camera is gone: {0}")]
    Gone(String),
    /// No answer within the deadline; close and reopen.
    #[error("camera did not answer within {after_s:.1} s: {what}")]
    Timeout {
        /// Deadline, s.
        after_s: f64,
        /// Event that was waited for.
        what: String,
    },
    /// Refused by the camera; the operator must act.
    #[error("camera refuses: {0}")]
    Refused(String),
    /// Damaged or repeated frame.
    #[error("camera delivered a bad frame: {0}")]
    BadFrame(String),
}

impl CameraError {
    /// Builds the error of a camera that is not open.
    pub fn closed() -> Self {
        Self::Gone("the camera is not open".to_owned())
    }
}

/// Camera's description of itself when opened.
#[derive(Clone, Debug, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct CameraInfo {
    /// Maker, model, serial number as far as known.
    pub name: String,
    /// Settings in force. Stored in `series.json`.
    pub settings: Map<String, Value>,
    /// Settings that differ from the configuration; logged and stored.
    pub warnings: Vec<String>,
    /// Number of frames after which the camera repeats by its configuration: a replay that loops.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats_after: Option<usize>,
}

/// Camera, used by one thread of its own. Every call returns by its deadline; the daemon enforces a hard limit in addition.
pub trait Camera: Send {
    /// Opens the camera and prepares a series; may be called again after `close`.
    fn open(&mut self) -> Result<CameraInfo, CameraError>;
    /// Returns the next frame that an interrupted series left on the camera's card, `None` if there is none. Called after
    /// `open` until `None`; `release_last` follows each, as after a shot.
    fn recover(&mut self, deadline: Duration) -> Result<Option<CameraFrame>, CameraError> {
        let _ = deadline;
        Ok(None)
    }
    /// Takes one shot.
    fn shoot(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError>;
    /// Returns the next frame of a stream that runs until the next shot of a series or `close`: newly exposed, without the
    /// overhead of a shot.
    fn next_live_frame(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError> {
        self.shoot(deadline)
    }
    /// Returns whether the camera keeps no copies: the next frame may be requested before the last one is durable.
    fn is_stream(&self) -> bool {
        false
    }
    /// Informs the camera that our copy of its last frame is durable, so that it may delete its own.
    fn release_last(&mut self) -> Result<(), CameraError> {
        Ok(())
    }
    /// Closes the camera; errors are ignored.
    fn close(&mut self);
}

/// Factory of closed cameras; called again whenever one had to be given up.
pub type CameraFactory = Arc<dyn Fn() -> Box<dyn Camera> + Send + Sync>;

/// Settings of a kind of camera, a section of the configuration.
pub trait DriverSection {
    /// Returns every fault, at its key of the section.
    fn faults(&self) -> Vec<KeyFault>;
    /// Creates the camera factory; no device is accessed before a camera is opened. The cameras of one factory share the
    /// name of the last shot; the recorder compares bytes. `origin` is the time since boot from which a replay list counts.
    fn factory(&self, clock: Arc<dyn Clock>, origin: Duration) -> CameraFactory;
}
