//! Setup and images that a cause modifies.

use nalgebra::{Rotation3, Vector2};

use super::super::attitude::rotation_from_many;
use super::super::image_problem::{ImageContext, ImageProblem, NamedImage, SizedShape};
use crate::observation::Observation;
use crate::setup::{Orientation, Setup};

/// Setup and images that a cause modifies.
#[derive(Clone, Debug)]
pub(super) struct Subject {
    pub(super) setup: Setup,
    pub(super) images: Vec<NamedImage>,
    /// Bend of the wing since the survey, at the tip, m.
    pub(super) bend_m: f64,
    /// Rotation of the camera relative to the ground frames.
    pub(super) turn: Rotation3<f64>,
}

impl Subject {
    /// Creates the subject of a setup as given.
    pub(super) fn new(setup: &Setup, images: Vec<NamedImage>) -> Self {
        Self {
            setup: setup.clone(),
            images,
            bend_m: 0.0,
            turn: Rotation3::identity(),
        }
    }

    /// Creates the subject of observations with the outline of each; missing ones are manual marks.
    pub(super) fn of_observations(
        setup: &Setup,
        observations: &[Observation],
        outlines: &[Option<SizedShape>],
    ) -> Self {
        let image =
            |(k, o): (usize, &Observation)| NamedImage::new(o, outlines.get(k).copied().flatten());
        Self::new(setup, observations.iter().enumerate().map(image).collect())
    }

    /// Returns the problem of the images, from a rotation.
    pub(super) fn image_problem(
        &self,
        start: Rotation3<f64>,
        orientation: Option<&Orientation>,
    ) -> ImageProblem<'_> {
        let context = orientation.map_or(ImageContext::Ground, ImageContext::Flight);
        ImageProblem::new(
            &self.setup,
            self.images.clone(),
            start,
            context,
            self.bend_m,
        )
    }

    /// Returns the attitude of the ground frames, turned, or for a ground frame the rotation that fits the directions of a
    /// modification `near` best.
    pub(super) fn start_rotation(
        &self,
        near: &Self,
        orientation: Option<&Orientation>,
    ) -> Option<Rotation3<f64>> {
        let setup = &near.setup;
        let direction = |image: &NamedImage| {
            let target = setup.markers.get(image.marker)?.position_m - setup.projection_centre_m;
            let ray = setup.lens.ray(&image.pixel).ok()?;
            Some((target.try_normalize(1e-9)?, ray, 1.0))
        };
        orientation
            .map(|o| self.turn * o.camera_from_survey)
            .or_else(|| rotation_from_many(near.images.iter().filter_map(direction)))
    }

    /// Replaces the pixel of each image; the map has the marker and the pixel.
    pub(super) fn map_pixels(&mut self, map: impl Fn(usize, Vector2<f64>) -> Vector2<f64>) {
        self.images
            .iter_mut()
            .for_each(|image| image.pixel = map(image.marker, image.pixel));
    }

    /// Exchanges the names of two markers: of manual marks, or else of their rows in the survey. The images of rows were
    /// named by their positions, so that kind and diameter are exchanged.
    pub(super) fn exchange_names(&mut self, a: usize, b: usize) {
        if self
            .images
            .iter()
            .all(|image| image.outline.is_some() || (image.marker != a && image.marker != b))
        {
            let of = |k: usize| self.setup.markers.get(k).map(|m| (m.shape, m.diameter_m));
            let (Some(first), Some(second)) = (of(a), of(b)) else {
                return;
            };
            (
                self.setup.markers[a].shape,
                self.setup.markers[a].diameter_m,
            ) = second;
            (
                self.setup.markers[b].shape,
                self.setup.markers[b].diameter_m,
            ) = first;
            return;
        }
        for image in &mut self.images {
            image.marker = if image.marker == a {
                b
            } else if image.marker == b {
                a
            } else {
                image.marker
            };
        }
    }

    /// Returns whether the outline of an image is of the other kind than its marker.
    pub(super) fn has_wrong_shape(&self, image: &NamedImage) -> bool {
        let shape = self.setup.markers.get(image.marker).map(|m| m.shape);
        image.outline.is_some_and(|(seen, _)| Some(seen) != shape)
    }
}
