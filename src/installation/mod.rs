//! Installation of an aircraft: a directory prepared by the user, which is read, checked, and written to.
//!
//! `installation.toml` names the other files (`docs/reference/installation-toml.md` has every key). The
//! errors of all files are collected, and each names the file, the key or line, the value and the remedy:
//!
//! ```
//! use std::path::Path;
//! use wingd::installation;
//!
//! let folder = tempfile::tempdir()?;
//! for name in ["installation.toml", "camera.toml", "survey.csv"] {
//!     std::fs::copy(Path::new("fixtures/dev/installation").join(name), folder.path().join(name))?;
//! }
//! let found = installation::load(folder.path()).expect("the fixture has no errors");
//! assert_eq!(found.setup.markers.len(), 21);
//!
//! let text = std::fs::read_to_string(folder.path().join("installation.toml"))?;
//! let text = text.replace("root_offset_m = 0.55", "root_offset_m = 550");
//! std::fs::write(folder.path().join("installation.toml"), text)?;
//! let faults = installation::load(folder.path()).unwrap_err();
//! assert_eq!((faults[0].place.as_str(), faults[0].problem.as_str()), ("wing.root_offset_m", "is 550.0 m"));
//! assert_eq!(faults[0].remedy, "give a number from -50 to 50 m");
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
mod write_setup;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

pub use board::{DescribedBoard, load_board};
pub use camera::{CalibrationReport, write_camera};
pub use corners::{ImageCorners, read_corners, write_corners};
pub use exchange::{CameraFormat, ReadCamera, WriteError, output_format, read_exchange, write_exchange};
pub use fault::{Fault, KeyFault};
pub use flight_prior::{FLIGHT_PRIOR_FILE, PriorFlight, StoredFlightPrior, write_flight_prior};
pub use keyed::LineFault;
pub use mountings::{Mountings, read_mountings};
pub use observations::{ManualObservation, ManualPosition, observations_text, read_observations};
pub use orientation::write_orientation;
pub use rows::{Row, RowsError, parse_rows, separator_line};
pub use structure::{Structure, read_stiffness};
pub use tables::OpticsTable;
pub use text::{cell_text, decode_text, printable_path, printable_text, text_cell};
pub use warnings::find_warnings;
pub use write_setup::write_installation;

use crate::measure::geometry::TransformFit;
use crate::measure::setup::{Orientation, Setup};

/// Installation that was read without errors.
#[derive(Clone, Debug)]
pub struct Installation {
    /// Directory of the files.
    pub directory: PathBuf,
    /// Measured and configured values.
    pub setup: Setup,
    /// Orientation from `orientation.toml`, if it exists.
    pub orientation: Option<Orientation>,
    /// Markers that the ground frames of the orientation did not use (index in the survey), with the reason.
    pub unused_on_ground: Vec<(usize, String)>,
    /// Transform from survey to CAD frame, from the tie points.
    pub cad: Option<TransformFit>,
    /// Data of the lens and sensor, for planning.
    pub optics: Option<OpticsTable>,
    /// Beam model of the wing, for moments.
    pub structure: Option<Structure>,
    /// Name and SHA-256 of every file that was read, for provenance.
    pub digests: Vec<(String, String)>,
    /// Names of the camera and survey files, which an orientation depends on.
    pub sources: [String; 2],
    /// Prior from earlier flights (`wingd learn`), for the present orientation.
    pub flight_prior: Option<StoredFlightPrior>,
    /// Reason for accepting a refused calibration of the camera (`wingd calibrate --accept`).
    pub accepted: Option<String>,
}

/// Name of the file that `wingd orient` writes.
pub const ORIENTATION_FILE: &str = "orientation.toml";

impl Installation {
    /// Returns name and bytes of every file that was read, or an error if one has changed since.
    pub fn files(&self) -> Result<Vec<(String, Vec<u8>)>, Fault> {
        let read = |(name, digest): &(String, String)| {
            let file = self.directory.join(name);
            let same = |bytes: &Vec<u8>| hex::encode(Sha256::digest(bytes)) == *digest;
            let bytes = std::fs::read(&file).ok().filter(same);
            let bytes =
                bytes.ok_or_else(|| Fault::new(file, "file", "has changed since it was read", "start again"))?;
            Ok((name.clone(), bytes))
        };
        self.digests.iter().map(read).collect()
    }

    /// Returns the orientation, or an error if there is none.
    pub fn require_orientation(&self) -> Result<&Orientation, Fault> {
        self.orientation.as_ref().ok_or_else(|| {
            let remedy = format!("run `wingd orient --installation {} GROUND_FRAME`", self.directory.display());
            Fault::new(self.directory.join(ORIENTATION_FILE), "file", "there is no orientation yet", remedy)
        })
    }
}

/// Reader of an installation's files, which collects errors and hashes.
struct Reader {
    directory: PathBuf,
    faults: Vec<Fault>,
    digests: Vec<(String, String)>,
}

impl Reader {
    /// Creates the reader for a file in any directory; returns it and the file's name.
    fn for_file(file: &Path) -> (Self, PathBuf) {
        let directory = file.parent().unwrap_or(Path::new("")).to_owned();
        let name = file.file_name().map(PathBuf::from).unwrap_or_default();
        (Self { directory, faults: vec![], digests: vec![] }, name)
    }

    fn add_line_fault(&mut self, file: &Path, fault: LineFault) {
        self.faults.push(fault.into_fault(file));
    }

    fn fault(&mut self, file: &Path, place: &str, problem: impl Into<String>, remedy: impl Into<String>) {
        self.faults.push(Fault::new(file, place, problem, remedy));
    }

    /// Reads the text of a file; reports an error if it cannot be read.
    fn read_text(&mut self, name: impl AsRef<Path>, remedy: &str) -> Option<(PathBuf, String)> {
        let file = self.directory.join(&name);
        let escaped = name.as_ref().to_string_lossy().contains(char::is_control);
        let bytes = match std::fs::read(&file) {
            Ok(bytes) => bytes,
            Err(_) if escaped => {
                let problem = "is not a valid path: within double quotes a backslash begins an escape, such as \\n";
                self.fault(&file, "file", problem, "write the path with /, or in single quotes: 'C:\\data'");
                return None;
            }
            Err(error) => {
                self.fault(&file, "file", format!("cannot be read ({error})"), remedy);
                return None;
            }
        };
        self.digests.push((printable_path(name.as_ref()), hex::encode(Sha256::digest(&bytes))));
        match decode_text(bytes) {
            Ok(text) => Some((file, text)),
            Err((problem, remedy)) => {
                self.fault(&file, "file", problem, remedy);
                None
            }
        }
    }
}

/// Reads and checks an installation.
pub fn load(directory: &Path) -> Result<Installation, Vec<Fault>> {
    read_installation(directory, true)
}

/// Reads and checks an installation without its orientation, which is about to be written again.
pub fn load_without_orientation(directory: &Path) -> Result<Installation, Vec<Fault>> {
    read_installation(directory, false)
}

fn read_installation(directory: &Path, with_orientation: bool) -> Result<Installation, Vec<Fault>> {
    let mut reader = Reader { directory: directory.into(), faults: vec![], digests: vec![] };
    let parts = document::read_document(&mut reader);
    let markers = parts.as_ref().map_or(&[][..], |parts| &parts.setup.markers);
    // An orientation cannot be checked against camera and survey if these have errors.
    let orientation = if with_orientation && reader.faults.is_empty() {
        orientation::read_orientation(&mut reader, markers)
    } else {
        None
    };
    let (orientation, not_on_ground) = orientation.unzip();
    let flight_prior = match &parts {
        Some(parts) if orientation.is_some() && reader.faults.is_empty() => {
            flight_prior::read_flight_prior(&mut reader, &parts.setup, &parts.sources)
        }
        _ => None,
    };
    let cad = parts.as_ref().and_then(|parts| ties::estimate_transform(&mut reader, &parts.setup));
    match parts {
        Some(parts) if reader.faults.is_empty() => Ok(Installation {
            directory: directory.into(),
            setup: parts.setup,
            orientation,
            unused_on_ground: not_on_ground.unwrap_or_default(),
            cad,
            optics: parts.optics,
            structure: parts.structure,
            digests: reader.digests,
            sources: parts.sources,
            flight_prior,
            accepted: parts.accepted,
        }),
        _ => Err(fold_repeated(reader.faults)),
    }
}

/// Largest number of similar errors that are reported individually; of more, the first represents all.
const MAX_SIMILAR_FAULTS: usize = 3;

/// Combines the errors of each line without numbers: rows of units, repeated headers, totals. If many lines are affected,
/// the cause is the columns.
fn fold_lines_without_numbers(faults: Vec<Fault>) -> Vec<Fault> {
    let line = |f: &Fault| f.place.split_once(", column ").map(|(line, _)| (f.file.clone(), line.to_owned()));
    let mut counts: BTreeMap<_, usize> = BTreeMap::new();
    let numbers = faults.iter().filter(|f| f.problem.contains(rows::NO_NUMBER));
    numbers.filter_map(line).for_each(|line| *counts.entry(line).or_default() += 1);
    counts.retain(|_, count| *count > MAX_SIMILAR_FAULTS);
    if counts.len() > MAX_SIMILAR_FAULTS {
        return faults;
    }
    let (of_these, mut kept): (Vec<_>, Vec<_>) =
        faults.into_iter().partition(|f| line(f).is_some_and(|line| counts.contains_key(&line)));
    let remedy = "delete the line if it is a row of units, a second header or a total";
    let one = |(file, line)| Fault::new(file, line, "has no numbers in columns that need them", remedy);
    kept.splice(0..0, of_these.iter().filter_map(line).collect::<BTreeSet<_>>().into_iter().map(one));
    kept
}

/// Combines errors with the same cause on many lines, or in many cells of a line.
fn fold_repeated(faults: Vec<Fault>) -> Vec<Fault> {
    let faults = fold_lines_without_numbers(faults);
    let kind = |f: &Fault| {
        let place = f.place.split_once(", ").filter(|(line, _)| line.starts_with("line "));
        let marker = if f.place.starts_with("marker ") { "marker" } else { f.place.as_str() };
        let whole = if f.place.starts_with("line ") { "line" } else { marker };
        (f.file.clone(), place.map_or(whole, |(_, column)| column).to_owned(), f.remedy.clone())
    };
    let kinds: Vec<_> = faults.iter().map(kind).collect();
    let mut kept: Vec<Fault> = vec![];
    for (k, mut fault) in faults.into_iter().enumerate() {
        let similar = kinds.iter().filter(|other| **other == kinds[k]).count();
        if similar > MAX_SIMILAR_FAULTS {
            if kinds[..k].contains(&kinds[k]) {
                continue;
            }
            fault.problem = format!("{}, and {} similar errors", fault.problem, similar - 1);
        }
        kept.push(fault);
    }
    kept
}

/// Reads a camera file alone (`camera.toml`).
pub fn load_camera(file: &Path) -> Result<crate::measure::geometry::Lens, Vec<Fault>> {
    let (mut reader, name) = Reader::for_file(file);
    let lens = camera::read_camera(&mut reader, &name);
    lens.map(|camera| camera.lens).filter(|_| reader.faults.is_empty()).ok_or(reader.faults)
}

/// Converts an error of the TOML parser into a fault with its line.
pub fn toml_fault(file: &Path, text: &str, error: &toml::de::Error, remedy: &str) -> Fault {
    let line = error.span().map(|s| 1 + text.get(..s.start).map_or(0, |t| t.matches('\n').count()));
    let shown = line.and_then(|l| text.lines().nth(l - 1)).map(str::trim).unwrap_or_default();
    let place = line.map_or("file".into(), |l| format!("line {l} (`{shown}`)"));
    let at = error.span().and_then(|span| text.get(span)).unwrap_or_default();
    let (problem, remedy) = match common_toml_mistake(shown, at, error.message()) {
        Some((problem, remedy)) => (problem.to_owned(), remedy),
        None => (error.message().replace('\n', " "), remedy),
    };
    Fault::new(file, place, problem, remedy)
}

/// Returns problem and remedy of common mistakes in TOML: paths with backslashes, dates without quotes, decimal commas,
/// typographic quotes.
fn common_toml_mistake(line: &str, at: &str, message: &str) -> Option<(&'static str, &'static str)> {
    let value = line.split_once('=').map_or("", |(_, value)| value.trim());
    if value.starts_with('"') && message.contains("escape") {
        let remedy = "write the path with /, or in single quotes: 'C:\\data'";
        return Some(("has a backslash, which begins an escape within double quotes", remedy));
    }
    let parts =
        value.split_once(',').filter(|parts| [parts.0, parts.1].iter().all(|p| p.trim().parse::<i64>().is_ok()));
    if parts.is_some() {
        return Some(("has a decimal comma", "use a decimal point: 0.55"));
    }
    if value.starts_with(['\u{201c}', '\u{201d}', '\u{201e}', '\u{2018}', '\u{2019}']) {
        return Some(("has typographic quotes", "use straight quotes: \"survey.csv\""));
    }
    let date = !at.is_empty() && at.trim().parse::<toml::value::Datetime>().is_ok();
    date.then_some(("is a date, but a text or a number is expected", "put a text in quotes: \"2026-06-01\""))
}

/// Writes a page atomically.
pub fn write_page(file: &Path, text: &str) -> std::io::Result<()> {
    write_atomically(file, text)
}

/// Writes a file atomically; it is durable before its name appears.
fn write_atomically(file: &Path, text: &str) -> std::io::Result<()> {
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
