//! Requests to stop, and power failures, as seen by all threads: current work is finished or abandoned by a given time.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Fraction of the available time that a camera or a solver may take; the rest is for closing and syncing.
const WORK_FRACTION: f64 = 0.5;

/// Order to the threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    /// Work normally.
    Work,
    /// Begin nothing until the failing power is back.
    Pause,
    /// End.
    End,
}

#[derive(Debug)]
struct HaltState {
    order: Order,
    /// Time at which current work is abandoned.
    give_up: Option<Instant>,
}

/// Order to stop or pause, shared by the threads. Clones share one state.
#[derive(Clone, Debug)]
pub(crate) struct Halt {
    state: Arc<Mutex<HaltState>>,
}

impl Default for Halt {
    fn default() -> Self {
        Self {
            state: Arc::new(Mutex::new(HaltState {
                order: Order::Work,
                give_up: None,
            })),
        }
    }
}

impl Halt {
    /// Orders the program to end within this machine time. The order cannot be revoked, and an earlier limit stays.
    pub fn end(&self, within: Duration) {
        self.set_order_and_deadline(Order::End, within);
    }

    /// Orders the threads to begin nothing and to make current work durable within this machine time.
    pub fn pause(&self, within: Duration) {
        if !self.is_ending() {
            self.set_order_and_deadline(Order::Pause, within);
        }
    }

    /// Revokes a pause, because the power is back.
    pub fn resume(&self) {
        let mut state = self.lock_state();
        if state.order == Order::Pause {
            *state = HaltState {
                order: Order::Work,
                give_up: None,
            };
        }
    }

    fn set_order_and_deadline(&self, order: Order, within: Duration) {
        let limit = Instant::now().checked_add(within.mul_f64(WORK_FRACTION));
        let mut state = self.lock_state();
        let give_up = state.give_up.into_iter().chain(limit).min();
        *state = HaltState { order, give_up };
    }

    /// Returns whether an end or a pause is ordered.
    pub fn is_requested(&self) -> bool {
        self.lock_state().order != Order::Work
    }

    /// Returns whether a pause is ordered.
    pub fn is_paused(&self) -> bool {
        self.lock_state().order == Order::Pause
    }

    /// Returns whether an end is ordered.
    pub fn is_ending(&self) -> bool {
        self.lock_state().order == Order::End
    }

    /// Returns whether current work must be abandoned now.
    pub fn is_expired(&self) -> bool {
        self.lock_state()
            .give_up
            .is_some_and(|limit| Instant::now() >= limit)
    }

    fn lock_state(&self) -> MutexGuard<'_, HaltState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_can_be_revoked_and_a_shutdown_cannot() {
        let halt = Halt::default();
        assert!(!halt.is_requested() && !halt.is_expired());
        halt.pause(Duration::ZERO);
        assert!(halt.is_paused() && halt.is_expired());
        halt.resume();
        assert!(!halt.is_requested() && !halt.is_expired());
        halt.end(Duration::from_secs(60));
        halt.pause(Duration::ZERO);
        halt.resume();
        assert!(halt.is_ending() && !halt.is_paused() && !halt.is_expired());
    }

    #[test]
    fn a_power_failure_shortens_the_stop_limit_but_a_stop_does_not_extend_it() {
        let halt = Halt::default();
        halt.pause(Duration::ZERO);
        halt.end(Duration::from_secs(60));
        assert!(halt.is_expired());
    }
}
