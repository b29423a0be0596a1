//! A mailbox has a place for one thing: what is still there when the next comes is replaced, never queued.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

struct Slot<T> {
    thing: Option<T>,
    closed: bool,
}

/// Between one thread that gives and one that takes.
pub(crate) struct Mailbox<T> {
    slot: Mutex<Slot<T>>,
    changed: Condvar,
}

/// What a look into the mailbox gave.
#[derive(Debug, PartialEq)]
pub(crate) enum Look<T> {
    Thing(T),
    Nothing,
    Closed,
}

impl<T> Default for Mailbox<T> {
    fn default() -> Self {
        Self { slot: Mutex::new(Slot { thing: None, closed: false }), changed: Condvar::new() }
    }
}

impl<T> Mailbox<T> {
    /// True where another thing lay there, which is gone.
    pub fn put(&self, thing: T) -> bool {
        let replaced = self.slot().thing.replace(thing).is_some();
        self.changed.notify_one();
        replaced
    }

    /// Nothing more will come.
    pub fn close(&self) {
        self.slot().closed = true;
        self.changed.notify_all();
    }

    /// Waits at most so long; machine time.
    pub fn take(&self, patience: Duration) -> Look<T> {
        let slot = self.slot();
        let waiting = |slot: &mut Slot<T>| slot.thing.is_none() && !slot.closed;
        let waited = self.changed.wait_timeout_while(slot, patience, waiting);
        let mut slot = waited.unwrap_or_else(PoisonError::into_inner).0;
        match (slot.thing.take(), slot.closed) {
            (Some(thing), _) => Look::Thing(thing),
            (None, true) => Look::Closed,
            (None, false) => Look::Nothing,
        }
    }

    fn slot(&self) -> MutexGuard<'_, Slot<T>> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_is_there_and_the_last_is_taken_before_the_end() {
        let mailbox = Mailbox::default();
        assert_eq!(mailbox.take(Duration::ZERO), Look::Nothing);
        assert!(!mailbox.put(1));
        assert!(mailbox.put(2));
        mailbox.close();
        assert_eq!(mailbox.take(Duration::from_secs(60)), Look::Thing(2));
        assert_eq!(mailbox.take(Duration::from_secs(60)), Look::Closed);
    }
}
