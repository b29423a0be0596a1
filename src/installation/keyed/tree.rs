//! The tree of a keyed file, each value with the line that it stands on.

use std::path::Path;

use crate::installation::fault::Fault;

/// What is wrong at a place of a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, {key}: {problem}; {mend}")]
pub struct Trouble {
    /// From 1; 0 where it is the whole file.
    pub line: u64,
    /// The key, empty where there is none.
    pub key: String,
    /// What is wrong, with the value.
    pub problem: String,
    /// What to do.
    pub mend: String,
}

impl Trouble {
    /// A trouble at a line and a key.
    pub fn new(line: u64, key: &str, problem: impl Into<String>, mend: impl Into<String>) -> Self {
        Self { line, key: key.into(), problem: problem.into(), mend: mend.into() }
    }

    /// The fault of the file in which the place is.
    pub fn of(self, file: &Path) -> Fault {
        let place = match (self.line, self.key.is_empty()) {
            (0, true) => "file".to_owned(),
            (0, false) => self.key,
            (line, true) => format!("line {line}"),
            (line, false) => format!("line {line}, {}", self.key),
        };
        Fault::new(file, place, self.problem, self.mend)
    }
}

/// A value and where it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// The line on which it begins, from 1.
    pub line: u64,
    /// The type that is written before it, such as `opencv-matrix`.
    pub tag: Option<String>,
    /// The value.
    pub value: Value,
}

/// What a value is.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Keys with their values, in the file's order.
    Map(Vec<Entry>),
    /// Values in order.
    List(Vec<Node>),
    /// A number or a text, without its quotes.
    Text(String),
}

/// A key with its value.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// As it stands in the file.
    pub key: String,
    /// Its value.
    pub node: Node,
}

impl Node {
    /// The entries of a map; none of other values.
    pub fn entries(&self) -> &[Entry] {
        if let Value::Map(entries) = &self.value { entries } else { &[] }
    }

    /// The value of a key, capitals or small letters: programs have changed them between versions.
    ///
    /// # Errors
    /// Where two keys differ in their capitals alone.
    pub fn get(&self, key: &str) -> Result<Option<&Self>, Trouble> {
        let mut found = self.entries().iter().filter(|e| e.key.eq_ignore_ascii_case(key));
        let first = found.next();
        match found.next() {
            Some(again) => Err(twice(again)),
            None => Ok(first.map(|e| &e.node)),
        }
    }

    /// The value of a key that must be there.
    ///
    /// # Errors
    /// Where it is not.
    pub fn need(&self, key: &str, mend: &str) -> Result<&Self, Trouble> {
        self.get(key)?.ok_or_else(|| Trouble::new(self.line, key, "is missing", mend))
    }

    /// A number or a text.
    pub fn text(&self) -> Option<&str> {
        if let Value::Text(text) = &self.value { Some(text.as_str()) } else { None }
    }

    /// The finite numbers of a list, or of a single value.
    ///
    /// # Errors
    /// Names the first element that is none.
    pub fn numbers(&self, key: &str) -> Result<Vec<f64>, Trouble> {
        match &self.value {
            Value::List(items) => items.iter().map(|item| item.number(key)).collect(),
            Value::Text(_) => Ok(vec![self.number(key)?]),
            Value::Map(_) => {
                Err(Trouble::new(self.line, key, "holds keys, not numbers", "give a list of numbers"))
            }
        }
    }

    /// A finite number.
    ///
    /// # Errors
    /// Where it is none, with the likely cause.
    pub fn number(&self, key: &str) -> Result<f64, Trouble> {
        let fault = |problem: String, mend: &str| Err(Trouble::new(self.line, key, problem, mend));
        let Some(text) = self.text() else {
            return fault("holds a list or keys where a number must be".into(), "give a number");
        };
        if let Some(number) = text.parse::<f64>().ok().filter(|n| n.is_finite()) {
            return Ok(number);
        }
        let words: Vec<&str> = text.split_whitespace().collect();
        if words.len() > 1 && words.iter().all(|w| w.parse::<f64>().is_ok()) {
            let problem = format!("holds {} numbers without commas between them", words.len());
            return fault(problem, "write commas between the numbers");
        }
        fault(format!("\"{text}\" is not a finite number"), "give a decimal number with a point")
    }

    /// No map of the tree has a key twice: which of the two counts would be a guess.
    pub(super) fn no_key_twice(&self) -> Result<(), Trouble> {
        for (k, entry) in self.entries().iter().enumerate() {
            if self.entries()[..k].iter().any(|other| other.key == entry.key) {
                return Err(twice(entry));
            }
            entry.node.no_key_twice()?;
        }
        if let Value::List(items) = &self.value {
            items.iter().try_for_each(Self::no_key_twice)?;
        }
        Ok(())
    }

    /// Values in it, itself counted.
    pub(super) fn size(&self) -> usize {
        1 + match &self.value {
            Value::Map(entries) => entries.iter().map(|e| e.node.size()).sum(),
            Value::List(items) => items.iter().map(Self::size).sum(),
            Value::Text(_) => 0,
        }
    }
}

fn twice(entry: &Entry) -> Trouble {
    Trouble::new(entry.node.line, &entry.key, "stands twice", "keep the one that holds")
}

/// Values that a file may hold, and how deep they may lie: a calibration has some hundred, in five levels. A few lines of
/// YAML can stand for millions.
pub(super) const MAX_NODES: usize = 200_000;
pub(super) const DEEPEST: usize = 64;

pub(super) fn too_deep(line: u64) -> Trouble {
    Trouble::new(line, "", format!("is more than {DEEPEST} levels deep"), "name a camera's file")
}

pub(super) fn too_many(line: u64) -> Trouble {
    Trouble::new(line, "", format!("holds more than {MAX_NODES} values"), "name a camera's file")
}
