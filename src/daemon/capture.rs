//! The camera on its thread: every call has a hard limit, a call that does not return is given up
//! with its thread, and a new camera is made.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

use super::halt::Halt;
use crate::camera::{Camera, CameraError, CameraInfo, Frame};

/// Makes a camera, closed. Called again after a hang, a panic or an unplug.
pub type CameraFactory = Box<dyn FnMut() -> Result<Box<dyn Camera>, CameraError> + Send>;

/// Calls that may hang at a time before no new camera is made: each holds a thread.
const MAX_HANGING: usize = 8;
/// The longest wait without a sign of life from the recorder, and without a look at the halt. Machine time.
const BEAT: Duration = Duration::from_millis(50);

enum Request {
    Open,
    Recover(Duration),
    Shoot(Duration),
    Live(Duration),
    Release,
    Close,
}

enum Reply {
    Opened(Result<CameraInfo, CameraError>),
    Recovered(Result<Option<Frame>, CameraError>),
    Shot(Result<Frame, CameraError>),
    Done,
}

struct Worker {
    requests: Sender<Request>,
    replies: Receiver<Reply>,
}

/// Owns the camera's thread.
pub(crate) struct Host {
    factory: CameraFactory,
    worker: Option<Worker>,
    open: bool,
    /// One count per living thread, and ours.
    alive: Arc<()>,
    hangs: u64,
    open_limit: Duration,
    halt: Halt,
}

impl Host {
    pub fn new(factory: CameraFactory, open_limit: Duration, halt: Halt) -> Self {
        Self { factory, worker: None, open: false, alive: Arc::new(()), hangs: 0, open_limit, halt }
    }

    /// Calls given up so far.
    pub fn hangs(&self) -> u64 {
        self.hangs
    }

    /// Threads that hang still.
    pub fn hanging(&self) -> usize {
        Arc::strong_count(&self.alive) - 1 - usize::from(self.worker.is_some())
    }

    /// Opens where it is not open; `None` where it was.
    pub fn ensure_open(&mut self, beat: &dyn Fn()) -> Result<Option<CameraInfo>, CameraError> {
        if self.open {
            return Ok(None);
        }
        match self.call(Request::Open, self.open_limit, "opening", beat)? {
            Reply::Opened(Ok(info)) => {
                self.open = true;
                Ok(Some(info))
            }
            Reply::Opened(Err(error)) => Err(error),
            _ => Err(self.out_of_step()),
        }
    }

    /// A frame that an interrupted series left in the camera, until there is none.
    pub fn recover(&mut self, deadline: Duration, beat: &dyn Fn()) -> Result<Option<Frame>, CameraError> {
        match self.call(Request::Recover(deadline), hard(deadline), "a frame left in it", beat)? {
            Reply::Recovered(result) => result,
            _ => Err(self.out_of_step()),
        }
    }

    /// Takes one shot. The camera gets `deadline`; a quarter more and it is given up.
    pub fn shoot(&mut self, deadline: Duration, beat: &dyn Fn()) -> Result<Frame, CameraError> {
        self.frame(Request::Shoot(deadline), deadline, beat)
    }

    /// Takes the next frame of a stream, by the same limits.
    pub fn live(&mut self, deadline: Duration, beat: &dyn Fn()) -> Result<Frame, CameraError> {
        self.frame(Request::Live(deadline), deadline, beat)
    }

    fn frame(&mut self, request: Request, deadline: Duration, beat: &dyn Fn()) -> Result<Frame, CameraError> {
        match self.call(request, hard(deadline), "the frame", beat)? {
            Reply::Shot(result) => {
                if matches!(result, Err(CameraError::Gone(_) | CameraError::Timeout { .. })) {
                    self.reset(beat);
                }
                result
            }
            _ => Err(self.out_of_step()),
        }
    }

    /// Tells the camera that our copy is durable; a failure costs nothing here.
    pub fn release_last(&mut self, beat: &dyn Fn()) {
        let _ = self.call(Request::Release, self.open_limit, "releasing the frame", beat);
    }

    /// Closes the camera until the next series.
    pub fn close(&mut self, beat: &dyn Fn()) {
        if std::mem::take(&mut self.open) {
            let _ = self.call(Request::Close, self.open_limit, "closing", beat);
        }
    }

    /// Closes and throws the camera away; the next call makes a new one.
    fn reset(&mut self, beat: &dyn Fn()) {
        self.close(beat);
        self.worker = None;
    }

    fn out_of_step(&mut self) -> CameraError {
        self.worker = None;
        self.open = false;
        CameraError::Gone("its driver answered out of step; it is opened anew".to_owned())
    }

    fn call(
        &mut self,
        request: Request,
        limit: Duration,
        what: &str,
        beat: &dyn Fn(),
    ) -> Result<Reply, CameraError> {
        let worker = match self.worker.take() {
            Some(worker) => worker,
            None => self.start()?,
        };
        let mut left = limit;
        let mut answer = match worker.requests.send(request) {
            Ok(()) => Err(RecvTimeoutError::Timeout),
            Err(_) => Err(RecvTimeoutError::Disconnected),
        };
        while matches!(answer, Err(RecvTimeoutError::Timeout)) && !left.is_zero() && !self.halt.over() {
            let slice = left.min(BEAT);
            beat();
            answer = worker.replies.recv_timeout(slice);
            left -= slice;
        }
        match answer {
            Ok(reply) => {
                self.worker = Some(worker);
                Ok(reply)
            }
            Err(RecvTimeoutError::Timeout) => {
                // Dropping our ends makes the thread end by itself, should its call ever return.
                self.open = false;
                let after_s = (limit - left).as_secs_f64();
                if self.halt.over() {
                    let what = format!("{what}; it is given up because wingd stops or the power fails");
                    return Err(CameraError::Timeout { after_s, what });
                }
                self.hangs += 1;
                let what = format!("{what}; the call hangs and is given up");
                Err(CameraError::Timeout { after_s, what })
            }
            Err(RecvTimeoutError::Disconnected) => {
                self.open = false;
                Err(CameraError::Gone("its driver panicked; it is opened anew".to_owned()))
            }
        }
    }

    fn start(&mut self) -> Result<Worker, CameraError> {
        if self.hanging() >= MAX_HANGING {
            let what = format!("{MAX_HANGING} calls to it hang; unplug it and restart wingd");
            return Err(CameraError::Gone(what));
        }
        let camera = (self.factory)()?;
        let (requests, inbox) = channel();
        let (outbox, replies) = channel();
        let alive = self.alive.clone();
        let thread = std::thread::Builder::new().name("camera".to_owned());
        let spawned = thread.spawn(move || {
            serve(camera, &inbox, &outbox);
            drop(alive);
        });
        spawned.map_err(|error| CameraError::Busy(format!("no thread for the camera: {error}")))?;
        Ok(Worker { requests, replies })
    }
}

/// The limit that a call has, when its camera was given this deadline.
fn hard(deadline: Duration) -> Duration {
    deadline + deadline / 4 + Duration::from_millis(250)
}

fn serve(mut camera: Box<dyn Camera>, inbox: &Receiver<Request>, outbox: &Sender<Reply>) {
    while let Ok(request) = inbox.recv() {
        let reply = match request {
            Request::Open => Reply::Opened(camera.open()),
            Request::Recover(deadline) => Reply::Recovered(camera.recover(deadline)),
            Request::Shoot(deadline) => Reply::Shot(camera.shoot(deadline)),
            Request::Live(deadline) => Reply::Shot(camera.live(deadline)),
            Request::Release => {
                let _ = camera.release_last();
                Reply::Done
            }
            Request::Close => {
                camera.close();
                Reply::Done
            }
        };
        if outbox.send(reply).is_err() {
            break;
        }
    }
    camera.close();
}
