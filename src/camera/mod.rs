//! Cameras. One interface, [`Camera`], and what works behind it: files replayed, Video for Linux, a still camera on USB, and
//! any of them on a remote release.

pub mod deadline;
#[cfg(any(feature = "v4l", feature = "gpio"))]
mod delay;
pub mod exif;
pub mod freshness;
#[cfg(feature = "gphoto")]
pub mod gphoto;
pub mod jpeg;
#[cfg(feature = "gpio")]
pub mod release;
pub mod replay;
pub mod section;
#[cfg(feature = "v4l")]
pub mod v4l;

use std::sync::Arc;
use std::time::Duration;

use serde_json::{Map, Value};

use crate::clock::exposure::ExposureEvidence;

/// A frame as the camera delivered it.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraFrame {
    /// The camera's own bytes, untouched.
    pub bytes: Vec<u8>,
    /// How to read them.
    pub format: Format,
    /// What the camera says of the shot: exposure, counter, its own time. Kept in `series.json`.
    pub settings: Map<String, Value>,
    /// What the camera knows of when it exposed; `None`: between asking and delivery.
    pub exposed: Option<ExposureEvidence>,
}

/// How a frame's bytes are to be read; also gives the file's ending.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase", tag = "kind")]
pub enum Format {
    /// A whole JPEG file (MJPEG frames too).
    Jpeg,
    /// A whole PNG, PNM or TIFF file; the ending is kept.
    File {
        /// Without the dot.
        extension: String,
    },
    /// Bare samples of a V4L2 device.
    Raw {
        /// FourCC such as `GREY`, `YUYV`, `BA81`, `RG10`, `RG12`.
        fourcc: String,
        /// px.
        width: u32,
        /// px.
        height: u32,
        /// Bytes from one row to the next.
        stride: u32,
    },
}

impl Format {
    /// As a series' manifest keeps it.
    ///
    /// # Errors
    /// Where it is none.
    pub fn from_manifest(kept: &Value) -> Result<Self, UnknownFormat> {
        Ok(serde_json::from_value(kept.clone())?)
    }
}

/// A manifest that does not say how to read a frame.
#[derive(Debug, thiserror::Error)]
#[error("series.json does not say how to read it: {0}")]
pub struct UnknownFormat(#[from] serde_json::Error);

/// Of a file with such bytes, without the dot.
pub fn file_extension(format: &Format) -> &str {
    match format {
        Format::Jpeg => "jpg",
        Format::File { extension } => extension,
        Format::Raw { fourcc, .. } => fourcc.trim(),
    }
}

/// Why a camera did not deliver, cut by what the caller does about it.
#[derive(Clone, Debug, PartialEq, thiserror::Error, serde::Serialize, serde::Deserialize)]
pub enum CameraError {
    /// Try again soon.
    #[error("camera is busy: {0}")]
    Busy(String),
    /// Reopen, and look for it again.
    #[error("camera is gone: {0}")]
    Gone(String),
    /// No answer within the deadline; close and reopen.
    #[error("camera did not answer within {after_s:.1} s: {what}")]
    Timeout {
        /// The deadline that passed, s.
        after_s: f64,
        /// What was waited for.
        what: String,
    },
    /// The camera refuses what is asked; a person must act.
    #[error("camera refuses: {0}")]
    Refused(String),
    /// A frame came, but it is damaged or an old one.
    #[error("camera delivered a bad frame: {0}")]
    BadFrame(String),
}

impl CameraError {
    /// Of a camera that is asked while it is not open.
    pub fn closed() -> Self {
        Self::Gone("the camera is not open".to_owned())
    }
}

/// What a camera says of itself when opened.
#[derive(Clone, Debug, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct CameraInfo {
    /// Maker, model, serial number as far as known.
    pub name: String,
    /// Settings in force. Kept in `series.json`.
    pub settings: Map<String, Value>,
    /// Settings that are not as configured; logged and recorded.
    pub warnings: Vec<String>,
}

/// A camera. It lives on a thread of its own; every call may block up to its deadline and no longer
/// by design, yet the daemon keeps a hard limit of its own.
pub trait Camera: Send {
    /// Opens and prepares for a series; may be called again after `close`.
    fn open(&mut self) -> Result<CameraInfo, CameraError>;
    /// The next frame that an interrupted series left on the camera's card, `None` when there is none.
    /// To be asked after `open` until `None`; `release_last` follows each, as after a shot.
    fn recover(&mut self, deadline: Duration) -> Result<Option<CameraFrame>, CameraError> {
        let _ = deadline;
        Ok(None)
    }
    /// Takes one shot.
    fn shoot(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError>;
    /// The next frame of a stream that goes on until the next shot of a series or `close`: newly exposed, and without what a
    /// shot costs beside.
    fn live(&mut self, deadline: Duration) -> Result<CameraFrame, CameraError> {
        self.shoot(deadline)
    }
    /// Tells the camera that our copy of its last frame is durable (it may now delete its own).
    fn release_last(&mut self) -> Result<(), CameraError> {
        Ok(())
    }
    /// Closes; errors are of no interest any more.
    fn close(&mut self);
}

/// Makes a camera, closed; called anew as often as one had to be given up.
pub type CameraFactory = Arc<dyn Fn() -> Box<dyn Camera> + Send + Sync>;
