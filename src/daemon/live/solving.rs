//! Frames are solved as they come, the newest first and behind a deadline. What goes wrong with a frame costs its result.

use std::sync::Arc;
use std::sync::mpsc::{SyncSender, TrySendError};
use std::time::Duration;

use super::events::Watch;
use super::frames::Raw;
use super::mailbox::{Look, Mailbox};
use super::meter::Meter;
use super::out::Tap;
use super::result::{Given, LiveFrame, LiveResult};
use super::shared::Shared;
use crate::camera::CameraFrame;
use crate::daemon::solver::{Track, Tracking};
use crate::daemon::worker::{Unanswered, Worker};
use crate::pipeline::guided::Search;
use crate::pipeline::live::Tracked;
use crate::record::{ImageRecord, Method};

/// A frame that takes longer is given up, with its thread. Machine time.
const DEADLINE: Duration = Duration::from_secs(5);
/// Solvers given up that may run on at a time; each holds a thread, at worst a core.
pub(super) const MAX_HANGING: usize = 2;
/// Without a frame for so long the rate is looked at.
const QUIET: Duration = Duration::from_millis(100);
/// Results between two looks at the latencies.
const LATENCIES_EVERY: u64 = 8;

/// What the live thread works with.
pub(super) struct Solving {
    pub shared: Shared,
    pub mailbox: Arc<Mailbox<Arc<LiveFrame>>>,
    pub track: Option<Track>,
    pub raw: Arc<Raw>,
    pub tap: Tap,
    pub rows: SyncSender<Arc<LiveResult>>,
    /// The thread that has the state of the adjustment.
    pub worker: Worker<Tracking>,
}

impl Solving {
    /// Until the recorder ends.
    pub fn run(mut self) {
        let mut watch = Watch::new(self.shared.config.keep.clone());
        let mut meter = Meter::default();
        loop {
            match self.mailbox.take(QUIET) {
                Look::Thing(frame) => {
                    if let Some(tracked) = self.solve(&frame) {
                        self.give(&frame, tracked, (&mut watch, &mut meter));
                    }
                }
                Look::Nothing => self.quiet(&meter),
                Look::Closed => break,
            }
        }
    }

    /// `None` where frames are not solved: nothing is known to solve them with, or too many solvers hang.
    fn solve(&mut self, frame: &Arc<LiveFrame>) -> Option<Tracked> {
        let track = self.track.clone()?;
        let work = {
            let frame = frame.clone();
            // The frame is let go of before the answer: its memory is not the solver's any more.
            move |tracking: &mut Tracking| {
                let CameraFrame { bytes, format, .. } = &frame.taken.frame;
                tracking(&frame.name(), bytes, format, frame.at_s())
            }
        };
        let why = match self.worker.call(DEADLINE, &|| {}, move || track().ok(), work) {
            Ok(tracked) => return Some(tracked),
            Err(Unanswered::TooManyHang) => {
                let why = "solvers hang; live frames are not solved before a restart of wingd";
                self.shared.fault("solver", why);
                return None;
            }
            Err(Unanswered::NoThread(error)) => {
                self.shared.fault("solver", &format!("no thread to solve live frames on: {error}"));
                return None;
            }
            Err(Unanswered::Broken) => {
                "the solver broke off on this frame, and begins anew; send the frame to the developers"
                    .to_owned()
            }
            Err(Unanswered::Late) => {
                format!("the solver had no result after {DEADLINE:?} and was given up, and begins anew")
            }
            Err(Unanswered::Halted(_)) => {
                "the solver was given up because wingd stops or the power fails".to_owned()
            }
        };
        self.shared.fault("solver", &why);
        let hangs = self.worker.given_up();
        self.shared.update(|live| live.solver_hangs = hangs);
        Some(Tracked::failed(ImageRecord::failed(&frame.name(), Method::Spatial, why)))
    }

    fn give(&self, frame: &Arc<LiveFrame>, tracked: Tracked, (watch, meter): (&mut Watch, &mut Meter)) {
        let now_s = self.shared.core.clock.since_boot().as_secs_f64();
        let latency_ms = 1e3 * (now_s - frame.at_s());
        let skipped = self.shared.skipped();
        let result = Arc::new(LiveResult::new(frame, tracked, latency_ms, skipped));
        if let Some(reason) = watch.look(&result) {
            self.raw.event(&self.shared, reason, frame.at_s(), false);
        }
        self.tap.preview.show(frame);
        if result.solved() {
            self.shared.clear("solver");
        }
        let judged = (result.solved(), result.rejected());
        self.shared.core.board.live_result(frame.at_s(), judged, skipped);
        // Nobody listening is no error.
        if self.tap.given.receiver_count() > 0 {
            let datagram = result.datagram(self.shared.core.board.health());
            let _ = self.tap.given.send(Arc::new(Given { state: false, line: result.line(), datagram }));
        }
        let lost = matches!(self.rows.try_send(result.clone()), Err(TrySendError::Full(_)));
        meter.note(now_s, latency_ms);
        self.shared.update(|live| {
            live.results += 1;
            live.unsolvable += u64::from(!result.solved());
            live.full_searches += u64::from(result.search == Search::Full);
            live.mount_disturbances += u64::from(result.mount_disturbed);
            live.dropped += u64::from(lost);
            live.rate_hz = meter.rate_hz(now_s);
            if live.results % LATENCIES_EVERY == 1 {
                live.latency_median_ms = meter.latency_ms(0.5);
                live.latency_p95_ms = meter.latency_ms(0.95);
            }
        });
    }

    fn quiet(&self, meter: &Meter) {
        let rate_hz = meter.rate_hz(self.shared.core.clock.since_boot().as_secs_f64());
        self.shared.update(|live| live.rate_hz = rate_hz);
    }
}
