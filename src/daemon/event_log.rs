//! What becomes of series and frames is said here to all who listen: the log, the status, the progress display.

use super::capture::STALE;
use super::core::Core;
use super::event::Event;
use super::status::Activity;
use crate::record::{GlobalTest, ImageRecord, Status};
use crate::store::manifest::{SeriesCause, ShotFailure, FrameEntry, Shot};
use crate::store::{FrameRef, OpenSeries, StoreError};

impl Core {
    /// A series begins, of so many shots.
    pub fn series_began(&self, series: &OpenSeries, cause: SeriesCause, shots: u32) {
        let (id, flight) = (series.id().to_owned(), series.flight().to_owned());
        tracing::info!(series = id, flight, ?cause, "series begins");
        self.board.update(|status| {
            status.activity = Activity::Capturing;
            status.store.refuses = None;
            status.series = Some(id.clone());
            status.shot = 0;
            status.shots_per_series = shots;
        });
        (self.observer)(&Event::SeriesBegan { series: id, flight });
    }

    /// The store takes no series.
    pub fn series_refused(&self, error: &StoreError) {
        tracing::error!(%error, "series refused by the store");
        self.board.fault(&error.to_string());
        self.board.update(|status| {
            status.counts.series_refused += 1;
            status.store.refuses = Some(error.to_string());
            status.store.free_mb = self.store.free_mb().ok();
        });
        (self.observer)(&Event::Refused { reason: error.to_string() });
    }

    /// A series is over: closed, or broken off. `complete`: every planned shot was tried.
    pub fn series_ended(&self, series: String, complete: bool, closed: &Result<(), StoreError>) {
        let complete = complete && closed.is_ok();
        match closed {
            Ok(()) => tracing::info!(series, complete, "series closed"),
            Err(error) => {
                tracing::error!(series, %error, "series broken off; recovered before the next one");
                self.board.fault(&error.to_string());
            }
        }
        self.board.update(|status| {
            let counts = &mut status.counts;
            *(if complete { &mut counts.series_complete } else { &mut counts.series_interrupted }) += 1;
            status.store.free_mb = self.store.free_mb().ok();
        });
        (self.observer)(&Event::SeriesClosed { series, complete });
    }

    /// An attempt at a shot failed.
    pub fn attempt_failed(&self, series: &str, shot: u32, failure: &ShotFailure) {
        tracing::warn!(series, shot, kind = failure.kind, reason = failure.reason);
        self.board.fault(&failure.reason);
        self.board.update(|status| {
            status.counts.failed_attempts += 1;
            status.counts.stale_frames += u64::from(failure.kind == STALE);
        });
    }

    /// A shot is durable, with its frame or without one.
    pub fn shot_stored(&self, series: &str, shot: &Shot, frame: Option<FrameEntry>) {
        let (id, number) = (series.to_owned(), shot.shot);
        self.board.update(|status| status.shot = number);
        match frame {
            Some(FrameEntry { file, sha256, .. }) => {
                // From here on the frame is promised: tests and people may count on this line.
                tracing::info!(series, file, sha256, "frame is durable");
                self.board.frame_stored(&shot.stamp);
                (self.observer)(&Event::FrameStored { series: id, shot: number, file, sha256 });
            }
            None => {
                tracing::error!(series, shot = number, "shot without a frame");
                self.board.update(|status| status.counts.failed_shots += 1);
                (self.observer)(&Event::ShotFailed { series: id, shot: number });
            }
        }
    }

    /// A frame has its result; it is not a `new` one where the frame had a result already.
    pub fn frame_solved(&self, frame: &FrameRef, record: &ImageRecord, new: bool) {
        let (series, file) = (frame.series.id.as_str(), frame.entry.file.as_str());
        match (&record.reason, new) {
            (_, false) => tracing::warn!(series, file, "has a result already"),
            (None, true) => tracing::info!(series, file, "solved"),
            (Some(reason), true) => tracing::warn!(series, file, reason, "not solved"),
        }
        let ok = record.status == Status::Ok;
        if new {
            self.board.series_result(ok, record.global_test == Some(GlobalTest::Rejected));
        }
        self.board.update(|status| {
            let count = if ok { &mut status.counts.solved } else { &mut status.counts.unsolvable };
            *count += u64::from(new);
            status.to_solve = status.to_solve.saturating_sub(1);
        });
        (self.observer)(&Event::Solved { series: series.to_owned(), file: file.to_owned(), ok });
    }
}
