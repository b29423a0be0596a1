//! Figures, tables, exports.
//!
//! | file | from | to |
//! |---|---|---|
//! | `summary` | the records of a series | means, standard deviations, scatter |
//! | `table` | records, detections, summaries | text for a terminal |
//! | `overlay` | a frame and its detections | a picture to look at |

pub mod grid;
pub mod number;
pub mod overlay;
pub mod summary;
pub mod table;

#[cfg(test)]
mod sample;

use jiff::Timestamp;

use crate::record::ImageRecord;

/// A series as the report needs it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeriesData {
    /// The flight it belongs to.
    pub flight: String,
    /// Unique in the store.
    pub name: String,
    /// UTC of the first shot, where it is known.
    pub begun: Option<Timestamp>,
    /// A crash or a power cut ended it early.
    pub interrupted: bool,
    /// Results in the order of the shots.
    pub records: Vec<ImageRecord>,
    /// Every shot asked for, failed ones included.
    pub shots: Vec<ShotData>,
}

/// A shot as the series' manifest keeps it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShotData {
    /// File name of the frame; `None` where the camera gave none.
    pub image: Option<String>,
    /// UTC as the machine believed it.
    pub utc: Option<Timestamp>,
    /// SHA-256 of the frame, hexadecimal.
    pub sha256: Option<String>,
    /// Why there is no frame.
    pub failure: Option<String>,
}
