//! Parser of Python literals such as mrcal's `.cameramodel`: dictionaries, lists, tuples, strings, bytes, numbers, and
//! comments from `#` to the line's end (docs.python.org, "Lexical analysis", and `ast.literal_eval`, with which mrcal reads
//! it).

use super::tree::{KeyedEntry, KeyedValue, MAX_DEPTH, MAX_NODES, Node, too_deep, too_many};
use crate::installation::KeyFault;

pub(super) fn parse_literal(text: &str) -> Result<Node, KeyFault> {
    let mut scanner = Scanner {
        rest: text,
        line: 1,
        nodes: 0,
    };
    let node = scanner.value(0)?;
    scanner.skip_blanks();
    match scanner.rest.chars().next() {
        None => Ok(node),
        Some(c) => Err(scanner.fault_here(format!("has \"{c}\" after its end"))),
    }
}

struct Scanner<'a> {
    rest: &'a str,
    line: u64,
    nodes: usize,
}

impl<'a> Scanner<'a> {
    fn fault_here(&self, problem: String) -> KeyFault {
        KeyFault::on_line(
            self.line,
            "",
            problem,
            "write it as mrcal does: {'key': [ 1.0, 2.0, ], }",
        )
    }

    /// Consumes the next `length` bytes.
    fn take(&mut self, length: usize) -> &'a str {
        let (taken, rest) = self
            .rest
            .split_at_checked(length)
            .unwrap_or((self.rest, ""));
        self.line += taken.matches('\n').count() as u64;
        self.rest = rest;
        taken
    }

    /// Skips blanks and comments.
    fn skip_blanks(&mut self) {
        loop {
            let blank = self.rest.len() - self.rest.trim_start().len();
            self.take(blank);
            if !self.rest.starts_with('#') {
                return;
            }
            self.take(self.rest.find('\n').unwrap_or(self.rest.len()));
        }
    }

    /// Consumes the next character if it is `sign`; returns whether it was.
    fn take_sign(&mut self, sign: char) -> bool {
        self.skip_blanks();
        let there = self.rest.starts_with(sign);
        if there {
            self.take(sign.len_utf8());
        }
        there
    }

    fn value(&mut self, depth: usize) -> Result<Node, KeyFault> {
        self.skip_blanks();
        let line = self.line;
        self.nodes += 1;
        if depth > MAX_DEPTH {
            return Err(too_deep(line));
        }
        if self.nodes > MAX_NODES {
            return Err(too_many(line));
        }
        let value = match self.rest.chars().next() {
            Some('{') => self.map(depth)?,
            Some('[') => self.list('[', ']', depth)?,
            Some('(') => self.list('(', ')', depth)?,
            Some('\'' | '"') => KeyedValue::Text(self.string()?),
            Some('b') if self.rest[1..].starts_with(['\'', '"']) => {
                self.take(1);
                KeyedValue::Text(self.string()?)
            }
            Some(_) => KeyedValue::Text(self.word()?),
            None => return Err(self.fault_here("ends prematurely".into())),
        };
        Ok(Node {
            line,
            tag: None,
            value,
        })
    }

    fn map(&mut self, depth: usize) -> Result<KeyedValue, KeyFault> {
        self.take_sign('{');
        let mut entries = vec![];
        while !self.take_sign('}') {
            let key = self.value(depth + 1)?;
            let Some(key) = key.text().map(str::to_owned) else {
                return Err(self.fault_here("has a key that is not a text".into()));
            };
            if !self.take_sign(':') {
                return Err(self.fault_here(format!("has no colon after the key \"{key}\"")));
            }
            entries.push(KeyedEntry {
                key,
                node: self.value(depth + 1)?,
            });
            self.expect_comma_or('}')?;
        }
        Ok(KeyedValue::Map(entries))
    }

    fn list(&mut self, open: char, close: char, depth: usize) -> Result<KeyedValue, KeyFault> {
        self.take_sign(open);
        let mut items = vec![];
        while !self.take_sign(close) {
            items.push(self.value(depth + 1)?);
            self.expect_comma_or(close)?;
        }
        Ok(KeyedValue::List(items))
    }

    /// Expects a comma or the closing character after an element.
    fn expect_comma_or(&mut self, close: char) -> Result<(), KeyFault> {
        if self.take_sign(',') || self.rest.starts_with(close) {
            return Ok(());
        }
        Err(self.fault_here(format!("has neither a comma nor \"{close}\" after a value")))
    }

    /// Parses a quoted string without resolving escapes: keys and numbers of a camera have none.
    fn string(&mut self) -> Result<String, KeyFault> {
        let quote = self.take(1);
        let mut length = 0;
        let mut escaped = false;
        for c in self.rest.chars() {
            match c {
                '\n' => break,
                '\\' if !escaped => escaped = true,
                c if quote.starts_with(c) && !escaped => {
                    let text = self.take(length).to_owned();
                    self.take(1);
                    return Ok(text);
                }
                _ => escaped = false,
            }
            length += c.len_utf8();
        }
        Err(self.fault_here("has a string without a closing quote".into()))
    }

    /// Parses a number, or a word of Python.
    fn word(&mut self) -> Result<String, KeyFault> {
        let end = self
            .rest
            .find(|c: char| !(c.is_ascii_alphanumeric() || "+-._".contains(c)));
        let word = self.take(end.unwrap_or(self.rest.len()));
        if word.parse::<f64>().is_ok() || ["None", "True", "False"].contains(&word) {
            return Ok(word.to_owned());
        }
        let shown: String = if word.is_empty() {
            self.rest.chars().take(1).collect()
        } else {
            word.into()
        };
        Err(self.fault_here(format!("has \"{shown}\" where a value is expected")))
    }
}
