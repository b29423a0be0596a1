//! Flights into an object store (S3, or a directory): for `wingd upload`.
//!
//! What exists first, then results, then frames, over all flights. Every object is put only where none is, with its
//! SHA-256; a mark says when all of a stage is there. What is broken off goes on with what is missing.

mod bucket;
mod manifest;
mod pace;
mod send;
mod target;

use std::path::Path;

pub use manifest::{WingLabels, UploadManifest, UploadStage};
pub use target::{PutOutcome, UploadSettings, UploadTarget, TargetError};

use crate::store::{FlightRef, StoreError};
use pace::SendPace;
use send::FlightUpload;

/// Why a flight is not whole there.
#[derive(Debug, thiserror::Error)]
pub enum UploadError {
    /// The flight is not sound here.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The other side did not do its part.
    #[error(transparent)]
    Target(#[from] TargetError),
    /// Another flight met what this one would have met.
    #[error("was not tried further; call the command again, it goes on where it ended")]
    Stopped,
}

impl UploadError {
    /// Whether other flights will meet the same: the other side cannot be reached, or refuses us.
    pub fn affects_all_flights(&self) -> bool {
        matches!(self, Self::Target(TargetError::Failed { .. }))
    }
}

/// What was done for a flight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UploadCounts {
    /// Objects of the flight, manifest and marks among them.
    pub objects: usize,
    /// Their bytes.
    pub bytes: u64,
    /// Objects that this call put.
    pub sent: usize,
    /// Their bytes.
    pub sent_bytes: u64,
    /// Of them those that took the place of damaged ones.
    pub repaired: usize,
    /// Frames that had arrived and are there no more: a rule of the bucket ages them.
    pub expired: usize,
}

impl UploadCounts {
    fn add(&mut self, put: PutOutcome, length: u64) {
        self.objects += 1;
        self.bytes += length;
        if put == PutOutcome::Sent {
            self.sent += 1;
            self.sent_bytes += length;
        }
    }
}

/// What is sent where.
pub struct Upload<'a> {
    /// Where to.
    pub target: &'a UploadTarget,
    /// The store's root.
    pub root: &'a Path,
    /// Whose flights they are.
    pub labels: &'a WingLabels,
    /// Whether damaged objects get their bytes again.
    pub repair: bool,
    /// Gets the length of each object that is there.
    pub progress: &'a (dyn Fn(u64) + Sync),
}

/// What became of a flight.
pub type UploadOutcome = Result<(UploadCounts, UploadManifest), UploadError>;

/// A flight on its way, or why it stays.
type PendingUpload = Result<FlightUpload, UploadError>;

impl Upload<'_> {
    /// Sends flights stage by stage; an outcome for each.
    pub async fn upload_flights(&self, flights: &[FlightRef]) -> Vec<UploadOutcome> {
        let mut pace = SendPace::new(self.target.settings().jobs, std::time::Instant::now());
        let mut on_their_way: Vec<PendingUpload> = Vec::new();
        for flight in flights {
            let begun = match on_their_way.iter().find_map(blocking_error) {
                Some(()) => Err(UploadError::Stopped),
                None => self.publish_manifest(flight, on_their_way.is_empty()).await,
            };
            on_their_way.push(begun);
        }
        for stage in [UploadStage::Results, UploadStage::Frames] {
            for place in 0..on_their_way.len() {
                let stopped = on_their_way.iter().find_map(blocking_error).is_some();
                let Some(Ok(flight)) = on_their_way.get_mut(place) else { continue };
                let sent = if stopped {
                    Err(UploadError::Stopped)
                } else {
                    self.upload_stage(flight, stage, &mut pace).await
                };
                if let (Err(error), Some(one)) = (sent, on_their_way.get_mut(place)) {
                    *one = Err(error);
                }
            }
        }
        on_their_way.into_iter().map(|flight| flight.map(|flight| (flight.sent, flight.manifest))).collect()
    }
}

fn blocking_error(flight: &PendingUpload) -> Option<()> {
    flight.as_ref().err().filter(|error| error.affects_all_flights()).map(|_| ())
}
