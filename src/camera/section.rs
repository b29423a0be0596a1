//! Section `[camera]` of the configuration: kind of camera and its settings.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Deserializer, Serialize, de};

#[cfg(feature = "gphoto")]
use crate::camera::gphoto::GphotoSection;
use crate::camera::release::ReleaseSection;
use crate::camera::replay::ReplayConfig;
#[cfg(feature = "v4l")]
use crate::camera::v4l::V4lSection;
use crate::camera::{CameraFactory, DriverSection};
#[cfg(not(feature = "gphoto"))]
use DriverNotBuilt as GphotoSection;
#[cfg(not(feature = "v4l"))]
use DriverNotBuilt as V4lSection;
use wingd_base::clock::Clock;
use wingd_base::fault::KeyFault;

/// Configuration of one camera, chosen by `kind`, which the reader of the file turns into the variant's name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraSection {
    /// Replayed files.
    Replay(ReplayConfig),
    /// Video for Linux.
    V4l(V4lSection),
    /// Still camera on USB.
    Gphoto(GphotoSection),
    /// Camera on a remote release.
    Release(ReleaseSection),
}

impl CameraSection {
    fn driver_section(&self) -> &dyn DriverSection {
        match self {
            Self::Replay(section) => section,
            Self::V4l(section) => section,
            Self::Gphoto(section) => section,
            Self::Release(section) => section,
        }
    }

    /// Returns every fault, at its key of the full file.
    pub fn faults(&self) -> Vec<KeyFault> {
        self.driver_section()
            .faults()
            .into_iter()
            .map(|fault| fault.with_section("camera"))
            .collect()
    }

    /// Creates the camera factory; see [`DriverSection::factory`].
    pub fn factory(&self, clock: Arc<dyn Clock>, origin: Duration) -> CameraFactory {
        self.driver_section().factory(clock, origin)
    }

    /// Returns the replay configuration, if replayed files take the place of a camera.
    pub fn replay_mut(&mut self) -> Option<&mut ReplayConfig> {
        match self {
            Self::Replay(section) => Some(section),
            _ => None,
        }
    }
}

/// Section of a kind of camera that was not compiled in; it has no values.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum DriverNotBuilt {}

impl<'de> Deserialize<'de> for DriverNotBuilt {
    /// Rejects the kind of camera with the remedy.
    fn deserialize<D: Deserializer<'de>>(_: D) -> Result<Self, D::Error> {
        let remedy = "this wingd was built without this kind of camera; build it with `cargo build --release --locked`";
        Err(de::Error::custom(remedy))
    }
}

impl DriverSection for DriverNotBuilt {
    fn faults(&self) -> Vec<KeyFault> {
        match *self {}
    }

    fn factory(&self, _: Arc<dyn Clock>, _: Duration) -> CameraFactory {
        match *self {}
    }
}
