//! Upload of flights to an object store (S3 or a directory), for `wingd upload`.
//!
//! Manifests are uploaded first, then results, then frames, each for all flights. Every object is created only if it does
//! not exist, with its SHA-256; a completion object shows that a stage is complete. An interrupted upload continues with
//! the missing objects.

mod bucket;
mod manifest;
mod pace;
mod send;
mod target;

use std::path::Path;

pub use manifest::{UploadManifest, UploadStage, WingLabels};
pub use target::{PutOutcome, TargetError, UploadSettings, UploadTarget};

use pace::SendPace;
use send::FlightUpload;
use wingd_store::{FlightRef, StoreError};

/// Error that leaves a flight incomplete at the target.
#[derive(Debug, thiserror::Error)]
pub enum UploadError {
    /// The local flight is not sound.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The target failed.
    #[error(transparent)]
    Target(#[from] TargetError),
    /// Not tried because another flight met an error that affects all.
    #[error("was not tried; run the command again to continue")]
    Stopped,
}

impl UploadError {
    /// Returns whether other flights will meet the same error: the target is not reachable or refuses access.
    pub fn affects_all_flights(&self) -> bool {
        matches!(self, Self::Target(TargetError::Failed { .. }))
    }
}

/// Counts of the objects of an uploaded flight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UploadCounts {
    /// Objects of the flight, including manifest and completion objects.
    pub objects: usize,
    pub bytes: u64,
    /// Objects put by this call.
    pub sent: usize,
    pub sent_bytes: u64,
    /// Objects that replaced damaged ones.
    pub repaired: usize,
    /// Frames that had arrived and were deleted by a lifecycle rule of the bucket.
    pub expired: usize,
}

impl UploadCounts {
    fn count_put(&mut self, put: PutOutcome, length: u64) {
        self.objects += 1;
        self.bytes += length;
        if put == PutOutcome::Sent {
            self.sent += 1;
            self.sent_bytes += length;
        }
    }
}

/// Upload of flights of one store to a target.
pub struct Upload<'a> {
    pub target: &'a UploadTarget,
    /// Root of the store.
    pub root: &'a Path,
    pub labels: &'a WingLabels,
    /// Replace damaged objects.
    pub repair: bool,
    /// Callback that receives the length of each object that has arrived.
    pub progress: &'a (dyn Fn(u64) + Sync),
}

/// Result of uploading a flight.
pub type UploadOutcome = Result<(UploadCounts, UploadManifest), UploadError>;

/// Upload in progress, or the error that stopped it.
type PendingUpload = Result<FlightUpload, UploadError>;

impl Upload<'_> {
    /// Uploads flights stage by stage; returns an outcome for each.
    pub async fn upload_flights(&self, flights: &[FlightRef]) -> Vec<UploadOutcome> {
        let mut pace = SendPace::new(self.target.settings().jobs, std::time::Instant::now());
        let mut uploads: Vec<PendingUpload> = Vec::new();
        for flight in flights {
            let upload = match uploads.iter().find_map(blocking_error) {
                Some(()) => Err(UploadError::Stopped),
                None => self.publish_manifest(flight, uploads.is_empty()).await,
            };
            uploads.push(upload);
        }
        for stage in [UploadStage::Results, UploadStage::Frames] {
            for place in 0..uploads.len() {
                let stopped = uploads.iter().find_map(blocking_error).is_some();
                let Some(Ok(flight)) = uploads.get_mut(place) else {
                    continue;
                };
                let sent = if stopped {
                    Err(UploadError::Stopped)
                } else {
                    self.upload_stage(flight, stage, &mut pace).await
                };
                if let (Err(error), Some(one)) = (sent, uploads.get_mut(place)) {
                    *one = Err(error);
                }
            }
        }
        uploads
            .into_iter()
            .map(|flight| flight.map(|flight| (flight.sent, flight.manifest)))
            .collect()
    }
}

fn blocking_error(flight: &PendingUpload) -> Option<()> {
    flight
        .as_ref()
        .err()
        .filter(|error| error.affects_all_flights())
        .map(|_| ())
}
