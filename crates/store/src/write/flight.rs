//! Rule for the beginning of a new flight.
//!
//! A flight is the period between two pauses. The rule must keep a flight together through restarts of the daemon and power
//! cuts in the air, and must not merge two flights, because their frames may be adjusted together. It uses the time since
//! the last recorded shot:
//!
//! - same boot: time since boot, which nothing can set;
//! - another boot: at least the time since this boot has passed; UTC gives the rest if it advanced. The
//!   synchronised flag is ignored: in the air there is no time server, and a machine with a battery clock is
//!   correct without one;
//! - another boot and UTC went back (no battery clock): the pause is unknown and a new flight begins: a flight in
//!   two folders can be merged, two flights in one are hard to separate.

use std::time::Duration;

use crate::config::BootPolicy;
use wingd_base::clock::Stamp;

/// Returns the reason for a new flight at `now`, or `None` if the last one continues.
pub fn new_flight_reason(
    last: Option<&Stamp>,
    now: &Stamp,
    after: Duration,
    at_boot: BootPolicy,
) -> Option<String> {
    let Some(last) = last else {
        return Some("first series of the store".to_owned());
    };
    if last.boot_id == now.boot_id {
        return long_pause_reason(now.since_boot_s - last.since_boot_s, after);
    }
    match at_boot {
        BootPolicy::Always => return Some("the machine was switched on".to_owned()),
        BootPolicy::Never => return None,
        BootPolicy::ByClock => {}
    }
    let by_utc_s = now.utc.duration_since(last.utc).as_secs_f64();
    if by_utc_s < 0.0 {
        return Some(
            "the machine was switched on and its clock went back: the pause is unknown".to_owned(),
        );
    }
    long_pause_reason(by_utc_s.max(now.since_boot_s), after)
}

fn long_pause_reason(pause_s: f64, after: Duration) -> Option<String> {
    (pause_s > after.as_secs_f64()).then(|| format!("no shot for {:.1} h", pause_s / 3600.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    const AFTER: Duration = Duration::from_secs(3 * 3600);

    fn stamp(utc: &str, boot: &str, since_boot_s: f64) -> Stamp {
        Stamp {
            utc: utc.parse().unwrap(),
            utc_synchronised: false,
            boot_id: boot.to_owned(),
            since_boot_s,
        }
    }

    #[test]
    fn a_restart_or_power_cut_in_the_air_continues_the_flight() {
        let last = stamp("2026-03-01T10:00:00Z", "a", 7200.0);
        let restarted = stamp("2026-03-01T10:50:00Z", "a", 10200.0);
        let rebooted = stamp("2026-03-01T10:20:00Z", "b", 25.0);
        assert_eq!(
            new_flight_reason(Some(&last), &restarted, AFTER, BootPolicy::ByClock),
            None
        );
        assert_eq!(
            new_flight_reason(Some(&last), &rebooted, AFTER, BootPolicy::ByClock),
            None
        );
        assert!(new_flight_reason(Some(&last), &rebooted, AFTER, BootPolicy::Always).is_some());
    }

    #[test]
    fn a_night_on_the_ground_begins_a_new_flight() {
        let last = stamp("2026-03-01T18:00:00Z", "a", 7200.0);
        let next_day = stamp("2026-03-02T06:00:00Z", "b", 25.0);
        let left_on = stamp("2026-03-02T06:00:00Z", "a", 50400.0);
        for now in [&next_day, &left_on] {
            assert!(new_flight_reason(Some(&last), now, AFTER, BootPolicy::ByClock).is_some());
        }
        assert_eq!(
            new_flight_reason(Some(&last), &next_day, AFTER, BootPolicy::Never),
            None
        );
    }

    #[test]
    fn a_clock_without_battery_cannot_join_flights() {
        let last = stamp("2026-03-01T18:00:00Z", "a", 7200.0);
        let reset = stamp("1970-01-01T00:00:25Z", "b", 25.0);
        assert!(new_flight_reason(Some(&last), &reset, AFTER, BootPolicy::ByClock).is_some());
        let stuck = stamp("1970-01-01T00:00:30Z", "c", 4.0 * 3600.0);
        assert!(new_flight_reason(Some(&reset), &stuck, AFTER, BootPolicy::ByClock).is_some());
    }

    #[test]
    fn a_jump_of_utc_within_a_boot_has_no_effect() {
        let last = stamp("1970-01-01T00:10:00Z", "a", 600.0);
        let synced = stamp("2026-03-01T18:00:00Z", "a", 4200.0);
        assert_eq!(
            new_flight_reason(Some(&last), &synced, AFTER, BootPolicy::ByClock),
            None
        );
    }
}
