//! A worker is a thread for calls that may hang. A call that has not returned by its deadline is abandoned with its thread,
//! and counted. The camera's driver, the solver of series and the solver of live mode use it.

use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::core::Core;
use super::shutdown::Halt;

/// Maximum time between two beats of the waiting thread, and between two checks of the halt. Machine time.
const BEAT_INTERVAL: Duration = Duration::from_millis(50);

type WorkerCall<S> = Box<dyn FnOnce(&mut S) + Send>;

/// Error of a call. If the call was begun, its thread is gone and the next call starts another one.
#[derive(Debug)]
pub(crate) enum CallError {
    /// Too many threads hang; each holds a thread, at worst a core.
    TooManyHang,
    /// The thread could not be started.
    NoThread(std::io::Error),
    /// The call had not returned by its deadline; it is counted.
    TimedOut,
    /// The call was abandoned after this time because wingd stops or the power fails.
    Halted(Duration),
    /// The call panicked, or the state for it could not be created.
    Broken,
}

/// A thread with the state `S` on which the calls work. A dismissed thread ends after its current call.
pub(crate) struct Worker<S> {
    name: &'static str,
    max_hanging: usize,
    halt: Halt,
    thread: Option<(Sender<WorkerCall<S>>, JoinHandle<()>)>,
    abandoned: Vec<JoinHandle<()>>,
    given_up: u64,
}

impl<S: 'static> Worker<S> {
    /// Creates a worker without a thread. At most `max_hanging` abandoned threads may run at a time.
    pub fn new(name: &'static str, max_hanging: usize, halt: Halt) -> Self {
        Self {
            name,
            max_hanging,
            halt,
            thread: None,
            abandoned: Vec::new(),
            given_up: 0,
        }
    }

    /// Returns the number of calls abandoned at their deadline.
    pub fn given_up(&self) -> u64 {
        self.given_up
    }

    /// Returns the number of abandoned threads that still run.
    pub fn hanging(&self) -> usize {
        self.abandoned
            .iter()
            .filter(|thread| !thread.is_finished())
            .count()
    }

    /// Dismisses the worker thread; the next call starts a new one.
    pub fn dismiss(&mut self) {
        self.thread = None;
    }

    fn start_thread(
        &mut self,
        make: impl FnOnce() -> Option<S> + Send + 'static,
    ) -> Result<(Sender<WorkerCall<S>>, JoinHandle<()>), CallError> {
        self.abandoned.retain(|thread| !thread.is_finished());
        if self.abandoned.len() >= self.max_hanging {
            return Err(CallError::TooManyHang);
        }
        let (calls, inbox) = channel::<WorkerCall<S>>();
        let thread = Core::spawn_thread(self.name, move || {
            let Some(mut state) = make() else { return };
            while let Ok(call) = inbox.recv() {
                call(&mut state);
            }
        });
        Ok((calls, thread.map_err(CallError::NoThread)?))
    }

    /// Runs `work` and returns its value, within `limit` of machine time; `beat` is called while waiting. If there is no
    /// thread, one is started, and `make` creates its state.
    pub fn call<T: Send + 'static>(
        &mut self,
        limit: Duration,
        beat: &dyn Fn(),
        make: impl FnOnce() -> Option<S> + Send + 'static,
        work: impl FnOnce(&mut S) -> T + Send + 'static,
    ) -> Result<T, CallError> {
        let (calls, thread) = self
            .thread
            .take()
            .map_or_else(|| self.start_thread(make), Ok)?;
        let (answer, answered) = channel();
        // Nobody waits for a call that was abandoned.
        let call: WorkerCall<S> = Box::new(move |state| drop(answer.send(work(state))));
        calls.send(call).map_err(|_| CallError::Broken)?;
        let mut left = limit;
        while !left.is_zero() && !self.halt.is_expired() {
            let slice = left.min(BEAT_INTERVAL);
            beat();
            match answered.recv_timeout(slice) {
                Ok(result) => {
                    self.thread = Some((calls, thread));
                    return Ok(result);
                }
                Err(RecvTimeoutError::Disconnected) => return Err(CallError::Broken),
                Err(RecvTimeoutError::Timeout) => left -= slice,
            }
        }
        self.abandoned.push(thread);
        if self.halt.is_expired() {
            return Err(CallError::Halted(limit - left));
        }
        self.given_up += 1;
        Err(CallError::TimedOut)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread::sleep;

    /// Time limit far above the time that a thread needs to answer.
    const LONG: Duration = Duration::from_secs(60);

    fn worker(max_hanging: usize) -> Worker<u32> {
        Worker::new("test", max_hanging, Halt::default())
    }

    fn count(worker: &mut Worker<u32>) -> Result<u32, CallError> {
        let add = |state: &mut u32| {
            *state += 1;
            *state
        };
        worker.call(LONG, &|| {}, || Some(7), add)
    }

    fn hang(worker: &mut Worker<u32>, limit: Duration) -> Result<(), CallError> {
        worker.call(limit, &|| {}, || Some(0), |_| sleep(LONG))
    }

    #[test]
    fn calls_share_a_state_and_a_panic_costs_only_its_thread() {
        let mut worker = worker(1);
        assert!(matches!(
            (count(&mut worker), count(&mut worker)),
            (Ok(8), Ok(9))
        ));
        let broken = worker.call(LONG, &|| {}, || None, |_| panic!("requested by the test"));
        assert!(matches!(broken, Err(CallError::Broken)));
        assert!(matches!(
            worker.call(LONG, &|| {}, || None, |_| ()),
            Err(CallError::Broken)
        ));
        assert!(matches!(count(&mut worker), Ok(8)));
        assert_eq!((worker.given_up(), worker.hanging()), (0, 0));
    }

    #[test]
    fn hanging_calls_are_abandoned_and_counted_up_to_a_limit_and_a_halt_is_not_counted() {
        let mut worker = worker(2);
        assert!(matches!(
            hang(&mut worker, Duration::from_millis(1)),
            Err(CallError::TimedOut)
        ));
        assert_eq!((worker.given_up(), worker.hanging()), (1, 1));
        worker.halt.pause(Duration::ZERO);
        assert!(matches!(hang(&mut worker, LONG), Err(CallError::Halted(_))));
        assert_eq!((worker.given_up(), worker.hanging()), (1, 2));
        assert!(matches!(count(&mut worker), Err(CallError::TooManyHang)));
    }
}
