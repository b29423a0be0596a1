//! Health is defined here and nowhere else: by the age of the last good frame.

use serde::{Deserialize, Serialize};

/// Whether frames come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Health {
    /// No frame is due yet.
    #[default]
    Young,
    /// The last good frame is younger than one and a half intervals.
    Good,
    /// It is older: the camera needs a look, whatever it answers.
    Stale,
}

/// Intervals after the last good frame at which the next one is overdue: half of one is for shots that fail and are repeated.
const OVERDUE_INTERVALS: f64 = 1.5;

/// When good frames came and when the next one is due. Times since boot, s.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Frames {
    last_s: Option<f64>,
    due_s: Option<f64>,
    interval_s: f64,
}

impl Frames {
    /// From now on a good frame is expected every interval.
    pub fn expect(&mut self, interval_s: f64, now_s: f64) {
        self.interval_s = interval_s;
        self.due_s = Some(now_s + OVERDUE_INTERVALS * interval_s);
    }

    /// A good frame was asked for at this time.
    pub fn came(&mut self, at_s: f64) {
        self.last_s = Some(at_s);
        self.due_s = Some(at_s + OVERDUE_INTERVALS * self.interval_s);
    }

    /// Since the last good frame, s; `None` before the first.
    pub fn age_s(&self, now_s: f64) -> Option<f64> {
        self.last_s.map(|at_s| now_s - at_s)
    }

    /// The health that follows.
    pub fn health(&self, now_s: f64) -> Health {
        match (self.due_s, self.last_s) {
            (Some(due_s), _) if now_s > due_s => Health::Stale,
            (_, Some(_)) => Health::Good,
            (_, None) => Health::Young,
        }
    }
}
