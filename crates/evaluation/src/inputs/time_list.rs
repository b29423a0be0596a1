//! List of the times of images, a CSV file of the user.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

use crate::installation::{Reader, read_table};
use wingd_base::clock::written_time::WrittenTime;
use wingd_base::fault::Fault;

/// First year of a time in a name or list.
pub const FIRST_YEAR: i16 = 1990;

/// Names with their lines and times, by the last part of the name.
type Images = BTreeMap<OsString, Vec<(PathBuf, u64, WrittenTime)>>;

/// Times by name of image.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeList {
    /// File that was read.
    pub file: PathBuf,
    images: Images,
}

/// Columns of a list.
const COLUMNS: [&str; 2] = ["image", "utc"];

impl TimeList {
    /// Reads a CSV file with the columns image and utc; times without a zone are UTC.
    ///
    /// # Errors
    /// Returns the errors of the file with line and remedy.
    pub fn read(file: &Path) -> Result<Self, Vec<Fault>> {
        let images = Reader::read_file(file, |reader, name| {
            let remedy = "name a list with the columns image,utc";
            let (_, lines) = read_table(reader, name, remedy, COLUMNS, &[])?;
            let mut images = Images::new();
            for line in lines {
                let [image, written] = &line.cells;
                let Some(time) = WrittenTime::find(written, FIRST_YEAR) else {
                    let problem = format!("has no time (\"{written}\")");
                    line.fault(reader, problem, "write it as 2026-06-01T08:00:00Z");
                    continue;
                };
                let name = PathBuf::from(image);
                let last = name.file_name().map(OsStr::to_owned).unwrap_or_default();
                let same = images.entry(last).or_default();
                if let Some((_, first, _)) = same.iter().find(|(other, ..)| *other == name) {
                    let problem = format!("repeats {image} of line {first}");
                    line.fault(reader, problem, "keep the valid line");
                }
                same.push((name, line.number, time));
            }
            Some(images)
        })?;
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
