//! `[camera]` of the configuration says which camera there is, and how it is to be set.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::camera::CameraFactory;
#[cfg(any(feature = "gphoto", feature = "gpio"))]
use crate::camera::freshness::LastName;
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
    /// The same, in a program without it.
    #[cfg(not(feature = "v4l"))]
    #[serde(with = "not_built")]
    V4l(std::convert::Infallible),
    /// A still camera on USB.
    #[cfg(feature = "gphoto")]
    Gphoto(crate::camera::gphoto::GphotoSection),
    /// The same, in a program without it.
    #[cfg(not(feature = "gphoto"))]
    #[serde(with = "not_built")]
    Gphoto(std::convert::Infallible),
    /// A camera on a remote release.
    #[cfg(feature = "gpio")]
    Release(crate::camera::release::ReleaseSection),
    /// The same, in a program without it.
    #[cfg(not(feature = "gpio"))]
    #[serde(with = "not_built")]
    Release(std::convert::Infallible),
}

impl CameraSection {
    /// Every fault, at its key of the whole file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let faults = match self {
            Self::Replay(section) => section.faults(),
            #[cfg(feature = "v4l")]
            Self::V4l(section) => section.faults(),
            #[cfg(not(feature = "v4l"))]
            Self::V4l(never) => match *never {},
            #[cfg(feature = "gphoto")]
            Self::Gphoto(section) => section.faults(),
            #[cfg(not(feature = "gphoto"))]
            Self::Gphoto(never) => match *never {},
            #[cfg(feature = "gpio")]
            Self::Release(section) => section.faults(),
            #[cfg(not(feature = "gpio"))]
            Self::Release(never) => match *never {},
        };
        faults.into_iter().map(|fault| fault.within("camera")).collect()
    }

    /// The pictures that take a camera's place, where they do.
    pub fn replay(&mut self) -> Option<&mut ReplayConfig> {
        match self {
            Self::Replay(section) => Some(section),
            _ => None,
        }
    }

    /// Nothing is touched before a camera is opened. The cameras of one factory remember the camera's name
    /// for the last shot together; bytes are compared by the recorder. `origin`: the time since boot from which a replay list counts.
    pub fn factory(&self, clock: Arc<dyn Clock>, origin: Duration) -> CameraFactory {
        #[cfg(any(feature = "gphoto", feature = "gpio"))]
        let last = LastName::default();
        match self.clone() {
            Self::Replay(section) => {
                let replay = ReplayFactory::new(section, clock, origin);
                Arc::new(move || Box::new(replay.make()))
            }
            #[cfg(not(feature = "v4l"))]
            Self::V4l(never) => match never {},
            #[cfg(not(feature = "gphoto"))]
            Self::Gphoto(never) => match never {},
            #[cfg(not(feature = "gpio"))]
            Self::Release(never) => match never {},
            #[cfg(feature = "v4l")]
            Self::V4l(section) => {
                Arc::new(move || Box::new(crate::camera::v4l::V4lCamera::new(section.clone())))
            }
            #[cfg(feature = "gphoto")]
            Self::Gphoto(section) => Arc::new(move || {
                Box::new(crate::camera::gphoto::GphotoCamera::new(section.clone(), last.clone()))
            }),
            #[cfg(feature = "gpio")]
            Self::Release(section) => Arc::new(move || {
                Box::new(crate::camera::release::ReleaseCamera::new(section.clone(), last.clone()))
            }),
        }
    }
}

/// A kind of camera that this program was built without, as a sentence with the mend.
#[cfg(not(all(feature = "v4l", feature = "gphoto", feature = "gpio")))]
mod not_built {
    use std::convert::Infallible;

    use serde::{Deserializer, Serializer, de::Error};

    pub fn serialize<S: Serializer>(never: &Infallible, _: S) -> Result<S::Ok, S::Error> {
        match *never {}
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(_: D) -> Result<Infallible, D::Error> {
        Err(D::Error::custom(
            "this wingd was built without this kind of camera; build it with `cargo build --release --locked`",
        ))
    }
}
