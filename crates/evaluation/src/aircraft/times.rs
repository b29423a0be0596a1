//! Formats of time tags.

use jiff::civil::{Date, DateTime};
use jiff::tz::TimeZone;
use serde::{Deserialize, Serialize};

use wingd_base::clock::written_time::WrittenTime;

/// Format of the times in a table or feed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TimeFormat {
    /// ISO 8601 (UTC if it has no zone), or seconds since 1970.
    #[default]
    Utc,
    /// Milliseconds since 1970.
    UnixMs,
    /// Microseconds since 1970.
    UnixUs,
    /// Nanoseconds since 1970.
    UnixNs,
    /// Day numbers of a spreadsheet that begins with 1900.
    ExcelDays,
    /// Day numbers of a spreadsheet that begins with 1904.
    Excel1904Days,
    /// Day numbers of MATLAB's `datenum`, which begin with year 0.
    MatlabDays,
    /// Julian dates.
    JulianDays,
    /// Seconds since 6 January 1980, without leap seconds.
    GpsSeconds,
    /// Seconds since midnight of a given date, or `07:59:50`.
    SecondsOfDay,
    /// `20260601075950`.
    Compact,
    /// IRIG: day of the year and time, `152:07:59:50`, after the year if there is one.
    Irig,
}

/// Length of a day, s.
pub const DAY_S: f64 = 86_400.0;
/// Day number of 1 January 1970, midnight: in a spreadsheet (1 January 1900 is 1, and 1900 counts as a leap year), in one
/// that begins with 1904 (1 January 1904 is 0), in `datenum` (1 January of year 0 is 1), and as a Julian date.
const EXCEL_1970: f64 = 25_569.0;
const EXCEL1904_1970: f64 = 24_107.0;
const MATLAB_1970: f64 = 719_529.0;
const JULIAN_1970: f64 = 2_440_587.5;
/// Time from 1 January 1970 to 6 January 1980, the origin of GPS time (IS-GPS-200), s.
const GPS_EPOCH_S: f64 = 315_964_800.0;
/// GPS time minus UTC since 1 January 2017 (IERS Bulletin C 52; no leap second since), s.
const GPS_LESS_UTC_S: f64 = 18.0;
/// GPS time of 1 January 2017, s; the difference to UTC was smaller before.
const GPS_2017_S: f64 = 1_167_264_018.0;

impl TimeFormat {
    /// Converts a time into seconds since 1970, UTC. `date` is that of [`TimeFormat::SecondsOfDay`], its year that of
    /// [`TimeFormat::Irig`] without one; `zone_s` is the offset from UTC of times of a calendar that have no zone, s. `None`
    /// if the text does not have this format.
    pub fn seconds(self, text: &str, date: Option<Date>, zone_s: f64) -> Option<f64> {
        let number = || {
            text.parse::<f64>()
                .ok()
                .filter(|s| s.is_finite() && *s >= 0.0)
        };
        let days = |of_1970: f64| {
            number()
                .filter(|n| *n >= of_1970)
                .map(|n| (n - of_1970) * DAY_S - zone_s)
        };
        match self {
            Self::Utc => number()
                .filter(|s| *s > 0.0)
                .or_else(|| parse_iso(text, zone_s))
                .or_else(|| day_of_year(text, None).map(|s| s - zone_s)),
            Self::UnixMs => number().map(|n| n * 1e-3),
            Self::UnixUs => number().map(|n| n * 1e-6),
            Self::UnixNs => number().map(|n| n * 1e-9),
            Self::ExcelDays => days(EXCEL_1970),
            Self::Excel1904Days => days(EXCEL1904_1970),
            Self::MatlabDays => days(MATLAB_1970),
            Self::JulianDays => days(JULIAN_1970),
            Self::GpsSeconds => number()
                .filter(|n| *n >= GPS_2017_S)
                .map(|n| n + GPS_EPOCH_S - GPS_LESS_UTC_S),
            Self::SecondsOfDay => {
                let of_day = number()
                    .filter(|n| *n <= MAX_SECONDS_OF_DAY)
                    .or_else(|| time_of_day(text));
                of_day
                    .map(|n| n - zone_s)
                    .zip(midnight_s(date?))
                    .map(|(n, midnight)| n + midnight)
            }
            Self::Compact => {
                let (day, time) = text.split_at_checked(8)?;
                let digits = day.bytes().all(|b| b.is_ascii_digit()) && time.len() >= 6;
                digits.then(|| parse_iso(&format!("{day}T{time}"), zone_s))?
            }
            Self::Irig => day_of_year(text, date.map(Date::year)).map(|s| s - zone_s),
        }
    }
}

/// Largest second of a day: files of several days count on after midnight (ICARTT, section 2.3.1 of its standard).
const MAX_SECONDS_OF_DAY: f64 = 4.0 * DAY_S;

/// Returns the midnight with which a day begins, seconds since 1970, UTC.
fn midnight_s(date: Date) -> Option<f64> {
    date.to_zoned(TimeZone::UTC)
        .ok()
        .map(|midnight| unix_seconds(midnight.timestamp()))
}

/// Parses a day of the year with a time: `2026:152:07:59:50.0`, `2026-152T07:59:50Z`, and `152:07:59:50` in a known year.
fn day_of_year(text: &str, year: Option<i16>) -> Option<f64> {
    // Colons separate at least the time of the day: of a date with months, a lost one would make a day of the year.
    let (before, second) = text.trim_end_matches(['Z', 'z']).rsplit_once(':')?;
    let (before, minute) = before.rsplit_once(':')?;
    let parts: Vec<&str> = before.split([':', ' ', '-', '/', 'T']).collect();
    let (year, [day, hour]) = match parts[..] {
        [day, hour] => (year?, [day, hour]),
        [year, day, hour] if year.len() == 4 => (year.parse().ok()?, [day, hour]),
        _ => return None,
    };
    let whole = |text: &str, low: u16, high: u16| {
        text.parse().ok().filter(|n: &u16| (low..=high).contains(n))
    };
    let (day, hour, minute) = (
        whole(day, 1, 366)?,
        whole(hour, 0, 23)?,
        whole(minute, 0, 59)?,
    );
    let second = second
        .parse::<f64>()
        .ok()
        .filter(|s| (0.0..61.0).contains(s))?;
    let begin = midnight_s(Date::new(year, 1, 1).ok()?)?;
    Some(
        begin
            + DAY_S * f64::from(day - 1)
            + 3600.0 * f64::from(hour)
            + 60.0 * f64::from(minute)
            + second,
    )
}

/// Parses a date: `2026-06-01`, `2026/06/01`, `20260601`, or `2026-152` by the day of the year.
pub(super) fn parse_date(text: &str) -> Option<Date> {
    let midnight = format!("{text} 00:00:00");
    let calendar = WrittenTime::find(&midnight, 1950)
        .filter(|_| text.len() <= 10)
        .map(|time| time.local.date());
    calendar.or_else(|| {
        let begin = jiff::Timestamp::from_second(day_of_year(&midnight, None)? as i64).ok()?;
        Some(begin.to_zoned(TimeZone::UTC).date())
    })
}

/// Parses ISO 8601; without a zone of its own at an offset from UTC, s.
fn parse_iso(text: &str, zone_s: f64) -> Option<f64> {
    let utc = |civil: DateTime| civil.to_zoned(TimeZone::UTC).map(|z| z.timestamp());
    let stamp = text.parse::<jiff::Timestamp>().ok().map(unix_seconds);
    stamp.or_else(|| {
        utc(text.parse::<DateTime>().ok()?)
            .ok()
            .map(|civil| unix_seconds(civil) - zone_s)
    })
}

/// Parses a time of day such as `07:59:50` into seconds since midnight.
fn time_of_day(text: &str) -> Option<f64> {
    let time = text
        .parse::<jiff::civil::Time>()
        .ok()
        .filter(|_| text.get(2..3) == Some(":"))?;
    Some(
        time.duration_since(jiff::civil::Time::midnight())
            .as_secs_f64(),
    )
}

/// Converts a timestamp into seconds since 1970.
pub(super) fn unix_seconds(stamp: jiff::Timestamp) -> f64 {
    stamp.as_microsecond() as f64 * 1e-6
}

/// Formats a time for display; the number if it is beyond any calendar.
pub fn format_time(time_s: f64) -> String {
    let stamp = jiff::Timestamp::from_second(time_s.floor() as i64);
    stamp.map_or_else(|_| format!("{time_s} s"), |stamp| stamp.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2026-06-01T07:59:50Z.
    const BEGIN_S: f64 = 1_780_300_790.0;

    #[test]
    fn every_notation_of_a_time_gives_the_same_instant() {
        let date = Some("2026-06-01".parse().unwrap());
        for (format, text, within_s) in [
            (TimeFormat::Utc, "2026-06-01T07:59:50", 0.0),
            (TimeFormat::Utc, "2026-06-01T09:59:50+02:00", 0.0),
            (TimeFormat::Utc, "1780300790", 0.0),
            (TimeFormat::UnixMs, "1780300790000", 0.0),
            (TimeFormat::UnixUs, "1780300790000000", 0.0),
            (TimeFormat::UnixNs, "1780300790000000000", 0.0),
            (TimeFormat::ExcelDays, "46174.333218", 0.1),
            (TimeFormat::Excel1904Days, "44712.333218", 0.1),
            (TimeFormat::MatlabDays, "740134.333218", 0.1),
            (TimeFormat::JulianDays, "2461192.833218", 0.1),
            (TimeFormat::SecondsOfDay, "07:59:50", 0.0),
            (TimeFormat::SecondsOfDay, "07:59:50.000", 0.0),
            (TimeFormat::GpsSeconds, "1464336008", 0.0),
            (TimeFormat::SecondsOfDay, "28790.0", 0.0),
            (TimeFormat::Compact, "20260601075950", 0.0),
            (TimeFormat::Irig, "152:07:59:50.000", 0.0),
            (TimeFormat::Irig, "2026:152:07:59:50.000", 0.0),
            (TimeFormat::Utc, "2026-152T07:59:50Z", 0.0),
        ] {
            let found = format.seconds(text, date, 0.0).unwrap();
            assert!(
                (found - BEGIN_S).abs() <= within_s,
                "{format:?} {text}: {}",
                found - BEGIN_S
            );
            let local = format
                .seconds(text, date, 3600.0)
                .map(|s| (s - found).round());
            let civil =
                !text.contains('+') && (text.contains([':', '.']) && !text.starts_with("28790"));
            assert!(
                !civil || local == Some(-3600.0),
                "{format:?} {text}: {local:?}"
            );
        }
        assert_eq!(TimeFormat::SecondsOfDay.seconds("28790", None, 0.0), None);
        assert_eq!(
            TimeFormat::SecondsOfDay.seconds("115190", Some("2026-05-31".parse().unwrap()), 0.0),
            Some(BEGIN_S)
        );
        assert_eq!(
            TimeFormat::SecondsOfDay.seconds("2026-06-02T07:59:50", date, 0.0),
            None
        );
        assert_eq!(TimeFormat::GpsSeconds.seconds("1", None, 0.0), None);
        assert_eq!(
            TimeFormat::Compact.seconds("2026060107595", None, 0.0),
            None
        );
        assert_eq!(TimeFormat::Irig.seconds("152:07:59:50", None, 0.0), None);
        for text in ["2026-06-01", "2026/06/01", "20260601", "2026-152"] {
            assert_eq!(parse_date(text), date, "{text}");
        }
        assert_eq!(
            (parse_date("17"), parse_date("07:59:50"), parse_date("0.78")),
            (None, None, None)
        );
    }
}
