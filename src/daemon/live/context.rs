//! Configuration and status that the threads of live mode share.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::config::LiveConfig;
use crate::daemon::core::Core;
use crate::daemon::status::{LIVE_PARTS, LiveStatus};

/// Configuration and status that the threads of live mode share.
#[derive(Clone)]
pub(crate) struct LiveContext {
    pub core: Core,
    pub config: LiveConfig,
    skipped: Arc<AtomicU64>,
}

impl LiveContext {
    /// Creates the shared context of the live threads.
    pub fn new(core: &Core, config: &LiveConfig) -> Self {
        Self {
            core: core.clone(),
            config: config.clone(),
            skipped: Arc::default(),
        }
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

    /// Sets the fault of a part until it is cleared.
    pub fn set_fault(&self, part: &'static str, what: &str) {
        self.core
            .board
            .set_fault((LIVE_PARTS, part), Some(what.to_owned()));
    }

    /// Removes the fault of a part.
    pub fn clear_fault(&self, part: &'static str) {
        self.core.board.set_fault((LIVE_PARTS, part), None);
    }
}
