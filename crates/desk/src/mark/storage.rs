//! Storage of manual marks: with a store's flight as evidence, or in a file next to the images. Each mark is durable before
//! the server responds.

use std::path::PathBuf;

use wingd_base::fault::Fault;
use wingd_evaluation::installation;
use wingd_evaluation::installation::ManualObservation;
use wingd_evaluation::pipeline::manual_observations::{
    mark_from_observation, observation_from_mark,
};
use wingd_measure::setup::Setup;
use wingd_store::manual_marks::{ManualMark, effective_marks};
use wingd_store::{Disk, RealDisk, Store, StoreError, StoreResult};

/// Manual marks and their storage.
pub struct MarkStorage {
    destination: MarkDestination,
    /// All marks, in the order in which they were made.
    marks: Vec<ManualMark>,
}

enum MarkDestination {
    Flight { store: Box<Store>, flight: String },
    File { path: PathBuf, setup: Box<Setup> },
}

impl MarkStorage {
    /// Creates the storage of a stored flight, with its existing marks.
    pub fn from_flight(store: Store, flight: String, marks: Vec<ManualMark>) -> Self {
        Self {
            destination: MarkDestination::Flight {
                store: Box::new(store),
                flight,
            },
            marks,
        }
    }

    /// Creates the storage in a file of observations, with the marks already in it.
    ///
    /// # Errors
    /// Returns every error of an existing file.
    pub fn from_file(path: PathBuf, setup: &Setup) -> Result<Self, Vec<Fault>> {
        let existing = path
            .exists()
            .then(|| installation::read_observations(&path, setup))
            .transpose()?;
        let marks = existing
            .unwrap_or_default()
            .iter()
            .map(|o| mark_from_observation(o, setup))
            .collect();
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
            MarkDestination::Flight { store, flight } => {
                format!("{} of {}", flight, store.root().display())
            }
            MarkDestination::File { path, .. } => path.display().to_string(),
        }
    }

    /// Adds marks; they are durable when this returns.
    ///
    /// # Errors
    /// Returns an error if the marks cannot be written; none of them is then effective.
    pub fn add(&mut self, new: Vec<ManualMark>) -> StoreResult<()> {
        match &self.destination {
            MarkDestination::Flight { store, flight } => store.add_marks(flight, &new)?,
            MarkDestination::File { path, setup } => {
                let all: Vec<ManualMark> = self.marks.iter().chain(&new).cloned().collect();
                let rows: Vec<ManualObservation> = effective_marks(&all)
                    .into_iter()
                    .filter_map(|m| observation_from_mark(m, setup))
                    .collect();
                let disk: &dyn Disk = &RealDisk;
                let text = installation::observations_text(&rows, setup)
                    .map_err(StoreError::io(path, "write"))?;
                disk.replace_file(path, &text)?;
            }
        }
        self.marks.extend(new);
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

    /// Closes the marks file of a flight, so that its checksums cover it.
    ///
    /// # Errors
    /// Returns an error if it cannot be closed; the next start closes it.
    pub fn close(&self) -> StoreResult<()> {
        match &self.destination {
            MarkDestination::Flight { store, .. } => store.close_marks_file(),
            MarkDestination::File { .. } => Ok(()),
        }
    }
}
