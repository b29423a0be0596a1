//! Storage of manual marks: with a store's flight as evidence, or in a file next to the images. Each mark is durable before
//! the server responds. Other servers and commands may write to the same place: it is locked and read again for each mark, and
//! free in between.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use wingd_base::fault::Fault;
use wingd_evaluation::installation;
use wingd_evaluation::installation::ManualObservation;
use wingd_evaluation::pipeline::manual_observations::{
    mark_from_observation, observation_from_mark,
};
use wingd_measure::setup::Setup;
use wingd_store::manual_marks::{ManualMark, effective_marks, read_marks};
use wingd_store::{Disk, FlightRef, RealDisk, Store, StoreConfig, StoreError, StoreResult};

/// Manual marks and their storage.
pub struct MarkStorage {
    destination: MarkDestination,
    /// All marks, in the order in which they were made.
    marks: Vec<ManualMark>,
}

enum MarkDestination {
    Flight { root: PathBuf, flight: FlightRef },
    File { path: PathBuf, setup: Box<Setup> },
}

impl MarkStorage {
    /// Creates the storage of a store's flight, with its existing marks.
    pub fn from_flight(root: PathBuf, flight: FlightRef, marks: Vec<ManualMark>) -> Self {
        Self {
            destination: MarkDestination::Flight { root, flight },
            marks,
        }
    }

    /// Creates the storage in a file of observations, with the marks already in it.
    ///
    /// # Errors
    /// Returns every error of an existing file.
    pub fn from_file(path: PathBuf, setup: &Setup) -> Result<Self, Vec<Fault>> {
        let marks = read_file(&path, setup)?;
        Ok(Self {
            destination: MarkDestination::File {
                path,
                setup: Box::new(setup.clone()),
            },
            marks,
        })
    }

    /// Describes the storage for a person.
    pub fn description(&self) -> String {
        match &self.destination {
            MarkDestination::Flight { root, flight } => {
                format!("{} of {}", flight.id, root.display())
            }
            MarkDestination::File { path, .. } => path.display().to_string(),
        }
    }

    /// Adds marks; they are durable when this returns.
    ///
    /// # Errors
    /// Returns an error if the marks cannot be written; none of them is then effective.
    pub fn add(&mut self, new: Vec<ManualMark>) -> StoreResult<()> {
        let mut marks = match &self.destination {
            MarkDestination::Flight { root, flight } => {
                let config = StoreConfig {
                    reserve_mb: 0,
                    ..StoreConfig::new(root)
                };
                let (store, _) = Store::open(Arc::new(RealDisk), config)?;
                let (marks, _) = read_marks(store.disk(), root, flight)?;
                store.add_marks(&flight.id, &new)?;
                // So that the flight's checksums cover them; if that fails, the next opening does it.
                let _ = store.close_marks_file();
                marks
            }
            MarkDestination::File { path, setup } => {
                let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
                let folder = File::open(folder.unwrap_or(Path::new(".")));
                let folder = folder.map_err(StoreError::io(path, "write"))?;
                // Network disks may have no locks for folders.
                let _ = folder.lock();
                let mut marks = read_file(path, setup).map_err(|faults| StoreError::Damaged {
                    path: path.clone(),
                    problem: faults.first().map_or(String::new(), Fault::to_string),
                    remedy: "correct the file, then mark again",
                })?;
                for mark in &mut marks {
                    // The file does not hold how a position was found.
                    let is_same = |known: &&ManualMark| {
                        (&known.image, &known.id, &known.who, known.at)
                            == (&mark.image, &mark.id, &mark.who, mark.at)
                    };
                    if let Some(known) = self.marks.iter().rev().find(is_same) {
                        *mark = known.clone();
                    }
                }
                let all: Vec<ManualMark> = marks.iter().chain(&new).cloned().collect();
                let rows: Vec<ManualObservation> = effective_marks(&all)
                    .into_iter()
                    .filter_map(|m| observation_from_mark(m, setup))
                    .collect();
                let disk: &dyn Disk = &RealDisk;
                let text = installation::observations_text(&rows, setup)
                    .map_err(StoreError::io(path, "write"))?;
                disk.replace_file(path, &text)?;
                marks
            }
        };
        marks.extend(new);
        self.marks = marks;
        Ok(())
    }

    /// Returns the effective marks of an image.
    pub fn image_marks(&self, image: &str) -> Vec<ManualMark> {
        // In a file for a single image the image name may be empty.
        effective_marks(&self.marks)
            .into_iter()
            .filter(|mark| mark.image == image || mark.image.is_empty())
            .cloned()
            .collect()
    }
}

/// Reads the marks in a file of observations; none if it does not exist.
fn read_file(path: &Path, setup: &Setup) -> Result<Vec<ManualMark>, Vec<Fault>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let observations = installation::read_observations(path, setup)?;
    let mark = |o: &ManualObservation| mark_from_observation(o, setup);
    Ok(observations.iter().map(mark).collect())
}
