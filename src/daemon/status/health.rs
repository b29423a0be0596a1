//! The only definition of health: one word with its reasons, for the page, `wingd status` and its exit status, and
//! the datagrams.

use serde::{Deserialize, Serialize};

use super::DaemonStatus;
use super::faults::{self, Faults};
use super::recent::{RecentResults, RecentShares};

/// Reliability of the recorder's results, in one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Health {
    /// Frames and results come as they should, or none is due yet.
    #[default]
    Ok,
    /// Frames and results come, but late, rejected, skipped or partly without numbers.
    Degraded,
    /// No frames or results come, or most results have no numbers.
    Failed,
}

/// Number of intervals after the last good frame at which the next one is overdue; 0.5 of them allow for repeated shots.
const OVERDUE_INTERVALS: f64 = 1.5;
/// Numbers of intervals after which the last live result is old, and after which it is lost. The page uses the same limits.
const OLD_INTERVALS: (f64, f64) = (3.0, 5.0);
/// Time for the camera to open and for the first full search, s (an assumption: slow cameras open in 10 s).
const STARTUP_S: f64 = 15.0;
/// Shares of results without numbers above which health is degraded, and failed.
const UNSOLVED_LIMITS: (f64, f64) = (0.1, 0.5);
/// Share of rejected results above which the standard deviations are doubtful.
const MAX_REJECTED: f64 = 0.1;
/// Share of skipped frames above which the machine is too slow for the rate.
const MAX_SKIPPED: f64 = 0.25;
/// Minimum number of results for which shares are evaluated.
const MIN_RESULTS: u64 = 3;
/// Time within which live results must be stored, s: the disk's own time and some failed attempts.
const LIVE_STORAGE_S: f64 = 30.0;
/// Time within which one of the waiting frames of series must have a result, s: well above the solver's deadline. With longer
/// intervals of the series it is [`OVERDUE_INTERVALS`] of them.
const SERIES_STORAGE_S: f64 = 300.0;
/// Maximum time that is formatted with one decimal, s.
const MAX_TENTHS_S: f64 = 9.95;

/// Times of the last good frame and of the next one due, since boot, s.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FrameMonitor {
    last_s: Option<f64>,
    due_s: Option<f64>,
    interval_s: f64,
}

impl FrameMonitor {
    /// Sets the interval at which good frames are expected from now on.
    pub fn expect_every(&mut self, interval_s: f64, now_s: f64) {
        self.interval_s = interval_s;
        self.due_s = Some(now_s + OVERDUE_INTERVALS * interval_s);
    }

    /// Notes a good frame that was requested at this time.
    pub fn note_frame(&mut self, at_s: f64) {
        self.last_s = Some(at_s);
        self.due_s = Some(at_s + OVERDUE_INTERVALS * self.interval_s);
    }

    /// Returns the time since the last good frame, s; `None` before the first.
    pub fn age_s(&self, now_s: f64) -> Option<f64> {
        self.last_s.map(|at_s| now_s - at_s)
    }

    fn add_reasons(&self, now_s: f64, reasons: &mut HealthReasons) {
        if self.due_s.is_some_and(|due_s| now_s > due_s) {
            let since = self.age_s(now_s).map_or("since the start".to_owned(), |s| {
                format!("for {}", format_span(s))
            });
            let every = format_span(self.interval_s);
            let remedy = "check the camera: power, cable, lens cap, card";
            reasons.add_failed(format!(
                "no good frame {since}, one every {every} is expected; {remedy}"
            ));
        }
    }
}

/// Time since which something waits, since boot, s.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WaitMonitor(Option<f64>);

impl WaitMonitor {
    /// Notes whether something waits now.
    pub fn set_waiting(&mut self, waiting: bool, now_s: f64) {
        self.0 = waiting.then(|| self.0.unwrap_or(now_s));
    }

    /// Returns the time for which something has waited, if that is longer than `limit_s`.
    fn exceeds(&self, limit_s: f64, now_s: f64) -> Option<f64> {
        self.0
            .map(|since_s| now_s - since_s)
            .filter(|waited_s| *waited_s > limit_s)
    }
}

/// Results on their way to the disk.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StorageMonitor {
    /// Live results.
    pub live: WaitMonitor,
    /// Results of series.
    pub series: WaitMonitor,
}

impl StorageMonitor {
    fn add_reasons(
        &self,
        status: &DaemonStatus,
        interval_s: f64,
        now_s: f64,
        reasons: &mut HealthReasons,
    ) {
        let series_s = SERIES_STORAGE_S.max(OVERDUE_INTERVALS * interval_s);
        let store = &status.store;
        if let Some(why) = &store.unclosed {
            reasons.add_failed(format!(
                "the last series could not be stored completely: {why}"
            ));
        }
        if store.stranded > 0 {
            let remedy = "see the log and run `wingd verify`";
            reasons.add_failed(format!(
                "{} series in incoming/ cannot be moved to their flight; {remedy}",
                store.stranded
            ));
        }
        if let Some(waited_s) = self.live.exceeds(LIVE_STORAGE_S, now_s) {
            reasons.add_failed(format!(
                "no live result was stored for {}; check the disk",
                format_span(waited_s.round())
            ));
        }
        if let Some(waited_s) = self.series.exceeds(series_s, now_s) {
            let waited = format_span(waited_s.round());
            reasons.add_degraded(format!(
                "{} frames wait to be solved, none was for {waited}",
                status.to_solve
            ));
        }
    }
}

/// Live results and their expected interval. Times since boot, s.
#[derive(Clone, Debug)]
pub(super) struct LiveMonitor {
    pub results: RecentResults,
    pub interval_s: f64,
    since_s: f64,
}

impl LiveMonitor {
    /// Expects one result per interval from now on.
    pub fn new(interval_s: f64, now_s: f64) -> Self {
        Self {
            results: RecentResults::for_live(),
            interval_s,
            since_s: now_s,
        }
    }

    fn add_reasons(&self, now_s: f64, reasons: &mut HealthReasons) {
        let interval_s = self.interval_s;
        let every = format_span(interval_s);
        match self.results.age_s(now_s) {
            Some(age_s) if age_s > OLD_INTERVALS.0 * interval_s => {
                let reason = format!(
                    "the last live result is {} old, one every {every} is expected; see the last error",
                    format_span(age_s)
                );
                reasons.add(
                    if age_s > OLD_INTERVALS.1 * interval_s {
                        Health::Failed
                    } else {
                        Health::Degraded
                    },
                    reason,
                );
            }
            None if now_s > self.since_s + STARTUP_S + OLD_INTERVALS.1 * interval_s => {
                reasons.add_failed(format!(
                    "no live result since the start, one every {every} is expected; see the last error"
                ));
            }
            _ => {}
        }
        add_share_reasons(&self.results.shares(), "live results", reasons);
    }
}

/// Reasons of the health, each with its severity.
#[derive(Default)]
struct HealthReasons {
    all: Vec<(Health, String)>,
}

impl HealthReasons {
    fn add(&mut self, health: Health, reason: String) {
        self.all.push((health, reason));
    }

    fn add_failed(&mut self, reason: String) {
        self.add(Health::Failed, reason);
    }

    fn add_degraded(&mut self, reason: String) {
        self.add(Health::Degraded, reason);
    }
}

/// Adds reasons for results of one kind that are without numbers, rejected or skipped.
fn add_share_reasons(recent: &RecentShares, kind: &str, reasons: &mut HealthReasons) {
    let results = recent.results;
    if results < MIN_RESULTS {
        return;
    }
    let count = |share: Option<f64>| (share.unwrap_or(0.0) * results as f64).round();
    let unsolved = recent.solved.map_or(0.0, |share| 1.0 - share);
    if unsolved > UNSOLVED_LIMITS.0 {
        let reason = format!(
            "{} of the last {results} {kind} have no numbers; check light, contamination and the camera's direction",
            count(Some(unsolved))
        );
        reasons.add(
            if unsolved > UNSOLVED_LIMITS.1 {
                Health::Failed
            } else {
                Health::Degraded
            },
            reason,
        );
    }
    let rejected = count(recent.rejected);
    // A single one may be chance.
    if rejected > 1.0 && recent.rejected.is_some_and(|share| share > MAX_REJECTED) {
        let share = format!("{rejected} of the last {results} {kind}");
        reasons.add_degraded(format!(
            "{share} are rejected by their global test; check the camera mounting"
        ));
    }
    if let Some(share) = recent.skipped.filter(|share| *share > MAX_SKIPPED) {
        reasons.add_degraded(format!(
            "{:.0} % of the live frames are skipped: the machine is too slow; lower rate_hz",
            100.0 * share
        ));
    }
}

/// Returns the health and its reasons, the most severe first. `series`: results of series.
pub(super) fn evaluate_health(
    status: &DaemonStatus,
    (frames, series, live, storage): (
        &FrameMonitor,
        &RecentResults,
        Option<&LiveMonitor>,
        &StorageMonitor,
    ),
    faults: &Faults,
    now_s: f64,
) -> (Health, Vec<String>) {
    let mut reasons = HealthReasons::default();
    frames.add_reasons(now_s, &mut reasons);
    if let Some(why) = &status.store.refuses {
        reasons.add_failed(format!("the store accepts no series: {why}"));
    }
    storage.add_reasons(status, frames.interval_s, now_s, &mut reasons);
    if let Some(live) = live {
        live.add_reasons(now_s, &mut reasons);
    }
    add_share_reasons(&series.shares(), "results of series", &mut reasons);
    for (part, what) in faults.current() {
        // Results that are not stored are lost at the next power cut.
        let health = if part == faults::RESULTS_PART {
            Health::Failed
        } else {
            Health::Degraded
        };
        reasons.add(health, format!("{}: {what}", faults::name(part)));
    }
    let health = reasons
        .all
        .iter()
        .map(|(health, _)| *health)
        .max()
        .unwrap_or_default();
    // The sort is stable: equal severities keep their order.
    reasons
        .all
        .sort_by_key(|(health, _)| std::cmp::Reverse(*health));
    (
        health,
        reasons.all.into_iter().map(|(_, reason)| reason).collect(),
    )
}

/// Formats a time span for people, such as `1 min 1 s`.
#[must_use]
pub fn format_span(seconds: f64) -> String {
    if seconds < MAX_TENTHS_S && seconds.fract() != 0.0 {
        let digits = if seconds < 0.1 { 3 } else { 1 };
        return format!("{seconds:.digits$} s");
    }
    let whole = seconds.round() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s} s"),
        (h, m, _) => format!("{h} h {m} min"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Live results at 10 Hz for ten seconds: whether each is solved and rejected, and the frames skipped before it.
    fn live(outcome: impl Fn(u64) -> (bool, bool, u64)) -> LiveMonitor {
        let mut live = LiveMonitor::new(0.1, 0.0);
        for k in 1..=100 {
            let (solved, rejected, skipped) = outcome(k);
            live.results
                .add_result(0.1 * k as f64, solved, rejected, skipped);
        }
        live
    }

    fn evaluate(live: &LiveMonitor, now_s: f64) -> (Health, String) {
        let (health, reasons) = evaluate_health(
            &DaemonStatus::default(),
            (
                &FrameMonitor::default(),
                &RecentResults::for_series(),
                Some(live),
                &StorageMonitor::default(),
            ),
            &Faults::default(),
            now_s,
        );
        (health, reasons.join("; "))
    }

    #[test]
    fn live_results_are_ok_old_and_lost_by_their_intervals() {
        let well = live(|_| (true, false, 0));
        assert_eq!(evaluate(&well, 10.25), (Health::Ok, String::new()));
        assert_eq!(evaluate(&well, 10.35).0, Health::Degraded);
        let (health, why) = evaluate(&well, 40.0);
        assert!(
            health == Health::Failed
                && why.contains("the last live result is 30 s old, one every 0.1 s"),
            "{why}"
        );
        let none = LiveMonitor::new(0.1, 0.0);
        assert_eq!(
            (evaluate(&none, 5.0).0, evaluate(&none, 20.0).0),
            (Health::Ok, Health::Failed)
        );
    }

    #[test]
    fn results_without_numbers_rejected_or_skipped_degrade_health() {
        let (health, why) = evaluate(&live(|k| (k % 10 < 3, false, 0)), 10.05);
        assert!(
            health == Health::Failed && why.starts_with("70 of the last 100 live results have no"),
            "{why}"
        );
        assert_eq!(
            evaluate(&live(|k| (k % 5 > 0, false, 0)), 10.05).0,
            Health::Degraded
        );
        let (health, why) = evaluate(&live(|_| (true, true, 0)), 10.05);
        assert!(
            health == Health::Degraded
                && why.contains("100 of the last 100 live results are rejected")
        );
        let (health, why) = evaluate(&live(|k| (true, false, k)), 10.05);
        assert!(
            health == Health::Degraded && why.contains("50 % of the live frames are skipped"),
            "{why}"
        );
        assert_eq!(
            evaluate(&live(|k| (k % 20 > 0, k % 20 == 1, k / 10)), 10.05).0,
            Health::Ok,
            "may be chance"
        );
    }

    #[test]
    fn reasons_are_listed_with_the_worst_first() {
        let mut status = DaemonStatus::default();
        status.store.refuses = Some("it is full".to_owned());
        let mut faults = Faults::default();
        faults.set(
            faults::AIRCRAFT_PART,
            Some("no line for 20 s".to_owned()),
            0.0,
        );
        let monitors = (
            &FrameMonitor::default(),
            &RecentResults::for_series(),
            None,
            &StorageMonitor::default(),
        );
        let (health, reasons) = evaluate_health(&status, monitors, &faults, 1.0);
        assert_eq!(health, Health::Failed);
        assert_eq!(
            reasons,
            [
                "the store accepts no series: it is full",
                "aircraft data: no line for 20 s"
            ]
        );
    }

    #[test]
    fn what_does_not_reach_the_disk_fails_health() {
        let evaluate = |status: &DaemonStatus, storage: &StorageMonitor, now_s| {
            let monitors = (
                &FrameMonitor::default(),
                &RecentResults::for_series(),
                None,
                storage,
            );
            evaluate_health(status, monitors, &Faults::default(), now_s)
        };
        let (mut status, mut storage) = (DaemonStatus::default(), StorageMonitor::default());
        storage.live.set_waiting(true, 1.0);
        storage.live.set_waiting(true, 20.0);
        storage.series.set_waiting(true, 1.0);
        assert_eq!(evaluate(&status, &storage, 30.0).0, Health::Ok);
        let (health, reasons) = evaluate(&status, &storage, 32.0);
        assert!(
            health == Health::Failed && reasons[0].contains("no live result was stored for 31 s"),
            "{reasons:?}"
        );
        storage.live.set_waiting(false, 33.0);
        assert_eq!(
            (
                evaluate(&status, &storage, 34.0).0,
                evaluate(&status, &storage, 302.0).0
            ),
            (Health::Ok, Health::Degraded)
        );
        status.store.stranded = 2;
        assert_eq!(evaluate(&status, &storage, 34.0).0, Health::Failed);
        status.store = super::super::StoreStatus {
            unclosed: Some("no permission".to_owned()),
            ..Default::default()
        };
        let (health, reasons) = evaluate(&status, &storage, 34.0);
        assert!(
            health == Health::Failed && reasons[0].contains("no permission"),
            "{reasons:?}"
        );
    }

    #[test]
    fn spans_are_short() {
        let spans = [0.05, 0.2, 5.0, 9.96, 61.0, 3700.0].map(format_span);
        assert_eq!(
            spans,
            ["0.050 s", "0.2 s", "5 s", "10 s", "1 min 1 s", "1 h 1 min"]
        );
    }
}
