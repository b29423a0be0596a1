//! A mailbox for one item: an item that is still there when the next one comes is replaced, never queued.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

struct Slot<T> {
    item: Option<T>,
    closed: bool,
}

/// A mailbox for one item between a sending and a receiving thread.
pub(crate) struct Mailbox<T> {
    slot: Mutex<Slot<T>>,
    changed: Condvar,
}

/// Result of [`Mailbox::take`].
#[derive(Debug, PartialEq)]
pub(crate) enum Delivery<T> {
    Item(T),
    Empty,
    Closed,
}

impl<T> Default for Mailbox<T> {
    fn default() -> Self {
        Self {
            slot: Mutex::new(Slot {
                item: None,
                closed: false,
            }),
            changed: Condvar::new(),
        }
    }
}

impl<T> Mailbox<T> {
    /// Puts an item in; returns whether it replaced another one.
    pub fn put(&self, thing: T) -> bool {
        let replaced = self.lock_slot().item.replace(thing).is_some();
        self.changed.notify_one();
        replaced
    }

    /// Closes the mailbox: no more items come.
    pub fn close(&self) {
        self.lock_slot().closed = true;
        self.changed.notify_all();
    }

    /// Waits for an item, at most for `patience` of machine time.
    pub fn take(&self, patience: Duration) -> Delivery<T> {
        let slot = self.lock_slot();
        let waiting = |slot: &mut Slot<T>| slot.item.is_none() && !slot.closed;
        let waited = self.changed.wait_timeout_while(slot, patience, waiting);
        let mut slot = waited.unwrap_or_else(PoisonError::into_inner).0;
        match (slot.item.take(), slot.closed) {
            (Some(thing), _) => Delivery::Item(thing),
            (None, true) => Delivery::Closed,
            (None, false) => Delivery::Empty,
        }
    }

    fn lock_slot(&self) -> MutexGuard<'_, Slot<T>> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_item_is_delivered_and_the_last_one_before_the_end() {
        let mailbox = Mailbox::default();
        assert_eq!(mailbox.take(Duration::ZERO), Delivery::Empty);
        assert!(!mailbox.put(1));
        assert!(mailbox.put(2));
        mailbox.close();
        assert_eq!(mailbox.take(Duration::from_secs(60)), Delivery::Item(2));
        assert_eq!(mailbox.take(Duration::from_secs(60)), Delivery::Closed);
    }
}
