//! All threads see here a wish to stop, or that the power fails: what is under way is finished or given up by a stated time.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Of the time that there is, what a camera or a solver may take; the rest is for closing and syncing.
const FOR_WORK: f64 = 0.5;

/// What the threads are to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    /// To work.
    Work,
    /// To begin nothing until the power is back, which fails.
    Pause,
    /// To end.
    End,
}

#[derive(Debug)]
struct State {
    order: Order,
    /// When work under way is given up.
    give_up: Option<Instant>,
}

/// Shared by the threads; copies are the same.
#[derive(Clone, Debug)]
pub(crate) struct Halt {
    state: Arc<Mutex<State>>,
}

impl Default for Halt {
    fn default() -> Self {
        Self { state: Arc::new(Mutex::new(State { order: Order::Work, give_up: None })) }
    }
}

impl Halt {
    /// The program ends within this time, machine time. It is not taken back, and an earlier limit stays.
    pub fn end(&self, within: Duration) {
        self.give(Order::End, within);
    }

    /// Nothing new begins, and what is under way is durable within this time, machine time.
    pub fn pause(&self, within: Duration) {
        if !self.ending() {
            self.give(Order::Pause, within);
        }
    }

    /// The power is back.
    pub fn resume(&self) {
        let mut state = self.state();
        if state.order == Order::Pause {
            *state = State { order: Order::Work, give_up: None };
        }
    }

    fn give(&self, order: Order, within: Duration) {
        let limit = Instant::now().checked_add(within.mul_f64(FOR_WORK));
        let mut state = self.state();
        let give_up = state.give_up.into_iter().chain(limit).min();
        *state = State { order, give_up };
    }

    /// To end, or to pause.
    pub fn wanted(&self) -> bool {
        self.state().order != Order::Work
    }

    /// To pause.
    pub fn paused(&self) -> bool {
        self.state().order == Order::Pause
    }

    /// To end.
    pub fn ending(&self) -> bool {
        self.state().order == Order::End
    }

    /// Work under way is to be given up now.
    pub fn over(&self) -> bool {
        self.state().give_up.is_some_and(|limit| Instant::now() >= limit)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_is_taken_back_and_an_end_is_not() {
        let halt = Halt::default();
        assert!(!halt.wanted() && !halt.over());
        halt.pause(Duration::ZERO);
        assert!(halt.paused() && halt.over());
        halt.resume();
        assert!(!halt.wanted() && !halt.over());
        halt.end(Duration::from_secs(60));
        halt.pause(Duration::ZERO);
        halt.resume();
        assert!(halt.ending() && !halt.paused() && !halt.over());
    }

    #[test]
    fn the_power_that_fails_shortens_what_a_stop_allows_and_not_the_other_way_round() {
        let halt = Halt::default();
        halt.pause(Duration::ZERO);
        halt.end(Duration::from_secs(60));
        assert!(halt.over());
    }
}
