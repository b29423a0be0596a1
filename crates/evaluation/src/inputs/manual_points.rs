//! Image points measured manually, in addition to images or instead of them.

use std::path::{Path, PathBuf};

use super::image_names;
use crate::installation;
use crate::installation::ManualObservation;
use wingd_base::failure::{Failure, TaskResult};
use wingd_base::fault::Fault;
use wingd_measure::setup::Setup;

/// Manually measured points, by image.
#[derive(Default)]
pub struct ManualPoints {
    points: Vec<ManualObservation>,
    /// Note on points that are not used.
    pub note: Option<String>,
}

impl ManualPoints {
    /// Reads the manually measured points of the named images.
    ///
    /// # Errors
    /// Returns an error if a point names no image, or one that is not among the given.
    pub fn read(file: &Path, files: &[PathBuf], setup: &Setup) -> TaskResult<Self> {
        let points = installation::read_observations(file, setup)?;
        let names = image_names::image_names(files);
        let fault = |place: &str, problem: String, remedy: &str| {
            Failure::from(Fault::new(
                file,
                place.to_owned(),
                problem,
                remedy.to_owned(),
            ))
        };
        if files.len() > 1 && points.iter().any(|p| p.image.is_none()) {
            let problem = format!(
                "does not name the image of every point, but {} images are given",
                files.len()
            );
            return Err(fault(
                "column image",
                problem,
                "name the image of every point as in the results",
            ));
        }
        let is_unknown =
            |p: &&ManualObservation| p.image.as_ref().is_some_and(|name| !names.contains(name));
        let unknown: Vec<&ManualObservation> = points.iter().filter(is_unknown).collect();
        let mut note = None;
        let first = unknown
            .first()
            .and_then(|p| p.image.clone())
            .filter(|_| !files.is_empty());
        if let Some(name) = first {
            if unknown.len() == points.len() {
                let problem = format!("\"{name}\" is not one of the images");
                return Err(fault(
                    "column image",
                    problem,
                    "name it as in the results, or omit its points",
                ));
            }
            // One file may contain the marks of a whole folder of images.
            let count = unknown.len();
            note = Some(format!(
                "{}: {count} points are in images that were not given, first {name}",
                file.display()
            ));
        }
        Ok(Self { points, note })
    }

    /// Iterates over all points.
    pub fn iter(&self) -> impl Iterator<Item = &ManualObservation> {
        self.points.iter()
    }

    /// Iterates over the points of an image, by its name in results.
    pub fn for_image(&self, name: &str) -> impl Iterator<Item = &ManualObservation> {
        self.points
            .iter()
            .filter(move |p| p.image.as_deref().is_none_or(|image| image == name))
    }
}
