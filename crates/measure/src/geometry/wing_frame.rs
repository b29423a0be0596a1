//! Wing frame, the frame of the adjustment.

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

/// Wing frame: X along the wing's horizontal span direction, outboard; Y up; Z = X x Y; m; origin in the projection centre.
/// Right wing: Z points aft; left wing: forward (docs/conventions.md).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WingFrame {
    /// Origin, survey frame, m.
    pub origin_m: Vector3<f64>,
    /// Rotates survey-frame vectors into the wing frame.
    pub wing_from_survey: Rotation3<f64>,
}

impl WingFrame {
    /// Creates the frame from the projection centre (survey frame, m) and a horizontal direction of any length.
    pub fn new(origin_m: Vector3<f64>, span_direction: Vector2<f64>) -> Self {
        let x = Vector3::new(span_direction.x, span_direction.y, 0.0).normalize();
        let y = Vector3::z();
        let z = x.cross(&y);
        let rows = Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]);
        Self {
            origin_m,
            wing_from_survey: Rotation3::from_matrix_unchecked(rows),
        }
    }

    /// Transforms a survey point to the wing frame, m.
    pub fn wing_point(&self, survey_m: &Vector3<f64>) -> Vector3<f64> {
        self.wing_from_survey * (survey_m - self.origin_m)
    }

    /// Transforms a wing point to the survey frame, m.
    pub fn survey_point(&self, wing_m: &Vector3<f64>) -> Vector3<f64> {
        self.wing_from_survey.inverse() * wing_m + self.origin_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn right_wing_z_points_aft_and_points_return() {
        // Aircraft flying north (+y), right wing to the east: aft is -y.
        let frame = WingFrame::new(Vector3::new(1.0, 2.0, 3.0), Vector2::new(2.0, 0.0));
        let aft = frame.wing_from_survey.inverse() * Vector3::z();
        assert!((aft - Vector3::new(0.0, -1.0, 0.0)).norm() < 1e-15);
        let p = Vector3::new(-4.0, 5.5, 0.25);
        assert!((frame.survey_point(&frame.wing_point(&p)) - p).norm() < 1e-12);
    }
}
