//! The recorder waits for the schedule, takes series and, in live mode, frames between them. Every frame of a series is
//! stored before anything computes on it.

use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::Duration;

use super::capture::{Capture, Missed, Mode, Taken};
use super::command::Command;
use super::config::SeriesConfig;
use super::core::Core;
use super::live::Feeder;
use super::schedule::{self, Moment, Next, Progress};
use super::status::Activity;
use super::{frame_storage, machine};
use crate::clock::Stamp;
use crate::store::manifest::{SeriesCause, ShotFailure, Shot, SeriesState};
use crate::store::{OpenSeries, SeriesPlan, StoreError};

/// Waits are cut into such pieces: a clock that was set and the watchdog are looked at in between.
const SLICE: Duration = Duration::from_secs(5);
/// Frames fetched from a camera's card before one series.
const MAX_LEFT_OVER: u32 = 200;
/// The series of those.
const LEFT_OVER: SeriesPlan = SeriesPlan { cause: SeriesCause::Recovered, shots: 0 };
/// Before a busy or lost camera is asked again.
const BACKOFF: Duration = Duration::from_millis(500);

/// What the recorder's thread works with.
pub(crate) struct Recorder {
    pub core: Core,
    pub config: SeriesConfig,
    pub inbox: Receiver<Command>,
    /// Wakes the processing; dropped at the end.
    pub wake: Sender<()>,
    pub capture: Capture,
    /// Which of the camera's openings the series under way has noted.
    pub noted: u64,
    pub triggered: bool,
    /// Between the series, in live mode.
    pub live: Option<Feeder>,
}

impl Recorder {
    /// Until the timetable is over or a stop is asked for.
    pub fn run(mut self) {
        let timetable = self.config.timetable();
        let mut progress = self.beginning();
        self.core.board.expect_frames(self.config.interval);
        while !self.core.halt.ending() {
            if self.core.halt.paused() {
                self.pause();
                continue;
            }
            if std::mem::take(&mut self.triggered) {
                self.series(SeriesCause::Triggered);
                continue;
            }
            let (next, state) = schedule::next(&timetable, progress, self.moment());
            progress = state;
            match next {
                Next::Over => break,
                Next::Begin(slot) => {
                    progress.last_slot = Some(slot);
                    if self.live.as_ref().is_none_or(Feeder::series) {
                        self.series(SeriesCause::Scheduled);
                    }
                }
                Next::Wait(wait) => {
                    let series = self.live.as_ref().is_none_or(Feeder::series);
                    self.core.board.next_series_in(series.then_some(wait));
                    self.idle(wait.min(SLICE));
                }
            }
        }
        self.core.board.next_series_in(None);
    }

    /// After a restart within one boot the slots go on where they were.
    fn beginning(&self) -> Progress {
        let (timetable, now) = (self.config.timetable(), self.moment());
        let began = self.core.store.series_starts_in_boot(&self.core.clock.stamp().boot_id);
        match (began.first(), began.last()) {
            (Some(first), Some(last)) => Progress::continuing(&timetable, *first, *last, now),
            _ => Progress::beginning(&timetable, now),
        }
    }

    fn moment(&self) -> Moment {
        let utc_s = self.core.clock.stamp().utc.as_millisecond() as f64 / 1e3;
        Moment { since_boot: self.core.clock.since_boot(), utc_s }
    }

    /// Waits on the clock and listens; returns early to stop, and where asked to on a trigger.
    fn wait(&mut self, duration: Duration, until_triggered: bool) {
        let end = self.core.clock.since_boot() + duration;
        let paused = self.core.halt.paused();
        while !(self.core.halt.ending()
            || self.core.halt.paused() != paused
            || until_triggered && self.triggered)
        {
            self.core.board.beat();
            let slice = end.saturating_sub(self.core.clock.since_boot()).min(SLICE);
            if slice.is_zero() {
                return;
            }
            match self.inbox.recv_timeout(self.core.clock.machine_time(slice)) {
                Ok(command) => self.obey(command),
                Err(RecvTimeoutError::Timeout) => self.core.clock.advance(slice),
                Err(RecvTimeoutError::Disconnected) => self.core.halt.end(SLICE),
            }
        }
    }

    fn obey(&mut self, command: Command) {
        match command {
            Command::Trigger => {
                self.triggered = true;
                self.live.iter().for_each(Feeder::trigger);
            }
            Command::NewFlight => {
                self.core.store.request_new_flight();
                self.triggered = true;
            }
            Command::Look if self.core.halt.ending() => {
                self.core.board.update(|status| status.activity = Activity::Stopping);
            }
            Command::Look => {}
        }
    }

    /// Until the power is back or goes, nothing is begun.
    fn pause(&mut self) {
        self.capture.close();
        self.core.board.update(|status| status.activity = Activity::PowerFailing);
        self.core.board.next_series_in(None);
        self.wait(SLICE, false);
        if !self.core.halt.wanted() {
            // What was left unsolved goes on.
            let _ = self.wake.send(());
        }
    }

    /// Between the series, for so long; returns early to stop and on a trigger.
    fn idle(&mut self, duration: Duration) {
        let activity = if self.live.is_some() { Activity::Live } else { Activity::Waiting };
        self.core.board.update(|status| status.activity = activity);
        let end = self.core.clock.since_boot() + duration;
        while !(self.core.halt.wanted() || self.triggered) {
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
                    live.due(now, self.capture.hanging()).min(end)
                }
            };
            if due > now {
                self.wait(due - now, true);
                continue;
            }
            self.core.board.beat();
            self.listen();
            if let Some(live) = &mut self.live {
                live.shot(&mut self.capture);
            }
        }
    }

    fn series(&mut self, cause: SeriesCause) {
        if let Err(error) = self.fetch_left_over() {
            tracing::error!(%error, "frames left in the camera could not be stored; tried again");
            self.core.board.fault(&error.to_string());
        }
        self.listen();
        if self.core.halt.wanted() {
            return self.capture.close();
        }
        let plan = SeriesPlan { cause, shots: self.config.shots };
        let mut series = match frame_storage::begin(&self.core, plan) {
            Ok(begun) => begun,
            Err(error) => {
                self.rest_camera();
                return self.core.series_refused(&error);
            }
        };
        // In live mode the camera is open already; each series says by what camera it was taken.
        self.noted = 0;
        if let Some(machine) = machine::line(Path::new(machine::SYS)) {
            tracing::info!(machine, "temperatures and supply");
        }
        self.core.series_began(&series, cause, plan.shots);
        self.live.iter().for_each(|live| live.expect_results(self.config.gap));
        let id = series.id().to_owned();
        let taken = self.shots(&mut series, plan.shots);
        let complete = series.shots().len() == plan.shots as usize;
        // Before the camera is closed: that may take its time, and the power may be about to go.
        let closed = taken.and_then(|()| self.close(series, complete));
        self.rest_camera();
        self.live.iter().for_each(|live| live.expect_results(Duration::ZERO));
        self.core.series_ended(id, complete, &closed);
        let _ = self.wake.send(());
    }

    /// In live mode it goes on.
    fn rest_camera(&mut self) {
        if self.live.is_none() {
            self.capture.close();
        }
    }

    fn close(&mut self, series: OpenSeries, complete: bool) -> Result<(), StoreError> {
        let state = if complete { SeriesState::Complete } else { SeriesState::Interrupted };
        let why = if self.core.halt.paused() { "the power failed" } else { "the daemon was asked to stop" };
        let remarks = if complete { Vec::new() } else { vec![why.to_owned()] };
        self.core.store.close_series(series, state, &self.core.clock.stamp(), remarks)
    }

    fn shots(&mut self, series: &mut OpenSeries, count: u32) -> Result<(), StoreError> {
        for number in 1..=count {
            self.listen();
            if self.core.halt.wanted() {
                break;
            }
            self.shot(series, number)?;
            if number < count {
                self.wait(self.config.gap, false);
            }
        }
        Ok(())
    }

    /// Frames that an interrupted series left on the camera's card become a series of their own.
    fn fetch_left_over(&mut self) -> Result<(), StoreError> {
        // A camera that was open has been asked; the shots will say why one does not open.
        if !self.capture.open().unwrap_or(false) {
            return Ok(());
        }
        let mut series: Option<OpenSeries> = None;
        for number in 1..=MAX_LEFT_OVER {
            self.listen();
            if self.core.halt.wanted() {
                break;
            }
            let Some(frame) = self.capture.left_over() else { break };
            if self.core.store.contains_frame(&frame.bytes) {
                self.capture.release_last();
                continue;
            }
            let open = match &mut series {
                Some(open) => open,
                none => none.insert(frame_storage::begin(&self.core, LEFT_OVER)?),
            };
            let stamp = self.core.clock.stamp();
            let failures = Vec::new();
            let shot = Shot { shot: number, stamp, duration_s: None, exposure: None, frame: None, failures };
            let entry = frame_storage::add(open, shot.clone(), Some(&frame))?;
            self.core.shot_stored(open.id(), &shot, entry);
            self.capture.release_last();
        }
        let Some(series) = series else { return Ok(()) };
        let remark = "found on the camera's card; the times are those of finding".to_owned();
        self.core.store.close_series(series, SeriesState::Interrupted, &self.core.clock.stamp(), vec![remark])
    }

    fn listen(&mut self) {
        while let Ok(command) = self.inbox.try_recv() {
            self.obey(command);
        }
    }

    /// One shot with its repeats, stored with its frame or with the reasons why there is none.
    fn shot(&mut self, series: &mut OpenSeries, number: u32) -> Result<(), StoreError> {
        let mut failures = Vec::new();
        loop {
            let stamp = self.core.clock.stamp();
            let missed = match self.attempt(series, &stamp)? {
                Ok(taken) => return self.keep(series, taken, number, failures),
                Err(missed) => missed,
            };
            let mut failure = missed.failure;
            if let Some(delivered) = missed.delivered {
                failure.kept_as = Some(series.set_aside(number, failures.len() + 1, &delivered.bytes)?);
            }
            self.core.attempt_failed(series.id(), number, &failure);
            failures.push(failure);
            if !missed.again || failures.len() > self.config.retries as usize || self.core.halt.wanted() {
                let duration_s = Some(self.core.clock.stamp().since_boot_s - stamp.since_boot_s);
                let shot = Shot { shot: number, stamp, duration_s, exposure: None, frame: None, failures };
                frame_storage::add(series, shot.clone(), None)?;
                self.core.shot_stored(series.id(), &shot, None);
                return Ok(());
            }
            self.wait(BACKOFF, false);
        }
    }

    fn attempt(
        &mut self,
        series: &mut OpenSeries,
        asked: &Stamp,
    ) -> Result<Result<Taken, Missed>, StoreError> {
        if let Err(error) = self.capture.open() {
            return Ok(Err(error.into()));
        }
        if let Some(camera) = self.capture.opened_since(&mut self.noted) {
            series.note_camera(camera)?;
        }
        Ok(self.capture.take(Mode::Shot, asked))
    }

    /// A good frame becomes durable and, in live mode, goes on to be solved.
    fn keep(
        &mut self,
        series: &mut OpenSeries,
        taken: Taken,
        number: u32,
        failures: Vec<ShotFailure>,
    ) -> Result<(), StoreError> {
        let shot = taken.shot(number, failures);
        let entry = frame_storage::add(series, shot.clone(), Some(&taken.frame))?;
        self.core.shot_stored(series.id(), &shot, entry);
        self.capture.release_last();
        if let Some(live) = &mut self.live {
            live.offer(taken, &self.capture);
        }
        Ok(())
    }
}
