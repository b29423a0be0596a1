//! Reader of the files of a directory, which collects errors and digests.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::fold::fold_repeated;
use wingd_base::fault::Fault;
use wingd_base::regular_file::{MAX_FILE_BYTES, read_regular_file};
use wingd_base::text::{decode_text, printable_path};
use wingd_base::toml_fault::parse_toml;

/// Reader of an installation's files, which collects errors and hashes.
pub(crate) struct Reader {
    pub directory: PathBuf,
    pub faults: Vec<Fault>,
    /// Remarks that stop nothing: columns that are not read.
    pub notes: Vec<Fault>,
    /// Largest size of a file, bytes.
    pub max_bytes: u64,
    /// Name and SHA-256 of every file that was read.
    pub digests: Vec<(String, String)>,
}

impl Reader {
    /// Creates the reader of a directory.
    pub fn new(directory: &Path) -> Self {
        Self {
            directory: directory.into(),
            faults: vec![],
            notes: vec![],
            max_bytes: MAX_FILE_BYTES,
            digests: vec![],
        }
    }

    /// Reads a file in any directory; `parse` gets the reader and the file's name. Remarks go to standard error.
    ///
    /// # Errors
    /// Returns all errors that were reported.
    pub fn read_file<T>(
        file: &Path,
        parse: impl FnOnce(&mut Self, &Path) -> Option<T>,
    ) -> Result<T, Vec<Fault>> {
        let mut reader = Self::new(file.parent().unwrap_or(Path::new("")));
        let found = parse(&mut reader, Path::new(file.file_name().unwrap_or_default()));
        for note in &reader.notes {
            wingd_base::eprintln!("wingd: {note}");
        }
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
        if let Some((problem, remedy)) = range_problem(value, range, unit) {
            self.fault(file, place, problem, remedy);
        }
    }

    /// Reads the text of a file; reports an error if it cannot be read.
    pub fn read_text(&mut self, name: impl AsRef<Path>, remedy: &str) -> Option<(PathBuf, String)> {
        let (file, bytes) = self.read_bytes(name, remedy)?;
        let fault = |(problem, remedy)| self.fault(&file, "file", problem, remedy);
        let text = decode_text(bytes).map_err(fault).ok()?;
        Some((file, text))
    }

    /// Reads a file and its digest; reports an error if it cannot be read.
    pub fn read_bytes(
        &mut self,
        name: impl AsRef<Path>,
        remedy: &str,
    ) -> Option<(PathBuf, Vec<u8>)> {
        let file = self.directory.join(&name);
        let escaped = name.as_ref().to_string_lossy().contains(char::is_control);
        let bytes = match read_regular_file(&file, self.max_bytes) {
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
        let remedy = "correct it as described in docs/reference/files.md";
        parse_toml(file, text, &[], remedy)
            .map_err(|fault| self.faults.push(fault))
            .ok()
    }
}

/// Returns problem and remedy of a number outside its range.
pub(super) fn range_problem(
    value: f64,
    range: RangeInclusive<f64>,
    unit: &str,
) -> Option<(String, String)> {
    let problem = format!("is {value:?} {unit}");
    let (low, high) = (range.start(), range.end());
    let remedy = format!("give a number from {low} to {high} {unit}");
    (!range.contains(&value)).then(|| (problem.trim_end().into(), remedy.trim_end().into()))
}
