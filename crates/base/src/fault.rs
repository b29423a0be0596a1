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
    /// Subject, by which errors with one cause are combined.
    pub subject: FaultSubject,
}

/// Subject of an error.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum FaultSubject {
    /// Key, or the whole file.
    #[default]
    Place,
    /// Surveyed marker.
    Marker,
    /// Line of a table.
    Line(u64),
    /// Cell of a table.
    Cell { line: u64, column: &'static str },
    /// Cell of a table that needs a number and has none.
    NoNumber { line: u64, column: &'static str },
}

impl Fault {
    /// Creates the error of a file at a key or line.
    pub fn new(
        file: impl Into<PathBuf>,
        place: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self {
            file: file.into(),
            place: place.into(),
            problem: problem.into(),
            remedy: remedy.into(),
            subject: FaultSubject::Place,
        }
    }

    /// Creates the error of a line or cell of a table.
    pub fn in_table(
        file: impl Into<PathBuf>,
        subject: FaultSubject,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        let place = match subject {
            FaultSubject::Cell { line, column } | FaultSubject::NoNumber { line, column } => {
                format!("line {line}, column {column}")
            }
            FaultSubject::Line(line) => format!("line {line}"),
            FaultSubject::Marker | FaultSubject::Place => "file".to_owned(),
        };
        Self {
            subject,
            ..Self::new(file, place, problem, remedy)
        }
    }

    /// Creates the error of a surveyed marker.
    pub fn of_marker(
        file: impl Into<PathBuf>,
        id: &str,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self {
            subject: FaultSubject::Marker,
            ..Self::new(file, format!("marker \"{id}\""), problem, remedy)
        }
    }
}

/// Error of a key or line, as its section or parser reports it; the reader adds the file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}: {problem}; {remedy}", place_in_file(*.line, .key))]
pub struct KeyFault {
    /// Line, from 1; 0 if the key alone names the place.
    pub line: u64,
    /// Key with its section, such as `series.interval`; empty for the whole line or file.
    pub key: String,
    /// Problem, with the value.
    pub problem: String,
    /// Remedy: the action to take.
    pub remedy: String,
}

fn place_in_file(line: u64, key: &str) -> String {
    match (line, key) {
        (0, "") => "file".to_owned(),
        (0, key) => key.to_owned(),
        (line, "") => format!("line {line}"),
        (line, key) => format!("line {line}, {key}"),
    }
}

impl KeyFault {
    /// Creates the error of a key.
    pub fn new(
        key: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self {
            line: 0,
            key: key.into(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// Returns errors for the violated rules of a section, each given as (holds, key, problem, remedy).
    pub fn from_rules(section: &str, rules: &[(bool, &str, &str, &str)]) -> Vec<Self> {
        let broken = rules.iter().filter(|(holds, ..)| !holds);
        broken
            .map(|(_, key, problem, remedy)| {
                Self::new(format!("{section}.{key}"), *problem, *remedy)
            })
            .collect()
    }

    /// Prefixes the key with the name of the enclosing section.
    pub fn with_section(self, section: &str) -> Self {
        Self {
            key: format!("{section}.{}", self.key),
            ..self
        }
    }

    /// Converts it into an error of the file that contains the key.
    pub fn into_fault(self, file: &Path) -> Fault {
        Fault::new(
            file,
            place_in_file(self.line, &self.key),
            self.problem,
            self.remedy,
        )
    }
}
