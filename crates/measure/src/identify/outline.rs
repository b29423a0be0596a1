//! The image of a disc: its ellipse, and the offset between the ellipse's centre and the image of the disc's centre.

use std::f64::consts::TAU;
use std::sync::LazyLock;

use nalgebra::{Rotation3, SymmetricEigen, Unit, Vector2, Vector3};

use crate::geometry::{Lens, fit_conic};

/// A disc on a slightly warped skin, camera frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct SkinDisc {
    pub(super) centre_m: Vector3<f64>,
    pub(super) normal: Vector3<f64>,
    /// Unit chordwise direction, in the disc's plane.
    pub(super) chord: Vector3<f64>,
    pub(super) radius_m: f64,
    /// Warp of the skin, d2(normal)/d(outboard)d(chordwise), 1/m. The crown is omitted: it bends the image's axis about the
    /// disc's centre, and the detector fits that bend.
    pub(super) warp_per_m: f64,
}

/// Image of a disc.
#[derive(Clone, Copy, Debug)]
pub(super) struct DiscOutline {
    /// Image of the disc's centre, px.
    pub(super) point_px: Vector2<f64>,
    /// Centre of the ellipse, px.
    pub(super) ellipse_px: Vector2<f64>,
    pub(super) semi_major_px: f64,
    pub(super) semi_minor_px: f64,
    /// Angle of the major axis from u towards v, rad, in (-pi/2, pi/2].
    pub(super) angle_rad: f64,
}

/// Number of boundary points: five determine an ellipse, more average the lens distortion.
const BOUNDARY_POINTS: usize = 24;
/// Sines and cosines of the angles of the boundary points.
static BOUNDARY: LazyLock<[(f64, f64); BOUNDARY_POINTS]> =
    LazyLock::new(|| std::array::from_fn(|i| (TAU * i as f64 / BOUNDARY_POINTS as f64).sin_cos()));

impl SkinDisc {
    /// Returns the outline; `None` if a part is behind the camera or the disc is seen edge-on.
    pub(super) fn outline(&self, lens: &Lens) -> Option<DiscOutline> {
        let outboard = self.normal.cross(&self.chord);
        let mut points = [Vector2::zeros(); BOUNDARY_POINTS];
        for (point, (sin, cos)) in points.iter_mut().zip(&*BOUNDARY) {
            let (along, across) = (self.radius_m * cos, self.radius_m * sin);
            let rise = self.normal * (self.warp_per_m * along * across);
            let p = self.centre_m + outboard * along + self.chord * across + rise;
            *point = lens.project(&p)?;
        }
        let (ellipse_px, shape) = fit_conic(&points)?;
        let eigen = SymmetricEigen::new(shape);
        let (large, small) = if eigen.eigenvalues[0] >= eigen.eigenvalues[1] {
            (0, 1)
        } else {
            (1, 0)
        };
        let axis = eigen.eigenvectors.column(large);
        let angle = axis[1].atan2(axis[0]);
        let half = std::f64::consts::FRAC_PI_2;
        let angle_rad = if angle > half {
            angle - 2.0 * half
        } else if angle <= -half {
            angle + 2.0 * half
        } else {
            angle
        };
        Some(DiscOutline {
            point_px: lens.project(&self.centre_m)?,
            ellipse_px,
            semi_major_px: eigen.eigenvalues[large].max(0.0).sqrt(),
            semi_minor_px: eigen.eigenvalues[small].max(0.0).sqrt(),
            angle_rad,
        })
    }

    /// Returns the offset of the ellipse's centre from the image of the disc's centre, px.
    pub(super) fn centre_bias_px(&self, lens: &Lens) -> Option<Vector2<f64>> {
        self.outline(lens).map(|o| o.ellipse_px - o.point_px)
    }

    /// Returns the disc with its normal turned about an axis of its plane.
    pub(super) fn tilted(&self, axis: &Vector3<f64>, angle_rad: f64) -> Self {
        let turn = Rotation3::from_axis_angle(&Unit::new_normalize(*axis), angle_rad);
        Self {
            normal: turn * self.normal,
            chord: turn * self.chord,
            ..*self
        }
    }
}
