//! `[camera]` of the configuration: which camera, and how it is to be set.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::camera::Camera;
#[cfg(any(feature = "v4l", feature = "gphoto", feature = "gpio"))]
use crate::camera::freshness::Freshness;
use crate::camera::replay::{ReplayConfig, ReplayFactory};
use crate::clock::Clock;
use crate::installation::KeyFault;

/// One camera, chosen by `kind`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum CameraSection {
    /// Files instead of a camera.
    Replay(ReplayConfig),
    /// Video for Linux.
    #[cfg(feature = "v4l")]
    V4l(crate::camera::v4l::V4lSection),
    /// A still camera on USB.
    #[cfg(feature = "gphoto")]
    Gphoto(crate::camera::gphoto::GphotoSection),
    /// A camera on a remote release.
    #[cfg(feature = "gpio")]
    Release(crate::camera::release::ReleaseSection),
}

/// Makes the camera anew, as often as one had to be abandoned.
pub type CameraFactory = Box<dyn Fn() -> Box<dyn Camera> + Send>;

impl CameraSection {
    /// Every fault, at its key of the whole file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let faults = match self {
            Self::Replay(section) => return section.faults(),
            #[cfg(feature = "v4l")]
            Self::V4l(section) => section.faults(),
            #[cfg(feature = "gphoto")]
            Self::Gphoto(section) => section.faults(),
            #[cfg(feature = "gpio")]
            Self::Release(section) => section.faults(),
        };
        faults.into_iter().map(|fault| fault.within("camera")).collect()
    }

    /// The pictures that take a camera's place, where they do.
    pub fn replay(&mut self) -> Option<&mut ReplayConfig> {
        match self {
            Self::Replay(section) => Some(section),
            #[cfg(any(feature = "v4l", feature = "gphoto", feature = "gpio"))]
            _ => None,
        }
    }

    /// Nothing is touched before a camera is opened. The cameras of one factory remember the camera's name
    /// for the last shot together; the recorder compares the bytes. `origin`: the time since boot from which a replay list counts.
    pub fn factory(&self, clock: Arc<dyn Clock>, origin: Duration) -> CameraFactory {
        #[cfg(any(feature = "v4l", feature = "gphoto", feature = "gpio"))]
        let memory = Freshness::remembering(0);
        match self.clone() {
            Self::Replay(section) => {
                let replay = ReplayFactory::new(section, clock, origin);
                Box::new(move || Box::new(replay.make()))
            }
            #[cfg(feature = "v4l")]
            Self::V4l(section) => Box::new(move || {
                Box::new(crate::camera::v4l::V4lCamera::new(section.clone(), memory.clone()))
            }),
            #[cfg(feature = "gphoto")]
            Self::Gphoto(section) => Box::new(move || {
                Box::new(crate::camera::gphoto::GphotoCamera::new(section.clone(), memory.clone()))
            }),
            #[cfg(feature = "gpio")]
            Self::Release(section) => Box::new(move || {
                Box::new(crate::camera::release::ReleaseCamera::new(section.clone(), memory.clone()))
            }),
        }
    }
}

/// Longest delay that is believed, s.
#[cfg(any(feature = "v4l", feature = "gpio"))]
const LONGEST_DELAY_S: f64 = 10.0;

/// What is wrong with a measured delay and its standard deviation.
#[cfg(any(feature = "v4l", feature = "gpio"))]
pub(crate) fn delay_fault(key: &str, seconds: Option<f64>, sigma_s: Option<f64>) -> Option<KeyFault> {
    let mend = format!("give {key}_s and {key}_sigma_s together, measured, or leave both out");
    match (seconds, sigma_s) {
        (None, None) => None,
        (Some(s), Some(sigma)) if s.abs() <= LONGEST_DELAY_S && (0.0..=LONGEST_DELAY_S).contains(&sigma) => {
            None
        }
        (Some(s), Some(sigma)) => {
            let mend = format!("give at most {LONGEST_DELAY_S} s, and a standard deviation of 0 or more");
            let problem = format!("is {s} s with a standard deviation of {sigma} s");
            Some(KeyFault::new(format!("{key}_s"), problem, mend))
        }
        (Some(_), None) => Some(KeyFault::new(format!("{key}_sigma_s"), "is missing", mend)),
        (None, Some(_)) => Some(KeyFault::new(format!("{key}_s"), "is missing", mend)),
    }
}
