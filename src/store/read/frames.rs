//! Frames of finished series, and their bytes.

use super::catalogue::SeriesRef;
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;
use crate::store::disk::{Disk, StoreError};
use crate::store::format::manifest::{FrameEntry, SeriesManifest};
use crate::store::format::{layout, sha256_hex};

/// A stored frame that can be read and given a result.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameRef {
    /// Where.
    pub series: SeriesRef,
    /// What.
    pub entry: FrameEntry,
    /// When the camera was asked.
    pub stamp: Stamp,
    /// When it was exposed, where that is known.
    pub exposure: Option<Exposure>,
}

/// A series' frames, in order.
pub fn series_frames(series: &SeriesRef, manifest: SeriesManifest) -> Vec<FrameRef> {
    let shots = manifest.shots.into_iter();
    shots
        .filter_map(|shot| {
            let entry = shot.frame.filter(|frame| layout::is_frame_name(&frame.file))?;
            Some(FrameRef { series: series.clone(), entry, stamp: shot.stamp, exposure: shot.exposure })
        })
        .collect()
}

/// A frame's bytes, as delivered; an error where they are not what the manifest says.
pub fn read_frame(disk: &dyn Disk, frame: &FrameRef) -> Result<Vec<u8>, StoreError> {
    let path = frame.series.folder.join(&frame.entry.file);
    let bytes = disk.load_file(&path)?;
    if sha256_hex(&bytes) == frame.entry.sha256 {
        return Ok(bytes);
    }
    let what = "its bytes do not have the hash of series.json".to_owned();
    Err(StoreError::Damaged { path, problem: what, remedy: "take this frame from a backup or an export" })
}
