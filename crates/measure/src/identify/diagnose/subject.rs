//! Setup and images that a cause modifies, and the covariance of the images.

use std::cell::RefCell;
use std::rc::Rc;

use nalgebra::{DMatrix, Matrix2, Rotation3, Vector2, Vector3};

use super::super::beam::CoarseBeam;
use super::super::scene::{MODEL_SIGMA_M, PIXEL_FLOOR_PX};
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

/// Standard deviations of a semi-major axis, px, of a circle and of a quadrant, whose white fields end without contrast:
/// measured in rendered frames of three programs in seven lights (docs/identification.md).
const SIZE_SIGMAS_PX: (f64, f64) = (0.2, 1.7);
/// Standard deviation of a semi-major axis over that of the centre of a marker partly hidden by glare or dirt, measured
/// likewise.
const SIZE_OVER_CENTRE: f64 = 2.0;
/// Standard deviation of a displacement of all edges, px: blur, tone curve and glare, measured likewise.
const EDGE_SIGMA_PX: f64 = 0.3;
/// Standard deviation of a displacement of the edges of all quadrants, px: contrast of the white fields, measured likewise.
const QUADRANT_SIGMA_PX: f64 = 2.0;
/// Relative standard deviation of a printed diameter, of each marker and common to all: 1 mm of 0.3 m, an assumption.
const PRINT_SIGMA: f64 = 0.003;
/// Rows of an image: pixel and logarithm of its size.
pub(super) const ROWS: usize = 3;

/// Returns the covariance of the logarithms of two semi-major axes, px; of one with itself if the covariance of its centre,
/// px^2, is given.
pub(super) fn size_covariance(
    a: (Shape, f64),
    b: (Shape, f64),
    centre_px2: Option<&Matrix2<f64>>,
) -> f64 {
    let quadrants = if (a.0, b.0) == (Shape::Quadrant, Shape::Quadrant) {
        QUADRANT_SIGMA_PX
    } else {
        0.0
    };
    let own_px = if a.0 == Shape::Circle {
        SIZE_SIGMAS_PX.0
    } else {
        SIZE_SIGMAS_PX.1
    };
    let own_px2 = centre_px2.map_or(0.0, |c| {
        own_px.powi(2) + SIZE_OVER_CENTRE.powi(2) * c.trace()
    });
    let print = if centre_px2.is_some() { 2.0 } else { 1.0 } * PRINT_SIGMA.powi(2);
    (EDGE_SIGMA_PX.powi(2) + quadrants.powi(2) + own_px2) / (a.1 * b.1) + print
}

/// Returns the covariance of images, sizes and survey.
pub(super) fn image_covariance(
    subject: &Subject,
    in_flight: bool,
    by_shift: &DMatrix<f64>,
) -> DMatrix<f64> {
    let count = subject.images.len();
    let mut covariance = DMatrix::zeros(ROWS * count, ROWS * count);
    let (model_m, floor_px) = if in_flight {
        (MODEL_SIGMA_M, PIXEL_FLOOR_PX)
    } else {
        (0.0, 0.0)
    };
    for (i, a) in subject.images.iter().enumerate() {
        let sigma_m = subject
            .setup
            .markers
            .get(a.marker)
            .map_or(0.0, |m| m.sigma_m.hypot(model_m));
        for (k, b) in subject.images.iter().enumerate() {
            if a.marker == b.marker {
                let (first, second) =
                    (by_shift.rows(ROWS * i, ROWS), by_shift.rows(ROWS * k, ROWS));
                let common = first * second.transpose() * sigma_m.powi(2);
                covariance
                    .view_mut((ROWS * i, ROWS * k), (ROWS, ROWS))
                    .copy_from(&common);
            }
            if let (Some((shape, Some(major))), Some((other, Some(length)))) =
                (a.outline, b.outline)
            {
                covariance[(ROWS * i + 2, ROWS * k + 2)] += size_covariance(
                    (shape, major),
                    (other, length),
                    (i == k).then_some(&a.covariance_px2),
                );
            }
        }
        let own = a.covariance_px2 + Matrix2::identity() * floor_px.powi(2);
        let mut block = covariance.view_mut((ROWS * i, ROWS * i), (2, 2));
        block += own;
        if a.size_px().is_none() {
            covariance[(ROWS * i + 2, ROWS * i + 2)] += 1.0;
        }
    }
    covariance
}
