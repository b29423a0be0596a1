//! Markers as thin discs that follow the skin.
//!
//! A crowned skin bends the disc: at the tip of a wing the centre of its image is up to a pixel away from the image of a
//! flat disc's centre.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::wing::DeformedWing;
use wingd_measure::setup::{POINT_EXTENT_M, Shape};

/// Reflectance of the black print.
const BLACK: f64 = 0.045;
/// Reflectance of the white print.
const WHITE: f64 = 0.82;
/// Reflectance of the plate of a fixed target.
const PLATE: f64 = 0.45;
/// Half side of that plate over the target's radius.
const PLATE_OVER_RADIUS: f64 = 1.7;

/// Marker on the wing at rest, material coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneMarker {
    pub id: String,
    pub shape: Shape,
    pub diameter_m: f64,
    /// Position along the axis, m.
    pub s_m: f64,
    /// Position across the axis, m.
    pub z_m: f64,
    /// Rotation of the pattern in its plane, rad.
    pub rotation_rad: f64,
    /// Height of the disc above the smooth skin, m.
    pub height_m: f64,
    /// Position in the wing frame, m, if the marker is a fixed target on a plate that faces the camera; `None` on the wing.
    pub fixed_m: Option<Vector3<f64>>,
}

impl SceneMarker {
    /// Creates a point without a decal at a position on the skin.
    pub(super) fn point(id: String, s_m: f64, z_m: f64) -> Self {
        let (shape, diameter_m) = (Shape::Point, POINT_EXTENT_M);
        Self {
            id,
            shape,
            diameter_m,
            s_m,
            z_m,
            rotation_rad: 0.0,
            height_m: 0.0,
            fixed_m: None,
        }
    }

    /// Returns the marker's disc on a deformed wing.
    pub fn disc_on_wing(&self, pose: &DeformedWing) -> MarkerDisc {
        if let Some(point) = self.fixed_m {
            return self.disc_on_plate(&(point + pose.cabin_m));
        }
        let (along, _, normal) = pose.tangents(self.s_m, self.z_m);
        let along = (along - normal * along.dot(&normal)).normalize();
        let across = normal.cross(&along);
        let (sin, cos) = self.rotation_rad.sin_cos();
        MarkerDisc {
            s_m: self.s_m,
            centre_m: pose.skin_point(self.s_m, self.z_m) + normal * (self.height_m * pose.scale),
            normal,
            first: along * cos + across * sin,
            second: across * cos - along * sin,
            form: second_fundamental_form(pose, self, &normal, cos, sin),
            radius_m: 0.5 * self.diameter_m * pose.scale,
            shape: self.shape,
            plate_m: None,
        }
    }

    fn disc_on_plate(&self, point_m: &Vector3<f64>) -> MarkerDisc {
        let normal = -point_m.normalize();
        let along = (Vector3::y() - normal * normal.y).normalize();
        let across = normal.cross(&along);
        let (sin, cos) = self.rotation_rad.sin_cos();
        let radius_m = 0.5 * self.diameter_m;
        MarkerDisc {
            s_m: f64::NEG_INFINITY,
            centre_m: *point_m,
            normal,
            first: along * cos + across * sin,
            second: across * cos - along * sin,
            form: Matrix2::zeros(),
            radius_m,
            shape: self.shape,
            plate_m: Some(PLATE_OVER_RADIUS * radius_m),
        }
    }
}

/// Disc in space, wing frame.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerDisc {
    /// Material coordinate along the axis, m.
    pub s_m: f64,
    pub centre_m: Vector3<f64>,
    /// Outward unit normal.
    pub normal: Vector3<f64>,
    first: Vector3<f64>,
    second: Vector3<f64>,
    /// Curvature of the skin along the pattern's axes, 1/m.
    form: Matrix2<f64>,
    pub radius_m: f64,
    shape: Shape,
    /// Half side of its plate, m, which hides the background; `None` on the wing.
    pub plate_m: Option<f64>,
}

impl MarkerDisc {
    /// Returns true if skin at `s` can be under the disc; other skin hides the disc or is hidden by it.
    pub fn covers(&self, s: f64) -> bool {
        (s - self.s_m).abs() < 1.5 * self.radius_m + 0.3
    }

    /// Returns the intersection of a ray from the origin with the disc, along the pattern's axes, m.
    pub fn pattern_point(&self, direction: &Vector3<f64>) -> (f64, f64) {
        let (distance, sink) = (self.centre_m.dot(&self.normal), direction.dot(&self.normal));
        let mut at = Vector2::zeros();
        // The skin deviates from its tangent plane by millimetres: each round reduces the error by a factor
        // of 20 or more.
        for _ in 0..5 {
            let arm = direction * ((distance + self.surface_rise(&at)) / sink) - self.centre_m;
            at = Vector2::new(arm.dot(&self.first), arm.dot(&self.second));
        }
        (at.x, at.y)
    }

    /// Returns the height of the skin over its tangent plane, m.
    fn surface_rise(&self, at: &Vector2<f64>) -> f64 {
        0.5 * at.dot(&(self.form * at))
    }

    /// Returns the reflectance at a point of the pattern; `None` outside the disc.
    pub fn reflectance(&self, (a, b): (f64, f64)) -> Option<f64> {
        if a * a + b * b > self.radius_m * self.radius_m {
            return None;
        }
        let white = self.shape == Shape::Quadrant && (a > 0.0) == (b > 0.0);
        Some(if white { WHITE } else { BLACK })
    }

    /// Returns the reflectance of the plate with its print; `None` outside the plate and for markers on the wing.
    pub fn plate_reflectance(&self, at: (f64, f64)) -> Option<f64> {
        let half = self.plate_m?;
        let on = at.0.abs() < half && at.1.abs() < half;
        on.then(|| self.reflectance(at).unwrap_or(PLATE))
    }

    /// Returns true if plate or pattern have an edge within `reach_m` of a point.
    pub fn plate_edge_within(&self, at: (f64, f64), reach_m: f64) -> bool {
        let side = at.0.abs().max(at.1.abs());
        self.edge_within(at, reach_m)
            || self
                .plate_m
                .is_some_and(|half| (side - half).abs() <= reach_m)
    }

    /// Returns the corners of the plate, m; none on the wing.
    pub fn plate_corners(&self) -> Vec<Vector3<f64>> {
        let corner =
            |(a, b): (f64, f64), half: f64| self.surface_point(&(Vector2::new(a, b) * half));
        let all = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        self.plate_m
            .map_or(vec![], |half| all.map(|c| corner(c, half)).to_vec())
    }

    /// Returns true if the pattern has an edge within `reach_m` of a point.
    pub fn edge_within(&self, (a, b): (f64, f64), reach_m: f64) -> bool {
        let r = a.hypot(b);
        let rim = (r - self.radius_m).abs() <= reach_m;
        let inner = self.shape == Shape::Quadrant
            && r < self.radius_m
            && (a.abs() <= reach_m || b.abs() <= reach_m);
        rim || inner
    }

    /// Returns points of the outline, m.
    pub fn outline(&self, count: usize) -> impl Iterator<Item = Vector3<f64>> + '_ {
        (0..count).map(move |i| {
            let (sin, cos) = (std::f64::consts::TAU * i as f64 / count as f64).sin_cos();
            self.surface_point(&(Vector2::new(cos, sin) * self.radius_m))
        })
    }

    /// Returns the point of the disc at a position along the pattern's axes, m.
    pub fn surface_point(&self, at: &Vector2<f64>) -> Vector3<f64> {
        self.centre_m + self.first * at.x + self.second * at.y + self.normal * self.surface_rise(at)
    }
}

/// Returns the second fundamental form of the skin at a marker, along axes rotated by the marker's rotation.
fn second_fundamental_form(
    pose: &DeformedWing,
    marker: &SceneMarker,
    normal: &Vector3<f64>,
    cos: f64,
    sin: f64,
) -> Matrix2<f64> {
    const H: f64 = 0.15;
    let at = |i: f64, j: f64| pose.skin_point(marker.s_m + i * H, marker.z_m + j * H);
    let (centre, before, after) = (at(0.0, 0.0), at(-1.0, 0.0), at(1.0, 0.0));
    let (left, right) = (at(0.0, -1.0), at(0.0, 1.0));
    let along = (after - before) / (2.0 * H);
    let across = (right - left) / (2.0 * H);
    let twice = (at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0)) / 4.0;
    let curvature = |v: Vector3<f64>| v.dot(normal) / (H * H);
    let mixed = curvature(twice);
    let material = Matrix2::new(
        curvature(after + before - centre * 2.0),
        mixed,
        mixed,
        curvature(left + right - centre * 2.0),
    );
    let first = (along - normal * along.dot(normal)).normalize();
    let second = normal.cross(&first);
    let tangent = Matrix2::new(
        along.dot(&first),
        across.dot(&first),
        along.dot(&second),
        across.dot(&second),
    );
    let turn = Matrix2::new(cos, sin, -sin, cos);
    match tangent.try_inverse() {
        Some(inverse) => turn * inverse.transpose() * material * inverse * turn.transpose(),
        None => Matrix2::zeros(),
    }
}
