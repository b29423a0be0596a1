//! Append-only files of JSON lines, whose last line a power cut may tear.

use serde::de::DeserializeOwned;

/// Parsed lines of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct ParsedLines<T> {
    /// Intact lines, with their numbers from 1.
    pub good: Vec<(usize, T)>,
    /// Numbers of damaged lines that have an intact line after them.
    pub damaged: Vec<usize>,
    /// Length up to the end of the last intact line, bytes; the bytes after it are a torn tail.
    pub good_length: usize,
}

/// Parses lines of JSON; never fails. A line is intact if it ends with a newline and parses.
pub fn parse_lines<T: DeserializeOwned>(bytes: &[u8]) -> ParsedLines<T> {
    let mut lines = ParsedLines {
        good: Vec::new(),
        damaged: Vec::new(),
        good_length: 0,
    };
    let mut pending = Vec::new();
    let mut end = 0;
    for (index, line) in bytes.split_inclusive(|byte| *byte == b'\n').enumerate() {
        end += line.len();
        let value = line
            .strip_suffix(b"\n")
            .and_then(|line| serde_json::from_slice(line).ok());
        match value {
            Some(value) => {
                lines.good.push((index + 1, value));
                lines.damaged.append(&mut pending);
                lines.good_length = end;
            }
            None => pending.push(index + 1),
        }
    }
    lines
}

/// Parses a file whose first line is its head; returns the head and the intact lines, or `None` if the head is damaged.
pub(crate) fn parse_headed<H: DeserializeOwned, L: DeserializeOwned>(
    bytes: &[u8],
) -> Option<(H, Vec<L>)> {
    let first = bytes.split_inclusive(|byte| *byte == b'\n').next()?;
    let head = serde_json::from_slice(first).ok()?;
    let lines = parse_lines(bytes.get(first.len()..)?).good;
    Some((head, lines.into_iter().map(|(_, line)| line).collect()))
}

/// Returns the length of the complete lines, bytes, and their flight by the head; `None` if the head is not complete.
pub(crate) fn intact_prefix<H: DeserializeOwned>(
    bytes: &[u8],
    flight: fn(H) -> String,
) -> Option<(usize, String)> {
    let good = parse_lines::<serde_json::Value>(bytes).good_length;
    let (head, _) = parse_headed::<H, serde_json::Value>(bytes.get(..good)?)?;
    Some((good, flight(head)))
}

/// Encodes a value as a line, with its newline.
pub fn encode_line<T: serde::Serialize>(value: &T) -> std::io::Result<Vec<u8>> {
    let mut bytes = serde_json::to_vec(value)?;
    bytes.push(b'\n');
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_torn_tail_is_distinguished_from_a_damaged_middle() {
        let lines = parse_lines::<u32>(b"1\n2\nx\n4\n5");
        assert_eq!(lines.good, [(1, 1), (2, 2), (4, 4)]);
        assert_eq!(lines.damaged, [3]);
        assert_eq!(lines.good_length, 8);
        let torn = parse_lines::<u32>(b"1\n\0\0\0\n");
        assert_eq!((torn.good_length, torn.damaged.len()), (2, 0));
    }
}
