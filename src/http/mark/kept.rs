//! Where marks are kept: with a store's flight as evidence, or in a file beside pictures. Each is durable before it is
//! answered for.

use std::path::PathBuf;

use crate::installation::{self, Fault, ManualObservation};
use crate::measure::setup::Setup;
use crate::pipeline::manual_observations::{mark, observation};
use crate::store::manual_marks::{ManualMark, effective_marks};
use crate::store::{Disk, RealDisk, Store, StoreError};

/// Marks, and where they are kept.
pub struct Kept {
    place: Where,
    /// All of them, in the order in which they were made.
    marks: Vec<ManualMark>,
}

enum Where {
    Flight { store: Box<Store>, flight: String },
    File { path: PathBuf, setup: Box<Setup> },
}

impl Kept {
    /// With a flight of a store, beside those that are there.
    pub fn with_flight(store: Store, flight: String, marks: Vec<ManualMark>) -> Self {
        Self { place: Where::Flight { store: Box::new(store), flight }, marks }
    }

    /// In a file of observations, beside those that stand in it.
    ///
    /// # Errors
    /// Every fault of a file that is there.
    pub fn in_file(path: PathBuf, setup: &Setup) -> Result<Self, Vec<Fault>> {
        let there = path.exists().then(|| installation::read_observations(&path, setup)).transpose()?;
        let marks = there.unwrap_or_default().iter().map(|o| mark(o, setup)).collect();
        Ok(Self { place: Where::File { path, setup: Box::new(setup.clone()) }, marks })
    }

    /// In words, for a person.
    pub fn words(&self) -> String {
        match &self.place {
            Where::Flight { store, flight } => format!("{} of {}", flight, store.root().display()),
            Where::File { path, .. } => path.display().to_string(),
        }
    }

    /// Adds marks; they are durable when this returns.
    ///
    /// # Errors
    /// Where they cannot be written; none of them counts then.
    pub fn add(&mut self, new: Vec<ManualMark>) -> Result<(), StoreError> {
        match &self.place {
            Where::Flight { store, flight } => store.add_marks(flight, &new)?,
            Where::File { path, setup } => {
                let all: Vec<ManualMark> = self.marks.iter().chain(&new).cloned().collect();
                let rows: Vec<ManualObservation> =
                    effective_marks(&all).into_iter().filter_map(|m| observation(m, setup)).collect();
                let disk: &dyn Disk = &RealDisk;
                let text =
                    installation::observations_text(&rows, setup).map_err(StoreError::io(path, "write"))?;
                disk.replace_file(path, &text)?;
            }
        }
        self.marks.extend(new);
        Ok(())
    }

    /// Those of a picture that count.
    pub fn of(&self, image: &str) -> Vec<ManualMark> {
        // A file of one picture need not name it.
        effective_marks(&self.marks)
            .into_iter()
            .filter(|mark| mark.image == image || mark.image.is_empty())
            .cloned()
            .collect()
    }

    /// Ends the file of a flight, so that its sums cover it.
    ///
    /// # Errors
    /// Where it cannot be closed; the next start closes it.
    pub fn close(&self) -> Result<(), StoreError> {
        match &self.place {
            Where::Flight { store, .. } => store.close_marks_file(),
            Where::File { .. } => Ok(()),
        }
    }
}
