//! Conditions of the paper (equations 6 and 7 in regular form) and their derivatives.

use nalgebra::{DVector, Matrix3x2, Rotation3, Vector2, Vector3};

use super::arc_length;
use crate::environment::Plate;
use crate::estimation::{EstimationError, EstimationResult, GroupPoint, Linearised};
use crate::geometry::WingFrame;
use crate::setup::{Orientation, Setup};

/// Index of the arc length among the observations of one marker.
pub const ARC_LENGTH: usize = 0;
/// Index of the ground height in the wing frame among the observations.
pub const HEIGHT: usize = 1;
/// Index of the first of two pixel coordinates among the observations.
pub const PIXEL: usize = 2;
/// Number of observations per marker.
pub const PER_MARKER: usize = 4;

/// Geometry shared by all markers.
pub struct ProfileGeometry<'a> {
    pub setup: &'a Setup,
    pub frame: WingFrame,
    wing_from_camera: Rotation3<f64>,
    /// The window's panes in flight, camera frame.
    pane: Option<Plate>,
    /// Length in flight over length on the ground.
    thermal_scale: f64,
}

/// Ray outside the window, scaled to unit length in the vertical plane, with its derivative with respect to the pixel
/// (including undistortion).
pub struct PlaneRay {
    /// Point on the ray, wing frame, m: the projection centre, shifted by the panes.
    pub from_m: Vector3<f64>,
    /// Direction in the wing frame; multiplied by d it is the vector from `from_m` to the marker (equations 8 and 10).
    pub direction: Vector3<f64>,
    /// d direction / d pixel, 1/px. The derivative of `from_m` is smaller by the ratio of pane thickness to distance and is
    /// neglected.
    pub by_pixel: Matrix3x2<f64>,
}

impl<'a> ProfileGeometry<'a> {
    /// Prepares the geometry of one frame.
    pub fn new(setup: &'a Setup, orientation: &Orientation) -> Self {
        let frame = setup.wing_frame();
        let wing_from_camera = frame.wing_from_survey * orientation.camera_from_survey.inverse();
        let thermal_scale = setup.thermal.map_or(1.0, |t| t.scale());
        let pane = Plate::from_window(setup.window.as_ref(), &orientation.camera_from_survey, true);
        Self {
            setup,
            frame,
            wing_from_camera,
            pane,
            thermal_scale,
        }
    }

    /// Arc length on the ground from the bending root, and height, wing frame, m (table 1 of the paper).
    pub fn ground_coordinates(&self, marker: usize) -> Option<(f64, f64)> {
        let p = self
            .frame
            .wing_point(&self.setup.markers.get(marker)?.position_m);
        Some((p.x - self.setup.root_offset_m, p.y))
    }

    /// Converts an arc length on the ground to the arc length in flight, m.
    pub fn flight_length_m(&self, ground_length_m: f64) -> f64 {
        ground_length_m * self.thermal_scale
    }

    /// Computes the ray of a pixel.
    ///
    /// # Errors
    /// Returns an error if the pixel has no ray or the ray does not point outboard.
    pub fn plane_ray(&self, pixel: &Vector2<f64>) -> EstimationResult<PlaneRay> {
        let (ray, jacobian) = self
            .setup
            .lens
            .ray_with_jacobian(pixel)
            .map_err(|e| EstimationError::Input(e.to_string()))?;
        let (from_m, ray) = self
            .pane
            .map_or((Vector3::zeros(), ray), |pane| pane.outside_ray(&ray));
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
        Ok(PlaneRay {
            from_m,
            direction: ray / plane,
            by_pixel,
        })
    }

    /// Linearises the conditions of all markers; each marker is a group of its own.
    ///
    /// # Errors
    /// Returns an error if a pixel has no valid ray.
    pub fn linearise(&self, at: &GroupPoint, blocks: &mut Vec<Linearised>) -> EstimationResult<()> {
        if blocks.is_empty() {
            let empty = Linearised::empty(2, vec![0], 1, PER_MARKER);
            blocks.extend(at.observed.iter().map(|_| empty.clone()));
        }
        let (a, d) = (at.global[0], at.local[0]);
        blocks
            .iter_mut()
            .zip(at.observed)
            .try_for_each(|(block, seen)| self.linearise_marker(a, d, seen, block))
    }

    /// Linearises one marker: `0 = l(x'; a) - l` and `0 = y + a x'^2 - y'`, with `x' = f_x + d r_x - root offset` and `y' =
    /// f_y + d r_y`, where f is the point of the ray at the window.
    fn linearise_marker(
        &self,
        a: f64,
        d: f64,
        seen: &DVector<f64>,
        out: &mut Linearised,
    ) -> EstimationResult<()> {
        let ray = self.plane_ray(&Vector2::new(seen[PIXEL], seen[PIXEL + 1]))?;
        let x = ray.from_m.x + d * ray.direction.x - self.setup.root_offset_m;
        let arc = arc_length(x, a);
        let slope = 2.0 * a * x;
        let rise = a * x * x - ray.from_m.y - d * ray.direction.y;
        out.misclosure[0] = arc.length_m - self.flight_length_m(seen[ARC_LENGTH]);
        out.misclosure[1] = seen[HEIGHT] + rise;
        (out.global[0], out.global[1]) = (arc.by_a, x * x);
        (out.local[0], out.local[1]) = (
            arc.by_x * ray.direction.x,
            slope * ray.direction.x - ray.direction.y,
        );
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
