//! What was checked and found.

use std::path::{Path, PathBuf};

use serde::Serialize;

/// A broken invariant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InvariantFault {
    /// Its number in docs/store.md.
    pub invariant: u8,
    /// Where.
    pub path: PathBuf,
    /// What is wrong, one sentence.
    pub what: String,
}

/// What was checked and found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct VerifyReport {
    /// Broken invariants; none in a sound store.
    pub faults: Vec<InvariantFault>,
    /// What a person should know: interrupted series, what lies in `incoming/` and `partial/`.
    pub notes: Vec<String>,
    /// Flights seen.
    pub flights: usize,
    /// Series seen.
    pub series: usize,
    /// Frames whose hash was computed.
    pub frames: usize,
    /// Bytes of those.
    pub bytes: u64,
    /// Results seen.
    pub results: usize,
}

impl VerifyReport {
    /// Whether every invariant holds.
    pub fn is_sound(&self) -> bool {
        self.faults.is_empty()
    }

    pub(super) fn add_fault(&mut self, invariant: u8, path: &Path, what: impl Into<String>) {
        self.faults.push(InvariantFault { invariant, path: path.to_owned(), what: what.into() });
    }
}
