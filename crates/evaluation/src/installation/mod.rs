//! Installation of an aircraft: a directory prepared by the user, which is read, checked, and written to.
//!
//! `installation.toml` names the other files (`docs/reference/installation-toml.md` has every key). The
//! errors of all files are collected, and each names the file, the key or line, the value and the remedy:
//!
//! ```
//! use std::path::Path;
//! use wingd_evaluation::installation;
//!
//! let folder = tempfile::tempdir()?;
//! for name in ["installation.toml", "camera.toml", "survey.csv"] {
//!     std::fs::copy(Path::new("../../fixtures/dev/installation").join(name), folder.path().join(name))?;
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

mod camera;
mod columns;
mod document;
mod flight_prior;
mod fold;
mod mountings;
mod observations;
mod orientation;
mod plausible;
mod ranges;
mod reader;
mod rows;
mod section;
mod structure;
mod survey;
mod tables;
mod ties;
mod warnings;
mod window;
mod write_setup;

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use sha2::{Digest, Sha256};

pub use camera::{CalibrationReport, load_camera, write_camera};

pub use document::DEFAULT_CENTRE_SIGMA_M;
pub use flight_prior::{FLIGHT_PRIOR_FILE, PriorFlight, StoredFlightPrior, write_flight_prior};
pub use mountings::{Mountings, read_mountings};
pub use observations::{
    ManualObservation, ManualPosition, POINT_SIGMA_PX, observations_text, read_observations,
};
pub use orientation::write_orientation;
pub(crate) use reader::Reader;
pub use rows::{Row, RowsError, parse_rows};
pub(crate) use rows::{TableLine, parse_records, read_table};
pub use ties::{CAD_ALPHA, CadModel};
pub use warnings::find_warnings;
pub use wingd_base::fault::{Fault, KeyFault};
pub use wingd_base::pending_file::{PendingFile, write_atomically};
use wingd_base::regular_file::{MAX_FILE_BYTES, read_regular_file};
pub use wingd_base::text::{cell_text, decode_text, printable_path, printable_text, text_cell};
pub use wingd_base::toml_fault::parse_toml;
pub use write_setup::write_installation;

use wingd_measure::geometry::TransformFit;
use wingd_measure::plan::Optics;
use wingd_measure::setup::{Orientation, Setup, StiffnessSection};

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
    /// Tie points and axes of the CAD model.
    pub cad_model: Option<CadModel>,
    /// Data of the lens and sensor, for planning.
    pub optics: Option<Optics>,
    /// Bending stiffness at stations from root to tip, for moments.
    pub structure: Option<Vec<StiffnessSection>>,
    /// Name and SHA-256 of every file that was read, for provenance.
    pub digests: Vec<(String, String)>,
    /// Names of the camera and survey files, which an orientation depends on.
    pub sources: [String; 2],
    /// Prior from earlier flights (`wingd learn`), for the present orientation.
    pub flight_prior: Option<StoredFlightPrior>,
    /// Remarks on the files: columns that are not read.
    pub notes: Vec<Fault>,
    /// Reason for accepting a refused calibration of the camera (`wingd calibrate --accept`).
    pub accepted: Option<String>,
    /// Reason for accepting an orientation that its test refuses (`wingd orient --accept`).
    pub accepted_orientation: Option<String>,
}

/// Main file, which names the others.
const INSTALLATION_FILE: &str = "installation.toml";
/// Name of the file that `wingd orient` writes.
pub const ORIENTATION_FILE: &str = "orientation.toml";

impl Installation {
    /// Returns name and bytes of every file that was read, or an error if one has changed since.
    pub fn files(&self) -> Result<Vec<(String, Vec<u8>)>, Fault> {
        let read = |(name, digest): &(String, String)| {
            let file = self.directory.join(name);
            let same = |bytes: &Vec<u8>| hex::encode(Sha256::digest(bytes)) == *digest;
            let bytes = read_regular_file(&file, MAX_FILE_BYTES).ok().filter(same);
            let bytes = bytes.ok_or_else(|| {
                Fault::new(file, "file", "has changed since it was read", "start again")
            })?;
            Ok((name.clone(), bytes))
        };
        self.digests.iter().map(read).collect()
    }

    /// Returns the direction aft in the survey frame, unit length, from the CAD model's aft axis.
    pub fn aft_direction(&self) -> Option<Vector3<f64>> {
        Some(self.cad.as_ref()?.transform.rotation.inverse() * self.cad_model.as_ref()?.aft?)
    }

    /// Takes the direction of the flow from the CAD model if the installation does not state it.
    fn with_flow_from_cad(mut self) -> Self {
        self.setup.flow_direction = self
            .setup
            .flow_direction
            .or_else(|| Some(self.aft_direction()?.xy()));
        self
    }

    /// Returns the orientation, or an error if there is none.
    pub fn require_orientation(&self) -> Result<&Orientation, Fault> {
        self.orientation.as_ref().ok_or_else(|| {
            let remedy = format!(
                "run `wingd orient --installation {} GROUND_FRAME`",
                self.directory.display()
            );
            Fault::new(
                self.directory.join(ORIENTATION_FILE),
                "file",
                "there is no orientation yet",
                remedy,
            )
        })
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
    let mut reader = Reader::new(directory);
    let parts = document::read_document(&mut reader);
    let markers = parts.as_ref().map_or(&[][..], |parts| &parts.setup.markers);
    // An orientation cannot be checked against camera and survey if these have errors.
    let orientation = if with_orientation && reader.faults.is_empty() {
        orientation::read_orientation(&mut reader, markers)
    } else {
        None
    };
    let flight_prior = match &parts {
        Some(parts) if orientation.is_some() && reader.faults.is_empty() => {
            flight_prior::read_flight_prior(&mut reader, &parts.setup, &parts.sources)
        }
        _ => None,
    };
    let cad = parts
        .as_ref()
        .and_then(|parts| ties::estimate_transform(&mut reader, parts.cad.as_ref()?, &parts.setup));
    match parts {
        Some(parts) if reader.faults.is_empty() => Ok(Installation {
            directory: directory.into(),
            setup: parts.setup,
            unused_on_ground: orientation.as_ref().map_or(vec![], |o| o.unused.clone()),
            accepted_orientation: orientation.as_ref().and_then(|o| o.accepted.clone()),
            orientation: orientation.map(|o| o.orientation),
            cad,
            cad_model: parts.cad,
            optics: parts.optics,
            structure: parts.structure,
            digests: reader.digests,
            sources: parts.sources,
            flight_prior,
            notes: reader.notes,
            accepted: parts.accepted,
        }
        .with_flow_from_cad()),
        _ => Err(fold::fold_repeated(reader.faults)),
    }
}
