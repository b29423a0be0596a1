//! Covariance of images and their sizes, from detection, print and survey.

use nalgebra::{DMatrix, Matrix2};

use super::super::scene::{MODEL_SIGMA_M, PIXEL_FLOOR_PX};
use super::subject::Subject;
use crate::setup::Shape;

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
pub(super) fn image_covariance(subject: &Subject, in_flight: bool, by_shift: &DMatrix<f64>) -> DMatrix<f64> {
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
