//! Camera access for scheduled series and live mode: hard limits on every call, and checks of each frame for completeness,
//! freshness and time of exposure.

mod frame_check;

use std::time::Duration;

use serde_json::{Map, Value};

use super::config::SeriesConfig;
use super::core::Core;
use super::worker::{CallError, Worker};
use crate::camera::{Camera, CameraError, CameraFactory, CameraFrame, CameraInfo};
pub(crate) use frame_check::STALE;
use frame_check::{FrameChecker, shot_failure};
use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;
use wingd_store::manifest::{Shot, ShotFailure};

/// Maximum number of hanging calls; beyond it no new camera is created, because each holds a thread.
const MAX_HANGING: usize = 8;

/// A camera that is closed when its thread ends, except after a panic, when the effect of closing it is unknown.
struct Driver(Box<dyn Camera>);

impl Drop for Driver {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            self.0.close();
        }
    }
}

/// Kind of frame requested from the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CaptureMode {
    /// A shot of a series.
    Shot,
    /// The next frame of a stream.
    Stream,
}

/// A good frame.
pub(crate) struct CapturedFrame {
    /// Frame as delivered by the camera.
    pub frame: CameraFrame,
    /// Time of the request.
    pub stamp: Stamp,
    /// Time from the request to the delivery, s.
    pub duration_s: f64,
    /// Time of exposure.
    pub exposure: Exposure,
}

impl CapturedFrame {
    /// Returns the entry of this frame as a shot of a series.
    pub fn to_shot(&self, number: u32, failures: Vec<ShotFailure>) -> Shot {
        Shot {
            shot: number,
            stamp: self.stamp.clone(),
            duration_s: Some(self.duration_s),
            exposure: Some(self.exposure.clone()),
            frame: None,
            failures,
        }
    }
}

/// An attempt without a good frame.
pub(crate) struct FailedAttempt {
    /// Kind and reason of the failure.
    pub failure: ShotFailure,
    /// True if another attempt at this shot may help; after a timeout it would cost as much time again.
    pub retry: bool,
    /// Frame that was delivered and rejected.
    pub delivered: Option<Box<CameraFrame>>,
}

impl From<CameraError> for FailedAttempt {
    fn from(error: CameraError) -> Self {
        let again = matches!(
            error,
            CameraError::Busy(_) | CameraError::Gone(_) | CameraError::BadFrame(_)
        );
        Self {
            failure: shot_failure(&error),
            retry: again,
            delivered: None,
        }
    }
}

/// The camera with its thread, its limits and the checks of its frames.
pub(crate) struct Capture {
    core: Core,
    factory: CameraFactory,
    worker: Worker<Driver>,
    open: bool,
    /// The camera as opened last keeps no copies of its frames.
    is_stream: bool,
    checker: FrameChecker,
    open_limit: Duration,
    deadline: Duration,
    /// Camera information from the last opening.
    info: CameraInfo,
    openings: u64,
}

impl Capture {
    /// Creates the access to a camera that is still closed.
    pub fn new(factory: CameraFactory, config: &SeriesConfig, core: &Core) -> Self {
        Self {
            core: core.clone(),
            factory,
            worker: Worker::new("camera", MAX_HANGING, core.halt.clone()),
            open: false,
            is_stream: false,
            checker: FrameChecker::new(config.stale_window),
            open_limit: config.open_deadline,
            deadline: config.shot_deadline,
            info: CameraInfo::default(),
            openings: 0,
        }
    }

    /// Returns the number of calls to the camera that still hang.
    pub fn hanging_calls(&self) -> usize {
        self.worker.hanging()
    }

    /// Returns whether the camera is open and frames may be requested before the last one is durable.
    pub fn is_streaming(&self) -> bool {
        self.open && self.is_stream
    }

    /// Opens the camera unless it is open. Returns whether it had to be opened.
    pub fn ensure_open(&mut self) -> Result<bool, CameraError> {
        if self.open {
            return Ok(false);
        }
        let opened = self.call(self.open_limit, "opening", |camera| {
            camera.open().map(|info| (info, camera.is_stream()))
        });
        let (info, is_stream) = opened??;
        self.checker.limit_to_loop(&info);
        for warning in &info.warnings {
            tracing::warn!(camera = info.name, warning);
        }
        self.core.board.update(|status| {
            status.camera.name = Some(info.name.clone());
            status.camera.open = true;
            status.camera.warnings = info.warnings.clone();
        });
        (self.open, self.is_stream, self.info) = (true, is_stream, info);
        self.openings += 1;
        Ok(true)
    }

    /// Returns the camera's entry for a series if it was opened again since the opening number `noted`, and updates that
    /// number.
    pub fn camera_if_reopened(&self, noted: &mut u64) -> Option<Map<String, Value>> {
        (std::mem::replace(noted, self.openings) != self.openings).then(|| {
            let mut camera = Map::new();
            camera.insert("name".to_owned(), Value::from(self.info.name.clone()));
            camera.insert(
                "settings".to_owned(),
                Value::Object(self.info.settings.clone()),
            );
            camera.insert(
                "warnings".to_owned(),
                Value::from(self.info.warnings.clone()),
            );
            camera
        })
    }

    /// Takes a frame of the open camera; `asked` is the time of the request. The camera must deliver within its deadline;
    /// after another 25 % the call is abandoned. A camera that is gone or reports a timeout is closed and replaced.
    pub fn take_frame(
        &mut self,
        mode: CaptureMode,
        asked: &Stamp,
    ) -> Result<CapturedFrame, FailedAttempt> {
        let deadline = self.deadline;
        let delivered = self.call(
            hard_limit(deadline),
            "the frame",
            move |camera| match mode {
                CaptureMode::Shot => camera.shoot(deadline),
                CaptureMode::Stream => camera.next_live_frame(deadline),
            },
        )?;
        if matches!(
            delivered,
            Err(CameraError::Gone(_) | CameraError::Timeout { .. })
        ) {
            self.close_driver();
            self.worker.dismiss();
        }
        let mut frame = delivered?;
        if let Err(failure) = self.checker.check(&frame) {
            return Err(FailedAttempt {
                failure,
                retry: true,
                delivered: Some(Box::new(frame)),
            });
        }
        let clock = self.core.clock.as_ref();
        let exposure = self.checker.determine_exposure(&mut frame, asked, clock);
        let duration_s = clock.since_boot().as_secs_f64() - asked.since_boot_s;
        Ok(CapturedFrame {
            frame,
            stamp: asked.clone(),
            duration_s,
            exposure,
        })
    }

    /// Returns the next frame that an interrupted series left on the card of the open camera.
    pub fn take_left_over(&mut self) -> Option<CameraFrame> {
        let deadline = self.deadline;
        let found = self.call(
            hard_limit(deadline),
            "a frame left on its card",
            move |camera| camera.recover(deadline),
        );
        found.and_then(|frame| frame).ok().flatten()
    }

    /// Informs the camera that our copy of its last frame is durable; a failure is ignored.
    pub fn release_last_frame(&mut self) {
        let _ = self.call(self.open_limit, "releasing the frame", |camera| {
            camera.release_last()
        });
    }

    /// Closes the camera until it is opened again.
    pub fn close(&mut self) {
        self.close_driver();
        self.core.board.update(|status| status.camera.open = false);
    }

    fn close_driver(&mut self) {
        if std::mem::take(&mut self.open) {
            let _ = self.call(self.open_limit, "closing", |camera| camera.close());
        }
    }

    /// Runs a call on the camera's thread, and creates a camera if there is none.
    fn call<T: Send + 'static>(
        &mut self,
        limit: Duration,
        what: &str,
        work: impl FnOnce(&mut dyn Camera) -> T + Send + 'static,
    ) -> Result<T, CameraError> {
        let (factory, board) = (self.factory.clone(), &self.core.board);
        let make = move || Some(Driver(factory()));
        let answer = self
            .worker
            .call(limit, &|| board.beat(), make, move |driver| {
                work(driver.0.as_mut())
            });
        board.update(|status| {
            status.counts.hangs = self.worker.given_up();
            status.camera.hanging_calls = self.worker.hanging();
        });
        answer.map_err(|why| {
            self.open = false;
            camera_error_from_call(why, limit, what)
        })
    }
}

fn camera_error_from_call(why: CallError, limit: Duration, what: &str) -> CameraError {
    let (after, why) = match why {
        CallError::TooManyHang => {
            let reason = format!("{MAX_HANGING} calls to it hang; unplug it and restart wingd");
            return CameraError::Gone(reason);
        }
        CallError::NoThread(error) => {
            return CameraError::Busy(format!(
                "no thread can be started for it: {error}; restart wingd"
            ));
        }
        CallError::Broken => {
            return CameraError::Gone("its driver crashed; it will be opened again".to_owned());
        }
        CallError::TimedOut => (limit, "the call hangs and is abandoned"),
        CallError::Halted(after) => (after, "abandoned because wingd stops or the power fails"),
    };
    CameraError::Timeout {
        after_s: after.as_secs_f64(),
        what: format!("{what}; {why}"),
    }
}

/// Returns the time limit of a call to a camera with this deadline.
fn hard_limit(deadline: Duration) -> Duration {
    deadline + deadline / 4 + Duration::from_millis(250)
}
