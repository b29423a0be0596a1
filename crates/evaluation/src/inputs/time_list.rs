//! List of the times of images, a CSV file of the user.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

use crate::installation::parse_rows;
use wingd_base::clock::written_time::WrittenTime;
use wingd_base::failure::{Failure, TaskResult, read_text_file};
use wingd_base::fault::KeyFault;

/// First year of a time in a name or list.
pub const FIRST_YEAR: i16 = 1990;

/// Times by name of image.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeList {
    /// File that was read.
    pub file: PathBuf,
    /// Names with their lines and times, by the last part of the name.
    images: BTreeMap<OsString, Vec<(PathBuf, u64, WrittenTime)>>,
}

/// Names of the columns of a list: image, time.
const LIST_COLUMNS: [&[&str]; 2] = [
    &[
        "image",
        "file",
        "filename",
        "file_name",
        "name",
        "frame",
        "picture",
    ],
    &[
        "utc",
        "time",
        "timestamp",
        "time_utc",
        "datetime",
        "date_time",
    ],
];

impl TimeList {
    /// Reads a CSV file with the columns image and utc; times without a zone are UTC.
    ///
    /// # Errors
    /// Returns the first error of the file with its line and remedy.
    pub fn read(file: &Path) -> TaskResult<Self> {
        let text = read_text_file(file)?;
        Self::parse(file, &text).map_err(|fault| Failure::from(fault.into_fault(file)))
    }

    fn parse(file: &Path, text: &str) -> Result<Self, KeyFault> {
        let fault =
            |line, problem: String, remedy: &str| KeyFault::on_line(line, "", problem, remedy);
        let separator = [';', '\t']
            .into_iter()
            .find(|s| text.lines().next().is_some_and(|l| l.contains(*s)));
        let rows = parse_rows(text, separator.unwrap_or(','))
            .map_err(|error| fault(error.line(), error.to_string(), "correct the line"))?;
        let plain = |cell: &String| {
            let name = cell.split(['[', '(']).next().unwrap_or_default();
            name.trim_matches(['#', ' ']).to_lowercase()
        };
        let place = |names: &[&str]| {
            rows.first()?
                .cells
                .iter()
                .position(|c| names.contains(&plain(c).as_str()))
        };
        let [Some(image), Some(time)] = LIST_COLUMNS.map(place) else {
            return Err(fault(
                1,
                "is not the header of a list of times".into(),
                "write image,utc there",
            ));
        };
        let mut images: BTreeMap<OsString, Vec<(PathBuf, u64, WrittenTime)>> = BTreeMap::new();
        for row in rows.iter().skip(1) {
            let cell = |k: usize| row.cells.get(k).map(String::as_str).unwrap_or_default();
            let written = WrittenTime::find(cell(time), FIRST_YEAR).ok_or_else(|| {
                fault(
                    row.line,
                    format!("has no time (\"{}\")", cell(time)),
                    "write it as 2026-06-01T08:00:00Z",
                )
            })?;
            let name = PathBuf::from(cell(image));
            let last = name.file_name().map(OsStr::to_owned).unwrap_or_default();
            let alike = images.entry(last).or_default();
            if let Some((_, line, _)) = alike.iter().find(|(other, ..)| *other == name) {
                return Err(fault(
                    row.line,
                    format!("repeats {} of line {line}", cell(image)),
                    "keep the valid line",
                ));
            }
            alike.push((name, row.line, written));
        }
        Ok(Self {
            file: file.to_owned(),
            images,
        })
    }

    /// Returns the number of images that it names.
    pub fn count(&self) -> usize {
        self.images.values().map(Vec::len).sum()
    }

    /// Returns line and time of an image: its path or its path without the extension ends with the name in the list.
    pub fn find(&self, image: &Path) -> Option<(u64, WrittenTime)> {
        [image.to_owned(), image.with_extension("")]
            .iter()
            .find_map(|path| {
                let alike = self.images.get(path.file_name()?)?;
                alike
                    .iter()
                    .find(|(name, ..)| path.ends_with(name))
                    .map(|(_, line, time)| (*line, *time))
            })
    }
}
