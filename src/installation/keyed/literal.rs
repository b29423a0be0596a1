//! A Python literal, as mrcal's `.cameramodel` is one: dictionaries, lists, tuples, strings, bytes, numbers, and comments
//! from `#` to the line's end (docs.python.org, "Lexical analysis", and `ast.literal_eval`, with which mrcal reads it).

use super::tree::{DEEPEST, Entry, MAX_NODES, Node, Trouble, Value, too_deep, too_many};

pub(super) fn parse(text: &str) -> Result<Node, Trouble> {
    let mut scanner = Scanner { rest: text, line: 1, nodes: 0 };
    let node = scanner.value(0)?;
    scanner.blanks();
    match scanner.rest.chars().next() {
        None => Ok(node),
        Some(c) => Err(scanner.trouble(format!("has \"{c}\" behind its end"))),
    }
}

struct Scanner<'a> {
    rest: &'a str,
    line: u64,
    nodes: usize,
}

impl<'a> Scanner<'a> {
    fn trouble(&self, problem: String) -> Trouble {
        Trouble::new(self.line, "", problem, "write it as mrcal does: {'key': [ 1.0, 2.0, ], }")
    }

    /// The next `length` bytes, taken.
    fn take(&mut self, length: usize) -> &'a str {
        let (taken, rest) = self.rest.split_at_checked(length).unwrap_or((self.rest, ""));
        self.line += taken.matches('\n').count() as u64;
        self.rest = rest;
        taken
    }

    /// Passes blanks and comments.
    fn blanks(&mut self) {
        loop {
            let blank = self.rest.len() - self.rest.trim_start().len();
            self.take(blank);
            if !self.rest.starts_with('#') {
                return;
            }
            self.take(self.rest.find('\n').unwrap_or(self.rest.len()));
        }
    }

    /// Whether the next sign is this one; it is taken then.
    fn sign(&mut self, sign: char) -> bool {
        self.blanks();
        let there = self.rest.starts_with(sign);
        if there {
            self.take(sign.len_utf8());
        }
        there
    }

    fn value(&mut self, depth: usize) -> Result<Node, Trouble> {
        self.blanks();
        let line = self.line;
        self.nodes += 1;
        if depth > DEEPEST {
            return Err(too_deep(line));
        }
        if self.nodes > MAX_NODES {
            return Err(too_many(line));
        }
        let value = match self.rest.chars().next() {
            Some('{') => self.map(depth)?,
            Some('[') => self.list('[', ']', depth)?,
            Some('(') => self.list('(', ')', depth)?,
            Some('\'' | '"') => Value::Text(self.string()?),
            Some('b') if self.rest[1..].starts_with(['\'', '"']) => {
                self.take(1);
                Value::Text(self.string()?)
            }
            Some(_) => Value::Text(self.word()?),
            None => return Err(self.trouble("ends in the middle".into())),
        };
        Ok(Node { line, tag: None, value })
    }

    fn map(&mut self, depth: usize) -> Result<Value, Trouble> {
        self.sign('{');
        let mut entries = vec![];
        while !self.sign('}') {
            let key = self.value(depth + 1)?;
            let Some(key) = key.text().map(str::to_owned) else {
                return Err(self.trouble("has a key that is no text".into()));
            };
            if !self.sign(':') {
                return Err(self.trouble(format!("has no colon behind the key \"{key}\"")));
            }
            entries.push(Entry { key, node: self.value(depth + 1)? });
            self.comma_or('}')?;
        }
        Ok(Value::Map(entries))
    }

    fn list(&mut self, open: char, close: char, depth: usize) -> Result<Value, Trouble> {
        self.sign(open);
        let mut items = vec![];
        while !self.sign(close) {
            items.push(self.value(depth + 1)?);
            self.comma_or(close)?;
        }
        Ok(Value::List(items))
    }

    /// After an element stands a comma or the end.
    fn comma_or(&mut self, close: char) -> Result<(), Trouble> {
        if self.sign(',') || self.rest.starts_with(close) {
            return Ok(());
        }
        Err(self.trouble(format!("has neither a comma nor \"{close}\" after a value")))
    }

    /// A string in its quotes, its escapes as they stand: no key and no number of a camera has any.
    fn string(&mut self) -> Result<String, Trouble> {
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
        Err(self.trouble("has a string without its end".into()))
    }

    /// A number, or one of Python's words.
    fn word(&mut self) -> Result<String, Trouble> {
        let end = self.rest.find(|c: char| !(c.is_ascii_alphanumeric() || "+-._".contains(c)));
        let word = self.take(end.unwrap_or(self.rest.len()));
        if word.parse::<f64>().is_ok() || ["None", "True", "False"].contains(&word) {
            return Ok(word.to_owned());
        }
        let shown: String = if word.is_empty() { self.rest.chars().take(1).collect() } else { word.into() };
        Err(self.trouble(format!("has \"{shown}\" where a value must be")))
    }
}
