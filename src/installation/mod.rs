//! The directory that a user prepares for an aircraft: it is read, checked, and written back to.
//!
//! `installation.toml` names the other files (`docs/reference/installation-toml.md` has every key). Every
//! fault of every file is gathered in one go, and each names the file, the key or line, the value and the mend:
//!
//! ```
//! use std::path::Path;
//! use wingd::installation;
//!
//! let folder = tempfile::tempdir()?;
//! for name in ["installation.toml", "camera.toml", "survey.csv"] {
//!     std::fs::copy(Path::new("fixtures/dev/installation").join(name), folder.path().join(name))?;
//! }
//! let found = installation::load(folder.path()).expect("the fixture is in order");
//! assert_eq!(found.setup.markers.len(), 21);
//!
//! let text = std::fs::read_to_string(folder.path().join("installation.toml"))?;
//! let text = text.replace("root_offset_m = 0.55", "root_offset_m = 550");
//! std::fs::write(folder.path().join("installation.toml"), text)?;
//! let faults = installation::load(folder.path()).unwrap_err();
//! assert_eq!((faults[0].place.as_str(), faults[0].problem.as_str()), ("wing.root_offset_m", "is 550.0 m"));
//! assert_eq!(faults[0].mend, "give a number from -50 to 50 m");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod board;
mod camera;
mod corners;
mod document;
mod exchange;
mod fault;
mod flight_effects;
mod flight_prior;
mod keyed;
mod mountings;
mod observations;
mod orientation;
mod plausible;
mod rows;
mod structure;
mod survey;
mod tables;
mod text;
mod ties;
mod toml_file;
mod warnings;
mod window;
mod written;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

pub use board::{DescribedBoard, load_board};
pub use camera::{CalibrationReport, write_camera};
pub use corners::{PictureCorners, read_corners, write_corners};
pub use exchange::{CameraFormat, ReadCamera, WriteError, format_of_name, read_exchange, write_exchange};
pub use fault::{Fault, KeyFault};
pub use flight_prior::{LEARNT_FILE, Learnt, Source, write_learnt};
pub use keyed::Trouble;
pub use mountings::{Mountings, read_mountings};
pub use observations::{ManualObservation, ManualPosition, observations_text, read_observations};
pub use orientation::write_orientation;
pub use rows::{Row, RowsError, rows, separator_line};
pub use structure::{Structure, read_stiffness};
pub use tables::Optics;
pub use text::{shown_path, text_of};
pub use warnings::doubts;
pub use written::write_installation;

use crate::measure::geometry::TransformFit;
use crate::measure::setup::{Orientation, Setup};

/// A directory that was read and found in order.
#[derive(Clone, Debug)]
pub struct Installation {
    /// Where it was read from.
    pub directory: PathBuf,
    /// Its numbers.
    pub setup: Setup,
    /// From `orientation.toml`, where that exists.
    pub orientation: Option<Orientation>,
    /// Markers that the ground frames of the orientation did not use (index in the survey), and why.
    pub not_on_ground: Vec<(usize, String)>,
    /// CAD frame from survey frame, from the tie points.
    pub cad: Option<TransformFit>,
    /// The lens and sensor as bought, for planning.
    pub optics: Option<Optics>,
    /// The wing as a beam, for moments.
    pub structure: Option<Structure>,
    /// (file name, SHA-256) of every file that was read, for provenance.
    pub digests: Vec<(String, String)>,
    /// Names of the files with camera and survey, which an orientation is bound to.
    pub sources: [String; 2],
    /// What flights taught (`wingd learn`); holds for the orientation.
    pub learnt: Option<Learnt>,
    /// Why a refused calibration of the camera was taken all the same (`wingd calibrate --accept`).
    pub accepted: Option<String>,
}

/// Name of the file that `wingd orient` writes.
pub const ORIENTATION_FILE: &str = "orientation.toml";

impl Installation {
    /// (name, bytes) of every file that was read; a fault where one has changed since.
    pub fn files(&self) -> Result<Vec<(String, Vec<u8>)>, Fault> {
        let read = |(name, digest): &(String, String)| {
            let file = self.directory.join(name);
            let same = |bytes: &Vec<u8>| hex::encode(Sha256::digest(bytes)) == *digest;
            let bytes = std::fs::read(&file).ok().filter(same);
            let bytes = bytes
                .ok_or_else(|| Fault::new(file, "file", "has changed while it was read", "start again"))?;
            Ok((name.clone(), bytes))
        };
        self.digests.iter().map(read).collect()
    }

    /// The orientation, or the fault of not having one.
    pub fn require_orientation(&self) -> Result<&Orientation, Fault> {
        self.orientation.as_ref().ok_or_else(|| {
            let mend = format!("run `wingd orient --installation {} GROUND_FRAME`", self.directory.display());
            Fault::new(self.directory.join(ORIENTATION_FILE), "file", "there is no orientation yet", mend)
        })
    }
}

/// Gathers faults while files are read, and hashes what was read.
struct Reader {
    directory: PathBuf,
    faults: Vec<Fault>,
    digests: Vec<(String, String)>,
}

impl Reader {
    /// For a file that lies anywhere: its directory's reader, and its name.
    fn of_file(file: &Path) -> (Self, PathBuf) {
        let directory = file.parent().unwrap_or(Path::new("")).to_owned();
        let name = file.file_name().map(PathBuf::from).unwrap_or_default();
        (Self { directory, faults: vec![], digests: vec![] }, name)
    }

    fn trouble(&mut self, file: &Path, trouble: Trouble) {
        self.faults.push(trouble.of(file));
    }

    fn fault(&mut self, file: &Path, place: &str, problem: impl Into<String>, mend: impl Into<String>) {
        self.faults.push(Fault::new(file, place, problem, mend));
    }

    /// A file's text; a fault where it cannot be read.
    fn text(&mut self, name: impl AsRef<Path>, mend: &str) -> Option<(PathBuf, String)> {
        let file = self.directory.join(&name);
        let escaped = name.as_ref().to_string_lossy().contains(char::is_control);
        let bytes = match std::fs::read(&file) {
            Ok(bytes) => bytes,
            Err(_) if escaped => {
                let problem = "is no name: a backslash within double quotes begins an escape, such as \\n";
                self.fault(&file, "file", problem, "write the path with /, or in single quotes: 'C:\\data'");
                return None;
            }
            Err(error) => {
                self.fault(&file, "file", format!("cannot be read ({error})"), mend);
                return None;
            }
        };
        self.digests.push((shown_path(name.as_ref()), hex::encode(Sha256::digest(&bytes))));
        match text_of(bytes) {
            Ok(text) => Some((file, text)),
            Err((problem, mend)) => {
                self.fault(&file, "file", problem, mend);
                None
            }
        }
    }
}

/// Reads and checks an installation.
pub fn load(directory: &Path) -> Result<Installation, Vec<Fault>> {
    read(directory, true)
}

/// Reads and checks an installation but for an orientation that is about to be written anew.
pub fn load_without_orientation(directory: &Path) -> Result<Installation, Vec<Fault>> {
    read(directory, false)
}

fn read(directory: &Path, with_orientation: bool) -> Result<Installation, Vec<Fault>> {
    let mut reader = Reader { directory: directory.into(), faults: vec![], digests: vec![] };
    let parts = document::read(&mut reader);
    let markers = parts.as_ref().map_or(&[][..], |parts| &parts.setup.markers);
    // What an orientation holds for is not known where the rest is at fault.
    let orientation = if with_orientation && reader.faults.is_empty() {
        orientation::read(&mut reader, markers)
    } else {
        None
    };
    let (orientation, not_on_ground) = orientation.unzip();
    let learnt = match &parts {
        Some(parts) if orientation.is_some() && reader.faults.is_empty() => {
            flight_prior::read(&mut reader, &parts.setup, &parts.sources)
        }
        _ => None,
    };
    let cad = parts.as_ref().and_then(|parts| ties::transform(&mut reader, &parts.setup));
    match parts {
        Some(parts) if reader.faults.is_empty() => Ok(Installation {
            directory: directory.into(),
            setup: parts.setup,
            orientation,
            not_on_ground: not_on_ground.unwrap_or_default(),
            cad,
            optics: parts.optics,
            structure: parts.structure,
            digests: reader.digests,
            sources: parts.sources,
            learnt,
            accepted: parts.accepted,
        }),
        _ => Err(folded(reader.faults)),
    }
}

/// Faults alike that are given one by one; of more the first stands for all.
const MAX_SIMILAR_NAMES: usize = 3;

/// Lines without numbers as one fault each: rows of units, headers again, totals. Where many lines are so, it is the columns.
fn lines_without_numbers(faults: Vec<Fault>) -> Vec<Fault> {
    let line = |f: &Fault| f.place.split_once(", column ").map(|(line, _)| (f.file.clone(), line.to_owned()));
    let mut counts: BTreeMap<_, usize> = BTreeMap::new();
    let numbers = faults.iter().filter(|f| f.problem.contains(rows::NO_NUMBER));
    numbers.filter_map(line).for_each(|line| *counts.entry(line).or_default() += 1);
    counts.retain(|_, count| *count > MAX_SIMILAR_NAMES);
    if counts.len() > MAX_SIMILAR_NAMES {
        return faults;
    }
    let (of_these, mut kept): (Vec<_>, Vec<_>) =
        faults.into_iter().partition(|f| line(f).is_some_and(|line| counts.contains_key(&line)));
    let mend = "leave the line out if it is a row of units, a second header or a total";
    let one = |(file, line)| Fault::new(file, line, "holds no numbers where its columns need them", mend);
    kept.splice(0..0, of_these.iter().filter_map(line).collect::<BTreeSet<_>>().into_iter().map(one));
    kept
}

/// One cause on many lines, or in many cells of a line, as one fault.
fn folded(faults: Vec<Fault>) -> Vec<Fault> {
    let faults = lines_without_numbers(faults);
    let kind = |f: &Fault| {
        let place = f.place.split_once(", ").filter(|(line, _)| line.starts_with("line "));
        let marker = if f.place.starts_with("marker ") { "marker" } else { f.place.as_str() };
        let whole = if f.place.starts_with("line ") { "line" } else { marker };
        (f.file.clone(), place.map_or(whole, |(_, column)| column).to_owned(), f.remedy.clone())
    };
    let kinds: Vec<_> = faults.iter().map(kind).collect();
    let mut kept: Vec<Fault> = vec![];
    for (k, mut fault) in faults.into_iter().enumerate() {
        let alike = kinds.iter().filter(|other| **other == kinds[k]).count();
        if alike > MAX_SIMILAR_NAMES {
            if kinds[..k].contains(&kinds[k]) {
                continue;
            }
            fault.problem = format!("{}, and {} more like it", fault.problem, alike - 1);
        }
        kept.push(fault);
    }
    kept
}

/// Reads a camera file alone (`camera.toml`).
pub fn load_camera(file: &Path) -> Result<crate::measure::geometry::Lens, Vec<Fault>> {
    let (mut reader, name) = Reader::of_file(file);
    let lens = camera::read(&mut reader, &name);
    lens.map(|camera| camera.lens).filter(|_| reader.faults.is_empty()).ok_or(reader.faults)
}

/// A TOML parser's complaint as a fault with its line.
pub fn toml_fault(file: &Path, text: &str, error: &toml::de::Error, mend: &str) -> Fault {
    let line = error.span().map(|s| 1 + text.get(..s.start).map_or(0, |t| t.matches('\n').count()));
    let shown = line.and_then(|l| text.lines().nth(l - 1)).map(str::trim).unwrap_or_default();
    let place = line.map_or("file".into(), |l| format!("line {l} (`{shown}`)"));
    let at = error.span().and_then(|span| text.get(span)).unwrap_or_default();
    let (problem, mend) = match common_toml_mistake(shown, at, error.message()) {
        Some((problem, mend)) => (problem.to_owned(), mend),
        None => (error.message().replace('\n', " "), mend),
    };
    Fault::new(file, place, problem, mend)
}

/// What hands write that TOML takes for something else, and the mend: paths with backslashes, dates without quotes, decimal
/// commas, quotes of text programs.
fn common_toml_mistake(line: &str, at: &str, said: &str) -> Option<(&'static str, &'static str)> {
    let value = line.split_once('=').map_or("", |(_, value)| value.trim());
    if value.starts_with('"') && said.contains("escape") {
        let mend = "write the path with /, or in single quotes: 'C:\\data'";
        return Some(("has a backslash, which begins an escape within double quotes", mend));
    }
    let parts = value
        .split_once(',')
        .filter(|parts| [parts.0, parts.1].iter().all(|p| p.trim().parse::<i64>().is_ok()));
    if parts.is_some() {
        return Some(("has a decimal comma", "write a point in numbers: 0.55"));
    }
    if value.starts_with(['\u{201c}', '\u{201d}', '\u{201e}', '\u{2018}', '\u{2019}']) {
        return Some(("has the quotes of a text program", "write a text in straight quotes: \"survey.csv\""));
    }
    let date = !at.is_empty() && at.trim().parse::<toml::value::Datetime>().is_ok();
    date.then_some(("is a date where a text or a number must be", "write a text in quotes: \"2026-06-01\""))
}

/// Writes a page whole or not at all.
pub fn write_page(file: &Path, text: &str) -> std::io::Result<()> {
    write_whole(file, text)
}

/// Writes a file whole or not at all, durable before its name appears.
fn write_whole(file: &Path, text: &str) -> std::io::Result<()> {
    use std::io::Write;
    use std::os::unix::fs::PermissionsExt;
    let directory = file.parent().filter(|d| !d.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut temporary = tempfile::NamedTempFile::new_in(directory)?;
    temporary.write_all(text.as_bytes())?;
    temporary.as_file().set_permissions(std::fs::Permissions::from_mode(0o644))?;
    temporary.as_file().sync_all()?;
    temporary.persist(file).map_err(|e| e.error)?;
    std::fs::File::open(directory)?.sync_all()
}
