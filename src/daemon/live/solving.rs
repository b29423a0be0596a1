//! Solves live frames, the newest first, with a deadline. An error in a frame loses only the result of that frame.

use std::sync::Arc;
use std::sync::mpsc::{SyncSender, TrySendError};
use std::time::Duration;

use super::context::LiveContext;
use super::events::EventDetector;
use super::frames::RawFrameBuffer;
use super::mailbox::{Delivery, Mailbox};
use super::meter::Meter;
use super::publisher::ResultPublisher;
use super::result::{LiveFrame, result_datagram};
use super::storing::WaitingResult;
use crate::camera::CameraFrame;
use crate::daemon::solver::{CurrentSolver, FrameTracker, Solver};
use crate::daemon::worker::{CallError, Worker};
use wingd_evaluation::pipeline::live::TrackedFrame;
use wingd_evaluation::record::ImageRecord;
use wingd_measure::adjust::AdjustmentMethod;
use wingd_measure::view::SearchMode;
use wingd_pages::recorder::LiveMessage;

/// Time after which a frame is abandoned with its thread. Machine time.
const DEADLINE: Duration = Duration::from_secs(5);
/// Maximum number of abandoned solvers that still run; each holds a thread, at worst a core.
pub(super) const MAX_HANGING: usize = 2;
/// Time without a frame after which the rate is updated.
const RATE_UPDATE_INTERVAL: Duration = Duration::from_millis(100);
/// Number of results between two updates of the latencies.
const LATENCY_UPDATE_RESULTS: u64 = 8;

/// State of the live thread: has frames solved and publishes the results.
pub(super) struct LiveSolver {
    pub shared: LiveContext,
    pub mailbox: Arc<Mailbox<Arc<LiveFrame>>>,
    pub current: CurrentSolver,
    /// Solver of the worker's tracker.
    pub solver: Option<Arc<Solver>>,
    pub raw: Arc<RawFrameBuffer>,
    pub publisher: ResultPublisher,
    pub rows: SyncSender<WaitingResult>,
    /// Thread that holds the state of the adjustment.
    pub worker: Worker<FrameTracker>,
}

impl LiveSolver {
    /// Solves frames until the recorder ends.
    pub fn run(mut self) {
        let mut watch = EventDetector::new(self.shared.config.keep.clone());
        let mut meter = Meter::default();
        loop {
            match self.mailbox.take(RATE_UPDATE_INTERVAL) {
                Delivery::Item(frame) => {
                    self.take_up_solver();
                    if let Some(solver) = self.solver.clone()
                        && let Some(tracked) = self.solve_frame(&solver, &frame)
                    {
                        self.publish_result(&frame, (tracked, solver), (&mut watch, &mut meter));
                    }
                }
                Delivery::Empty => self.publish_solving_rate(&meter),
                Delivery::Closed => break,
            }
        }
    }

    /// Takes up the current solver; the tracker of another one is dismissed with its state.
    fn take_up_solver(&mut self) {
        let current = self.current.get();
        if self.solver.as_ref().map(Arc::as_ptr) != current.as_ref().map(Arc::as_ptr) {
            self.worker.dismiss();
            self.solver = current;
        }
    }

    /// Solves a frame. Returns `None` if there is no tracker, or if too many solvers hang.
    fn solve_frame(&mut self, solver: &Solver, frame: &Arc<LiveFrame>) -> Option<TrackedFrame> {
        let track = solver.track.clone()?;
        let work = {
            let frame = frame.clone();
            // The frame is dropped before the answer, so that the solver no longer holds its memory.
            move |tracking: &mut FrameTracker| {
                let CameraFrame { bytes, format, .. } = &frame.taken.frame;
                tracking(&frame.name(), bytes, format, frame.exposed_at_s())
            }
        };
        let why = match self.worker.call(DEADLINE, &|| {}, move || track().ok(), work) {
            Ok(tracked) => return Some(tracked),
            Err(CallError::TooManyHang) => {
                let why = "solvers hang; live frames are not solved until you restart wingd";
                self.shared.set_fault("solver", why);
                return None;
            }
            Err(CallError::NoThread(error)) => {
                self.shared.set_fault(
                    "solver",
                    &format!("no thread can be started to solve live frames: {error}; restart wingd"),
                );
                return None;
            }
            Err(CallError::Broken) => {
                "the solver crashed on this frame and starts again; run `wingd solve` on the frame and report it".to_owned()
            }
            Err(CallError::TimedOut) => {
                format!("the solver had no result after {DEADLINE:?}, was abandoned and starts again")
            }
            Err(CallError::Halted(_)) => "the solver was abandoned because wingd stops or the power fails".to_owned(),
        };
        self.shared.set_fault("solver", &why);
        let hangs = self.worker.given_up();
        self.shared.update(|live| live.solver_hangs = hangs);
        let method = Some(AdjustmentMethod::Spatial);
        Some(TrackedFrame::failed(ImageRecord {
            method,
            ..ImageRecord::failed(&frame.name(), why)
        }))
    }

    fn publish_result(
        &self,
        frame: &Arc<LiveFrame>,
        (tracked, solver): (TrackedFrame, Arc<Solver>),
        (watch, meter): (&mut EventDetector, &mut Meter),
    ) {
        let now_s = self.shared.core.clock.since_boot().as_secs_f64();
        let latency_ms = 1e3 * (now_s - frame.exposed_at_s());
        let skipped = self.shared.skipped();
        let result = Arc::new(frame.result(tracked, latency_ms, skipped));
        if let Some(reason) = watch.detect(&result) {
            self.raw
                .add_event(&self.shared, reason, frame.exposed_at_s(), false);
        }
        self.publisher.preview.set_frame(frame);
        self.publisher.keep_result(&result);
        if result.is_solved() {
            self.shared.clear_fault("solver");
        }
        let outcome = (result.is_solved(), result.is_rejected());
        self.shared
            .core
            .board
            .add_live_result(frame.exposed_at_s(), outcome, skipped);
        // Without a listener this fails, which is no error.
        if self.publisher.messages.receiver_count() > 0 {
            let datagram = result_datagram(&result, self.shared.core.board.health());
            let _ = self.publisher.messages.send(Arc::new(LiveMessage {
                is_state: false,
                json: result.json_line(),
                datagram,
            }));
        }
        let lost = matches!(
            self.rows.try_send(WaitingResult {
                result: result.clone(),
                solver
            }),
            Err(TrySendError::Full(_))
        );
        meter.add_result(now_s, latency_ms);
        self.shared.update(|live| {
            live.results += 1;
            live.unsolvable += u64::from(!result.is_solved());
            live.full_searches += u64::from(result.tracked.search == SearchMode::Full);
            live.mount_disturbances += u64::from(result.tracked.mount_disturbed);
            live.dropped += u64::from(lost);
            live.rate_hz = meter.rate_hz(now_s);
            if live.results % LATENCY_UPDATE_RESULTS == 1 {
                live.latency_median_ms = meter.latency_ms(0.5);
                live.latency_p95_ms = meter.latency_ms(0.95);
            }
        });
    }

    fn publish_solving_rate(&self, meter: &Meter) {
        let rate_hz = meter.rate_hz(self.shared.core.clock.since_boot().as_secs_f64());
        self.shared.update(|live| live.rate_hz = rate_hz);
    }
}
