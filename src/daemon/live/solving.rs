//! Solving frames as they come: the newest first, behind a deadline. What goes wrong with a frame costs its result.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, TrySendError, channel};
use std::time::Duration;

use super::events::Watch;
use super::frames::Raw;
use super::mailbox::{Mailbox, Taken};
use super::out::Tap;
use super::result::{Given, LiveFrame, LiveResult};
use super::status::Meter;
use super::{Shared, Track};
use crate::pipeline::live::Told;
use crate::pipeline::stages::Search;
use crate::record::{ImageRecord, Method};

/// A frame that takes longer is given up, with its thread. Machine time.
const DEADLINE: Duration = Duration::from_secs(5);
/// Solvers given up that may run on at a time; each holds a thread, at worst a core.
const MAX_HANGING: usize = 2;
/// The longest wait without a look at the halt.
const BEAT: Duration = Duration::from_millis(100);
/// Results between two looks at the latencies.
const LATENCIES_EVERY: u64 = 8;

/// The thread that has the state of the adjustment.
struct Worker {
    frames: Sender<Arc<LiveFrame>>,
    told: Receiver<Told>,
}

/// What the live thread works with.
pub(super) struct Solving {
    pub shared: Shared,
    pub mailbox: Arc<Mailbox<Arc<LiveFrame>>>,
    pub track: Option<Track>,
    pub raw: Arc<Raw>,
    pub tap: Tap,
    pub rows: SyncSender<Arc<LiveResult>>,
    /// One count per worker, and ours.
    pub running: Arc<()>,
}

impl Solving {
    /// Until the recorder ends.
    pub fn run(self) {
        let mut worker = None;
        let mut watch = Watch::new(self.shared.config.keep.clone());
        let mut meter = Meter::default();
        loop {
            match self.mailbox.take(BEAT) {
                Taken::Thing(frame) => {
                    if let Some(told) = self.solve(&mut worker, &frame) {
                        self.give(&frame, told, (&mut watch, &mut meter));
                    }
                }
                Taken::Nothing => self.quiet(&meter),
                Taken::Closed => break,
            }
        }
    }

    /// `None` where frames are not solved: nothing is known to solve them with, or too many solvers hang.
    fn solve(&self, worker: &mut Option<Worker>, frame: &Arc<LiveFrame>) -> Option<Told> {
        let ready = match worker.take() {
            Some(ready) => ready,
            None => self.start()?,
        };
        let failed = |why: &str| Told {
            record: ImageRecord::failed(&frame.name(), Method::Spatial, why),
            search: Search::Whole,
            mounting: 0,
            jolt: false,
            outlines: Vec::new(),
            curvature: None,
        };
        if ready.frames.send(frame.clone()).is_err() {
            return Some(failed("the solver broke off before this frame"));
        }
        let mut left = DEADLINE;
        loop {
            let slice = left.min(BEAT);
            match ready.told.recv_timeout(slice) {
                Ok(told) => {
                    *worker = Some(ready);
                    return Some(told);
                }
                Err(RecvTimeoutError::Disconnected) => {
                    let what = "the solver broke off on this frame, and begins anew; send the frame to the developers";
                    self.shared.fault("solver", what);
                    return Some(failed(what));
                }
                Err(RecvTimeoutError::Timeout) if left <= slice || self.shared.halt.over() => {
                    self.shared.update(|live| live.solver_hangs += 1);
                    let what = format!(
                        "the solver had no result after {DEADLINE:?} and was given up, and begins anew"
                    );
                    self.shared.fault("solver", &what);
                    return Some(failed(&what));
                }
                Err(RecvTimeoutError::Timeout) => left -= slice,
            }
        }
    }

    fn start(&self) -> Option<Worker> {
        let track = self.track.clone()?;
        if Arc::strong_count(&self.running) > MAX_HANGING + 1 {
            self.shared.fault("solver", "solvers hang; live frames are not solved before a restart of wingd");
            return None;
        }
        let (frames, inbox) = channel::<Arc<LiveFrame>>();
        let (say, told) = channel();
        let running = self.running.clone();
        let thread = std::thread::Builder::new().name("live-solver".to_owned());
        let spawned = thread.spawn(move || {
            let _running = running;
            let Ok(mut tracker) = track() else { return };
            while let Ok(frame) = inbox.recv() {
                let at_s = frame.exposure.exposure_since_boot_s;
                let told = tracker(&frame.name(), &frame.frame.bytes, &frame.frame.format, at_s);
                // Before the answer: the frame's memory is not ours any more.
                drop(frame);
                if say.send(told).is_err() {
                    break;
                }
            }
        });
        match spawned {
            Ok(_) => Some(Worker { frames, told }),
            Err(error) => {
                self.shared.fault("solver", &format!("no thread to solve live frames on: {error}"));
                None
            }
        }
    }

    fn give(&self, frame: &Arc<LiveFrame>, told: Told, (watch, meter): (&mut Watch, &mut Meter)) {
        let now_s = self.shared.clock.since_boot().as_secs_f64();
        let latency_ms = 1e3 * (now_s - frame.exposure.exposure_since_boot_s);
        let skipped = self.shared.skipped();
        let result = Arc::new(LiveResult::new(frame, told, latency_ms, skipped));
        if let Some(reason) = watch.look(&result) {
            self.shared.event(&self.raw, reason, frame.exposure.exposure_since_boot_s, false);
        }
        if result.solved() {
            self.tap.preview.show(frame);
            self.shared.clear("solver");
        }
        // Nobody listening is no error.
        if self.tap.results.receiver_count() > 0 {
            let given = Given { line: result.line(), datagram: result.datagram() };
            let _ = self.tap.results.send(Arc::new(given));
        }
        let lost = matches!(self.rows.try_send(result.clone()), Err(TrySendError::Full(_)));
        meter.note(now_s, latency_ms);
        self.shared.update(|live| {
            live.results += 1;
            live.unsolvable += u64::from(!result.solved());
            live.whole_searches += u64::from(result.search == Search::Whole);
            live.jolts += u64::from(result.jolt);
            live.dropped += u64::from(lost);
            live.rate_hz = meter.rate_hz(now_s);
            if live.results % LATENCIES_EVERY == 1 {
                live.latency_median_ms = meter.latency_ms(0.5);
                live.latency_p95_ms = meter.latency_ms(0.95);
            }
        });
    }

    fn quiet(&self, meter: &Meter) {
        let rate_hz = meter.rate_hz(self.shared.clock.since_boot().as_secs_f64());
        self.shared.update(|live| live.rate_hz = rate_hz);
    }
}
