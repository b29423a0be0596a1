//! The last results: their number, and the shares of solved, rejected and skipped frames.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

/// Time over which live results are evaluated, s; the rate uses the same.
const LIVE_WINDOW_S: f64 = 10.0;
/// Minimum number of live results evaluated, if they come more slowly.
const MIN_LIVE_RESULTS: usize = 10;
/// Number of series results evaluated: two series.
const MIN_SERIES_RESULTS: usize = 20;

/// Shares of the last results.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct RecentShares {
    /// Number of results evaluated.
    pub results: u64,
    /// Share of results with numbers; `null` without a result.
    pub solved: Option<f64>,
    /// Share of results rejected by their global test; `null` without a result.
    pub rejected: Option<f64>,
    /// Share of frames skipped between them; `null` for series, or with fewer than two results.
    pub skipped: Option<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Outcome {
    at_s: f64,
    solved: bool,
    rejected: bool,
    /// Frames skipped since the start.
    skipped: u64,
}

/// The last results, in order. Times since boot, s.
#[derive(Clone, Debug, Default)]
pub(super) struct RecentResults {
    last: VecDeque<Outcome>,
    over_s: f64,
    least: usize,
}

impl RecentResults {
    /// Creates the counters of live results, over a window of time.
    pub fn for_live() -> Self {
        Self {
            last: VecDeque::new(),
            over_s: LIVE_WINDOW_S,
            least: MIN_LIVE_RESULTS,
        }
    }

    /// Creates the counters of series results, over the last series.
    pub fn for_series() -> Self {
        Self {
            last: VecDeque::new(),
            over_s: 0.0,
            least: MIN_SERIES_RESULTS,
        }
    }

    /// Adds a result; `skipped`: frames skipped since the start.
    pub fn add_result(&mut self, at_s: f64, solved: bool, rejected: bool, skipped: u64) {
        self.last.push_back(Outcome {
            at_s,
            solved,
            rejected,
            skipped,
        });
        while self.last.len() > self.least
            && self
                .last
                .front()
                .is_some_and(|f| at_s - f.at_s > self.over_s)
        {
            self.last.pop_front();
        }
    }

    /// Returns the time since the last result, s; `None` before the first.
    pub fn age_s(&self, now_s: f64) -> Option<f64> {
        self.last.back().map(|last| (now_s - last.at_s).max(0.0))
    }

    /// Returns the fractions of solved, rejected and skipped results.
    pub fn shares(&self) -> RecentShares {
        let results = self.last.len();
        let share = |of: fn(&Outcome) -> bool| {
            (results > 0)
                .then(|| self.last.iter().filter(|o| of(o)).count() as f64 / results as f64)
        };
        let between = self
            .last
            .back()
            .zip(self.last.front())
            .map(|(last, first)| last.skipped - first.skipped);
        let skipped = between.filter(|_| results > 1).map(|skipped| {
            let skipped = skipped as f64;
            skipped / (skipped + (results - 1) as f64)
        });
        RecentShares {
            results: results as u64,
            solved: share(|o| o.solved),
            rejected: share(|o| o.rejected),
            skipped,
        }
    }
}
