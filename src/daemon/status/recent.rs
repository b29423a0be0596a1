//! What the last results were like: with numbers or without, rejected or not, frames skipped between them.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

/// Live results are looked at over this time, s: as long as the rate is.
const LIVE_S: f64 = 10.0;
/// Or over so many, where they come more slowly.
const MIN_LIVE_RESULTS: usize = 10;
/// Results of series are looked at over so many: two series.
const SERIES: usize = 20;

/// Shares of the last results.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Recent {
    /// How many they are.
    pub results: u64,
    /// With numbers; `null` without a result.
    pub solved: Option<f64>,
    /// Rejected by their global test; `null` without a result.
    pub rejected: Option<f64>,
    /// Frames that were skipped between them; `null` where nothing is skipped, or without two results.
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
pub(super) struct Results {
    last: VecDeque<Outcome>,
    over_s: f64,
    least: usize,
}

impl Results {
    pub fn of_live() -> Self {
        Self { last: VecDeque::new(), over_s: LIVE_S, least: MIN_LIVE_RESULTS }
    }

    pub fn of_series() -> Self {
        Self { last: VecDeque::new(), over_s: 0.0, least: SERIES }
    }

    /// A result; `skipped`: frames skipped since the start.
    pub fn note(&mut self, at_s: f64, solved: bool, rejected: bool, skipped: u64) {
        self.last.push_back(Outcome { at_s, solved, rejected, skipped });
        while self.last.len() > self.least && self.last.front().is_some_and(|f| at_s - f.at_s > self.over_s) {
            self.last.pop_front();
        }
    }

    /// Since the last one, s; `None` before the first.
    pub fn age_s(&self, now_s: f64) -> Option<f64> {
        self.last.back().map(|last| (now_s - last.at_s).max(0.0))
    }

    pub fn recent(&self) -> Recent {
        let results = self.last.len();
        let share = |of: fn(&Outcome) -> bool| {
            (results > 0).then(|| self.last.iter().filter(|o| of(o)).count() as f64 / results as f64)
        };
        let between =
            self.last.back().zip(self.last.front()).map(|(last, first)| last.skipped - first.skipped);
        let skipped = between.filter(|_| results > 1).map(|skipped| {
            let skipped = skipped as f64;
            skipped / (skipped + (results - 1) as f64)
        });
        Recent {
            results: results as u64,
            solved: share(|o| o.solved),
            rejected: share(|o| o.rejected),
            skipped,
        }
    }
}
