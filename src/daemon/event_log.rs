//! Reports the events of series and frames to the log, the status and the progress display.

use super::capture::STALE;
use super::core::Core;
use super::event::Event;
use super::status::{Activity, SIGNING_PART};
use wingd_evaluation::record::{ImageRecord, RecordStatus};
use wingd_measure::estimation::quality::GlobalTest;
use wingd_store::manifest::{FrameEntry, SeriesCause, Shot, ShotFailure};
use wingd_store::{FrameRef, OpenSeries, StoreError, StoreResult};

impl Core {
    /// Reports that a series of `shots` shots begins.
    pub fn log_series_began(&self, series: &OpenSeries, cause: SeriesCause, shots: u32) {
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

    /// Reports that the store refused a series.
    pub fn log_series_refused(&self, error: &StoreError) {
        tracing::error!(%error, "series refused by the store");
        self.board.note_fault(&error.to_string());
        self.board.update(|status| {
            status.counts.series_refused += 1;
            status.store.refuses = Some(error.to_string());
            status.store.free_mb = self.store.free_mb().ok();
        });
    }

    /// Reports that a series was closed or interrupted. `complete`: every planned shot was attempted.
    pub fn log_series_ended(&self, series: String, complete: bool, closed: &StoreResult<()>) {
        let complete = complete && closed.is_ok();
        match closed {
            Ok(()) => tracing::info!(series, complete, "series closed"),
            Err(error) => {
                tracing::error!(series, %error, "series interrupted; it will be recovered before the next one");
                self.board.note_fault(&error.to_string());
            }
        }
        let stranded = self.store.stranded_series();
        self.board
            .set_fault(SIGNING_PART, self.store.signing_fault());
        self.board.update(|status| {
            status.store.unclosed = closed.as_ref().err().map(StoreError::to_string);
            status.store.stranded = stranded;
            let counts = &mut status.counts;
            *(if complete {
                &mut counts.series_complete
            } else {
                &mut counts.series_interrupted
            }) += 1;
            status.store.free_mb = self.store.free_mb().ok();
        });
        (self.observer)(&Event::SeriesClosed { series, complete });
    }

    /// Reports a failed attempt at a shot.
    pub fn log_attempt_failed(&self, series: &str, shot: u32, failure: &ShotFailure) {
        tracing::warn!(series, shot, kind = failure.kind, reason = failure.reason);
        self.board.note_fault(&failure.reason);
        self.board.update(|status| {
            status.counts.failed_attempts += 1;
            status.counts.stale_frames += u64::from(failure.kind == STALE);
        });
    }

    /// Reports that a shot is durable, with or without a frame.
    pub fn log_shot_stored(&self, series: &str, shot: &Shot, frame: Option<FrameEntry>) {
        let (id, number) = (series.to_owned(), shot.shot);
        self.board.update(|status| status.shot = number);
        match frame {
            Some(FrameEntry { file, sha256, .. }) => {
                // This line acknowledges the frame: tests and people may rely on it.
                tracing::info!(series, file, sha256, "frame is durable");
                self.board.note_stored_frame(&shot.stamp);
                (self.observer)(&Event::FrameStored {
                    series: id,
                    shot: number,
                    file,
                    sha256,
                });
            }
            None => {
                tracing::error!(series, shot = number, "shot without a frame");
                self.board.update(|status| status.counts.failed_shots += 1);
            }
        }
    }

    /// Reports that a frame has its result; `new` is false if it already had one.
    pub fn log_frame_solved(&self, frame: &FrameRef, record: &ImageRecord, new: bool) {
        let (series, file) = (frame.series.id.as_str(), frame.entry.file.as_str());
        match (&record.reason, new) {
            (_, false) => tracing::warn!(series, file, "already has a result"),
            (None, true) => tracing::info!(series, file, "solved"),
            (Some(reason), true) => tracing::warn!(series, file, reason, "not solved"),
        }
        let ok = record.status == RecordStatus::Ok;
        if new {
            self.board
                .add_series_result(ok, record.global_test == Some(GlobalTest::Rejected));
        }
        let waiting = self.board.update(|status| {
            let count = if ok {
                &mut status.counts.solved
            } else {
                &mut status.counts.unsolvable
            };
            *count += u64::from(new);
            status.to_solve.saturating_sub(1)
        });
        self.board.note_unsolved(waiting, true);
        (self.observer)(&Event::Solved {
            series: series.to_owned(),
            file: file.to_owned(),
            ok,
        });
    }
}
