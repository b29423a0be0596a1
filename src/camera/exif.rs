//! A picture says when it was taken, by the camera's own clock.

use exif::{In, Reader, Tag, Value};

/// `DateTimeOriginal` of a JPEG file: whole seconds in an unknown zone. `None` where there is none.
pub fn taken(bytes: &[u8]) -> Option<jiff::civil::DateTime> {
    let exif = Reader::new().read_from_container(&mut std::io::Cursor::new(bytes)).ok()?;
    let field = exif.get_field(Tag::DateTimeOriginal, In::PRIMARY)?;
    let Value::Ascii(texts) = &field.value else { return None };
    let text = std::str::from_utf8(texts.first()?).ok()?;
    jiff::civil::DateTime::strptime("%Y:%m:%d %H:%M:%S", text).ok()
}

/// That clock less UTC, s: the zone, the camera's error, and up to a second.
pub fn offset_s(bytes: &[u8], utc: jiff::Timestamp) -> Option<f64> {
    let read = taken(bytes)?.to_zoned(jiff::tz::TimeZone::UTC).ok()?.timestamp();
    Some(read.duration_since(utc).as_secs_f64())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// The smallest file with the tag: SOI, APP1 with an Exif block, EOI.
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

    #[test]
    fn the_cameras_clock_is_read_where_it_is() {
        let bytes = picture("2026:03:01 07:00:02");
        assert_eq!(taken(&bytes).unwrap().to_string(), "2026-03-01T07:00:02");
        assert_eq!(offset_s(&bytes, "2026-03-01T06:00:00.5Z".parse().unwrap()), Some(3601.5));
        for odd in ["0000:00:00 00:00:00", "    :  :     :  :  ", "yesterday, at noon "] {
            assert_eq!(taken(&picture(odd)), None, "{odd}");
        }
        assert_eq!(taken(b"\xFF\xD8\xFF\xD9"), None);
    }

    proptest::proptest! {
        #[test]
        fn any_flipped_byte_is_survived(at in 0usize..90, with in proptest::num::u8::ANY) {
            let mut bytes = picture("2026:03:01 07:00:02");
            let length = bytes.len();
            bytes[at % length] = with;
            let _ = taken(&bytes);
        }
    }
}
