//! The thread that follows the schedule, takes series and, in live mode, frames between them. Every frame of a series is
//! stored before any computation uses it.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use super::capture::{Capture, CaptureMode, CapturedFrame, FailedAttempt};
use super::command::Command;
use super::config::SeriesConfig;
use super::core::Core;
use super::frame_storage;
use super::live::Feeder;
use super::schedule::{self, Moment, Progress, ScheduleAction};
use super::status::Activity;
use crate::camera::CameraFrame;
use wingd_base::clock::Stamp;
use wingd_store::manifest::{SeriesCause, SeriesState, Shot, ShotFailure};
use wingd_store::{OpenSeries, SeriesPlan, StoreResult};

/// Maximum length of a wait between two checks of the clock and beats of the watchdog.
const WAIT_SLICE: Duration = Duration::from_secs(5);
/// Maximum number of frames fetched from a camera's card before a series.
const MAX_LEFT_OVER: u32 = 200;
/// Plan of the series of fetched frames.
const LEFT_OVER_SERIES: SeriesPlan = SeriesPlan {
    cause: SeriesCause::Recovered,
    shots: 0,
};
/// Pause before a busy or lost camera is asked again.
const RETRY_PAUSE: Duration = Duration::from_millis(500);

/// State of the recorder's thread.
pub(crate) struct Recorder {
    pub core: Core,
    pub config: SeriesConfig,
    pub inbox: Receiver<Command>,
    /// Channel that wakes the processing; dropped at the end.
    pub wake: Sender<()>,
    pub capture: Capture,
    /// Number of the camera opening that the current series has noted.
    pub noted_opening: u64,
    pub triggered: bool,
    /// Source of live frames between the series; `None` if live mode is off.
    pub live: Option<Feeder>,
}

impl Recorder {
    /// Takes series until the timetable is over or a stop is requested.
    pub fn run(mut self) {
        let timetable = self.config.timetable();
        let mut progress = self.initial_progress();
        self.core.board.expect_frames(self.config.interval);
        while !self.core.halt.is_ending() {
            if self.core.halt.is_paused() {
                self.wait_for_power();
                continue;
            }
            if std::mem::take(&mut self.triggered) {
                self.take_series(SeriesCause::Triggered);
                continue;
            }
            let (next, state) = schedule::next_action(&timetable, progress, self.current_moment());
            progress = state;
            match next {
                ScheduleAction::Over => break,
                ScheduleAction::Begin(slot) => {
                    progress.last_slot = Some(slot);
                    if self.live.as_ref().is_none_or(Feeder::series_are_enabled) {
                        self.take_series(SeriesCause::Scheduled);
                    }
                }
                ScheduleAction::Wait(wait) => {
                    let series = self.live.as_ref().is_none_or(Feeder::series_are_enabled);
                    self.core.board.set_next_series(series.then_some(wait));
                    self.wait_for_series(wait.min(WAIT_SLICE));
                }
            }
        }
        self.core.board.set_next_series(None);
    }

    /// Returns the schedule's progress to start with: after a restart within one boot the slots continue.
    fn initial_progress(&self) -> Progress {
        let (timetable, now) = (self.config.timetable(), self.current_moment());
        let began = self
            .core
            .store
            .series_starts_in_boot(&self.core.clock.stamp().boot_id);
        match (began.first(), began.last()) {
            (Some(first), Some(last)) => Progress::resume(&timetable, *first, *last, now),
            _ => Progress::start(&timetable, now),
        }
    }

    fn current_moment(&self) -> Moment {
        let utc_s = self.core.clock.stamp().utc.as_millisecond() as f64 / 1e3;
        Moment {
            since_boot: self.core.clock.since_boot(),
            utc_s,
        }
    }

    /// Waits on the clock and handles commands. Returns early on a stop request and, if `until_triggered`, on a trigger.
    fn wait(&mut self, duration: Duration, until_triggered: bool) {
        let end = self.core.clock.since_boot() + duration;
        let paused = self.core.halt.is_paused();
        while !(self.core.halt.is_ending()
            || self.core.halt.is_paused() != paused
            || until_triggered && self.triggered)
        {
            self.core.board.beat();
            let slice = end
                .saturating_sub(self.core.clock.since_boot())
                .min(WAIT_SLICE);
            if slice.is_zero() {
                return;
            }
            match self.inbox.recv_timeout(self.core.clock.machine_time(slice)) {
                Ok(command) => self.handle_command(command),
                Err(RecvTimeoutError::Timeout) => self.core.clock.advance(slice),
                Err(RecvTimeoutError::Disconnected) => self.core.halt.end(WAIT_SLICE),
            }
        }
    }

    fn handle_command(&mut self, command: Command) {
        match command {
            Command::Trigger => {
                self.triggered = true;
                self.live.iter().for_each(Feeder::save_recent_frames);
            }
            Command::NewFlight => {
                self.core.store.request_new_flight();
                self.triggered = true;
            }
            Command::HaltChanged if self.core.halt.is_ending() => {
                self.core
                    .board
                    .update(|status| status.activity = Activity::Stopping);
            }
            Command::HaltChanged => {}
        }
    }

    /// Begins nothing until the power is back or the daemon ends.
    fn wait_for_power(&mut self) {
        self.capture.close();
        self.core
            .board
            .update(|status| status.activity = Activity::PowerFailing);
        self.core.board.set_next_series(None);
        self.wait(WAIT_SLICE, false);
        if !self.core.halt.is_requested() {
            // Unsolved frames are solved now.
            let _ = self.wake.send(());
        }
    }

    /// Waits between the series for `duration`, taking live frames. Returns early on a stop request and on a trigger.
    fn wait_for_series(&mut self, duration: Duration) {
        let activity = if self.live.is_some() {
            Activity::Live
        } else {
            Activity::Waiting
        };
        self.core.board.update(|status| status.activity = activity);
        let end = self.core.clock.since_boot() + duration;
        while !(self.core.halt.is_requested() || self.triggered) {
            let now = self.core.clock.since_boot();
            if now >= end {
                return;
            }
            let due = match &mut self.live {
                None => end,
                Some(live) => {
                    if live.has_unsolved() {
                        let _ = self.wake.send(());
                    }
                    live.next_due(now, self.capture.hanging_calls()).min(end)
                }
            };
            if due > now {
                self.wait(due - now, true);
                continue;
            }
            self.core.board.beat();
            self.handle_pending_commands();
            if let Some(live) = &mut self.live {
                live.take_due_frame(&mut self.capture);
            }
        }
    }

    fn take_series(&mut self, cause: SeriesCause) {
        if let Err(error) = self.fetch_left_over() {
            tracing::error!(%error, "frames left in the camera could not be stored; trying again before the next series");
            self.core.board.note_fault(&error.to_string());
        }
        self.handle_pending_commands();
        if self.core.halt.is_requested() {
            return self.capture.close();
        }
        let plan = SeriesPlan {
            cause,
            shots: self.config.shots,
        };
        let mut series = match self.store(|core| frame_storage::begin_series(core, plan)) {
            Ok(begun) => begun,
            Err(error) => {
                self.close_idle_camera();
                return self.core.log_series_refused(&error);
            }
        };
        // In live mode the camera is already open; each series notes its camera.
        self.noted_opening = 0;
        self.core.log_series_began(&series, cause, plan.shots);
        self.live
            .iter()
            .for_each(|live| live.expect_results(self.config.gap));
        let id = series.id().to_owned();
        let taken = self.take_shots(&mut series, plan.shots);
        let complete = series.shots().len() == plan.shots as usize;
        // Before the camera is closed: that may take long, and the power may be about to fail.
        let closed = taken.and_then(|()| self.close_series(series, complete));
        self.close_idle_camera();
        self.live
            .iter()
            .for_each(|live| live.expect_results(Duration::ZERO));
        self.core.log_series_ended(id, complete, &closed);
        let _ = self.wake.send(());
    }

    /// Closes the camera after a series, except in live mode.
    fn close_idle_camera(&mut self) {
        if self.live.is_none() {
            self.capture.close();
        }
    }

    /// Runs `work`, which waits for the disk; meanwhile live frames are taken if the camera streams.
    fn store<T>(&mut self, work: impl FnOnce(&Core) -> T) -> T {
        let core = self.core.clone();
        let Some(live) = self.live.as_mut().filter(|_| self.capture.is_streaming()) else {
            return work(&core);
        };
        let (storing, stored) = channel();
        std::thread::scope(|scope| {
            live.spawn_while(scope, stored, &mut self.capture);
            let result = work(&core);
            drop(storing);
            result
        })
    }

    fn close_series(&mut self, series: OpenSeries, complete: bool) -> StoreResult<()> {
        let state = if complete {
            SeriesState::Complete
        } else {
            SeriesState::Interrupted
        };
        let remark = if self.core.halt.is_paused() {
            "the power failed"
        } else {
            "the daemon was asked to stop"
        };
        let remarks = if complete {
            Vec::new()
        } else {
            vec![remark.to_owned()]
        };
        self.store(|core| {
            core.store
                .close_series(series, state, &core.clock.stamp(), remarks)
        })
    }

    fn take_shots(&mut self, series: &mut OpenSeries, count: u32) -> StoreResult<()> {
        for number in 1..=count {
            self.handle_pending_commands();
            if self.core.halt.is_requested() {
                break;
            }
            self.take_shot(series, number)?;
            if number < count {
                self.wait(self.config.gap, false);
            }
        }
        Ok(())
    }

    /// Stores the frames that an interrupted series left on the camera's card as a series of their own.
    fn fetch_left_over(&mut self) -> StoreResult<()> {
        // The card of an open camera has been read already; if it does not open, the shots report why.
        if !self.capture.ensure_open().unwrap_or(false) {
            return Ok(());
        }
        let mut series: Option<OpenSeries> = None;
        for number in 1..=MAX_LEFT_OVER {
            self.handle_pending_commands();
            if self.core.halt.is_requested() {
                break;
            }
            let Some(frame) = self.capture.take_left_over() else {
                break;
            };
            if self.core.store.contains_frame(&frame.bytes) {
                self.capture.release_last_frame();
                continue;
            }
            let open = match &mut series {
                Some(open) => open,
                none => none.insert(frame_storage::begin_series(&self.core, LEFT_OVER_SERIES)?),
            };
            let stamp = self.core.clock.stamp();
            let failures = Vec::new();
            let shot = Shot {
                shot: number,
                stamp,
                duration_s: None,
                exposure: None,
                frame: None,
                failures,
            };
            let entry = frame_storage::add_shot(open, shot.clone(), Some(&frame))?;
            self.core.log_shot_stored(open.id(), &shot, entry);
            self.capture.release_last_frame();
        }
        let Some(series) = series else { return Ok(()) };
        let remark = "found on the camera's card; the times are those of the transfer".to_owned();
        self.core.store.close_series(
            series,
            SeriesState::Interrupted,
            &self.core.clock.stamp(),
            vec![remark],
        )
    }

    fn handle_pending_commands(&mut self) {
        while let Ok(command) = self.inbox.try_recv() {
            self.handle_command(command);
        }
    }

    /// Takes a shot, with repeats, and stores it with its frame or with the reasons for its absence.
    fn take_shot(&mut self, series: &mut OpenSeries, number: u32) -> StoreResult<()> {
        let mut failures = Vec::new();
        loop {
            let stamp = self.core.clock.stamp();
            let failed = match self.attempt_shot(series, &stamp)? {
                Ok(taken) => return self.store_frame(series, taken, number, failures),
                Err(failed) => failed,
            };
            let mut failure = failed.failure;
            // An old frame that is stored already is not kept again with each attempt.
            let stored = |frame: &CameraFrame| {
                series.contains_frame(&frame.bytes) || self.core.store.contains_frame(&frame.bytes)
            };
            // One bad frame of a shot shows what is wrong with the camera.
            let kept = failures.iter().any(|f: &ShotFailure| f.kept_as.is_some());
            let bad = failed.delivered.filter(|frame| !(kept || stored(frame)));
            if let Some(delivered) = bad {
                let attempt = failures.len() + 1;
                failure.kept_as =
                    Some(self.store(|_| series.set_aside(number, attempt, &delivered.bytes))?);
            }
            self.core.log_attempt_failed(series.id(), number, &failure);
            failures.push(failure);
            if !failed.retry
                || failures.len() > self.config.retries as usize
                || self.core.halt.is_requested()
            {
                let duration_s = Some(self.core.clock.stamp().since_boot_s - stamp.since_boot_s);
                let shot = Shot {
                    shot: number,
                    stamp,
                    duration_s,
                    exposure: None,
                    frame: None,
                    failures,
                };
                self.store(|_| frame_storage::add_shot(series, shot.clone(), None))?;
                self.core.log_shot_stored(series.id(), &shot, None);
                return Ok(());
            }
            self.wait(RETRY_PAUSE, false);
        }
    }

    fn attempt_shot(
        &mut self,
        series: &mut OpenSeries,
        asked: &Stamp,
    ) -> StoreResult<Result<CapturedFrame, FailedAttempt>> {
        if let Err(error) = self.capture.ensure_open() {
            return Ok(Err(error.into()));
        }
        if let Some(camera) = self.capture.camera_if_reopened(&mut self.noted_opening) {
            self.store(|_| series.note_camera(camera))?;
        }
        Ok(self.capture.take_frame(CaptureMode::Shot, asked))
    }

    /// Makes a good frame durable and, in live mode, passes it on to be solved.
    fn store_frame(
        &mut self,
        series: &mut OpenSeries,
        taken: CapturedFrame,
        number: u32,
        failures: Vec<ShotFailure>,
    ) -> StoreResult<()> {
        let shot = taken.to_shot(number, failures);
        let entry =
            self.store(|_| frame_storage::add_shot(series, shot.clone(), Some(&taken.frame)))?;
        self.core.log_shot_stored(series.id(), &shot, entry);
        self.capture.release_last_frame();
        if let Some(live) = &mut self.live {
            live.forward_frame(taken, &self.capture);
        }
        Ok(())
    }
}
