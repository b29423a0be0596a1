//! A JPEG whose number of lines stands behind its first scan, in a DNL marker (ITU-T T.81, B.2.5): line cameras and scanners
//! begin a picture without knowing its height.

use super::JpegFault;

/// Markers.
const SCAN: u8 = 0xda;
const LINES: u8 = 0xdc;
const RESTARTS: std::ops::Range<u8> = 0xd0..0xd8;
/// Bytes of the whole DNL segment: marker, length, lines.
const SEGMENT: usize = 6;

/// The same file with its height where it usually stands, and without the DNL marker; `None` where it has none.
///
/// # Errors
/// Where the marker's height is none, or another than the header's.
pub fn resolve_height(bytes: &[u8]) -> Option<Result<Vec<u8>, JpegFault>> {
    let (height_at, scan) = find_height_and_scan(bytes)?;
    let at = find_marker(bytes, scan)?;
    let &[0xff, LINES, 0, 4, high, low] = bytes.get(at..at + SEGMENT)? else { return None };
    let own = bytes.get(height_at..height_at + 2)?;
    if [high, low] == [0, 0] || (own != [0, 0] && own != [high, low]) {
        let number = |two: &[u8]| two.iter().fold(0, |sum, b| 256 * sum + u32::from(*b));
        let (header, marker) = (number(own), number(&[high, low]));
        let what = format!("its header says {header} lines, its DNL marker {marker}");
        return Some(Err(JpegFault::Damaged(what)));
    }
    let mut whole = [&bytes[..at], &bytes[at + SEGMENT..]].concat();
    whole[height_at..height_at + 2].copy_from_slice(&[high, low]);
    Some(Ok(whole))
}

/// Where the frame header's height stands, and where the first scan's data begin.
fn find_height_and_scan(bytes: &[u8]) -> Option<(usize, usize)> {
    let (mut at, mut height) = (2, None);
    loop {
        // Fill bytes may stand before a marker.
        at += bytes.get(at..)?.iter().take_while(|b| **b == 0xff).count();
        let code = *bytes.get(at)?;
        let length = usize::from(u16::from_be_bytes(bytes.get(at + 1..at + 3)?.try_into().ok()?));
        let frame = (0xc0..=0xcf).contains(&code) && ![0xc4, 0xc8, 0xcc].contains(&code);
        if frame {
            height = height.or(Some(at + 4));
        }
        at += 1 + length.max(2);
        if code == SCAN {
            return Some((height?, at));
        }
    }
}

/// The first marker in a scan that is none of its own: no stuffed zero, no restart.
fn find_marker(bytes: &[u8], scan: usize) -> Option<usize> {
    let mut at = scan;
    loop {
        at += memchr::memchr(0xff, bytes.get(at..)?)?;
        match *bytes.get(at + 1)? {
            0 => at += 2,
            0xff => at += 1,
            code if RESTARTS.contains(&code) => at += 2,
            _ => return Some(at),
        }
    }
}
