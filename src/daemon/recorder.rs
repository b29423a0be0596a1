//! Capturing: waits for the schedule, takes series, stores every frame before anything computes on it.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::Duration;

use serde_json::Value;

use super::capture::Host;
use super::halt::Halt;
use super::judging::{camera_map, failure_of, log_recovery, worth_another};
use super::live::Feeder;
use super::machine;
use super::schedule::{self, Moment, Next, Progress};
use super::status::{Activity, Board};
use super::{Event, Observer, SeriesConfig};
use crate::camera::freshness::Freshness;
use crate::camera::{CameraError, CameraInfo, Frame, extension};
use crate::clock::{Clock, Stamp};
use crate::store::manifest::{Cause, Shot, State};
use crate::store::{NewFrame, OpenSeries, Plan, Store, StoreError};

/// What others ask of the recorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Command {
    /// An extra series, soon.
    Trigger,
    /// The same, as the first of a new flight.
    NewFlight,
    /// The halt has changed.
    Look,
}

/// Waits are cut into such pieces: a clock that was set and the watchdog are looked at in between.
const SLICE: Duration = Duration::from_secs(5);
/// Frames fetched from a camera's card before one series.
const MAX_LEFT_OVER: u32 = 200;
/// Before a busy or lost camera is asked again.
const BACKOFF: Duration = Duration::from_millis(500);

/// What the recorder's thread works with.
pub(crate) struct Recorder {
    pub config: SeriesConfig,
    pub store: Arc<Store>,
    pub clock: Arc<dyn Clock>,
    pub board: Board,
    pub observer: Observer,
    pub inbox: Receiver<Command>,
    /// Wakes the processing; dropped at the end.
    pub wake: Sender<()>,
    pub camera: Host,
    pub freshness: Freshness,
    /// The camera's own clock less UTC by the last frame that told it, s.
    pub camera_clock_offset_s: Option<f64>,
    /// What the camera said when it was opened, until a series has noted it.
    pub opened: Option<CameraInfo>,
    pub triggered: bool,
    pub halt: Halt,
    /// Between the series, in live mode.
    pub live: Option<Feeder>,
}

impl Recorder {
    /// Until the timetable is over or a stop is asked for.
    pub fn run(mut self) {
        let timetable = self.config.timetable();
        let mut progress = self.beginning();
        self.board.expect_frames(self.config.interval);
        while !self.halt.ending() {
            if self.halt.paused() {
                self.pause();
                continue;
            }
            if std::mem::take(&mut self.triggered) {
                self.series(Cause::Triggered);
                continue;
            }
            let (next, state) = schedule::next(&timetable, progress, self.moment());
            progress = state;
            match next {
                Next::Over => break,
                Next::Begin(slot) => {
                    progress.last_slot = Some(slot);
                    if self.live.as_ref().is_none_or(Feeder::series) {
                        self.series(Cause::Scheduled);
                    }
                }
                Next::Wait(wait) => {
                    let series = self.live.as_ref().is_none_or(Feeder::series);
                    self.board.next_series_in(series.then_some(wait));
                    match self.live {
                        Some(_) => self.live(wait.min(SLICE)),
                        None => {
                            self.board.update(|status| status.activity = Activity::Waiting);
                            self.wait(wait.min(SLICE), true);
                        }
                    }
                }
            }
        }
        self.board.next_series_in(None);
    }

    /// After a restart within one boot the slots go on where they were.
    fn beginning(&self) -> Progress {
        let (timetable, now) = (self.config.timetable(), self.moment());
        let began = self.store.series_of_boot(&self.clock.stamp().boot_id);
        match (began.first(), began.last()) {
            (Some(first), Some(last)) => Progress::continuing(&timetable, *first, *last, now),
            _ => Progress::beginning(&timetable, now),
        }
    }

    fn moment(&self) -> Moment {
        let utc_s = self.clock.stamp().utc.as_millisecond() as f64 / 1e3;
        Moment { since_boot: self.clock.since_boot(), utc_s }
    }

    /// Waits on the clock and listens; returns early to stop, and where asked to on a trigger.
    pub(super) fn wait(&mut self, duration: Duration, until_triggered: bool) {
        let end = self.clock.since_boot() + duration;
        let paused = self.halt.paused();
        while !(self.halt.ending() || self.halt.paused() != paused || until_triggered && self.triggered) {
            self.board.beat();
            let slice = end.saturating_sub(self.clock.since_boot()).min(SLICE);
            if slice.is_zero() {
                return;
            }
            match self.inbox.recv_timeout(self.clock.machine_time(slice)) {
                Ok(command) => self.obey(command),
                Err(RecvTimeoutError::Timeout) => self.clock.advance(slice),
                Err(RecvTimeoutError::Disconnected) => self.halt.end(SLICE),
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
                self.store.want_new_flight();
                self.triggered = true;
            }
            Command::Look if self.halt.ending() => {
                self.board.update(|status| status.activity = Activity::Stopping);
            }
            Command::Look => {}
        }
    }

    /// Until the power is back or goes, nothing is begun.
    fn pause(&mut self) {
        self.close_camera();
        self.board.update(|status| status.activity = Activity::PowerFailing);
        self.board.next_series_in(None);
        self.wait(SLICE, false);
        if !self.halt.wanted() {
            // What was left unsolved goes on.
            let _ = self.wake.send(());
        }
    }

    fn series(&mut self, cause: Cause) {
        if let Err(error) = self.fetch_left_over() {
            tracing::error!(%error, "frames left in the camera could not be stored; tried again");
            self.board.fault(&error.to_string());
        }
        self.listen();
        if self.halt.wanted() {
            return self.close_camera();
        }
        // In live mode it is open already; each series says by what camera it was taken.
        self.opened = self.opened.take().or_else(|| self.live.as_ref()?.info.clone());
        let plan = Plan { cause, shots: self.config.shots };
        let begun = self.store.begin_series(plan, &self.clock.stamp());
        let (mut series, recovery) = match begun {
            Ok(begun) => begun,
            Err(error) => return self.refused(&error),
        };
        log_recovery(&recovery);
        if let Some(machine) = machine::line(Path::new(machine::SYS)) {
            tracing::info!(machine, "temperatures and supply");
        }
        tracing::info!(series = series.id(), flight = series.flight(), ?cause, "series begins");
        self.board.update(|status| {
            status.activity = Activity::Capturing;
            status.flight = Some(series.flight().to_owned());
            status.series = Some(series.id().to_owned());
            status.shot = 0;
            status.shots_per_series = plan.shots;
        });
        let (id, flight) = (series.id().to_owned(), series.flight().to_owned());
        (self.observer)(&Event::SeriesBegan { series: id.clone(), flight });
        let taken = self.shots(&mut series, plan.shots);
        let complete = series.shots().len() == plan.shots as usize;
        // Before the camera is closed: that may take its time, and the power may be about to go.
        let closed = taken.and_then(|()| self.close(series, complete));
        self.rest_camera();
        self.note_end(&id, complete, closed);
        let _ = self.wake.send(());
    }

    fn refused(&mut self, error: &StoreError) {
        tracing::error!(%error, "series refused by the store");
        self.rest_camera();
        self.board.fault(&error.to_string());
        self.board.update(|status| {
            status.counts.series_refused += 1;
            status.store.free_mb = self.store.free_mb().ok();
        });
        (self.observer)(&Event::Refused { reason: error.to_string() });
    }

    /// In live mode it goes on.
    fn rest_camera(&mut self) {
        if self.live.is_none() {
            self.close_camera();
        }
    }

    fn close_camera(&mut self) {
        let board = self.board.clone();
        self.camera.close(&|| board.beat());
    }

    fn close(&mut self, series: OpenSeries, complete: bool) -> Result<(), StoreError> {
        let state = if complete { State::Complete } else { State::Interrupted };
        let why = if self.halt.paused() { "the power failed" } else { "the daemon was asked to stop" };
        let remarks = if complete { Vec::new() } else { vec![why.to_owned()] };
        self.store.close_series(series, state, &self.clock.stamp(), remarks)
    }

    fn note_end(&mut self, id: &str, complete: bool, closed: Result<(), StoreError>) {
        let complete = complete && closed.is_ok();
        match &closed {
            Ok(()) => tracing::info!(series = id, complete, "series closed"),
            Err(error) => {
                tracing::error!(series = id, %error, "series broken off; recovered before the next one");
                self.board.fault(&error.to_string());
            }
        }
        self.board.update(|status| {
            let counts = &mut status.counts;
            *(if complete { &mut counts.series_complete } else { &mut counts.series_interrupted }) += 1;
            status.camera.open = self.live.is_some();
            status.store.free_mb = self.store.free_mb().ok();
        });
        (self.observer)(&Event::SeriesClosed { series: id.to_owned(), complete });
    }

    fn shots(&mut self, series: &mut OpenSeries, count: u32) -> Result<(), StoreError> {
        for number in 1..=count {
            self.listen();
            if self.halt.wanted() {
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
        let board = self.board.clone();
        let beat = || board.beat();
        match self.camera.ensure_open(&beat) {
            Ok(Some(info)) => self.opened = Some(info),
            // The shots will say why it does not open.
            Ok(None) | Err(_) => return Ok(()),
        }
        let mut series: Option<OpenSeries> = None;
        for number in 1..=MAX_LEFT_OVER {
            self.listen();
            if self.halt.wanted() {
                break;
            }
            let Ok(Some(frame)) = self.camera.recover(self.config.shot_deadline, &beat) else { break };
            if self.store.holds(&frame.bytes) {
                self.camera.release_last(&beat);
                continue;
            }
            let stamp = self.clock.stamp();
            let open = match &mut series {
                Some(open) => open,
                none => {
                    let plan = Plan { cause: Cause::Recovered, shots: 0 };
                    none.insert(self.store.begin_series(plan, &stamp)?.0)
                }
            };
            let shot = Shot {
                shot: number,
                stamp,
                duration_s: None,
                exposure: None,
                frame: None,
                failures: Vec::new(),
            };
            self.keep(open, shot, Some(frame))?;
        }
        let Some(series) = series else { return Ok(()) };
        let remark = "found on the camera's card; the times are those of finding".to_owned();
        self.store.close_series(series, State::Interrupted, &self.clock.stamp(), vec![remark])
    }

    pub(super) fn listen(&mut self) {
        while let Ok(command) = self.inbox.try_recv() {
            self.obey(command);
        }
    }

    /// One shot with its repeats, stored with its frame or with the reasons why there is none.
    fn shot(&mut self, series: &mut OpenSeries, number: u32) -> Result<(), StoreError> {
        let mut failures = Vec::new();
        let mut stamp = self.clock.stamp();
        let mut frame = None;
        while frame.is_none() {
            stamp = self.clock.stamp();
            let (failure, again) = match self.attempt(series)? {
                Ok(delivered) => match self.judge(&delivered) {
                    Ok(()) => {
                        frame = Some(delivered);
                        break;
                    }
                    Err(mut failure) => {
                        let name = series.set_aside(number, failures.len() + 1, &delivered.bytes)?;
                        failure.kept_as = Some(name);
                        (failure, true)
                    }
                },
                Err(error) => (failure_of(&error), worth_another(&error)),
            };
            tracing::warn!(series = series.id(), shot = number, kind = failure.kind, reason = failure.reason);
            self.note_failure(&failure);
            failures.push(failure);
            if !again || failures.len() > self.config.retries as usize || self.halt.wanted() {
                break;
            }
            self.wait(BACKOFF, false);
        }
        let duration_s = self.clock.stamp().since_boot_s - stamp.since_boot_s;
        let exposure = frame.as_mut().map(|frame| self.exposure(frame, &stamp));
        let duration_s = Some(duration_s);
        let shot = Shot { shot: number, stamp, duration_s, exposure, frame: None, failures };
        self.keep(series, shot, frame)
    }

    fn attempt(&mut self, series: &mut OpenSeries) -> Result<Result<Frame, CameraError>, StoreError> {
        let board = self.board.clone();
        let beat = || board.beat();
        let opened = self.camera.ensure_open(&beat);
        let outcome = match opened {
            Ok(info) => {
                if let Some(info) = info.or_else(|| self.opened.take()) {
                    self.note_camera(series, info)?;
                }
                self.camera.shoot(self.config.shot_deadline, &beat)
            }
            Err(error) => Err(error),
        };
        self.board.update(|status| {
            status.counts.hangs = self.camera.hangs();
            status.camera.hanging_calls = self.camera.hanging();
        });
        Ok(outcome)
    }

    fn note_camera(&mut self, series: &mut OpenSeries, info: CameraInfo) -> Result<(), StoreError> {
        for warning in &info.warnings {
            tracing::warn!(camera = info.name, warning);
        }
        let camera = camera_map(&info);
        self.live.iter_mut().for_each(|live| live.opened(&info));
        self.board.update(|status| {
            status.camera.name = Some(info.name);
            status.camera.open = true;
            status.camera.warnings = info.warnings;
        });
        series.note_camera(camera)
    }

    fn keep(&mut self, series: &mut OpenSeries, shot: Shot, frame: Option<Frame>) -> Result<(), StoreError> {
        let stamp: Stamp = shot.stamp.clone();
        let (number, duration_s, exposure) = (shot.shot, shot.duration_s, shot.exposure.clone());
        let new = frame.as_ref().map(|frame| NewFrame {
            bytes: &frame.bytes,
            extension: extension(&frame.format),
            format: serde_json::to_value(&frame.format).unwrap_or(Value::Null),
            settings: frame.settings.clone(),
        });
        let id = series.id().to_owned();
        let stored = series.add_shot(shot, new)?.frame.clone();
        self.board.update(|status| status.shot = number);
        match stored {
            Some(entry) => {
                // From here on the frame is promised: tests and people may count on this line.
                tracing::info!(series = id, file = entry.file, sha256 = entry.sha256, "frame is durable");
                self.board.frame_stored(&stamp);
                let (file, sha256) = (entry.file, entry.sha256);
                (self.observer)(&Event::FrameStored { series: id, shot: number, file, sha256 });
                let board = self.board.clone();
                self.camera.release_last(&|| board.beat());
                if let (Some(live), Some(frame), Some(exposure)) = (&mut self.live, frame, exposure) {
                    live.offer(frame, stamp, duration_s.unwrap_or(0.0), exposure);
                }
            }
            None => {
                tracing::error!(series = id, shot = number, "shot without a frame");
                self.board.update(|status| status.counts.failed_shots += 1);
                (self.observer)(&Event::ShotFailed { series: id, shot: number });
            }
        }
        Ok(())
    }
}
