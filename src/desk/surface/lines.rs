//! Lines of large text files, read one after the other with bounded memory.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use super::unreadable;
use crate::installation::KeyFault;

/// Longest line, bytes: nodes and facets have 200.
const MAX_LINE_BYTES: u64 = 1 << 16;

/// Number of characters of a line in a message.
const EXCERPT_CHARS: usize = 60;

/// Lines of a text with their numbers.
pub(super) struct TextLines<R> {
    reader: R,
    bytes: Vec<u8>,
    /// Last line, without surrounding blanks and the comment that may follow it.
    pub text: String,
    /// Number of the last line, from 1.
    pub number: u64,
}

/// Opens a file of text.
pub(super) fn open_lines(file: &Path) -> Result<TextLines<BufReader<File>>, KeyFault> {
    let opened = File::open(file).map_err(|error| unreadable(&error))?;
    Ok(TextLines::new(BufReader::new(opened)))
}

impl<R: BufRead> TextLines<R> {
    /// Creates the lines of a reader.
    pub fn new(reader: R) -> Self {
        Self {
            reader,
            bytes: vec![],
            text: String::new(),
            number: 0,
        }
    }

    /// Advances to the next line that is neither blank nor a comment; false at the end.
    pub fn advance(&mut self, comment: char) -> Result<bool, KeyFault> {
        self.text.clear();
        while self.text.is_empty() {
            self.bytes.clear();
            self.number += 1;
            let limited = &mut self.reader.by_ref().take(MAX_LINE_BYTES);
            let length = limited
                .read_until(b'\n', &mut self.bytes)
                .map_err(|error| unreadable(&error))?;
            if length == 0 {
                return Ok(false);
            }
            let is_text = |text: &&str| (length as u64) < MAX_LINE_BYTES && !text.contains('\0');
            let Some(line) = std::str::from_utf8(&self.bytes).ok().filter(is_text) else {
                return Err(self.fault("is not text", "export the file as text, UTF-8"));
            };
            let own = line.split(comment).next().unwrap_or_default();
            self.text
                .push_str(own.trim_start_matches('\u{feff}').trim());
        }
        Ok(true)
    }

    /// Beginning of the last line, for messages.
    pub fn excerpt(&self) -> String {
        let begin: String = self.text.chars().take(EXCERPT_CHARS).collect();
        if begin.len() < self.text.len() {
            format!("\"{begin}...\"")
        } else {
            format!("\"{begin}\"")
        }
    }

    /// Creates the error of the last line.
    pub fn fault(&self, problem: impl Into<String>, remedy: impl Into<String>) -> KeyFault {
        KeyFault::on_line(self.number, "", problem, remedy)
    }

    /// Creates the error of a file that ends early.
    pub fn end_fault(&self, missing: &str) -> KeyFault {
        self.fault(
            format!("is the end of the file, but {missing}"),
            "the file is truncated; export or copy it again",
        )
    }
}
