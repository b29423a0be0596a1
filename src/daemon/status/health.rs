//! Health is defined here and nowhere else: one word with its reasons, for the page, `wingd status` and its exit status, the
//! metrics and the datagrams.

use serde::{Deserialize, Serialize};

use super::Status;
use super::recent::{Recent, Results};

/// Whether what the recorder gives can be relied on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Health {
    /// Frames and results come as they should, or none is due yet.
    #[default]
    Ok,
    /// They come, and not as they should.
    Degraded,
    /// There are none, or most have no numbers.
    Failed,
}

/// Intervals after the last good frame at which the next one is overdue: half of one is for shots that fail and are repeated.
const OVERDUE_INTERVALS: f64 = 1.5;
/// Intervals after which the last live result is old, and after which it is lost. The page marks it by the same.
const OLD_INTERVALS: (f64, f64) = (3.0, 5.0);
/// For the camera to open and the first whole search, s (an assumption: slow cameras open in 10 s).
const BEGINNING_S: f64 = 15.0;
/// Shares of results without numbers: above the first some frames are lost, above the second most.
const UNSOLVED: (f64, f64) = (0.1, 0.5);
/// Share of results that the global test rejects, above which the standard deviations are in doubt.
const REJECTED: f64 = 0.1;
/// Share of frames skipped, above which the machine is too slow for the rate.
const SKIPPED: f64 = 0.25;
/// Of fewer results no share is told.
const MIN_RESULTS: u64 = 3;
/// A span is given with a tenth up to here, s.
const TENTHS_S: f64 = 9.95;

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

    fn judge(&self, now_s: f64, reasons: &mut Reasons) {
        if self.due_s.is_some_and(|due_s| now_s > due_s) {
            let since =
                self.age_s(now_s).map_or("since the start".to_owned(), |s| format!("for {}", span(s)));
            let every = span(self.interval_s);
            reasons.bad(format!("no good frame {since}, one every {every} is expected: look at the camera"));
        }
    }
}

/// Live results as they come, and how often they should. Times since boot, s.
#[derive(Clone, Debug)]
pub(super) struct Live {
    pub results: Results,
    /// None while none is wanted.
    pub interval_s: Option<f64>,
    since_s: f64,
}

impl Live {
    /// One is expected every interval from now on.
    pub fn begin(interval_s: Option<f64>, now_s: f64) -> Self {
        Self { results: Results::of_live(), interval_s, since_s: now_s }
    }

    fn judge(&self, now_s: f64, reasons: &mut Reasons) {
        let Some(interval_s) = self.interval_s else {
            return reasons.doubtful("live frames pause: the processor is too hot".to_owned());
        };
        let every = span(interval_s);
        match self.results.age_s(now_s) {
            Some(age_s) if age_s > OLD_INTERVALS.0 * interval_s => {
                let what =
                    format!("the last live result is {} old, one every {every} is expected", span(age_s));
                reasons.add(
                    if age_s > OLD_INTERVALS.1 * interval_s { Health::Failed } else { Health::Degraded },
                    what,
                );
            }
            None if now_s > self.since_s + BEGINNING_S + OLD_INTERVALS.1 * interval_s => {
                reasons.bad(format!("no live result since the start, one every {every} is expected"));
            }
            _ => {}
        }
        shares(&self.results.recent(), "live results", reasons);
    }
}

/// What is to be said, and how bad it is.
#[derive(Default)]
struct Reasons {
    all: Vec<(Health, String)>,
}

impl Reasons {
    fn add(&mut self, health: Health, what: String) {
        self.all.push((health, what));
    }

    fn bad(&mut self, what: String) {
        self.add(Health::Failed, what);
    }

    fn doubtful(&mut self, what: String) {
        self.add(Health::Degraded, what);
    }
}

/// Of results of one kind: without numbers, rejected, skipped.
fn shares(recent: &Recent, kind: &str, reasons: &mut Reasons) {
    let results = recent.results;
    if results < MIN_RESULTS {
        return;
    }
    let count = |share: Option<f64>| (share.unwrap_or(0.0) * results as f64).round();
    let unsolved = recent.solved.map_or(0.0, |share| 1.0 - share);
    if unsolved > UNSOLVED.0 {
        let what = format!("{} of the last {results} {kind} have no numbers", count(Some(unsolved)));
        reasons.add(if unsolved > UNSOLVED.1 { Health::Failed } else { Health::Degraded }, what);
    }
    let rejected = count(recent.rejected);
    // One alone is chance.
    if rejected > 1.0 && recent.rejected.is_some_and(|share| share > REJECTED) {
        reasons
            .doubtful(format!("{rejected} of the last {results} {kind} are rejected by their global test"));
    }
    if let Some(share) = recent.skipped.filter(|share| *share > SKIPPED) {
        reasons.doubtful(format!(
            "{:.0} % of the live frames are skipped: the machine is too slow",
            100.0 * share
        ));
    }
}

/// The word and its reasons, the worst first. `series`: results of series.
pub(super) fn judge(
    status: &Status,
    (frames, series, live): (&Frames, &Results, Option<&Live>),
    now_s: f64,
) -> (Health, Vec<String>) {
    let mut reasons = Reasons::default();
    frames.judge(now_s, &mut reasons);
    if let Some(why) = &status.store.refuses {
        reasons.bad(format!("the store takes no series: {why}"));
    }
    if let Some(live) = live {
        live.judge(now_s, &mut reasons);
    }
    shares(&series.recent(), "results of series", &mut reasons);
    if let Some(fault) = status.live.as_ref().and_then(|live| live.fault.as_ref()) {
        reasons.doubtful(fault.clone());
    }
    if let Some(fault) = status.aircraft.as_ref().and_then(|aircraft| aircraft.fault.as_ref()) {
        reasons.doubtful(format!("aircraft data: {fault}"));
    }
    let health = reasons.all.iter().map(|(health, _)| *health).max().unwrap_or_default();
    // Stable: of two alike the one that was said first.
    reasons.all.sort_by_key(|(health, _)| std::cmp::Reverse(*health));
    (health, reasons.all.into_iter().map(|(_, what)| what).collect())
}

/// A span of time for people.
#[must_use]
pub fn span(seconds: f64) -> String {
    if seconds < TENTHS_S && seconds.fract() != 0.0 {
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

    /// Live at 10 Hz for ten seconds: each result solved or not, rejected or not, with so many skipped before it.
    fn live(outcome: impl Fn(u64) -> (bool, bool, u64)) -> Live {
        let mut live = Live::begin(Some(0.1), 0.0);
        for k in 1..=100 {
            let (solved, rejected, skipped) = outcome(k);
            live.results.note(0.1 * k as f64, solved, rejected, skipped);
        }
        live
    }

    fn judged(live: &Live, now_s: f64) -> (Health, String) {
        let (health, reasons) =
            judge(&Status::default(), (&Frames::default(), &Results::of_series(), Some(live)), now_s);
        (health, reasons.join("; "))
    }

    #[test]
    fn live_results_are_good_old_and_lost_by_their_intervals() {
        let well = live(|_| (true, false, 0));
        assert_eq!(judged(&well, 10.25), (Health::Ok, String::new()));
        assert_eq!(judged(&well, 10.35).0, Health::Degraded);
        let (health, why) = judged(&well, 40.0);
        assert!(
            health == Health::Failed && why.contains("the last live result is 30 s old, one every 0.1 s"),
            "{why}"
        );
        let none = Live::begin(Some(0.1), 0.0);
        assert_eq!((judged(&none, 5.0).0, judged(&none, 20.0).0), (Health::Ok, Health::Failed));
        assert_eq!(judged(&Live::begin(None, 0.0), 100.0).0, Health::Degraded);
    }

    #[test]
    fn results_without_numbers_rejected_or_skipped_are_no_good_health() {
        let (health, why) = judged(&live(|k| (k % 10 < 3, false, 0)), 10.05);
        assert!(
            health == Health::Failed && why.starts_with("70 of the last 100 live results have no"),
            "{why}"
        );
        assert_eq!(judged(&live(|k| (k % 5 > 0, false, 0)), 10.05).0, Health::Degraded);
        let (health, why) = judged(&live(|_| (true, true, 0)), 10.05);
        assert!(health == Health::Degraded && why.contains("100 of the last 100 live results are rejected"));
        let (health, why) = judged(&live(|k| (true, false, k)), 10.05);
        assert!(health == Health::Degraded && why.contains("50 % of the live frames are skipped"), "{why}");
        assert_eq!(judged(&live(|k| (k % 20 > 0, k % 20 == 1, k / 10)), 10.05).0, Health::Ok, "by chance");
    }

    #[test]
    fn faults_are_said_beside_and_the_worst_first() {
        let mut status = Status::default();
        status.store.refuses = Some("it is full".to_owned());
        status.aircraft.get_or_insert_default().fault = Some("no line for 20 s".to_owned());
        let (health, reasons) = judge(&status, (&Frames::default(), &Results::of_series(), None), 1.0);
        assert_eq!(health, Health::Failed);
        assert_eq!(reasons, ["the store takes no series: it is full", "aircraft data: no line for 20 s"]);
    }

    #[test]
    fn spans_are_short() {
        let spans = [0.05, 0.2, 5.0, 9.96, 61.0, 3700.0].map(span);
        assert_eq!(spans, ["0.050 s", "0.2 s", "5 s", "10 s", "1 min 1 s", "1 h 1 min"]);
    }
}
