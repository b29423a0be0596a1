//! Markers as flat discs on the skin.

use nalgebra::Vector3;

use super::wing::Pose;
use crate::measure::setup::Shape;

/// Reflectance of the black print.
const BLACK: f64 = 0.045;
/// Reflectance of the white print.
const WHITE: f64 = 0.82;

/// A marker on the wing at rest, material coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Marker {
    /// As in the survey.
    pub id: String,
    /// Quadrant or circle.
    pub shape: Shape,
    /// m.
    pub diameter_m: f64,
    /// Along the axis, m.
    pub s_m: f64,
    /// Across it, m.
    pub z_m: f64,
    /// Of the pattern in its plane, rad.
    pub rotation_rad: f64,
    /// Of the disc above the smooth skin, m.
    pub height_m: f64,
}

impl Marker {
    /// The marker on a deformed wing.
    pub fn placed(&self, pose: &Pose) -> Placed {
        let (along, _, normal) = pose.tangents(self.s_m, self.z_m);
        let along = (along - normal * along.dot(&normal)).normalize();
        let across = normal.cross(&along);
        let (sin, cos) = self.rotation_rad.sin_cos();
        Placed {
            s_m: self.s_m,
            centre_m: pose.point(self.s_m, self.z_m) + normal * (self.height_m * pose.scale),
            normal,
            first: along * cos + across * sin,
            second: across * cos - along * sin,
            radius_m: 0.5 * self.diameter_m * pose.scale,
            shape: self.shape,
        }
    }
}

/// A disc in space, wing frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Placed {
    /// Along the axis, m, material.
    pub s_m: f64,
    /// m.
    pub centre_m: Vector3<f64>,
    /// Outward, unit.
    pub normal: Vector3<f64>,
    first: Vector3<f64>,
    second: Vector3<f64>,
    /// m.
    pub radius_m: f64,
    shape: Shape,
}

impl Placed {
    /// Whether skin at `s` can be under the disc; if not, it hides it or is hidden by it.
    pub fn covers(&self, s: f64) -> bool {
        (s - self.s_m).abs() < 1.5 * self.radius_m + 0.3
    }

    /// Where a ray from the origin meets the disc's plane, along the pattern's axes, m.
    pub fn plane_point(&self, direction: &Vector3<f64>) -> (f64, f64) {
        let t = self.centre_m.dot(&self.normal) / direction.dot(&self.normal);
        let arm = direction * t - self.centre_m;
        (arm.dot(&self.first), arm.dot(&self.second))
    }

    /// Reflectance at a point of the plane; `None` beside the disc.
    pub fn reflectance(&self, (a, b): (f64, f64)) -> Option<f64> {
        if a * a + b * b > self.radius_m * self.radius_m {
            return None;
        }
        let white = self.shape == Shape::Quadrant && (a > 0.0) == (b > 0.0);
        Some(if white { WHITE } else { BLACK })
    }

    /// Whether the pattern has an edge within `reach_m` of a point of the plane.
    pub fn edge_within(&self, (a, b): (f64, f64), reach_m: f64) -> bool {
        let r = a.hypot(b);
        let rim = (r - self.radius_m).abs() <= reach_m;
        let inner =
            self.shape == Shape::Quadrant && r < self.radius_m && (a.abs() <= reach_m || b.abs() <= reach_m);
        rim || inner
    }

    /// Points of the outline, m.
    pub fn outline(&self, count: usize) -> impl Iterator<Item = Vector3<f64>> + '_ {
        (0..count).map(move |i| {
            let (sin, cos) = (std::f64::consts::TAU * i as f64 / count as f64).sin_cos();
            self.centre_m + (self.first * cos + self.second * sin) * self.radius_m
        })
    }
}
