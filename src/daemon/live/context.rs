//! Configuration and status that the threads of live mode share.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use super::config::LiveConfig;
use crate::daemon::core::Core;
use crate::daemon::status::LiveStatus;

/// Configuration, status and faults that the threads of live mode share.
#[derive(Clone)]
pub(crate) struct LiveContext {
    pub core: Core,
    pub config: LiveConfig,
    skipped: Arc<AtomicU64>,
    faults: Arc<Mutex<BTreeMap<&'static str, String>>>,
}

impl LiveContext {
    /// Creates the shared context of the live threads.
    pub fn new(core: &Core, config: &LiveConfig) -> Self {
        Self { core: core.clone(), config: config.clone(), skipped: Arc::default(), faults: Arc::default() }
    }

    /// Changes the live part of the status.
    pub fn update(&self, f: impl FnOnce(&mut LiveStatus)) {
        self.core.board.update_live(f);
    }

    /// Returns the number of skipped frames.
    pub fn skipped(&self) -> u64 {
        self.skipped.load(Ordering::Relaxed)
    }

    /// Counts a skipped frame and updates the status.
    pub fn count_skipped(&self) {
        let skipped = self.skipped.fetch_add(1, Ordering::Relaxed) + 1;
        self.update(|live| live.skipped = skipped);
    }

    /// Sets the fault of a part until it is cleared, and logs it once.
    pub fn set_fault(&self, part: &'static str, what: &str) {
        let mut faults = self.faults.lock().unwrap_or_else(PoisonError::into_inner);
        if faults.get(part).map(String::as_str) == Some(what) {
            return;
        }
        faults.insert(part, what.to_owned());
        drop(faults);
        tracing::warn!(part, what, "live mode");
        self.core.board.note_fault(what);
        self.update(|live| live.fault = Some(what.to_owned()));
    }

    /// Removes the error of a part from the status.
    pub fn clear_fault(&self, part: &'static str) {
        let mut faults = self.faults.lock().unwrap_or_else(PoisonError::into_inner);
        if faults.remove(part).is_some() {
            let other = faults.values().next().cloned();
            drop(faults);
            tracing::info!(part, "live mode: works again");
            self.update(|live| live.fault = other);
        }
    }
}
