//! Decides, as a pure function of state and time, whether a series is due.

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// Alignment of the series.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Align {
    /// The first series begins at once, the others follow at the interval.
    #[default]
    Start,
    /// Series begin at whole multiples of the interval in UTC, for example every full hour.
    Clock,
}

/// Configured timetable of the series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timetable {
    /// Time from the beginning of one series to the beginning of the next.
    pub interval: Duration,
    pub align: Align,
    /// The daemon ends if the next series would begin later than this after the origin.
    pub until: Option<Duration>,
}

/// A moment by the two clocks that the schedule uses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    pub since_boot: Duration,
    /// UTC, seconds since 1970.
    pub utc_s: f64,
}

/// Progress of the schedule. A slot is a numbered interval; each gets one series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Time since boot from which the slots of `Align::Start` count.
    pub origin: Duration,
    /// The last slot that got its series.
    pub last_slot: Option<i64>,
}

/// Next action of the schedule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ScheduleAction {
    /// Begin a series for this slot.
    Begin(i64),
    /// Wait for this time.
    Wait(Duration),
    /// The timetable has ended.
    Over,
}

impl Progress {
    /// Starts at `now`; with `Align::Clock` the current slot is skipped.
    pub fn start(timetable: &Timetable, now: Moment) -> Self {
        let progress = Self {
            origin: now.since_boot,
            last_slot: None,
        };
        let last_slot = match timetable.align {
            Align::Start => None,
            Align::Clock => Some(slot_number_at(timetable, &progress, now)),
        };
        Self {
            last_slot,
            ..progress
        }
    }

    /// Continues within one boot after a restart; `first` and `last` are the times since boot at which series began.
    pub fn resume(timetable: &Timetable, first: Duration, last: Duration, now: Moment) -> Self {
        let progress = Self {
            origin: first,
            last_slot: None,
        };
        let of_last = match timetable.align {
            Align::Start => slot_number_at(
                timetable,
                &progress,
                Moment {
                    since_boot: last,
                    ..now
                },
            ),
            Align::Clock => slot_number_at(timetable, &progress, now),
        };
        Self {
            last_slot: Some(of_last),
            ..progress
        }
    }
}

fn slot_number_at(timetable: &Timetable, progress: &Progress, now: Moment) -> i64 {
    (seconds_since_origin(timetable, progress, now) / interval_s(timetable)).floor() as i64
}

fn seconds_since_origin(timetable: &Timetable, progress: &Progress, now: Moment) -> f64 {
    match timetable.align {
        Align::Start => now.since_boot.saturating_sub(progress.origin).as_secs_f64(),
        Align::Clock => now.utc_s,
    }
}

fn interval_s(timetable: &Timetable) -> f64 {
    timetable.interval.as_secs_f64().max(1e-3)
}

/// Returns whether to take a series now or wait. A due slot without a series gets one, even if late; missed slots are
/// dropped, so that a long stop is not followed by a burst. If UTC is set back (`Align::Clock`), the series continue
/// with the next slot of the new time; the returned progress reflects this.
pub fn next_action(
    timetable: &Timetable,
    mut progress: Progress,
    now: Moment,
) -> (ScheduleAction, Progress) {
    let present = slot_number_at(timetable, &progress, now);
    if progress.last_slot.is_some_and(|last| last > present) {
        progress.last_slot = Some(present);
    }
    let due = progress.last_slot.is_none_or(|last| last < present);
    let wait_s = match due {
        true => 0.0,
        false => {
            (present + 1) as f64 * interval_s(timetable)
                - seconds_since_origin(timetable, &progress, now)
        }
    };
    let wait = Duration::try_from_secs_f64(wait_s.max(0.0)).unwrap_or(timetable.interval);
    let begins_after = now.since_boot.saturating_sub(progress.origin) + wait;
    let next = match timetable.until {
        Some(until) if begins_after > until => ScheduleAction::Over,
        _ if due => ScheduleAction::Begin(present),
        // Never zero: rounding must not make the caller spin.
        _ => ScheduleAction::Wait(wait.max(Duration::from_millis(1))),
    };
    (next, progress)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: Duration = Duration::from_secs(3600);

    fn timetable(align: Align, until: Option<Duration>) -> Timetable {
        Timetable {
            interval: HOUR,
            align,
            until,
        }
    }

    fn moment(since_boot_s: f64, utc_s: f64) -> Moment {
        Moment {
            since_boot: Duration::from_secs_f64(since_boot_s),
            utc_s,
        }
    }

    /// Runs a timetable and returns the times at which its series began, s since boot.
    fn run(timetable: &Timetable, series_s: f64, mut now: Moment) -> Vec<f64> {
        let mut progress = Progress::start(timetable, now);
        let mut began = Vec::new();
        while began.len() < 20 {
            let (next, state) = next_action(timetable, progress, now);
            progress = state;
            let passes = match next {
                ScheduleAction::Over => break,
                ScheduleAction::Wait(wait) => wait.as_secs_f64(),
                ScheduleAction::Begin(slot) => {
                    began.push(now.since_boot.as_secs_f64());
                    progress.last_slot = Some(slot);
                    series_s
                }
            };
            now = moment(now.since_boot.as_secs_f64() + passes, now.utc_s + passes);
        }
        began
    }

    #[test]
    fn series_aligned_to_the_start_begin_at_once_and_end_before_the_end() {
        let began = run(
            &timetable(Align::Start, Some(HOUR * 8 + HOUR / 2)),
            25.0,
            moment(30.0, 0.0),
        );
        let expected: Vec<f64> = (0..9).map(|k| 30.0 + 3600.0 * f64::from(k)).collect();
        assert_eq!(began, expected);
    }

    #[test]
    fn series_aligned_to_the_clock_are_at_full_hours() {
        let began = run(
            &timetable(Align::Clock, Some(HOUR * 4)),
            25.0,
            moment(30.0, 7200.0 + 600.0),
        );
        let full_hours: Vec<f64> = (0..4)
            .map(|k| 30.0 + 3000.0 + 3600.0 * f64::from(k))
            .collect();
        assert_eq!(began.len(), 4);
        for (began, full_hour) in began.iter().zip(full_hours) {
            assert!((began - full_hour).abs() < 0.01, "{began} {full_hour}");
        }
    }

    #[test]
    fn a_series_longer_than_the_interval_is_not_followed_by_a_burst() {
        let began = run(
            &timetable(Align::Start, Some(HOUR * 10)),
            2.5 * 3600.0,
            moment(0.0, 0.0),
        );
        assert_eq!(began, [0.0, 9000.0, 18000.0, 27000.0, 36000.0]);
    }

    #[test]
    fn a_clock_set_forward_or_back_does_not_stop_the_series() {
        let table = timetable(Align::Clock, None);
        let at_1970 = moment(60.0, 60.0);
        let progress = Progress::start(&table, at_1970);
        let synced = moment(100.0, 1.8e9);
        assert!(matches!(
            next_action(&table, progress, synced).0,
            ScheduleAction::Begin(_)
        ));
        let progress = Progress::start(&table, synced);
        let (what, _) = next_action(&table, progress, moment(200.0, 100.0));
        assert_eq!(what, ScheduleAction::Wait(Duration::from_secs(3500)));
    }

    #[test]
    fn after_a_restart_the_same_slot_is_not_taken_again() {
        let table = timetable(Align::Start, None);
        let seconds = Duration::from_secs;
        let now = moment(30.0 + 3600.0 + 700.0, 0.0);
        let progress = Progress::resume(&table, seconds(30), seconds(30 + 3600), now);
        assert_eq!(
            next_action(&table, progress, now).0,
            ScheduleAction::Wait(seconds(2900))
        );
        let missed = moment(30.0 + 2.0 * 3600.0 + 600.0, 0.0);
        assert_eq!(
            next_action(&table, progress, missed).0,
            ScheduleAction::Begin(2)
        );
    }
}
