//! Being told to stop, or that the power fails: what is under way is finished or given up by a stated time.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Of the time that there is, what a camera or a solver may take; the rest is for closing and syncing.
const FOR_WORK: f64 = 0.5;

/// What the threads are told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Told {
    /// To work.
    Work,
    /// That the power fails: to begin nothing until it is back.
    Pause,
    /// To end.
    End,
}

#[derive(Debug)]
struct State {
    told: Told,
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
        Self { state: Arc::new(Mutex::new(State { told: Told::Work, give_up: None })) }
    }
}

impl Halt {
    /// The program ends within this time, machine time. It is not taken back, and an earlier limit stays.
    pub fn end(&self, within: Duration) {
        self.tell(Told::End, within);
    }

    /// Nothing new begins, and what is under way is durable within this time, machine time.
    pub fn pause(&self, within: Duration) {
        if !self.ending() {
            self.tell(Told::Pause, within);
        }
    }

    /// The power is back.
    pub fn resume(&self) {
        let mut state = self.state();
        if state.told == Told::Pause {
            *state = State { told: Told::Work, give_up: None };
        }
    }

    fn tell(&self, told: Told, within: Duration) {
        let limit = Instant::now().checked_add(within.mul_f64(FOR_WORK));
        let mut state = self.state();
        let give_up = state.give_up.into_iter().chain(limit).min();
        *state = State { told, give_up };
    }

    /// To end, or to pause.
    pub fn wanted(&self) -> bool {
        self.state().told != Told::Work
    }

    /// To pause.
    pub fn paused(&self) -> bool {
        self.state().told == Told::Pause
    }

    /// To end.
    pub fn ending(&self) -> bool {
        self.state().told == Told::End
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
