//! Reader of the files of a directory, which collects errors and digests.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::fold::fold_repeated;
use wingd_base::fault::Fault;
use wingd_base::text::{decode_text, printable_path};
use wingd_base::toml_fault::toml_fault;

/// Reader of an installation's files, which collects errors and hashes.
pub(crate) struct Reader {
    pub directory: PathBuf,
    pub faults: Vec<Fault>,
    /// Name and SHA-256 of every file that was read.
    pub digests: Vec<(String, String)>,
}

impl Reader {
    /// Creates the reader of a directory.
    pub fn new(directory: &Path) -> Self {
        Self {
            directory: directory.into(),
            faults: vec![],
            digests: vec![],
        }
    }

    /// Reads a file in any directory; `parse` gets the reader and the file's name.
    ///
    /// # Errors
    /// Returns all errors that were reported.
    pub fn read_file<T>(
        file: &Path,
        parse: impl FnOnce(&mut Self, &Path) -> Option<T>,
    ) -> Result<T, Vec<Fault>> {
        let mut reader = Self::new(file.parent().unwrap_or(Path::new("")));
        let found = parse(&mut reader, Path::new(file.file_name().unwrap_or_default()));
        found
            .filter(|_| reader.faults.is_empty())
            .ok_or_else(|| fold_repeated(reader.faults))
    }

    /// Reports an error of a file.
    pub fn fault(
        &mut self,
        file: &Path,
        place: &str,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) {
        self.faults.push(Fault::new(file, place, problem, remedy));
    }

    /// Reports a number outside its range.
    pub fn check_range(
        &mut self,
        file: &Path,
        place: &str,
        value: f64,
        range: RangeInclusive<f64>,
        unit: &str,
    ) {
        if !range.contains(&value) {
            let problem = format!("is {value:?} {unit}");
            let remedy = format!(
                "give a number from {} to {} {unit}",
                range.start(),
                range.end()
            );
            self.fault(file, place, problem.trim_end(), remedy.trim_end());
        }
    }

    /// Reads the text of a file; reports an error if it cannot be read.
    pub fn read_text(&mut self, name: impl AsRef<Path>, remedy: &str) -> Option<(PathBuf, String)> {
        let (file, bytes) = self.read_bytes(name, remedy)?;
        match decode_text(bytes) {
            Ok(text) => Some((file, text)),
            Err((problem, remedy)) => {
                self.fault(&file, "file", problem, remedy);
                None
            }
        }
    }

    /// Reads a file and its digest; reports an error if it cannot be read.
    pub fn read_bytes(
        &mut self,
        name: impl AsRef<Path>,
        remedy: &str,
    ) -> Option<(PathBuf, Vec<u8>)> {
        let file = self.directory.join(&name);
        let escaped = name.as_ref().to_string_lossy().contains(char::is_control);
        let bytes = match std::fs::read(&file) {
            Ok(bytes) => bytes,
            Err(_) if escaped => {
                let problem = "is not a valid path: within double quotes a backslash begins an escape, such as \\n";
                self.fault(
                    &file,
                    "file",
                    problem,
                    "write the path with /, or in single quotes: 'C:\\data'",
                );
                return None;
            }
            Err(error) => {
                self.fault(&file, "file", format!("cannot be read ({error})"), remedy);
                return None;
            }
        };
        self.digests.push((
            printable_path(name.as_ref()),
            hex::encode(Sha256::digest(&bytes)),
        ));
        Some((file, bytes))
    }

    /// Deserializes a TOML table; an error names the line and key reported by the parser.
    pub fn parse_toml<T: serde::de::DeserializeOwned>(
        &mut self,
        file: &Path,
        text: &str,
    ) -> Option<T> {
        let fault = |error| {
            toml_fault(
                file,
                text,
                &error,
                "correct it as described in docs/reference/files.md",
            )
        };
        toml::from_str(text)
            .map_err(|error| self.faults.push(fault(error)))
            .ok()
    }
}
