//! Capture metadata of an image: time by the camera's own clock, and camera settings.

use exif::{Exif, In, Reader, Tag, Value};
use jiff::civil::DateTime;
use jiff::tz::Offset;

/// Capture metadata of an image.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct CaptureMetadata {
    /// Time of the camera's clock in the camera's zone, with fractions of a second if given.
    pub local_time: Option<DateTime>,
    /// Number of digits of the fraction of a second: 0 for whole seconds.
    pub subsecond_digits: u32,
    /// Time zone of the camera, if given.
    pub offset: Option<Offset>,
    /// Camera and exposure settings, by name, as text.
    pub settings: Vec<(&'static str, String)>,
}

/// Tags that are kept, by name.
const SETTINGS: [(&str, Tag); 8] = [
    ("make", Tag::Make),
    ("model", Tag::Model),
    ("serial_number", Tag::BodySerialNumber),
    ("exposure_time", Tag::ExposureTime),
    ("f_number", Tag::FNumber),
    ("iso", Tag::PhotographicSensitivity),
    ("focal_length", Tag::FocalLength),
    ("orientation", Tag::Orientation),
];

/// Maximum number of digits of a fraction of a second: nanoseconds.
const MAX_TIME_DIGITS: usize = 9;

fn read_exif(bytes: &[u8]) -> Option<Exif> {
    Reader::new().read_from_container(&mut std::io::Cursor::new(bytes)).ok()
}

fn ascii_value(exif: &Exif, tag: Tag) -> Option<&str> {
    let Value::Ascii(texts) = &exif.get_field(tag, In::PRIMARY)?.value else { return None };
    Some(std::str::from_utf8(texts.first()?).ok()?.trim())
}

fn original_time(exif: &Exif) -> Option<DateTime> {
    DateTime::strptime("%Y:%m:%d %H:%M:%S", ascii_value(exif, Tag::DateTimeOriginal)?).ok()
}

/// Reads `DateTimeOriginal` of a JPEG file: whole seconds in an unknown zone. `None` if there is none.
pub fn capture_time(bytes: &[u8]) -> Option<DateTime> {
    original_time(&read_exif(bytes)?)
}

/// Reads time and settings of a JPEG, PNG or TIFF file: `DateTimeOriginal` with `SubSecTimeOriginal` and
/// `OffsetTimeOriginal` (Exif 2.31). Empty if there are none.
pub fn read_metadata(bytes: &[u8]) -> CaptureMetadata {
    let Some(exif) = read_exif(bytes) else { return CaptureMetadata::default() };
    let parts = ascii_value(&exif, Tag::SubSecTimeOriginal).filter(|t| t.bytes().all(|b| b.is_ascii_digit()));
    let parts = parts.filter(|t| !t.is_empty()).map(|t| &t[..t.len().min(MAX_TIME_DIGITS)]);
    let nanoseconds = parts.and_then(|t| format!("{t:0<MAX_TIME_DIGITS$}").parse().ok());
    let local = original_time(&exif).map(|whole| {
        let finer = nanoseconds.and_then(|n| whole.with().subsec_nanosecond(n).build().ok());
        finer.unwrap_or(whole)
    });
    let setting = |(name, tag): &(&'static str, Tag)| {
        let field = exif.get_field(*tag, In::PRIMARY)?;
        let text = field.display_value().with_unit(&exif).to_string();
        let text = text.trim_matches(|c: char| c == '"' || c.is_whitespace()).to_owned();
        (!text.is_empty()).then_some((*name, text))
    };
    CaptureMetadata {
        local_time: local,
        subsecond_digits: parts.map_or(0, |t| t.len() as u32),
        offset: ascii_value(&exif, Tag::OffsetTimeOriginal).and_then(parse_offset),
        settings: SETTINGS.iter().filter_map(setting).collect(),
    }
}

/// Parses a zone as written by Exif and people: `+02:00`, `-03:30`, `Z`.
pub fn parse_offset(text: &str) -> Option<Offset> {
    if text == "Z" {
        return Some(Offset::UTC);
    }
    let (sign, rest) = match text.split_at_checked(1)? {
        ("+", rest) => (1, rest),
        ("-", rest) => (-1, rest),
        _ => return None,
    };
    let (hours, minutes) = rest.split_once(':').unwrap_or((rest, "0"));
    let number = |t: &str| t.parse::<i32>().ok().filter(|_| t.len() <= 2 && t.bytes().all(|b| b.is_ascii_digit()));
    let (hours, minutes) = (number(hours)?, number(minutes)?);
    let sound = hours <= 14 && minutes < 60;
    Offset::from_seconds(sign * (3600 * hours + 60 * minutes)).ok().filter(|_| sound)
}

/// Returns the camera's clock less UTC, s: the zone, the camera's error, and up to a second.
pub fn camera_clock_offset_s(bytes: &[u8], utc: jiff::Timestamp) -> Option<f64> {
    let read = capture_time(bytes)?.to_zoned(jiff::tz::TimeZone::UTC).ok()?.timestamp();
    Some(read.duration_since(utc).as_secs_f64())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Builds the smallest file with the tag: SOI, APP1 with an Exif block, EOI.
    fn picture(text: &str) -> Vec<u8> {
        let mut tiff = b"MM\0\x2a\0\0\0\x08".to_vec();
        // One entry: the Exif directory, at 26.
        tiff.extend([0, 1, 0x87, 0x69, 0, 4, 0, 0, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0]);
        // One entry: DateTimeOriginal, 20 characters, at 44.
        tiff.extend([0, 1, 0x90, 0x03, 0, 2, 0, 0, 0, 20, 0, 0, 0, 44, 0, 0, 0, 0]);
        tiff.extend(text.bytes().chain([0]));
        let length = u16::try_from(tiff.len() + 8).unwrap().to_be_bytes();
        [&[0xFF, 0xD8, 0xFF, 0xE1], &length[..], b"Exif\0\0", &tiff, &[0xFF, 0xD9]].concat()
    }

    /// Builds a file with a fraction of a second and a zone: three entries, followed by the long texts.
    fn picture_with_zone(fraction: [u8; 4]) -> Vec<u8> {
        let mut tiff = b"MM\0\x2a\0\0\0\x08".to_vec();
        tiff.extend([0, 1, 0x87, 0x69, 0, 4, 0, 0, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0]);
        tiff.extend([0, 3]);
        tiff.extend([0x90, 0x03, 0, 2, 0, 0, 0, 20, 0, 0, 0, 68]);
        tiff.extend([0x90, 0x11, 0, 2, 0, 0, 0, 7, 0, 0, 0, 88]);
        tiff.extend([0x92, 0x91, 0, 2, 0, 0, 0, 4]);
        tiff.extend(fraction);
        tiff.extend([0, 0, 0, 0]);
        tiff.extend(b"2026:03:01 09:00:02\0+02:00\0");
        let length = u16::try_from(tiff.len() + 8).unwrap().to_be_bytes();
        [&[0xFF, 0xD8, 0xFF, 0xE1], &length[..], b"Exif\0\0", &tiff, &[0xFF, 0xD9]].concat()
    }

    #[test]
    fn the_camera_clock_is_read_if_present() {
        let bytes = picture("2026:03:01 07:00:02");
        assert_eq!(capture_time(&bytes).unwrap().to_string(), "2026-03-01T07:00:02");
        assert_eq!(camera_clock_offset_s(&bytes, "2026-03-01T06:00:00.5Z".parse().unwrap()), Some(3601.5));
        for odd in ["0000:00:00 00:00:00", "    :  :     :  :  ", "yesterday, at noon "] {
            assert_eq!(capture_time(&picture(odd)), None, "{odd}");
        }
        assert_eq!(capture_time(b"\xFF\xD8\xFF\xD9"), None);
    }

    #[test]
    fn fractions_of_a_second_and_the_zone_are_read_if_present() {
        let read = read_metadata(&picture_with_zone(*b"250\0"));
        assert_eq!(
            (read.local_time.unwrap().to_string().as_str(), read.subsecond_digits),
            ("2026-03-01T09:00:02.25", 3)
        );
        let utc = read.offset.unwrap().to_timestamp(read.local_time.unwrap()).unwrap();
        assert_eq!(utc, "2026-03-01T07:00:02.25Z".parse().unwrap());
        let coarse = read_metadata(&picture_with_zone(*b"   \0"));
        assert_eq!(
            (coarse.local_time.unwrap().to_string().as_str(), coarse.subsecond_digits),
            ("2026-03-01T09:00:02", 0)
        );
        assert_eq!(read_metadata(&picture("2026:03:01 07:00:02")).offset, None);
        assert_eq!(read_metadata(b"\xFF\xD8\xFF\xD9"), CaptureMetadata::default());
        for (text, seconds) in [("+05:45", Some(20_700)), ("-03:30", Some(-12_600)), ("Z", Some(0)), ("+2", Some(7200))]
        {
            assert_eq!(parse_offset(text).map(Offset::seconds), seconds, "{text}");
        }
        for odd in ["", "02:00", "+aa:00", "+02:75", "+99:00", "   :  ", "+-1:00"] {
            assert_eq!(parse_offset(odd), None, "{odd}");
        }
    }

    proptest::proptest! {
        #[test]
        fn any_flipped_byte_is_survived(at in 0usize..127, with in proptest::num::u8::ANY) {
            for mut bytes in [picture("2026:03:01 07:00:02"), picture_with_zone(*b"250\0")] {
                let length = bytes.len();
                bytes[at % length] = with;
                let _ = (capture_time(&bytes), read_metadata(&bytes));
            }
        }
    }
}
