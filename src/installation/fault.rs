//! Errors in files written by the user.

use std::path::{Path, PathBuf};

use super::text::printable_path;

/// Error in a file written by the user: names the file, the key or line, the value and the remedy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}: {place}: {problem}; {remedy}", printable_path(.file))]
pub struct Fault {
    /// File with the error.
    pub file: PathBuf,
    /// Key such as `camera.fx`, or `line 7, column sigma_m`.
    pub place: String,
    /// Problem, with the value.
    pub problem: String,
    /// Remedy: the action to take.
    pub remedy: String,
}

impl Fault {
    /// Creates the error of a file at a key or line.
    pub fn new(
        file: impl Into<PathBuf>,
        place: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self { file: file.into(), place: place.into(), problem: problem.into(), remedy: remedy.into() }
    }
}

/// Error of a key, as the section of the key reports it; the reader adds the file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key}: {problem}; {remedy}")]
pub struct KeyFault {
    /// Key with its section, such as `series.interval`.
    pub key: String,
    /// Problem, with the value.
    pub problem: String,
    /// Remedy: the action to take.
    pub remedy: String,
}

impl KeyFault {
    /// Creates the error of a key.
    pub fn new(key: impl Into<String>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { key: key.into(), problem: problem.into(), remedy: remedy.into() }
    }

    /// Returns errors for the violated rules of a section, each given as (holds, key, problem, remedy).
    pub fn from_rules(section: &str, rules: &[(bool, &str, &str, &str)]) -> Vec<Self> {
        let broken = rules.iter().filter(|(holds, ..)| !holds);
        broken.map(|(_, key, problem, remedy)| Self::new(format!("{section}.{key}"), *problem, *remedy)).collect()
    }

    /// Prefixes the key with the name of the enclosing section.
    pub fn with_section(self, section: &str) -> Self {
        Self { key: format!("{section}.{}", self.key), ..self }
    }

    /// Converts it into an error of the file that contains the key.
    pub fn into_fault(self, file: &Path) -> Fault {
        Fault::new(file, self.key, self.problem, self.remedy)
    }
}

/// Error at a line and key of a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, {key}: {problem}; {remedy}")]
pub struct LineFault {
    /// Line, from 1; 0 for the whole file.
    pub line: u64,
    /// Key; empty if there is none.
    pub key: String,
    /// Problem, with the value.
    pub problem: String,
    /// Remedy: the action to take.
    pub remedy: String,
}

impl LineFault {
    /// Creates an error at a line and key.
    pub fn new(line: u64, key: &str, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { line, key: key.into(), problem: problem.into(), remedy: remedy.into() }
    }

    /// Converts it into an error of `file`.
    pub fn into_fault(self, file: &Path) -> Fault {
        let place = match (self.line, self.key.is_empty()) {
            (0, true) => "file".to_owned(),
            (0, false) => self.key,
            (line, true) => format!("line {line}"),
            (line, false) => format!("line {line}, {}", self.key),
        };
        Fault::new(file, place, self.problem, self.remedy)
    }
}
