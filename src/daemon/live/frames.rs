//! Raw frames are kept: every n-th, and those about an event. They wait in memory that is bounded; what it does not hold is
//! lost and counted.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::{Map, Value};

use super::config::KeepConfig;
use super::result::LiveFrame;
use super::shared::Shared;
use crate::daemon::frame_storage;
use crate::store::manifest::{SeriesCause, SeriesState as Ended};
use crate::store::{OpenSeries, SeriesPlan, StoreError};

/// Of every n-th frame so many may wait for the disk.
const NTH_WAITING: usize = 4;
/// Frames of a series of every n-th frame; then the next begins.
const NTH_OF_SERIES: usize = 500;
/// An event that others prolong ends after so many frames; a file's name has four digits.
const EVENT_FRAMES: usize = 9000;

/// What is to be saved about an event.
struct Wanted {
    from_s: f64,
    until_s: f64,
    reasons: Vec<String>,
    frames: usize,
}

#[derive(Default)]
struct State {
    ring: VecDeque<Arc<LiveFrame>>,
    bytes: usize,
    nth: VecDeque<Arc<LiveFrame>>,
    event: Option<Wanted>,
    /// Before this time since boot, s, nothing but a wish begins an event.
    quiet_until_s: f64,
    camera: Map<String, Value>,
    closed: bool,
}

/// Frames in memory, between the recorder and the keeper.
pub(crate) struct Raw {
    keep: KeepConfig,
    state: Mutex<State>,
    changed: Condvar,
    /// A series of raw frames is there to be solved.
    pub unsolved: AtomicBool,
}

/// What the keeper does next.
enum Job {
    Nth(Arc<LiveFrame>),
    OfEvent(Arc<LiveFrame>),
    EndEvent(Vec<String>),
    Wait,
    End,
}

impl Raw {
    pub fn new(keep: KeepConfig) -> Self {
        Self { keep, state: Mutex::default(), changed: Condvar::new(), unsolved: AtomicBool::new(false) }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is written of the camera into each series.
    pub fn camera(&self, camera: Map<String, Value>) {
        self.state().camera = camera;
    }

    /// Takes up a frame; returns how many are lost for it.
    pub fn push(&self, frame: &Arc<LiveFrame>) -> u64 {
        let mut state = self.state();
        let mut lost = 0;
        if self.keep.every > 0 && frame.number.is_multiple_of(self.keep.every.into()) {
            state.nth.push_back(frame.clone());
            if state.nth.len() > NTH_WAITING {
                state.nth.pop_front();
                lost += 1;
            }
        }
        if self.keep.ring_mb > 0 {
            state.bytes += frame.taken.frame.bytes.len();
            state.ring.push_back(frame.clone());
            lost += state.make_room(self.keep.ring_mb as usize * 1_000_000, self.keep.before.as_secs_f64());
        }
        drop(state);
        self.changed.notify_all();
        lost
    }

    /// Something happened at this time since boot, s, or somebody asks: it begins an event, or prolongs one.
    pub fn event(&self, shared: &Shared, reason: String, at_s: f64, asked: bool) {
        let mut state = self.state();
        if self.keep.ring_mb == 0 || state.event.is_none() && !asked && at_s < state.quiet_until_s {
            return;
        }
        let until_s = at_s + self.keep.after.as_secs_f64();
        state.quiet_until_s = until_s + self.keep.pause.as_secs_f64();
        match &mut state.event {
            Some(event) => {
                event.until_s = event.until_s.max(until_s);
                if !event.reasons.contains(&reason) && event.reasons.len() < 20 {
                    event.reasons.push(reason);
                }
            }
            none => {
                tracing::info!(reason, "event");
                shared.update(|live| live.events += 1);
                let from_s = at_s - self.keep.before.as_secs_f64();
                *none = Some(Wanted { from_s, until_s, reasons: vec![reason], frames: 0 });
            }
        }
        drop(state);
        self.changed.notify_all();
    }

    /// No more frames come.
    pub fn close(&self) {
        self.state().closed = true;
        self.changed.notify_all();
    }

    fn wait(&self) {
        let state = self.state();
        let _ = self.changed.wait_timeout(state, Duration::from_millis(500));
    }
}

impl State {
    /// The oldest frames go; how many of them an event wanted.
    fn make_room(&mut self, most_bytes: usize, before_s: f64) -> u64 {
        let newest_s = self.ring.back().map_or(0.0, |f| f.at_s());
        let mut lost = 0;
        while let Some(front) = self.ring.front() {
            let at_s = front.at_s();
            let wanted = self.event.as_ref().is_some_and(|e| (e.from_s..=e.until_s).contains(&at_s));
            let old = !wanted && newest_s - at_s > before_s;
            // The newest stays, however large.
            if self.ring.len() < 2 || !(old || self.bytes > most_bytes) {
                break;
            }
            lost += u64::from(wanted);
            self.pop();
        }
        lost
    }

    fn pop(&mut self) -> Option<Arc<LiveFrame>> {
        let frame = self.ring.pop_front()?;
        self.bytes -= frame.taken.frame.bytes.len();
        Some(frame)
    }

    fn next(&mut self) -> Job {
        if let Some(frame) = self.nth.pop_front() {
            return Job::Nth(frame);
        }
        while let Some(event) = &mut self.event {
            let at_s = self.ring.front().map(|f| f.at_s());
            let (from_s, until_s) = (event.from_s, event.until_s);
            let over = at_s.is_some_and(|at| at > until_s) || event.frames >= EVENT_FRAMES;
            if over || (at_s.is_none() && self.closed) {
                return Job::EndEvent(self.event.take().map(|e| e.reasons).unwrap_or_default());
            }
            match at_s {
                None => return Job::Wait,
                Some(at) if at < from_s => drop(self.pop()),
                Some(_) => {
                    event.frames += 1;
                    if let Some(frame) = self.pop() {
                        return Job::OfEvent(frame);
                    }
                }
            }
        }
        if self.closed { Job::End } else { Job::Wait }
    }
}

/// Writes the frames, on a thread of its own.
pub(super) struct Keeper {
    pub shared: Shared,
    pub raw: Arc<Raw>,
}

impl Keeper {
    /// Until no more frames come.
    pub fn run(self) {
        let (mut nth, mut event) = (None, None);
        loop {
            let job = self.raw.state().next();
            match job {
                Job::Nth(frame) => {
                    self.keep(&mut nth, SeriesCause::Live, &frame);
                    if nth.as_ref().is_some_and(|series: &OpenSeries| series.shots().len() >= NTH_OF_SERIES) {
                        self.close(&mut nth, vec![self.words_of_nth()]);
                    }
                }
                Job::OfEvent(frame) => self.keep(&mut event, SeriesCause::Event, &frame),
                Job::EndEvent(reasons) => self.close(&mut event, reasons),
                Job::Wait => self.raw.wait(),
                Job::End => break,
            }
        }
        self.close(&mut nth, vec![self.words_of_nth()]);
    }

    fn words_of_nth(&self) -> String {
        format!("every {}th frame of live mode", self.raw.keep.every)
    }

    fn keep(&self, series: &mut Option<OpenSeries>, cause: SeriesCause, frame: &LiveFrame) {
        match self.store(series, cause, frame) {
            Ok(()) => {
                self.shared.update(|live| live.kept_frames += 1);
                self.shared.clear("frames");
            }
            Err(error) => {
                // A series that a call failed in is recovered before the next one begins.
                *series = None;
                self.shared.update(|live| live.lost_frames += 1);
                self.shared.fault("frames", &format!("raw frames cannot be kept: {error}"));
            }
        }
    }

    fn store(
        &self,
        series: &mut Option<OpenSeries>,
        cause: SeriesCause,
        frame: &LiveFrame,
    ) -> Result<(), StoreError> {
        let open = match series {
            Some(open) => open,
            none => {
                let mut begun = frame_storage::begin(&self.shared.core, SeriesPlan { cause, shots: 0 })?;
                begun.note_camera(self.raw.state().camera.clone())?;
                none.insert(begun)
            }
        };
        let number = u32::try_from(open.shots().len()).unwrap_or(u32::MAX).saturating_add(1);
        frame_storage::add(open, frame.taken.shot(number, Vec::new()), Some(&frame.taken.frame)).map(drop)
    }

    fn close(&self, series: &mut Option<OpenSeries>, remarks: Vec<String>) {
        let Some(series) = series.take() else { return };
        let id = series.id().to_owned();
        let core = &self.shared.core;
        match core.store.close_series(series, Ended::Complete, &core.clock.stamp(), remarks.clone()) {
            Ok(()) => {
                tracing::info!(series = id, why = remarks.join("; "), "raw frames of live mode are kept")
            }
            Err(error) => self.shared.fault("frames", &format!("raw frames cannot be kept: {error}")),
        }
        self.raw.unsolved.store(true, Ordering::Relaxed);
    }
}
