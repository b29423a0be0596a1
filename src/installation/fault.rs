//! Faults in what a user wrote.

use std::path::{Path, PathBuf};

use super::text::shown_path;

/// A fault in something a user wrote: names the file, the key or line, the value and the mend.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}: {place}: {problem}; {remedy}", shown_path(.file))]
pub struct Fault {
    /// The file at fault.
    pub file: PathBuf,
    /// Key such as `camera.fx`, or `line 7, column sigma_m`.
    pub place: String,
    /// What is wrong, with the value.
    pub problem: String,
    /// What to do.
    pub remedy: String,
}

impl Fault {
    /// Of a file, at a key or line of it.
    pub fn new(
        file: impl Into<PathBuf>,
        place: impl Into<String>,
        problem: impl Into<String>,
        mend: impl Into<String>,
    ) -> Self {
        Self { file: file.into(), place: place.into(), problem: problem.into(), remedy: mend.into() }
    }
}

/// A fault of a key, as the section knows it that the key stands in: which file that is, its reader adds.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key}: {problem}; {remedy}")]
pub struct KeyFault {
    /// With its section, such as `series.interval`.
    pub key: String,
    /// What is wrong, with the value.
    pub problem: String,
    /// What to do.
    pub remedy: String,
}

impl KeyFault {
    /// Of a key.
    pub fn new(key: impl Into<String>, problem: impl Into<String>, mend: impl Into<String>) -> Self {
        Self { key: key.into(), problem: problem.into(), remedy: mend.into() }
    }

    /// Of the rules of a section, each with its key, the problem and the mend, those that do not hold.
    pub fn broken(section: &str, rules: &[(bool, &str, &str, &str)]) -> Vec<Self> {
        let broken = rules.iter().filter(|(holds, ..)| !holds);
        broken.map(|(_, key, problem, mend)| Self::new(format!("{section}.{key}"), *problem, *mend)).collect()
    }

    /// The same fault as seen from the section around.
    pub fn within(self, section: &str) -> Self {
        Self { key: format!("{section}.{}", self.key), ..self }
    }

    /// The fault of the file that the key stands in.
    pub fn of(self, file: &Path) -> Fault {
        Fault::new(file, self.key, self.problem, self.remedy)
    }
}
