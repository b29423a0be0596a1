//! Report of a verification.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

use wingd_base::text::printable_path;

/// Violated invariant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InvariantFault {
    /// Number of the invariant in docs/store.md.
    pub invariant: u8,
    pub path: PathBuf,
    /// Description, one sentence.
    pub what: String,
}

/// Report of a verification.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct VerifyReport {
    /// Violated invariants; empty for a sound store.
    pub faults: Vec<InvariantFault>,
    /// Notes for a person: interrupted series, content of `incoming/` and `partial/`.
    pub notes: Vec<String>,
    /// Number of flights.
    pub flights: usize,
    /// Number of series.
    pub series: usize,
    /// Number of frames whose digest was computed.
    pub frames: usize,
    /// Bytes of those frames.
    pub bytes: u64,
    /// Number of results.
    pub results: usize,
}

impl fmt::Display for InvariantFault {
    /// Formats the error on one line: its path and names may hold any characters.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = printable_path(&self.what);
        write!(
            f,
            "invariant {}: {}: {what}",
            self.invariant,
            printable_path(&self.path)
        )
    }
}

impl VerifyReport {
    /// Returns whether every invariant is satisfied.
    pub fn is_sound(&self) -> bool {
        self.faults.is_empty()
    }

    pub(super) fn add_fault(&mut self, invariant: u8, path: &Path, problem: impl Into<String>) {
        self.faults.push(InvariantFault {
            invariant,
            path: path.to_owned(),
            what: problem.into(),
        });
    }
}
