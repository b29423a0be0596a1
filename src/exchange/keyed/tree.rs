//! Tree of a keyed file; each value has its line number.

use crate::installation::KeyFault;

/// Value and its position in the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Line on which it begins, from 1.
    pub line: u64,
    /// Type written before it, such as `opencv-matrix`.
    pub tag: Option<String>,
    pub value: KeyedValue,
}

/// Kinds of values.
#[derive(Clone, Debug, PartialEq)]
pub enum KeyedValue {
    /// Keys with their values, in the file's order.
    Map(Vec<KeyedEntry>),
    /// Values in order.
    List(Vec<Node>),
    /// Number or text, without its quotes.
    Text(String),
}

/// Key with its value.
#[derive(Clone, Debug, PartialEq)]
pub struct KeyedEntry {
    /// Key as written in the file.
    pub key: String,
    pub node: Node,
}

impl Node {
    /// Returns the entries of a map; none of other values.
    pub fn entries(&self) -> &[KeyedEntry] {
        if let KeyedValue::Map(entries) = &self.value {
            entries
        } else {
            &[]
        }
    }

    /// Returns the value of a key, in upper or lower case: programs have changed it between versions.
    ///
    /// # Errors
    /// Returns an error if two keys differ only in case.
    pub fn get(&self, key: &str) -> Result<Option<&Self>, KeyFault> {
        let mut found = self
            .entries()
            .iter()
            .filter(|e| e.key.eq_ignore_ascii_case(key));
        let first = found.next();
        match found.next() {
            Some(again) => Err(duplicate_key(again)),
            None => Ok(first.map(|e| &e.node)),
        }
    }

    /// Returns the value of a required key.
    ///
    /// # Errors
    /// Returns an error if the key is missing.
    pub fn require(&self, key: &str, remedy: &str) -> Result<&Self, KeyFault> {
        self.get(key)?
            .ok_or_else(|| KeyFault::on_line(self.line, key, "is missing", remedy))
    }

    /// Returns a number or text as text.
    pub fn text(&self) -> Option<&str> {
        if let KeyedValue::Text(text) = &self.value {
            Some(text.as_str())
        } else {
            None
        }
    }

    /// Returns the finite numbers of a list, or of a single value.
    ///
    /// # Errors
    /// Returns an error if an element is not a finite number.
    pub fn numbers(&self, key: &str) -> Result<Vec<f64>, KeyFault> {
        match &self.value {
            KeyedValue::List(items) => items.iter().map(|item| item.number(key)).collect(),
            KeyedValue::Text(_) => Ok(vec![self.number(key)?]),
            KeyedValue::Map(_) => Err(KeyFault::on_line(
                self.line,
                key,
                "has keys, not numbers",
                "give a list of numbers",
            )),
        }
    }

    /// Returns a finite number.
    ///
    /// # Errors
    /// Returns an error, with the likely cause, if the value is not a finite number.
    pub fn number(&self, key: &str) -> Result<f64, KeyFault> {
        let fault =
            |problem: String, remedy: &str| Err(KeyFault::on_line(self.line, key, problem, remedy));
        let Some(text) = self.text() else {
            return fault(
                "has a list or keys where a number is expected".into(),
                "give a number",
            );
        };
        if let Some(number) = text.parse::<f64>().ok().filter(|n| n.is_finite()) {
            return Ok(number);
        }
        let words: Vec<&str> = text.split_whitespace().collect();
        if words.len() > 1 && words.iter().all(|w| w.parse::<f64>().is_ok()) {
            let problem = format!("has {} numbers without commas between them", words.len());
            return fault(problem, "write commas between the numbers");
        }
        fault(
            format!("\"{text}\" is not a finite number"),
            "give a decimal number with a point",
        )
    }

    /// Rejects maps that have a key twice, since it is unknown which of the two is valid.
    pub(super) fn check_duplicate_keys(&self) -> Result<(), KeyFault> {
        for (k, entry) in self.entries().iter().enumerate() {
            if self.entries()[..k]
                .iter()
                .any(|other| other.key == entry.key)
            {
                return Err(duplicate_key(entry));
            }
            entry.node.check_duplicate_keys()?;
        }
        if let KeyedValue::List(items) = &self.value {
            items.iter().try_for_each(Self::check_duplicate_keys)?;
        }
        Ok(())
    }

    /// Returns the number of values in the tree, including itself.
    pub(super) fn size(&self) -> usize {
        1 + match &self.value {
            KeyedValue::Map(entries) => entries.iter().map(|e| e.node.size()).sum(),
            KeyedValue::List(items) => items.iter().map(Self::size).sum(),
            KeyedValue::Text(_) => 0,
        }
    }
}

fn duplicate_key(entry: &KeyedEntry) -> KeyFault {
    KeyFault::on_line(
        entry.node.line,
        &entry.key,
        "occurs twice",
        "keep the valid one",
    )
}

/// Largest number of values in a file, and largest depth: a calibration has some hundreds, in five levels. A few lines of
/// YAML can expand to millions.
pub(super) const MAX_NODES: usize = 200_000;
pub(super) const MAX_DEPTH: usize = 64;

pub(super) fn too_deep(line: u64) -> KeyFault {
    KeyFault::on_line(
        line,
        "",
        format!("is more than {MAX_DEPTH} levels deep"),
        "name a camera file",
    )
}

pub(super) fn too_many(line: u64) -> KeyFault {
    KeyFault::on_line(
        line,
        "",
        format!("has more than {MAX_NODES} values"),
        "name a camera file",
    )
}
