//! Image of a card with its time, and the origin of that time.

use std::path::PathBuf;

use jiff::Timestamp;
use serde_json::{Map, Value};

use crate::exif::CaptureMetadata;
use wingd_base::clock::written_time::WrittenTime;

/// An image file with its time.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct DatedImage {
    pub file: PathBuf,
    /// Shortest part of the path that differs from those of the other images.
    pub name: String,
    pub digest: String,
    /// Width and height, px; `None` if the file is damaged.
    pub size: Option<(usize, usize)>,
    /// Metadata of the file.
    pub taken: CaptureMetadata,
    /// Time of the shot; `None` if unknown.
    pub utc: Option<Timestamp>,
    /// Origin of that time.
    pub source: Option<TimeSource>,
    /// Number of digits of its fraction of a second.
    pub digits: u32,
    /// Whether that time has no zone of its own.
    pub zoneless: bool,
}

impl DatedImage {
    /// Resolution of the clock that gave the time, s.
    pub fn clock_step_s(&self) -> f64 {
        0.1f64.powi(self.digits as i32)
    }

    /// Sets the time, if there is one, with its notation and origin.
    pub(super) fn set_time(
        &mut self,
        utc: Option<Timestamp>,
        written: Option<&WrittenTime>,
        source: TimeSource,
    ) {
        if utc.is_some() {
            (self.utc, self.source) = (utc, Some(source));
            self.digits = written.map_or(0, |time| time.digits);
            self.zoneless =
                source != TimeSource::List && written.is_some_and(|time| time.offset.is_none());
        }
    }

    /// Returns the file name given by the camera and the settings of the shot.
    pub fn settings(&self) -> Map<String, Value> {
        let mut all = Map::from_iter([("source".to_owned(), self.name.clone().into())]);
        all.extend(
            self.taken
                .time
                .map(|t| ("camera_time".to_owned(), t.local.to_string().into())),
        );
        all.extend(
            self.taken
                .settings
                .iter()
                .map(|(k, v)| ((*k).to_owned(), v.clone().into())),
        );
        all
    }
}

/// Origin of an image's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeSource {
    /// List given by the user.
    List,
    /// Camera's clock, from the metadata.
    Metadata,
    /// Position fix, from the metadata.
    PositionFix,
    /// Name of the file.
    Name,
    /// Begin and interval given by the user.
    Start,
}
