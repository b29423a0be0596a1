//! The directory a user prepares: read, validate, write back (CONTRACT.md section 2).

use std::path::PathBuf;

use crate::measure::setup::{Orientation, Setup};

/// A fault in something a user wrote: names the file, the key or line, the value and the mend.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}: {place}: {problem}; {mend}", .file.display())]
pub struct Fault {
    /// The file at fault.
    pub file: PathBuf,
    /// Key such as `camera.fx`, or `line 7, column sigma_m`.
    pub place: String,
    /// What is wrong, with the value.
    pub problem: String,
    /// What to do.
    pub mend: String,
}

/// A directory that was read and found in order.
#[derive(Clone, Debug)]
pub struct Installation {
    /// Where it was read from.
    pub directory: PathBuf,
    /// Its numbers.
    pub setup: Setup,
    /// From `orientation.toml`, where that exists.
    pub orientation: Option<Orientation>,
    /// (file name, SHA-256) of every file that was read, for provenance.
    pub digests: Vec<(String, String)>,
}
