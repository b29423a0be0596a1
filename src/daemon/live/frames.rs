//! Keeps raw frames: every n-th frame, and the frames around an event. They wait in bounded memory; frames that do not fit
//! are lost and counted.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::{Map, Value};

use super::config::KeepConfig;
use super::context::LiveContext;
use super::result::LiveFrame;
use crate::daemon::budget::check_disk_share;
use crate::daemon::frame_storage;
use wingd_store::manifest::{SeriesCause, SeriesState};
use wingd_store::{OpenSeries, SeriesPlan, StoreResult};

/// Maximum number of every-n-th frames that wait for the disk.
const MAX_NTH_WAITING: usize = 4;
/// Number of frames in a series; then the next series begins. Closing a series and reading its results takes time and memory.
const MAX_SERIES_FRAMES: usize = 1000;
/// Multiple of `after` by which further events prolong an event at most: a camera that is disturbed all the time must not fill
/// the disk.
const MAX_PROLONGATION: u32 = 3;
/// Share of the disk for raw frames of live mode.
const DISK_SHARE: f64 = 0.5;

/// Period of an event whose frames are to be saved.
struct EventWindow {
    from_s: f64,
    until_s: f64,
    /// Time since boot at which it ends even if it is prolonged, s.
    latest_s: f64,
    reasons: Vec<String>,
}

#[derive(Default)]
struct BufferState {
    ring: VecDeque<Arc<LiveFrame>>,
    bytes: usize,
    nth: VecDeque<Arc<LiveFrame>>,
    event: Option<EventWindow>,
    /// Time since boot before which only `wingd trigger` begins an event, s.
    quiet_until_s: f64,
    camera: Map<String, Value>,
    closed: bool,
}

/// Frames in memory, between the recorder and the [`RawFrameWriter`].
pub(crate) struct RawFrameBuffer {
    keep: KeepConfig,
    state: Mutex<BufferState>,
    changed: Condvar,
    /// True if a closed series of raw frames waits to be solved.
    pub unsolved: AtomicBool,
}

/// Next job of the [`RawFrameWriter`].
enum WriterJob {
    Nth(Arc<LiveFrame>),
    /// Frame of an event, with the reasons so far.
    OfEvent(Arc<LiveFrame>, Vec<String>),
    EndEvent(Vec<String>),
    Wait,
    End,
}

impl RawFrameBuffer {
    /// Creates an empty buffer.
    pub fn new(keep: KeepConfig) -> Self {
        Self {
            keep,
            state: Mutex::default(),
            changed: Condvar::new(),
            unsolved: AtomicBool::new(false),
        }
    }

    fn lock_state(&self) -> MutexGuard<'_, BufferState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the camera's entry for each series.
    pub fn set_camera(&self, camera: Map<String, Value>) {
        self.lock_state().camera = camera;
    }

    /// Adds a frame; returns the number of frames lost for it.
    pub fn push(&self, frame: &Arc<LiveFrame>) -> u64 {
        let mut state = self.lock_state();
        let mut lost = 0;
        if self.keep.every > 0 && frame.number.is_multiple_of(self.keep.every.into()) {
            state.nth.push_back(frame.clone());
            if state.nth.len() > MAX_NTH_WAITING {
                state.nth.pop_front();
                lost += 1;
            }
        }
        if self.keep.ring_mb > 0 {
            state.bytes += frame.taken.frame.bytes.len();
            state.ring.push_back(frame.clone());
            lost += state.make_room(
                self.keep.ring_mb as usize * 1_000_000,
                self.keep.before.as_secs_f64(),
            );
        }
        drop(state);
        self.changed.notify_all();
        lost
    }

    /// Begins or prolongs an event at the time `at_s` since boot, s; `requested`: it was requested by `wingd trigger`.
    pub fn add_event(&self, shared: &LiveContext, reason: String, at_s: f64, requested: bool) {
        let mut state = self.lock_state();
        if self.keep.ring_mb == 0
            || state.event.is_none() && !requested && at_s < state.quiet_until_s
        {
            return;
        }
        let after_s = self.keep.after.as_secs_f64();
        let latest_s = state
            .event
            .as_ref()
            .map_or(at_s + f64::from(MAX_PROLONGATION) * after_s, |event| {
                event.latest_s
            });
        let until_s = (at_s + after_s).min(latest_s);
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
                *none = Some(EventWindow {
                    from_s,
                    until_s,
                    latest_s,
                    reasons: vec![reason],
                });
            }
        }
        drop(state);
        self.changed.notify_all();
    }

    /// Closes the buffer: no more frames come.
    pub fn close(&self) {
        self.lock_state().closed = true;
        self.changed.notify_all();
    }

    fn wait_for_change(&self) {
        let state = self.lock_state();
        let _ = self.changed.wait_timeout(state, Duration::from_millis(500));
    }
}

impl BufferState {
    /// Drops the oldest frames; returns the number of those that belonged to an event.
    fn make_room(&mut self, max_bytes: usize, before_s: f64) -> u64 {
        let newest_s = self.ring.back().map_or(0.0, |f| f.exposed_at_s());
        let mut lost = 0;
        while let Some(front) = self.ring.front() {
            let at_s = front.exposed_at_s();
            let in_event = self
                .event
                .as_ref()
                .is_some_and(|e| (e.from_s..=e.until_s).contains(&at_s));
            let old = !in_event && newest_s - at_s > before_s;
            // The newest stays, however large.
            if self.ring.len() < 2 || !(old || self.bytes > max_bytes) {
                break;
            }
            lost += u64::from(in_event);
            self.pop_oldest();
        }
        lost
    }

    fn pop_oldest(&mut self) -> Option<Arc<LiveFrame>> {
        let frame = self.ring.pop_front()?;
        self.bytes -= frame.taken.frame.bytes.len();
        Some(frame)
    }

    fn next_job(&mut self) -> WriterJob {
        if let Some(frame) = self.nth.pop_front() {
            return WriterJob::Nth(frame);
        }
        while let Some(event) = &mut self.event {
            let at_s = self.ring.front().map(|f| f.exposed_at_s());
            let (from_s, until_s) = (event.from_s, event.until_s);
            let over = at_s.is_some_and(|at| at > until_s);
            if over || (at_s.is_none() && self.closed) {
                return WriterJob::EndEvent(
                    self.event.take().map(|e| e.reasons).unwrap_or_default(),
                );
            }
            match at_s {
                None => return WriterJob::Wait,
                Some(at) if at < from_s => drop(self.pop_oldest()),
                Some(_) => {
                    let reasons = event.reasons.clone();
                    if let Some(frame) = self.pop_oldest() {
                        return WriterJob::OfEvent(frame, reasons);
                    }
                }
            }
        }
        if self.closed {
            WriterJob::End
        } else {
            WriterJob::Wait
        }
    }
}

/// Writes raw frames to the store, on its own thread.
pub(super) struct RawFrameWriter {
    shared: LiveContext,
    raw: Arc<RawFrameBuffer>,
    /// Raw frames of live mode in the newest flight, bytes.
    bytes: u64,
}

impl RawFrameWriter {
    /// Creates the writer of a buffer's frames.
    pub fn new(shared: LiveContext, raw: Arc<RawFrameBuffer>) -> Self {
        let bytes = shared.core.store.raw_frame_bytes();
        Self { shared, raw, bytes }
    }

    /// Writes frames until the buffer is closed and empty.
    pub fn run(mut self) {
        let (mut nth, mut event) = (None, None);
        loop {
            let job = self.raw.lock_state().next_job();
            match job {
                WriterJob::Nth(frame) => {
                    let remarks = vec![self.nth_frame_series_remark()];
                    self.store_within_budget(&mut nth, SeriesCause::Live, &frame, remarks);
                }
                WriterJob::OfEvent(frame, reasons) => {
                    self.store_within_budget(&mut event, SeriesCause::Event, &frame, reasons);
                }
                WriterJob::EndEvent(reasons) => self.close_series(&mut event, reasons),
                WriterJob::Wait => self.raw.wait_for_change(),
                WriterJob::End => break,
            }
        }
        self.close_series(&mut nth, vec![self.nth_frame_series_remark()]);
    }

    fn nth_frame_series_remark(&self) -> String {
        format!("every {}th frame of live mode", self.raw.keep.every)
    }

    /// Stores a frame, and closes a series that is long enough.
    fn store_within_budget(
        &mut self,
        series: &mut Option<OpenSeries>,
        cause: SeriesCause,
        frame: &LiveFrame,
        remarks: Vec<String>,
    ) {
        let used = self.bytes + frame.taken.frame.bytes.len() as u64;
        let allowed = check_disk_share(&self.shared.core.store, DISK_SHARE, used);
        let stored = allowed.and_then(|()| {
            // A series with a failed call is recovered before the next one begins.
            self.write_frame(series, cause, frame)
                .inspect_err(|_| *series = None)
                .map_err(|error| error.to_string())
        });
        match stored {
            Ok(()) => {
                self.bytes = used;
                self.shared.update(|live| live.kept_frames += 1);
                self.shared.clear_fault("frames");
            }
            Err(error) => {
                self.shared.update(|live| live.lost_frames += 1);
                self.shared
                    .set_fault("frames", &format!("raw frames cannot be kept: {error}"));
            }
        }
        let is_full = |series: &&mut OpenSeries| series.shots().len() >= MAX_SERIES_FRAMES;
        if series.as_mut().filter(is_full).is_some() {
            self.close_series(series, remarks);
        }
    }

    fn write_frame(
        &self,
        series: &mut Option<OpenSeries>,
        cause: SeriesCause,
        frame: &LiveFrame,
    ) -> StoreResult<()> {
        let open = match series {
            Some(open) => open,
            none => {
                let mut begun =
                    frame_storage::begin_series(&self.shared.core, SeriesPlan { cause, shots: 0 })?;
                begun.note_camera(self.raw.lock_state().camera.clone())?;
                none.insert(begun)
            }
        };
        let number = u32::try_from(open.shots().len())
            .unwrap_or(u32::MAX)
            .saturating_add(1);
        frame_storage::add_shot(
            open,
            frame.taken.to_shot(number, Vec::new()),
            Some(&frame.taken.frame),
        )
        .map(drop)
    }

    fn close_series(&self, series: &mut Option<OpenSeries>, remarks: Vec<String>) {
        let Some(series) = series.take() else { return };
        let id = series.id().to_owned();
        let core = &self.shared.core;
        match core.store.close_series(
            series,
            SeriesState::Complete,
            &core.clock.stamp(),
            remarks.clone(),
        ) {
            Ok(()) => {
                tracing::info!(
                    series = id,
                    why = remarks.join("; "),
                    "stored a series of raw frames of live mode"
                )
            }
            Err(error) => self
                .shared
                .set_fault("frames", &format!("raw frames cannot be kept: {error}")),
        }
        self.raw.unsolved.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraFrame;
    use crate::daemon::capture::CapturedFrame;
    use crate::daemon::core::Core;
    use crate::daemon::live::LiveConfig;
    use crate::daemon::shutdown::Halt;
    use crate::daemon::status::StatusBoard;
    use wingd_base::clock::exposure::Exposure;
    use wingd_base::clock::quality::ClockQuality;
    use wingd_base::clock::{Clock, SimulatedClock, Stamp};
    use wingd_evaluation::frame_format::Format;
    use wingd_store::{RealDisk, Store, StoreConfig};

    fn context(root: &std::path::Path) -> LiveContext {
        let clock: Arc<dyn Clock> = Arc::new(SimulatedClock::new(
            "b",
            "2026-03-01T06:00:00Z".parse().unwrap(),
            None,
        ));
        let config = StoreConfig {
            reserve_mb: 0,
            ..StoreConfig::new(root)
        };
        let store = Store::open(Arc::new(RealDisk), config);
        let (store, board) = (Arc::new(store.unwrap().0), StatusBoard::new(clock.clone()));
        let core = Core {
            store,
            clock,
            board,
            halt: Halt::default(),
            observer: Arc::new(|_| ()),
        };
        LiveContext::new(&core, &LiveConfig::default())
    }

    fn live_frame(number: u64, at_s: f64) -> LiveFrame {
        let stamp = Stamp {
            utc: "2026-03-01T06:00:00Z".parse().unwrap(),
            utc_synchronised: true,
            boot_id: "b".to_owned(),
            since_boot_s: at_s,
        };
        let frame = CameraFrame {
            bytes: (number as u32).to_le_bytes().to_vec(),
            format: Format::Jpeg,
            settings: Map::new(),
            exposed: None,
        };
        let exposure = Exposure::from_request(&stamp, at_s, ClockQuality::default());
        let taken = CapturedFrame {
            frame,
            stamp,
            duration_s: 0.0,
            exposure,
        };
        LiveFrame { number, taken }
    }

    #[test]
    fn a_long_event_is_stored_in_several_series() {
        let dir = tempfile::tempdir().unwrap();
        let shared = context(dir.path());
        let buffer = Arc::new(RawFrameBuffer::new(KeepConfig::default()));
        buffer.add_event(&shared, "a gust".to_owned(), 1.0, true);
        for number in 0..=MAX_SERIES_FRAMES as u64 {
            buffer.push(&Arc::new(live_frame(number, 1.0)));
        }
        buffer.close();
        RawFrameWriter::new(shared.clone(), buffer).run();
        let manifests = shared.core.store.newest_manifests();
        let counts: Vec<_> = manifests.iter().map(|m| m.shots.len()).collect();
        assert_eq!(counts, [MAX_SERIES_FRAMES, 1]);
        assert!(manifests.iter().all(|m| m.remarks == ["a gust"]));
        let bytes = (MAX_SERIES_FRAMES as u64 + 1) * 4;
        assert_eq!(
            shared.core.store.raw_frame_bytes(),
            bytes,
            "a restart knows them"
        );
    }

    #[test]
    fn an_event_that_others_prolong_ends_and_a_pause_follows() {
        let dir = tempfile::tempdir().unwrap();
        let shared = context(dir.path());
        let buffer = RawFrameBuffer::new(KeepConfig::default());
        // A jolt in each frame at 10 Hz, for half an hour.
        let mut kept = 0;
        for tenth in 0..18_000 {
            let at_s = 0.1 * f64::from(tenth);
            buffer.add_event(&shared, "jolt".to_owned(), at_s, false);
            let mut state = buffer.lock_state();
            if let Some(event) = &state.event {
                assert!(
                    event.until_s - event.from_s <= 20.0 + 1e-9,
                    "before and three times after"
                );
                kept += 1;
                if at_s >= event.until_s {
                    state.event = None;
                }
            }
        }
        let share = f64::from(kept) / 18_000.0;
        assert!((0.15..0.25).contains(&share), "15 s of 75 s: {share}");
        buffer.add_event(&shared, "request".to_owned(), 1790.0, true);
        assert!(
            buffer.lock_state().event.is_some(),
            "wingd trigger begins one at any time"
        );
    }
}
