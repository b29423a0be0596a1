//! `[series]` of the configuration: when series are taken, and the deadlines of the camera.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use wingd_base::fault::KeyFault;

use super::schedule::{Align, Timetable};

/// `[series]` of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SeriesConfig {
    /// Time from the beginning of one series to the beginning of the next.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub interval: Duration,
    /// Shots per series.
    pub shots: u32,
    /// Pause between two shots.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub gap: Duration,
    /// Time within which the camera must deliver a frame; after another 25 % the call is abandoned. Machine time.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub shot_deadline: Duration,
    /// Time within which opening the camera must be finished. Machine time.
    #[serde(with = "jiff::fmt::serde::unsigned_duration::friendly::compact::required")]
    pub open_deadline: Duration,
    /// Additional attempts at a shot that failed.
    pub retries: u32,
    /// Alignment of the series: `start` or `clock`.
    pub align: Align,
    /// The daemon ends by itself if the next series would begin later than this after the first.
    #[serde(
        with = "jiff::fmt::serde::unsigned_duration::friendly::compact::optional",
        skip_serializing_if = "Option::is_none"
    )]
    pub until: Option<Duration>,
    /// Number of preceding frames with which a frame is compared; it is stale if it equals one of them.
    pub stale_window: usize,
}

impl Default for SeriesConfig {
    fn default() -> Self {
        Self {
            interval: Duration::from_secs(3600),
            shots: 10,
            gap: Duration::from_secs(2),
            shot_deadline: Duration::from_secs(20),
            open_deadline: Duration::from_secs(30),
            retries: 2,
            align: Align::Start,
            until: None,
            stale_window: 16,
        }
    }
}

impl SeriesConfig {
    /// Returns every invalid setting, with its key in the whole file.
    pub fn faults(&self) -> Vec<KeyFault> {
        let least = self.gap.saturating_mul(self.shots.saturating_sub(1));
        let fits = least < self.interval || self.interval.is_zero();
        let too_short = "is shorter than the sum of a series' gaps";
        let positive = "must be longer than 0";
        let rules = [
            (
                !self.interval.is_zero(),
                "interval",
                positive,
                "for example \"1h\"",
            ),
            (
                (1..=9999).contains(&self.shots),
                "shots",
                "must be 1 to 9999",
                "correct it",
            ),
            (
                !self.shot_deadline.is_zero(),
                "shot_deadline",
                positive,
                "for example \"20s\"",
            ),
            (
                !self.open_deadline.is_zero(),
                "open_deadline",
                positive,
                "for example \"30s\"",
            ),
            (
                self.retries <= 10,
                "retries",
                "must be at most 10",
                "correct it",
            ),
            (
                fits,
                "interval",
                too_short,
                "lengthen it, or lower shots or gap",
            ),
        ];
        KeyFault::from_rules("series", &rules)
    }

    /// Returns the timetable of the series.
    pub(crate) fn timetable(&self) -> Timetable {
        Timetable {
            interval: self.interval,
            align: self.align,
            until: self.until,
        }
    }
}
