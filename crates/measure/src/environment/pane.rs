//! Window panes: a plane-parallel plate displaces every ray and deflects none.
//!
//! Rule of thumb: seen through acrylic, the camera appears a third of the thickness nearer to the pane: 4.8 mm for 14.5 mm,
//! which is 5 px for a marker at 8 m and, if seen in flight only, 6 cm of deflection.
//!
//! Formula: a ray at the angle i to the normal leaves a plate of thickness t and index n on a line through the point `k`
//! along the normal from the projection centre, `k = t (1 - cos i / sqrt(n^2 - sin^2 i))`, at any distance of the plate.
//! Several plates with one normal add up. Source: Snell's law at both faces (Kraus, Photogrammetry, on plane-parallel
//! plates; Born and Wolf, Principles of Optics, 4.6). The air on both sides is taken as equal here, its own refraction is
//! in `refraction.rs`; together they leave 2e-4 of the camera's distance from the pane times tan i, 0.02 mm.
//!
//! Validated against rays traced face by face (tests/adjust/window.rs) and on the panes of a third renderer.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::bowed_pane;
use crate::setup::{Pane, Window};

/// Number of iterations from a point to its ray; each reduces the error by k over the distance, a factor of 1000.
const STEPS: usize = 4;

/// Typical radius of a pane that was not measured, m: a sagitta of 0.3 mm over 25 cm, compared with a large one of 0.8 mm.
pub const DEFAULT_BOW_RADIUS_M: f64 = 30.0;

/// Window panes combined into one plate, in the frame of its normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plate {
    /// Outward unit normal.
    pub normal: Vector3<f64>,
    /// Properties of the pane, as configured.
    pub pane: Pane,
}

impl Plate {
    /// Returns the plate in front of the camera, its normal rotated from the survey frame by `turn`; `None` if no pane is
    /// configured, or for a ground frame without it.
    pub fn from_window(
        window: Option<&Window>,
        turn: &Rotation3<f64>,
        in_flight: bool,
    ) -> Option<Self> {
        let window = window?;
        let mut pane = window
            .pane
            .filter(|pane| in_flight || pane.same_on_ground)?;
        // On ground no pressure bows it.
        pane.bow_radius_m = pane.bow_radius_m.filter(|_| in_flight);
        Some(Self {
            normal: turn * window.normal?,
            pane,
        })
    }

    /// Returns the plate with its normal rotated into another frame.
    pub fn rotated(&self, turn: &Matrix3<f64>) -> Self {
        Self {
            normal: turn * self.normal,
            ..*self
        }
    }

    /// Returns the plate with its curvature changed by a fraction of it or, if no bow is configured, of the typical one.
    pub fn with_bow_change(&self, change: f64) -> Self {
        let radius = match self.pane.bow_radius_m {
            Some(radius) => Some(radius / (1.0 + change)),
            None => (change != 0.0).then(|| DEFAULT_BOW_RADIUS_M / change),
        };
        Self {
            pane: Pane {
                bow_radius_m: radius,
                ..self.pane
            },
            ..*self
        }
    }

    /// Returns the outside ray that the camera sees in the direction of the unit vector `ray`: a point on it from the
    /// projection centre, m, and its direction. A ray that does not leave through the pane is unchanged.
    pub fn outside_ray(&self, ray: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let cosine = ray.dot(&self.normal);
        if cosine <= 0.0 {
            return (Vector3::zeros(), *ray);
        }
        let curved = self
            .pane
            .bow_radius_m
            .and_then(|radius| bowed_pane::trace_bowed_pane(&self.pane, &self.normal, radius, ray));
        curved.unwrap_or((
            self.normal * shift_m(self.pane.thickness_m, self.pane.index, cosine),
            *ray,
        ))
    }

    /// Returns the apparent position of a point from the projection centre, m, in the direction in which the camera sees
    /// it. If its derivative by the point is taken as 1 (orientation, identification, profile), k over the distance is
    /// neglected, 6e-4 at 8 m: it slows the iteration by as much.
    pub fn apparent_point(&self, point_m: &Vector3<f64>) -> Vector3<f64> {
        let mut seen = *point_m;
        for _ in 0..STEPS {
            let distance = seen.norm();
            let ray = seen / distance;
            let (from, direction) = self.outside_ray(&ray);
            let along = (point_m - from).dot(&direction);
            seen = ray * along + (point_m - from - direction * along);
        }
        seen
    }

    /// Returns [`Plate::apparent_point`] and its derivative by the point, by differences of a millimetre (the second
    /// derivative is k over the distance squared).
    pub fn apparent_with_jacobian(&self, point_m: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        const STEP_M: f64 = 1e-3;
        let seen = self.apparent_point(point_m);
        let column =
            |axis: Vector3<f64>| (self.apparent_point(&(point_m + axis * STEP_M)) - seen) / STEP_M;
        (
            seen,
            Matrix3::from_columns(&[Vector3::x(), Vector3::y(), Vector3::z()].map(column)),
        )
    }

    /// Returns the covariance, m^2, of the projection centre's shift due to the uncertainty of thickness, index and normal,
    /// for rays near `axis` (unit length). For rays up to 15 degrees from it a shift of the centre represents an error of
    /// the pane to 10 %.
    pub fn shift_covariance_m2(&self, axis: &Vector3<f64>) -> Matrix3<f64> {
        let Pane {
            thickness_m: t,
            index: n,
            ..
        } = self.pane;
        let cosine = axis.dot(&self.normal).clamp(0.1, 1.0);
        let k = shift_m(t, n, cosine);
        let tilted = (cosine.acos() + self.pane.normal_sigma_rad).cos();
        let changes = [
            shift_m(t + self.pane.thickness_sigma_m, n, cosine) - k,
            shift_m(t, n + self.pane.index_sigma, cosine) - k,
            shift_m(t, n, tilted) - k,
        ];
        let along = changes.iter().map(|c| c * c).sum::<f64>();
        let across = (k * self.pane.normal_sigma_rad).powi(2);
        let axial = self.normal * self.normal.transpose();
        axial * along + (Matrix3::identity() - axial) * across
    }
}

/// Returns the point at which the camera sees a point (from the projection centre, survey frame, m), through the panes if
/// any are configured; camera frame, m. `turn`: rotation from the survey to the camera frame.
pub fn apparent_point(
    window: Option<&Window>,
    turn: &Rotation3<f64>,
    point_m: &Vector3<f64>,
    in_flight: bool,
) -> Vector3<f64> {
    let p = turn * point_m;
    Plate::from_window(window, turn, in_flight).map_or(p, |pane| pane.apparent_point(&p))
}

/// Returns the shift of the projection centre along the normal, m, for a ray with this cosine to it.
fn shift_m(thickness_m: f64, index: f64, cosine: f64) -> f64 {
    thickness_m * (1.0 - cosine / (index * index - 1.0 + cosine * cosine).sqrt())
}
