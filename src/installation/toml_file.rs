//! The name of the main file, and TOML into tables of ours.

use std::path::Path;

use super::{Reader, toml_fault};

/// The main file, which names the others.
pub(super) const FILE: &str = "installation.toml";

/// TOML into a table of ours; the fault names the line and the key as the parser saw them.
pub(super) fn parse_toml<T: serde::de::DeserializeOwned>(
    reader: &mut Reader,
    file: &Path,
    text: &str,
) -> Option<T> {
    match toml::from_str(text) {
        Ok(value) => Some(value),
        Err(error) => {
            let fault = toml_fault(file, text, &error, "correct it as docs/interface.md describes the key");
            reader.faults.push(fault);
            None
        }
    }
}
