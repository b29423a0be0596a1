//! Section `[camera]` of the configuration: kind of camera and its settings.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::camera::CameraFactory;
#[cfg(any(feature = "gphoto", feature = "gpio"))]
use crate::camera::freshness::LastName;
use crate::camera::replay::{ReplayConfig, ReplayFactory};
use crate::clock::Clock;
use crate::installation::KeyFault;

/// Configuration of one camera, chosen by `kind`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum CameraSection {
    /// Replayed files.
    Replay(ReplayConfig),
    /// Video for Linux.
    #[cfg(feature = "v4l")]
    V4l(crate::camera::v4l::V4lSection),
    /// Video for Linux, not compiled in.
    #[cfg(not(feature = "v4l"))]
    #[serde(with = "not_built")]
    V4l(std::convert::Infallible),
    /// Still camera on USB.
    #[cfg(feature = "gphoto")]
    Gphoto(crate::camera::gphoto::GphotoSection),
    /// Still camera on USB, not compiled in.
    #[cfg(not(feature = "gphoto"))]
    #[serde(with = "not_built")]
    Gphoto(std::convert::Infallible),
    /// Camera on a remote release.
    #[cfg(feature = "gpio")]
    Release(crate::camera::release::ReleaseSection),
    /// Camera on a remote release, not compiled in.
    #[cfg(not(feature = "gpio"))]
    #[serde(with = "not_built")]
    Release(std::convert::Infallible),
}

impl CameraSection {
    /// Returns every fault, at its key of the full file.
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
        faults.into_iter().map(|fault| fault.with_section("camera")).collect()
    }

    /// Returns the replay configuration, if replayed files take the place of a camera.
    pub fn replay_mut(&mut self) -> Option<&mut ReplayConfig> {
        match self {
            Self::Replay(section) => Some(section),
            _ => None,
        }
    }

    /// Creates the camera factory; no device is accessed before a camera is opened. The cameras of one factory share the
    /// name of the last shot; the recorder compares bytes. `origin` is the time since boot from which a replay list counts.
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
            Self::V4l(section) => Arc::new(move || Box::new(crate::camera::v4l::V4lCamera::new(section.clone()))),
            #[cfg(feature = "gphoto")]
            Self::Gphoto(section) => {
                Arc::new(move || Box::new(crate::camera::gphoto::GphotoCamera::new(section.clone(), last.clone())))
            }
            #[cfg(feature = "gpio")]
            Self::Release(section) => {
                Arc::new(move || Box::new(crate::camera::release::ReleaseCamera::new(section.clone(), last.clone())))
            }
        }
    }
}

/// Deserialization error for a kind of camera that was not compiled in, with the remedy.
#[cfg(not(all(feature = "v4l", feature = "gphoto", feature = "gpio")))]
mod not_built {
    use std::convert::Infallible;

    use serde::{Deserializer, Serializer, de::Error};

    /// Never called: the type has no values.
    pub fn serialize<S: Serializer>(never: &Infallible, _: S) -> Result<S::Ok, S::Error> {
        match *never {}
    }

    /// Rejects the kind of camera with the remedy.
    pub fn deserialize<'de, D: Deserializer<'de>>(_: D) -> Result<Infallible, D::Error> {
        Err(D::Error::custom(
            "this wingd was built without this kind of camera; build it with `cargo build --release --locked`",
        ))
    }
}
