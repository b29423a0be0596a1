//! Frames of finished series, and their bytes.

use super::catalogue::SeriesRef;
use crate::disk::{Disk, StoreError, StoreResult};
use crate::format::manifest::{FrameEntry, SeriesManifest};
use crate::format::{layout, sha256_hex};
use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;

/// Reference to a stored frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameRef {
    pub series: SeriesRef,
    pub entry: FrameEntry,
    /// Time of the request to the camera.
    pub stamp: Stamp,
    /// Time of the exposure, if known.
    pub exposure: Option<Exposure>,
}

/// Returns the frames of a series, in order.
pub fn series_frames(series: &SeriesRef, manifest: SeriesManifest) -> Vec<FrameRef> {
    let shots = manifest.shots.into_iter();
    shots
        .filter_map(|shot| {
            let entry = shot
                .frame
                .filter(|frame| layout::is_frame_name(&frame.file))?;
            Some(FrameRef {
                series: series.clone(),
                entry,
                stamp: shot.stamp,
                exposure: shot.exposure,
            })
        })
        .collect()
}

/// Reads the bytes of a frame, as delivered by the camera.
///
/// # Errors
/// Returns an error if they do not have the digest in the manifest.
pub fn read_frame(disk: &dyn Disk, frame: &FrameRef) -> StoreResult<Vec<u8>> {
    let path = frame.series.folder.join(&frame.entry.file);
    let bytes = disk.load_file(&path)?;
    if sha256_hex(&bytes) == frame.entry.sha256 {
        return Ok(bytes);
    }
    let problem = "its bytes do not have the hash of series.json".to_owned();
    Err(StoreError::Damaged {
        path,
        problem,
        remedy: "take this frame from a backup or an export",
    })
}
