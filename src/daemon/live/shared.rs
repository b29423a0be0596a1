//! The threads of live mode share their configuration, and what they write into the status.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use super::config::LiveConfig;
use crate::daemon::core::Core;
use crate::daemon::status::LiveStatus;

/// What the threads share.
#[derive(Clone)]
pub(crate) struct Shared {
    pub core: Core,
    pub config: LiveConfig,
    skipped: Arc<AtomicU64>,
    faults: Arc<Mutex<BTreeMap<&'static str, String>>>,
}

impl Shared {
    pub fn new(core: &Core, config: &LiveConfig) -> Self {
        Self { core: core.clone(), config: config.clone(), skipped: Arc::default(), faults: Arc::default() }
    }

    pub fn update(&self, f: impl FnOnce(&mut LiveStatus)) {
        self.core.board.update_live(f);
    }

    pub fn skipped(&self) -> u64 {
        self.skipped.load(Ordering::Relaxed)
    }

    pub fn skip(&self) {
        let skipped = self.skipped.fetch_add(1, Ordering::Relaxed) + 1;
        self.update(|live| live.skipped = skipped);
    }

    /// What is wrong with a part, until it is cleared; said once.
    pub fn fault(&self, part: &'static str, what: &str) {
        let mut faults = self.faults.lock().unwrap_or_else(PoisonError::into_inner);
        if faults.get(part).map(String::as_str) == Some(what) {
            return;
        }
        faults.insert(part, what.to_owned());
        drop(faults);
        tracing::warn!(part, what, "live mode");
        self.core.board.fault(what);
        self.update(|live| live.fault = Some(what.to_owned()));
    }

    pub fn clear(&self, part: &'static str) {
        let mut faults = self.faults.lock().unwrap_or_else(PoisonError::into_inner);
        if faults.remove(part).is_some() {
            let other = faults.values().next().cloned();
            drop(faults);
            tracing::info!(part, "live mode: works again");
            self.update(|live| live.fault = other);
        }
    }
}
