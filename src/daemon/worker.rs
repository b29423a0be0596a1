//! A worker is a thread for calls that may hang. A call that has not returned by its deadline is given up with its thread,
//! and counted. The camera's driver, the solver of series and that of live mode work so.

use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::core::Core;
use super::shutdown::Halt;

/// The longest wait without a sign of life from who waits, and without a look at the halt. Machine time.
const BEAT: Duration = Duration::from_millis(50);

type Call<S> = Box<dyn FnOnce(&mut S) + Send>;

/// Why a call has no answer. Where it was begun its thread is gone, and the next call begins another one.
#[derive(Debug)]
pub(crate) enum Unanswered {
    /// As many threads hang as may: each holds a thread, at worst a core.
    TooManyHang,
    /// The machine gave no thread.
    NoThread(std::io::Error),
    /// It had not returned by its deadline, and is counted.
    Late,
    /// wingd stops or the power fails, after this time.
    Halted(Duration),
    /// It panicked, or what it works on could not be made.
    Broken,
}

/// A thread with what the calls work on, of type `S`. It ends once it is let go of, after the call under way.
pub(crate) struct Worker<S> {
    name: &'static str,
    most_hanging: usize,
    halt: Halt,
    thread: Option<(Sender<Call<S>>, JoinHandle<()>)>,
    left_behind: Vec<JoinHandle<()>>,
    given_up: u64,
}

impl<S: 'static> Worker<S> {
    /// Without a thread as yet. So many threads that were given up may run on at a time.
    pub fn new(name: &'static str, most_hanging: usize, halt: Halt) -> Self {
        Self { name, most_hanging, halt, thread: None, left_behind: Vec::new(), given_up: 0 }
    }

    /// Calls given up at their deadline so far.
    pub fn given_up(&self) -> u64 {
        self.given_up
    }

    /// Threads that were given up and run still.
    pub fn hanging(&self) -> usize {
        self.left_behind.iter().filter(|thread| !thread.is_finished()).count()
    }

    /// Lets go of the thread.
    pub fn dismiss(&mut self) {
        self.thread = None;
    }

    fn begin(
        &mut self,
        make: impl FnOnce() -> Option<S> + Send + 'static,
    ) -> Result<(Sender<Call<S>>, JoinHandle<()>), Unanswered> {
        self.left_behind.retain(|thread| !thread.is_finished());
        if self.left_behind.len() >= self.most_hanging {
            return Err(Unanswered::TooManyHang);
        }
        let (calls, inbox) = channel::<Call<S>>();
        let thread = Core::spawn(self.name, move || {
            let Some(mut state) = make() else { return };
            while let Ok(call) = inbox.recv() {
                call(&mut state);
            }
        });
        Ok((calls, thread.map_err(Unanswered::NoThread)?))
    }

    /// What `work` returns within `limit`, machine time; `beat` is called while it is waited for. Where there is no thread
    /// one is begun, on which `make` makes what the calls work on.
    pub fn call<T: Send + 'static>(
        &mut self,
        limit: Duration,
        beat: &dyn Fn(),
        make: impl FnOnce() -> Option<S> + Send + 'static,
        work: impl FnOnce(&mut S) -> T + Send + 'static,
    ) -> Result<T, Unanswered> {
        let (calls, thread) = self.thread.take().map_or_else(|| self.begin(make), Ok)?;
        let (answer, answered) = channel();
        // Nobody waits any more for a call that was given up.
        let call: Call<S> = Box::new(move |state| drop(answer.send(work(state))));
        calls.send(call).map_err(|_| Unanswered::Broken)?;
        let mut left = limit;
        while !left.is_zero() && !self.halt.over() {
            let slice = left.min(BEAT);
            beat();
            match answered.recv_timeout(slice) {
                Ok(result) => {
                    self.thread = Some((calls, thread));
                    return Ok(result);
                }
                Err(RecvTimeoutError::Disconnected) => return Err(Unanswered::Broken),
                Err(RecvTimeoutError::Timeout) => left -= slice,
            }
        }
        self.left_behind.push(thread);
        if self.halt.over() {
            return Err(Unanswered::Halted(limit - left));
        }
        self.given_up += 1;
        Err(Unanswered::Late)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::panic)]
    use super::*;
    use std::thread::sleep;

    /// Far above what a thread needs to answer.
    const LONG: Duration = Duration::from_secs(60);

    fn worker(most_hanging: usize) -> Worker<u32> {
        Worker::new("test", most_hanging, Halt::default())
    }

    fn count(worker: &mut Worker<u32>) -> Result<u32, Unanswered> {
        let add = |state: &mut u32| {
            *state += 1;
            *state
        };
        worker.call(LONG, &|| {}, || Some(7), add)
    }

    fn hang(worker: &mut Worker<u32>, limit: Duration) -> Result<(), Unanswered> {
        worker.call(limit, &|| {}, || Some(0), |_| sleep(LONG))
    }

    #[test]
    fn calls_share_a_state_and_one_that_panics_costs_its_thread_alone() {
        let mut worker = worker(1);
        assert!(matches!((count(&mut worker), count(&mut worker)), (Ok(8), Ok(9))));
        let broken = worker.call(LONG, &|| {}, || None, |_| panic!("asked for by the test"));
        assert!(matches!(broken, Err(Unanswered::Broken)));
        assert!(matches!(worker.call(LONG, &|| {}, || None, |_| ()), Err(Unanswered::Broken)));
        assert!(matches!(count(&mut worker), Ok(8)));
        assert_eq!((worker.given_up(), worker.hanging()), (0, 0));
    }

    #[test]
    fn what_hangs_is_given_up_and_counted_up_to_a_limit_and_a_halt_counts_nothing() {
        let mut worker = worker(2);
        assert!(matches!(hang(&mut worker, Duration::from_millis(1)), Err(Unanswered::Late)));
        assert_eq!((worker.given_up(), worker.hanging()), (1, 1));
        worker.halt.pause(Duration::ZERO);
        assert!(matches!(hang(&mut worker, LONG), Err(Unanswered::Halted(_))));
        assert_eq!((worker.given_up(), worker.hanging()), (1, 2));
        assert!(matches!(count(&mut worker), Err(Unanswered::TooManyHang)));
    }
}
