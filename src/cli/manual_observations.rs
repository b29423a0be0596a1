//! Image points measured by hand, beside pictures or instead of them.

use std::path::{Path, PathBuf};

use super::{Failure, frames};
use crate::installation::{self, Fault, ManualObservation};
use crate::measure::setup::Setup;

/// Points measured by hand, by the pictures they are of.
#[derive(Default)]
pub(super) struct ByHand {
    points: Vec<ManualObservation>,
}

impl ByHand {
    /// Reads them.
    ///
    /// # Errors
    /// Where a point says of no picture, or of none of these, which it is of.
    pub fn read(file: &Path, files: &[PathBuf], setup: &Setup) -> Result<Self, Failure> {
        let points = installation::read_observations(file, setup)?;
        let names = frames::names(files);
        let fault = |place: &str, problem: String, mend: &str| {
            Failure::from(Fault::new(file, place.to_owned(), problem, mend.to_owned()))
        };
        if files.len() > 1 && points.iter().any(|p| p.image.is_none()) {
            let problem = format!("does not say for every point which of {} pictures it is of", files.len());
            return Err(fault(
                "column image",
                problem,
                "name the picture of every point, as results name it",
            ));
        }
        let is_strange = |p: &&ManualObservation| p.image.as_ref().is_some_and(|name| !names.contains(name));
        let strange: Vec<&ManualObservation> = points.iter().filter(is_strange).collect();
        let first = strange.first().and_then(|p| p.image.clone()).filter(|_| !files.is_empty());
        if let Some(name) = first {
            if strange.len() == points.len() {
                let problem = format!("\"{name}\" is none of the pictures");
                return Err(fault(
                    "column image",
                    problem,
                    "name it as results name it, or leave its points out",
                ));
            }
            // One file may hold what was marked in a folder of pictures.
            let count = strange.len();
            eprintln!(
                "wingd: {}: {count} points are of pictures that are not asked for, first {name}",
                file.display()
            );
        }
        Ok(Self { points })
    }

    /// All of them.
    pub fn all(&self) -> impl Iterator<Item = &ManualObservation> {
        self.points.iter()
    }

    /// Those of a picture, by the name that results give it.
    pub fn of(&self, name: &str) -> impl Iterator<Item = &ManualObservation> {
        self.points.iter().filter(move |p| p.image.as_deref().is_none_or(|image| image == name))
    }
}
