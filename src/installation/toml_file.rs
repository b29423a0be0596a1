//! Name of the main file, and deserialization of TOML tables.

use std::path::Path;

use super::{Reader, toml_fault};

/// Main file, which names the others.
pub(super) const INSTALLATION_FILE: &str = "installation.toml";

/// Deserializes a TOML table; an error names the line and key reported by the parser.
pub(super) fn parse_toml<T: serde::de::DeserializeOwned>(reader: &mut Reader, file: &Path, text: &str) -> Option<T> {
    match toml::from_str(text) {
        Ok(value) => Some(value),
        Err(error) => {
            let fault = toml_fault(file, text, &error, "correct it as described in docs/interface.md");
            reader.faults.push(fault);
            None
        }
    }
}
