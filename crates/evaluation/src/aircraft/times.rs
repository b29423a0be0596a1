//! Time tags.

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

/// Parses a time into seconds since 1970, UTC: ISO 8601, in UTC if it has no zone, or seconds since 1970.
pub(super) fn parse_time(text: &str) -> Option<f64> {
    let civil = || text.parse::<DateTime>().ok()?.to_zoned(TimeZone::UTC).ok();
    let stamp = || {
        let stamp = text.parse::<Timestamp>().ok();
        stamp.or_else(|| Some(civil()?.timestamp()))
    };
    let number = text.parse::<f64>().ok();
    let number = number.filter(|s| s.is_finite() && *s > 0.0);
    number.or_else(|| stamp().map(unix_seconds))
}

/// Converts a timestamp into seconds since 1970.
pub(super) fn unix_seconds(stamp: Timestamp) -> f64 {
    stamp.as_microsecond() as f64 * 1e-6
}

/// Formats a time for display; the number if it is beyond any calendar.
pub fn format_time(time_s: f64) -> String {
    let stamp = Timestamp::from_second(time_s.floor() as i64);
    stamp.map_or_else(|_| format!("{time_s} s"), |stamp| stamp.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_notation_of_a_time_gives_the_same_instant() {
        for text in [
            "2026-06-01T07:59:50",
            "2026-06-01T09:59:50+02:00",
            "20260601T075950Z",
            "1780300790",
        ] {
            assert_eq!(parse_time(text), Some(1_780_300_790.0), "{text}");
        }
        for text in ["", "07:59:50", "NaN", "-1", "01.06.2026 07:59:50"] {
            assert_eq!(parse_time(text), None, "{text}");
        }
    }
}
