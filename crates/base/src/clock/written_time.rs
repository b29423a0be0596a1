//! Times as devices and people write them: in metadata of images, file names and lists.

use jiff::civil::DateTime;
use jiff::tz::{Offset, TimeZone};
use jiff::{SpanRound, Timestamp, Unit};

/// Date and time found in a text.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrittenTime {
    /// Date and time in the zone of the writer.
    pub local: DateTime,
    /// Number of digits of the fraction of a second: 0 for whole seconds.
    pub digits: u32,
    /// Zone, if the text has one.
    pub offset: Option<Offset>,
}

/// Maximum number of digits of a fraction of a second: nanoseconds.
const MAX_DIGITS: usize = 9;
/// Range of a number that counts as seconds since 1970: the years 2001, when it got its tenth digit, to 2099.
const UNIX_SECONDS: std::ops::Range<i64> = 1_000_000_000..4_102_444_800;

impl WrittenTime {
    /// Finds the first time in a text: date and time with or without separators, from a year on, or 10, 13, 16 or 19 digits
    /// that count from 1970 in seconds to nanoseconds.
    pub fn find(text: &str, first_year: i16) -> Option<Self> {
        let bytes = text.as_bytes();
        let begins =
            |k: &usize| bytes[*k].is_ascii_digit() && (*k == 0 || !bytes[*k - 1].is_ascii_digit());
        (0..bytes.len()).filter(begins).find_map(|k| {
            let rest = text.get(k..)?;
            read_calendar(rest, first_year).or_else(|| read_unix(rest))
        })
    }

    /// Returns the time in UTC; a time without a zone is in `zone`.
    pub fn timestamp(&self, zone: Offset) -> Option<Timestamp> {
        self.offset.unwrap_or(zone).to_timestamp(self.local).ok()
    }

    /// Adds a fraction of a second given by its digits, unless the time has one.
    pub fn with_fraction(self, digits: &str) -> Self {
        let count = digits.len().min(MAX_DIGITS);
        let finer =
            nanoseconds(digits).and_then(|n| self.local.with().subsec_nanosecond(n).build().ok());
        match finer {
            Some(local) if self.digits == 0 => Self {
                local,
                digits: count as u32,
                ..self
            },
            _ => self,
        }
    }
}

/// Returns the digits at the beginning of a text.
fn leading_digits(text: &str) -> &str {
    &text[..text.bytes().take_while(u8::is_ascii_digit).count()]
}

/// Converts digits after the decimal point of a second.
fn nanoseconds(digits: &str) -> Option<i32> {
    let digits = digits
        .get(..digits.len().min(MAX_DIGITS))
        .filter(|d| !d.is_empty() && leading_digits(d) == *d)?;
    format!("{digits:0<MAX_DIGITS$}").parse().ok()
}

/// Removes a number of this many digits from the beginning of a text.
fn take_number<T: std::str::FromStr>(rest: &mut &str, digits: usize) -> Option<T> {
    let (number, behind) = rest.split_at_checked(digits)?;
    let number = Some(number)
        .filter(|n| leading_digits(n) == *n)?
        .parse()
        .ok()?;
    *rest = behind;
    Some(number)
}

/// Removes the first character if it is one of `any`.
fn take_sign(rest: &mut &str, any: &str) -> Option<char> {
    let sign = rest.chars().next().filter(|c| any.contains(*c))?;
    *rest = &rest[sign.len_utf8()..];
    Some(sign)
}

/// Reads date and time at the beginning of a text: `2026:06:01 10:00:00.25+02:00`, `20260601T080000Z`, `20260601080000`.
fn read_calendar(text: &str, first_year: i16) -> Option<WrittenTime> {
    let mut rest = text;
    let year = take_number(&mut rest, 4).filter(|year| (first_year..2100).contains(year))?;
    let separated = take_sign(&mut rest, ":-/._");
    let month = take_number(&mut rest, 2)?;
    if separated.is_some() && take_sign(&mut rest, ":-/._") != separated {
        return None;
    }
    let day = take_number(&mut rest, 2)?;
    let iso = take_sign(&mut rest, "T _-").is_some_and(|sign| sign == 'T');
    let hour = take_number(&mut rest, 2)?;
    let separated = take_sign(&mut rest, ":-._");
    let minute = take_number(&mut rest, 2)?;
    if separated.is_some() && take_sign(&mut rest, ":-._") != separated {
        return None;
    }
    let second = take_number(&mut rest, 2)?;
    let point = take_sign(&mut { rest }, ".,")
        .filter(|_| rest[1..].starts_with(|c: char| c.is_ascii_digit()));
    let fraction = leading_digits(&rest[usize::from(point.is_some())..]);
    // A counter without a point between it and the seconds would be far longer.
    if point.is_none() && fraction.len() > MAX_DIGITS {
        return None;
    }
    let rest = &rest[usize::from(point.is_some()) + fraction.len()..];
    let local = DateTime::new(year, month, day, hour, minute, second, 0).ok()?;
    let time = WrittenTime {
        local,
        digits: 0,
        offset: zone_at(rest, iso),
    };
    Some(time.with_fraction(fraction))
}

/// Reads the zone behind a time. A counter may follow the time of a name: without `T` the zone needs its colon.
fn zone_at(text: &str, iso: bool) -> Option<Offset> {
    let text = text.trim_start();
    let length = text
        .find(|c: char| !c.is_ascii_alphanumeric() && !"+-:".contains(c))
        .unwrap_or(text.len());
    let zone = &text[..length];
    let offset = parse_offset(zone)?;
    (iso || zone.contains(':') || !zone.starts_with('-')).then_some(offset)
}

/// Reads a number that counts from 1970 at the beginning of a text.
fn read_unix(text: &str) -> Option<WrittenTime> {
    let number = leading_digits(text);
    let (seconds, mut fraction) = number.split_at_checked(10)?;
    let seconds = seconds.parse().ok().filter(|s| UNIX_SECONDS.contains(s))?;
    match fraction.len() {
        0 => {
            let behind = leading_digits(text[10..].trim_start_matches(['.', ',', '_', '-']));
            let pointed = text[10..].starts_with(['.', ',']);
            fraction = if pointed || [6, MAX_DIGITS].contains(&behind.len()) {
                behind
            } else {
                ""
            };
        }
        3 | 6 | MAX_DIGITS => {}
        _ => return None,
    }
    let local = Timestamp::from_second(seconds)
        .ok()?
        .to_zoned(TimeZone::UTC)
        .datetime();
    Some(
        WrittenTime {
            local,
            digits: 0,
            offset: Some(Offset::UTC),
        }
        .with_fraction(fraction),
    )
}

/// Parses a zone as written in metadata, names and by people: `+02:00`, `-0330`, `+2`, `Z`, `UTC+2`.
pub fn parse_offset(text: &str) -> Option<Offset> {
    let text = text.trim();
    let bare = ["UTC", "GMT"]
        .iter()
        .find_map(|name| text.strip_prefix(name));
    let text = bare.unwrap_or(text).trim_start();
    if text.eq_ignore_ascii_case("z") || bare == Some("") {
        return Some(Offset::UTC);
    }
    let sign = text.chars().next()?;
    let rest = text.strip_prefix(['+', '-', '\u{2212}'])?;
    let compact = if rest.len() == 4 {
        rest.split_at_checked(2)
    } else {
        None
    };
    let (hours, minutes) = rest.split_once(':').or(compact).unwrap_or((rest, "0"));
    let number = |t: &str| {
        t.parse::<i32>()
            .ok()
            .filter(|_| t.len() <= 2 && leading_digits(t) == t)
    };
    let (hours, minutes) = (number(hours)?, number(minutes)?);
    let seconds = 3600 * hours + 60 * minutes;
    let sound = hours <= 14 && minutes < 60;
    Offset::from_seconds(if sign == '+' { seconds } else { -seconds })
        .ok()
        .filter(|_| sound)
}

/// Formats an offset from UTC as `+02:00`.
pub fn offset_text(offset: Offset) -> String {
    let minutes = offset.seconds() / 60;
    format!(
        "{}{:02}:{:02}",
        if minutes < 0 { '-' } else { '+' },
        minutes.abs() / 60,
        minutes.abs() % 60
    )
}

/// Formats a duration for messages, such as `5h` or `3653d 2h 10s`.
pub fn duration_text(seconds: f64) -> String {
    let span =
        jiff::SignedDuration::try_from_secs_f64(seconds.abs()).and_then(jiff::Span::try_from);
    let rounded = span.and_then(|span| {
        let options = SpanRound::new()
            .largest(Unit::Day)
            .smallest(Unit::Millisecond)
            .days_are_24_hours();
        span.round(options)
    });
    rounded.map_or_else(|_| format!("{seconds} s"), |span| format!("{span:#}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_metadata_names_and_lists_are_found() {
        for (text, utc, digits) in [
            ("2026:06:01 10:00:00", "2026-06-01T10:00:00Z", 0),
            (
                "2026-06-01 10:00:00.250+02:00",
                "2026-06-01T08:00:00.25Z",
                3,
            ),
            ("2026/06/01 10:00:00Z", "2026-06-01T10:00:00Z", 0),
            ("cam_20260601T080000.250Z", "2026-06-01T08:00:00.25Z", 3),
            ("20260601T030000-0500", "2026-06-01T08:00:00Z", 0),
            ("IMG_20260601_080000_001", "2026-06-01T08:00:00Z", 0),
            ("left-2026-06-01_08-00-00-07", "2026-06-01T08:00:00Z", 0),
            ("PXL_20260601_080000250", "2026-06-01T08:00:00.25Z", 3),
            ("20260601080000", "2026-06-01T08:00:00Z", 0),
            ("1780300800250000000", "2026-06-01T08:00:00.25Z", 9),
            ("frame_1780300800250", "2026-06-01T08:00:00.25Z", 3),
            ("1780300800.25", "2026-06-01T08:00:00.25Z", 2),
            ("1780300800-250000000", "2026-06-01T08:00:00.25Z", 9),
        ] {
            let found = WrittenTime::find(text, 1990).unwrap();
            assert_eq!(
                found.timestamp(Offset::UTC),
                Some(utc.parse().unwrap()),
                "{text}"
            );
            assert_eq!(found.digits, digits, "{text}");
        }
        for text in [
            "IMG_0001",
            "IMG-20260601-WA0001",
            "0000:00:00 00:00:00",
            "20261301_080000",
            "99999999999999",
            "",
        ] {
            assert_eq!(WrittenTime::find(text, 1990), None, "{text}");
        }
    }

    #[test]
    fn offsets_are_read_in_every_spelling() {
        for (text, seconds) in [
            ("+05:45", Some(20_700)),
            ("-03:30", Some(-12_600)),
            ("Z", Some(0)),
            ("+2", Some(7200)),
            ("+0200", Some(7200)),
            ("UTC+2", Some(7200)),
            ("GMT", Some(0)),
        ] {
            assert_eq!(parse_offset(text).map(Offset::seconds), seconds, "{text}");
        }
        for odd in [
            "", "02:00", "+aa:00", "+02:75", "+99:00", "   :  ", "+-1:00",
        ] {
            assert_eq!(parse_offset(odd), None, "{odd}");
        }
        assert_eq!(
            (
                offset_text(Offset::from_seconds(-12_600).unwrap()),
                duration_text(-3600.0)
            ),
            ("-03:30".into(), "1h".into())
        );
    }

    proptest::proptest! {
        #[test]
        fn any_text_is_searched_without_a_panic(text in "[0-9T:+ .\u{e4}Z-]{0,40}") {
            let _ = WrittenTime::find(&text, 1990);
        }
    }
}
