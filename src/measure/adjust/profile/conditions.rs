//! The paper's conditions (equations 6 and 7 in their regular form) and their derivatives.

use nalgebra::{DVector, Matrix3x2, Rotation3, Vector2, Vector3};

use super::arc_length;
use crate::environment::Plate;
use crate::estimation::{EstimationError, GroupPoint, Linearised};
use crate::geometry::WingFrame;
use crate::setup::{Orientation, Setup};

/// Observations of one marker, in this order.
pub const ARC_LENGTH: usize = 0;
/// Ground height in the wing frame.
pub const HEIGHT: usize = 1;
/// Pixel, first of two.
pub const PIXEL: usize = 2;
/// Their number.
pub const PER_MARKER: usize = 4;

/// What is the same for all markers.
pub struct Geometry<'a> {
    /// The user's numbers.
    pub setup: &'a Setup,
    /// Wing frame of the installation.
    pub frame: WingFrame,
    wing_from_camera: Rotation3<f64>,
    /// The window's panes in flight, camera frame.
    pane: Option<Plate>,
    /// Length in flight over length on ground.
    thermal_scale: f64,
}

/// The ray outside the window, scaled so that its part in the vertical plane has unit length, with the derivative by the
/// pixel (undistortion included).
pub struct PlaneRay {
    /// A point on it, wing frame, m: the projection centre, shifted by the panes.
    pub from_m: Vector3<f64>,
    /// Wing frame; times d it is the marker, seen from `from_m` (equations 8 and 10).
    pub direction: Vector3<f64>,
    /// d direction / d pixel, 1/px; that of `from_m` is smaller by the panes' thickness over the distance.
    pub by_pixel: Matrix3x2<f64>,
}

impl<'a> Geometry<'a> {
    /// For one frame.
    pub fn new(setup: &'a Setup, orientation: &Orientation) -> Self {
        let frame = setup.wing_frame();
        let wing_from_camera = frame.wing_from_survey * orientation.camera_from_survey.inverse();
        let thermal_scale = setup.thermal.map_or(1.0, |t| t.scale());
        let pane = Plate::from_window(setup.window.as_ref(), &orientation.camera_from_survey, true);
        Self { setup, frame, wing_from_camera, pane, thermal_scale }
    }

    /// Arc length on ground from the bending root and height, wing frame, m (table 1 of the paper).
    pub fn ground(&self, marker: usize) -> Option<(f64, f64)> {
        let p = self.frame.wing_point(&self.setup.markers.get(marker)?.position_m);
        Some((p.x - self.setup.root_offset_m, p.y))
    }

    /// Arc length in flight of one on ground, m.
    pub fn in_flight(&self, ground_length_m: f64) -> f64 {
        ground_length_m * self.thermal_scale
    }

    /// The ray of a pixel; it must point outboard.
    pub fn ray(&self, pixel: &Vector2<f64>) -> Result<PlaneRay, EstimationError> {
        let (ray, jacobian) =
            self.setup.lens.ray_with_jacobian(pixel).map_err(|e| EstimationError::Input(e.to_string()))?;
        let (from_m, ray) = self.pane.map_or((Vector3::zeros(), ray), |pane| pane.outside_ray(&ray));
        let (from_m, ray) = (self.wing_from_camera * from_m, self.wing_from_camera * ray);
        if ray.x <= 0.0 {
            return Err(EstimationError::Input(format!(
                "the ray of pixel ({:.1}, {:.1}) points away from the wing; check span_direction in \
                 installation.toml and orientation.toml",
                pixel.x, pixel.y
            )));
        }
        let jacobian = self.wing_from_camera.matrix() * jacobian;
        let plane = ray.x.hypot(ray.y);
        let along = (jacobian.row(0) * ray.x + jacobian.row(1) * ray.y) / plane;
        let by_pixel = (jacobian - ray / plane * along) / plane;
        Ok(PlaneRay { from_m, direction: ray / plane, by_pixel })
    }

    /// All markers' conditions; each is a group of its own.
    pub fn linearise(&self, at: &GroupPoint, blocks: &mut Vec<Linearised>) -> Result<(), EstimationError> {
        if blocks.is_empty() {
            let empty = Linearised::empty(2, vec![0], 1, PER_MARKER);
            blocks.extend(at.observed.iter().map(|_| empty.clone()));
        }
        let (a, d) = (at.global[0], at.local[0]);
        blocks.iter_mut().zip(at.observed).try_for_each(|(block, seen)| self.block(a, d, seen, block))
    }

    /// `0 = l(x'; a) - l` and `0 = y + a x'^2 - y'`, with `x' = f_x + d r_x - root offset`,
    /// `y' = f_y + d r_y`, f the ray's point at the window.
    fn block(
        &self,
        a: f64,
        d: f64,
        seen: &DVector<f64>,
        out: &mut Linearised,
    ) -> Result<(), EstimationError> {
        let ray = self.ray(&Vector2::new(seen[PIXEL], seen[PIXEL + 1]))?;
        let x = ray.from_m.x + d * ray.direction.x - self.setup.root_offset_m;
        let arc = arc_length(x, a);
        let slope = 2.0 * a * x;
        let rise = a * x * x - ray.from_m.y - d * ray.direction.y;
        out.misclosure[0] = arc.length_m - self.in_flight(seen[ARC_LENGTH]);
        out.misclosure[1] = seen[HEIGHT] + rise;
        (out.global[0], out.global[1]) = (arc.by_a, x * x);
        (out.local[0], out.local[1]) =
            (arc.by_x * ray.direction.x, slope * ray.direction.x - ray.direction.y);
        out.observations[(0, ARC_LENGTH)] = -self.thermal_scale;
        out.observations[(1, HEIGHT)] = 1.0;
        for k in 0..2 {
            let (dx, dy) = (d * ray.by_pixel[(0, k)], d * ray.by_pixel[(1, k)]);
            out.observations[(0, PIXEL + k)] = arc.by_x * dx;
            out.observations[(1, PIXEL + k)] = slope * dx - dy;
        }
        Ok(())
    }
}
