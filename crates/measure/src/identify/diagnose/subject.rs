//! Setup and images that a cause modifies.

use std::cell::RefCell;
use std::rc::Rc;

use nalgebra::{Matrix2, Rotation3, Vector2, Vector3};

use super::super::beam::CoarseBeam;
use crate::observation::Observation;
use crate::setup::{Orientation, Setup, Shape};

/// Kind and, if measured, semi-major axis of an outline, px.
pub type SizedShape = (Shape, Option<f64>);

/// Projection centre and positions of the markers, survey frame, m, with the beam made for them.
pub(super) type PlacedBeam = (Vec<Vector3<f64>>, CoarseBeam);

/// Image of a marker with its name; its centre is free of the perspective bias.
#[derive(Clone, Copy, Debug)]
pub(super) struct NamedImage {
    pub(super) marker: usize,
    pub(super) pixel: Vector2<f64>,
    pub(super) covariance_px2: Matrix2<f64>,
    /// Kind and semi-major axis, px, of the outline; `None` for a manual mark.
    pub(super) outline: Option<SizedShape>,
}

impl NamedImage {
    /// Returns the semi-major axis, px.
    pub(super) fn size_px(&self) -> Option<f64> {
        self.outline.and_then(|(_, major)| major)
    }
}

/// Setup and images that a cause modifies.
#[derive(Clone, Debug)]
pub(super) struct Subject {
    pub(super) setup: Setup,
    pub(super) images: Vec<NamedImage>,
    /// Bend of the wing since the survey, at the tip, m.
    pub(super) bend_m: f64,
    /// Rotation of the camera relative to the ground frames.
    pub(super) turn: Rotation3<f64>,
    /// Beam made last; modifications of the subject share it, because most keep the places.
    pub(super) beam: Rc<RefCell<Option<PlacedBeam>>>,
}

impl Subject {
    /// Creates the subject of a setup as given.
    pub(super) fn new(setup: &Setup, images: Vec<NamedImage>) -> Self {
        Self {
            setup: setup.clone(),
            images,
            bend_m: 0.0,
            turn: Rotation3::identity(),
            beam: Rc::default(),
        }
    }

    /// Creates the subject of observations with the outline of each; missing ones are manual marks.
    pub(super) fn of_observations(
        setup: &Setup,
        observations: &[Observation],
        outlines: &[Option<SizedShape>],
    ) -> Self {
        let image = |(k, o): (usize, &Observation)| NamedImage {
            marker: o.marker,
            pixel: o.pixel,
            covariance_px2: o.covariance_px2,
            outline: outlines.get(k).copied().flatten(),
        };
        Self::new(setup, observations.iter().enumerate().map(image).collect())
    }

    /// Returns the beam of the wing. Of all that it depends on, causes change the projection centre and the markers'
    /// positions alone. `orientation`: the same in all calls for a subject and its modifications.
    pub(super) fn beam(&self, orientation: &Orientation) -> CoarseBeam {
        let markers = &self.setup.markers;
        let places = std::iter::once(self.setup.projection_centre_m)
            .chain(markers.iter().map(|m| m.position_m));
        let mut known = self.beam.borrow_mut();
        if known
            .as_ref()
            .is_none_or(|(of, _)| !places.clone().eq(of.iter().copied()))
        {
            *known = None;
        }
        let (_, beam) = known.get_or_insert_with(|| {
            let shaping = orientation.shaping_markers(markers.len());
            (places.collect(), CoarseBeam::new(&self.setup, &shaping))
        });
        beam.clone()
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
