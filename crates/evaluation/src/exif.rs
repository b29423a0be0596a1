//! Capture metadata of an image: time by the camera's own clock, and camera settings.

use exif::{Context, Error, Exif, Field, In, Reader, Tag, Value};
use jiff::Timestamp;
use jiff::civil::DateTime;

use wingd_base::clock::written_time::{WrittenTime, parse_offset};

/// Capture metadata of an image.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct CaptureMetadata {
    /// Time of the camera's clock.
    pub time: Option<WrittenTime>,
    /// Time of the last position fix, UTC.
    pub gps_utc: Option<Timestamp>,
    /// Whether some of the metadata cannot be read.
    pub damaged: bool,
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

/// Tags of a time, of its fraction of a second and of its zone, in the order of preference (Exif 2.31): taken, digitized,
/// changed.
const TIME_TAGS: [[Tag; 3]; 3] = [
    [
        Tag::DateTimeOriginal,
        Tag::SubSecTimeOriginal,
        Tag::OffsetTimeOriginal,
    ],
    [
        Tag::DateTimeDigitized,
        Tag::SubSecTimeDigitized,
        Tag::OffsetTimeDigitized,
    ],
    [Tag::DateTime, Tag::SubSecTime, Tag::OffsetTime],
];

/// Reads the tags of an image, each on its own, and whether some cannot be read.
fn read_exif(bytes: &[u8]) -> (Option<Exif>, bool) {
    // Zeros before the image are padding.
    let zeros = bytes.iter().take_while(|b| **b == 0).count();
    let mut reader = Reader::new();
    match reader
        .continue_on_error(true)
        .read_from_container(&mut std::io::Cursor::new(&bytes[zeros..]))
    {
        Ok(exif) => (Some(exif), false),
        Err(Error::PartialResult(partial)) => (Some(partial.into_inner().0), true),
        Err(_) => (None, memchr::memmem::find(bytes, b"Exif\0\0").is_some()),
    }
}

/// Returns a tag of the image by its number: some programs write it into another directory of the block.
fn field(exif: &Exif, tag: Tag) -> Option<&Field> {
    let same = |f: &&Field| f.tag.number() == tag.number() && f.ifd_num == In::PRIMARY;
    exif.get_field(tag, In::PRIMARY).or_else(|| {
        exif.fields()
            .find(|f| same(f) && matches!(f.tag.context(), Context::Tiff | Context::Exif))
    })
}

fn ascii_value(exif: &Exif, tag: Tag) -> Option<&str> {
    let bytes = match &field(exif, tag)?.value {
        Value::Ascii(texts) => texts.first()?,
        Value::Undefined(bytes, _) | Value::Byte(bytes) => bytes,
        _ => return None,
    };
    Some(std::str::from_utf8(bytes).ok()?.trim_matches(['\0', ' '])).filter(|text| !text.is_empty())
}

/// First year in which a camera's clock may be: a later one that was not set may begin with 1970.
const FIRST_YEAR: i16 = 1900;

/// Returns the first time that any of the tags has.
fn capture_time(exif: &Exif) -> Option<WrittenTime> {
    let read = |[time, fraction, zone]: [Tag; 3]| {
        let time = WrittenTime::find(ascii_value(exif, time)?, FIRST_YEAR)?;
        let offset = || ascii_value(exif, zone).and_then(parse_offset);
        let time = WrittenTime {
            offset: time.offset.or_else(offset),
            ..time
        };
        Some(ascii_value(exif, fraction).map_or(time, |digits| time.with_fraction(digits)))
    };
    let time = TIME_TAGS.into_iter().find_map(read)?;
    // A camera has one clock: the zone of another tag is that of this time.
    let zone = || {
        TIME_TAGS
            .iter()
            .find_map(|[.., zone]| parse_offset(ascii_value(exif, *zone)?))
    };
    Some(WrittenTime {
        offset: time.offset.or_else(zone),
        ..time
    })
}

/// Returns the time of the position fix, UTC.
fn gps_time(exif: &Exif) -> Option<Timestamp> {
    let date = ascii_value(exif, Tag::GPSDateStamp)?;
    let Value::Rational(parts) = &exif.get_field(Tag::GPSTimeStamp, In::PRIMARY)?.value else {
        return None;
    };
    let [h, m, s] = parts[..] else { return None };
    let seconds = 3600.0 * h.to_f64() + 60.0 * m.to_f64() + s.to_f64();
    let midnight = WrittenTime::find(&format!("{date} 00:00:00"), FIRST_YEAR)?
        .timestamp(jiff::tz::Offset::UTC)?;
    midnight
        .checked_add(jiff::SignedDuration::try_from_secs_f64(seconds).ok()?)
        .ok()
}

/// Reads times and settings of a JPEG, PNG or TIFF file (Exif 2.31). Empty if there are none.
pub fn read_metadata(bytes: &[u8]) -> CaptureMetadata {
    let (exif, damaged) = read_exif(bytes);
    let Some(exif) = exif else {
        return CaptureMetadata {
            damaged,
            ..CaptureMetadata::default()
        };
    };
    let setting = |(name, tag): &(&'static str, Tag)| {
        let text = field(&exif, *tag)?
            .display_value()
            .with_unit(&exif)
            .to_string();
        let text = text
            .trim_matches(|c: char| c == '"' || c.is_whitespace())
            .to_owned();
        (!text.is_empty()).then_some((*name, text))
    };
    CaptureMetadata {
        time: capture_time(&exif),
        gps_utc: gps_time(&exif),
        damaged,
        settings: SETTINGS.iter().filter_map(setting).collect(),
    }
}

/// Returns the camera's clock less UTC, s: the zone, the camera's error, and up to a second.
pub fn camera_clock_offset_s(bytes: &[u8], utc: Timestamp) -> Option<f64> {
    let local: DateTime = capture_time(&read_exif(bytes).0?)?.local;
    let read = local
        .with()
        .subsec_nanosecond(0)
        .build()
        .ok()?
        .to_zoned(jiff::tz::TimeZone::UTC)
        .ok()?
        .timestamp();
    Some(read.duration_since(utc).as_secs_f64())
}

#[cfg(test)]
mod tests {
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
        [
            &[0xFF, 0xD8, 0xFF, 0xE1],
            &length[..],
            b"Exif\0\0",
            &tiff,
            &[0xFF, 0xD9],
        ]
        .concat()
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
        [
            &[0xFF, 0xD8, 0xFF, 0xE1],
            &length[..],
            b"Exif\0\0",
            &tiff,
            &[0xFF, 0xD9],
        ]
        .concat()
    }

    fn local(bytes: &[u8]) -> Option<String> {
        read_metadata(bytes).time.map(|time| time.local.to_string())
    }

    #[test]
    fn the_camera_clock_is_read_if_present() {
        let bytes = picture("2026:03:01 07:00:02");
        assert_eq!(local(&bytes).as_deref(), Some("2026-03-01T07:00:02"));
        assert_eq!(
            camera_clock_offset_s(&bytes, "2026-03-01T06:00:00.5Z".parse().unwrap()),
            Some(3601.5)
        );
        for odd in [
            "0000:00:00 00:00:00",
            "    :  :     :  :  ",
            "yesterday, at noon ",
        ] {
            assert_eq!(local(&picture(odd)), None, "{odd}");
        }
        assert_eq!(local(b"\xFF\xD8\xFF\xD9"), None);
        assert_eq!(
            local(&[b"\0\0", &bytes[..]].concat()).as_deref(),
            Some("2026-03-01T07:00:02")
        );
    }

    #[test]
    fn a_bad_pointer_loses_its_own_tag_only() {
        let sound = picture_with_zone(*b"250\0");
        // In the file, 12 bytes precede the block: the place of the zone is beyond its end, the entry at 26 of the
        // first directory and the pointer to the next directory too.
        for (at, lost) in [
            (12 + 48, "the zone"),
            (12 + 22, "nothing: the pointer to the next directory"),
        ] {
            let mut bytes = sound.clone();
            bytes[at..at + 4].fill(0xFF);
            let read = read_metadata(&bytes);
            let time = read.time.unwrap_or_else(|| panic!("{lost}"));
            assert_eq!(time.local.to_string(), "2026-03-01T09:00:02.25", "{lost}");
            assert!(read.damaged, "{lost}");
        }
    }

    #[test]
    fn fractions_of_a_second_and_the_zone_are_read_if_present() {
        let read = read_metadata(&picture_with_zone(*b"250\0")).time.unwrap();
        assert_eq!(
            (read.local.to_string().as_str(), read.digits),
            ("2026-03-01T09:00:02.25", 3)
        );
        assert_eq!(
            read.timestamp(jiff::tz::Offset::UTC),
            Some("2026-03-01T07:00:02.25Z".parse().unwrap())
        );
        let coarse = read_metadata(&picture_with_zone(*b"   \0")).time.unwrap();
        assert_eq!(
            (coarse.local.to_string().as_str(), coarse.digits),
            ("2026-03-01T09:00:02", 0)
        );
        assert_eq!(
            read_metadata(&picture("2026:03:01 07:00:02"))
                .time
                .unwrap()
                .offset,
            None
        );
        assert_eq!(
            read_metadata(b"\xFF\xD8\xFF\xD9"),
            CaptureMetadata::default()
        );
    }

    proptest::proptest! {
        #[test]
        fn any_flipped_byte_is_survived(at in 0usize..127, with in proptest::num::u8::ANY) {
            for mut bytes in [picture("2026:03:01 07:00:02"), picture_with_zone(*b"250\0")] {
                let length = bytes.len();
                bytes[at % length] = with;
                let _ = (camera_clock_offset_s(&bytes, Timestamp::UNIX_EPOCH), read_metadata(&bytes));
            }
        }
    }
}
