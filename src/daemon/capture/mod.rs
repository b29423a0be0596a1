//! The camera's side, below the series of the timetable and live mode alike: a camera behind hard limits, and of each
//! frame whether it is whole and new and when it was exposed.

mod judging;

use std::time::Duration;

use serde_json::{Map, Value};

use super::config::SeriesConfig;
use super::core::Core;
use super::worker::{Unanswered, Worker};
use crate::camera::{Camera, CameraError, CameraFactory, CameraInfo, CameraFrame};
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;
use crate::store::manifest::{ShotFailure, Shot};
pub(crate) use judging::STALE;
use judging::{Judge, failure_of};

/// Calls that may hang at a time before no new camera is made: each holds a thread.
const MAX_HANGING: usize = 8;

/// A camera that is closed when its thread ends; after a panic nobody knows what closing it would do.
struct Driver(Box<dyn Camera>);

impl Drop for Driver {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            self.0.close();
        }
    }
}

/// What is asked of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mode {
    /// A shot of a series.
    Shot,
    /// The next frame of a stream.
    Stream,
}

/// A good frame.
pub(crate) struct Taken {
    /// As the camera delivered it.
    pub frame: CameraFrame,
    /// When the camera was asked.
    pub stamp: Stamp,
    /// From asking to delivery, s.
    pub duration_s: f64,
    /// When it was exposed.
    pub exposure: Exposure,
}

impl Taken {
    /// The shot that it is in a series.
    pub fn shot(&self, number: u32, failures: Vec<ShotFailure>) -> Shot {
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
pub(crate) struct Missed {
    /// Why.
    pub failure: ShotFailure,
    /// Another attempt at the same shot may help. A camera that did not answer has cost its time already.
    pub again: bool,
    /// What was delivered instead.
    pub delivered: Option<Box<CameraFrame>>,
}

impl From<CameraError> for Missed {
    fn from(error: CameraError) -> Self {
        let again = matches!(error, CameraError::Busy(_) | CameraError::Gone(_) | CameraError::BadFrame(_));
        Self { failure: failure_of(&error), again, delivered: None }
    }
}

/// The camera's side.
pub(crate) struct Capture {
    core: Core,
    factory: CameraFactory,
    worker: Worker<Driver>,
    open: bool,
    judge: Judge,
    open_limit: Duration,
    deadline: Duration,
    /// What the camera said when it was opened last, and how often it was.
    info: CameraInfo,
    openings: u64,
}

impl Capture {
    /// With a camera that is closed.
    pub fn new(factory: CameraFactory, config: &SeriesConfig, core: &Core) -> Self {
        Self {
            core: core.clone(),
            factory,
            worker: Worker::new("camera", MAX_HANGING, core.halt.clone()),
            open: false,
            judge: Judge::remembering(config.stale_window),
            open_limit: config.open_deadline,
            deadline: config.shot_deadline,
            info: CameraInfo::default(),
            openings: 0,
        }
    }

    /// Calls to the camera that hang still.
    pub fn hanging(&self) -> usize {
        self.worker.hanging()
    }

    /// Opens the camera where it is not open; whether it was not.
    pub fn open(&mut self) -> Result<bool, CameraError> {
        if self.open {
            return Ok(false);
        }
        let info = self.call(self.open_limit, "opening", |camera| camera.open())??;
        for warning in &info.warnings {
            tracing::warn!(camera = info.name, warning);
        }
        self.core.board.update(|status| {
            status.camera.name = Some(info.name.clone());
            status.camera.open = true;
            status.camera.warnings = info.warnings.clone();
        });
        (self.open, self.info) = (true, info);
        self.openings += 1;
        Ok(true)
    }

    /// The camera as a series keeps it, where it was opened since the opening that is `noted`, which becomes this one.
    pub fn opened_since(&self, noted: &mut u64) -> Option<Map<String, Value>> {
        (std::mem::replace(noted, self.openings) != self.openings).then(|| {
            let mut camera = Map::new();
            camera.insert("name".to_owned(), Value::from(self.info.name.clone()));
            camera.insert("settings".to_owned(), Value::Object(self.info.settings.clone()));
            camera.insert("warnings".to_owned(), Value::from(self.info.warnings.clone()));
            camera
        })
    }

    /// A good frame of the open camera, which was `asked` for it at that moment. The camera gets its deadline; a quarter
    /// more and the call is given up. A camera that is gone, or late by its own account, is closed and thrown away.
    pub fn take(&mut self, mode: Mode, asked: &Stamp) -> Result<Taken, Missed> {
        let deadline = self.deadline;
        let delivered = self.call(hard(deadline), "the frame", move |camera| match mode {
            Mode::Shot => camera.shoot(deadline),
            Mode::Stream => camera.live(deadline),
        })?;
        if matches!(delivered, Err(CameraError::Gone(_) | CameraError::Timeout { .. })) {
            self.close_driver();
            self.worker.dismiss();
        }
        let mut frame = delivered?;
        if let Err(failure) = self.judge.judge(&frame) {
            return Err(Missed { failure, again: true, delivered: Some(Box::new(frame)) });
        }
        let clock = self.core.clock.as_ref();
        let exposure = self.judge.exposure(&mut frame, asked, clock);
        let duration_s = clock.since_boot().as_secs_f64() - asked.since_boot_s;
        Ok(Taken { frame, stamp: asked.clone(), duration_s, exposure })
    }

    /// The next frame that an interrupted series left on the open camera's card.
    pub fn left_over(&mut self) -> Option<CameraFrame> {
        let deadline = self.deadline;
        let found = self.call(hard(deadline), "a frame left in it", move |camera| camera.recover(deadline));
        found.and_then(|frame| frame).ok().flatten()
    }

    /// Tells the camera that our copy of its last frame is durable; a failure costs nothing here.
    pub fn release_last(&mut self) {
        let _ = self.call(self.open_limit, "releasing the frame", |camera| camera.release_last());
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

    /// One call, on the camera's thread; a new camera where there is none.
    fn call<T: Send + 'static>(
        &mut self,
        limit: Duration,
        what: &str,
        work: impl FnOnce(&mut dyn Camera) -> T + Send + 'static,
    ) -> Result<T, CameraError> {
        let (factory, board) = (self.factory.clone(), &self.core.board);
        let make = move || Some(Driver(factory()));
        let answer = self.worker.call(limit, &|| board.beat(), make, move |driver| work(driver.0.as_mut()));
        board.update(|status| {
            status.counts.hangs = self.worker.given_up();
            status.camera.hanging_calls = self.worker.hanging();
        });
        answer.map_err(|why| {
            self.open = false;
            unanswered(why, limit, what)
        })
    }
}

fn unanswered(why: Unanswered, limit: Duration, what: &str) -> CameraError {
    let (after, why) = match why {
        Unanswered::TooManyHang => {
            let what = format!("{MAX_HANGING} calls to it hang; unplug it and restart wingd");
            return CameraError::Gone(what);
        }
        Unanswered::NoThread(error) => {
            return CameraError::Busy(format!("no thread for the camera: {error}"));
        }
        Unanswered::Broken => return CameraError::Gone("its driver panicked; it is opened anew".to_owned()),
        Unanswered::Late => (limit, "the call hangs and is given up"),
        Unanswered::Halted(after) => (after, "it is given up because wingd stops or the power fails"),
    };
    CameraError::Timeout { after_s: after.as_secs_f64(), what: format!("{what}; {why}") }
}

/// The limit that a call has, when its camera was given this deadline.
fn hard(deadline: Duration) -> Duration {
    deadline + deadline / 4 + Duration::from_millis(250)
}
