//! JPEG files with the number of lines after the first scan, in a DNL marker (ITU-T T.81, B.2.5): line cameras and scanners
//! begin an image without knowing its height.

use super::JpegFault;

const SCAN: u8 = 0xda;
const LINES: u8 = 0xdc;
const RESTARTS: std::ops::Range<u8> = 0xd0..0xd8;
/// Number of bytes of a DNL segment: marker, length, lines.
const SEGMENT: usize = 6;

/// Moves the height to the frame header and removes the DNL marker; `None` if there is no such marker.
///
/// # Errors
/// Returns an error if the marker's height is 0 or differs from that of the header.
pub fn resolve_height(bytes: &[u8]) -> Option<Result<Vec<u8>, JpegFault>> {
    let (height_at, scan) = find_height_and_scan(bytes)?;
    let at = find_marker(bytes, scan)?;
    let &[0xff, LINES, 0, 4, high, low] = bytes.get(at..at + SEGMENT)? else {
        return None;
    };
    let own = bytes.get(height_at..height_at + 2)?;
    if [high, low] == [0, 0] || (own != [0, 0] && own != [high, low]) {
        let number = |two: &[u8]| two.iter().fold(0, |sum, b| 256 * sum + u32::from(*b));
        let (header, marker) = (number(own), number(&[high, low]));
        let problem = format!("the header gives {header} lines, the DNL marker {marker}");
        return Some(Err(JpegFault::Damaged(problem)));
    }
    let mut rebuilt = [&bytes[..at], &bytes[at + SEGMENT..]].concat();
    rebuilt[height_at..height_at + 2].copy_from_slice(&[high, low]);
    Some(Ok(rebuilt))
}

/// Returns the offsets of the frame header's height and of the first scan's data.
fn find_height_and_scan(bytes: &[u8]) -> Option<(usize, usize)> {
    let (mut at, mut height) = (2, None);
    loop {
        // Fill bytes may precede a marker.
        at += bytes.get(at..)?.iter().take_while(|b| **b == 0xff).count();
        let code = *bytes.get(at)?;
        let length = usize::from(u16::from_be_bytes(
            bytes.get(at + 1..at + 3)?.try_into().ok()?,
        ));
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

/// Finds the first marker in a scan that is neither a stuffed zero nor a restart.
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
