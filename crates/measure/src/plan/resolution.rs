//! Size of a pixel on the skin.

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// Distance between two neighbouring pixels on the skin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Footprint {
    /// Distance along the span, d^2 / (h c), mm.
    pub spanwise_mm: f64,
    /// Distance along the flow, d / c, mm.
    pub streamwise_mm: f64,
}

/// Returns the footprint at a point of the skin seen from the origin of the wing frame (m), with the skin's slope dY/dX;
/// `focal_px` is the focal length c, and h the height of the camera over the skin's tangent.
pub fn skin_footprint(point: &Vector3<f64>, slope: f64, focal_px: f64) -> Footprint {
    let distance = point.norm();
    let height = (slope * point.x - point.y).abs() / slope.hypot(1.0);
    Footprint {
        spanwise_mm: 1e3 * distance * distance / (height * focal_px),
        streamwise_mm: 1e3 * distance / focal_px,
    }
}

/// Returns the footprint on a target that faces the camera, as fixed targets do.
pub fn facing_footprint(point: &Vector3<f64>, focal_px: f64) -> Footprint {
    let mm = 1e3 * point.norm() / focal_px;
    Footprint {
        spanwise_mm: mm,
        streamwise_mm: mm,
    }
}

/// Profile of the skin on the ground along the span: height = c0 + c1 X + c2 X^2 through points of the wing frame, by
/// regression; a straight or a level line if there are too few points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkinProfile {
    coefficients: Vector3<f64>,
}

impl SkinProfile {
    /// Fits the profile to points of the wing frame, m.
    pub fn from_points(points: &[Vector3<f64>]) -> Self {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for p in points {
            let row = Vector3::new(1.0, p.x, p.x * p.x);
            normal += row * row.transpose();
            right += row * p.y;
        }
        let order = (1..=points.len().min(3))
            .rev()
            .find(|&n| normal.view((0, 0), (n, n)).determinant() > 1e-6);
        let mut coefficients = Vector3::zeros();
        if let Some(n) = order {
            let inverse = normal.view((0, 0), (n, n)).into_owned().try_inverse();
            if let Some(inverse) = inverse {
                coefficients
                    .rows_mut(0, n)
                    .copy_from(&(inverse * right.rows(0, n)));
            }
        }
        Self { coefficients }
    }

    /// Returns the slope dY/dX at a span.
    pub fn slope(&self, span_m: f64) -> f64 {
        self.coefficients.y + 2.0 * self.coefficients.z * span_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_skin_is_found_from_few_points_and_many() {
        let on = |x: f64| Vector3::new(x, -2.0 + 0.08 * x - 0.001 * x * x, 0.3);
        let many: Vec<_> = (0..9).map(|k| on(6.0 + 3.0 * f64::from(k))).collect();
        let skin = SkinProfile::from_points(&many);
        assert!((skin.slope(20.0) - 0.04).abs() < 1e-9);
        let line = SkinProfile::from_points(&many[..2]);
        assert!((line.slope(0.0) - line.slope(9.0)).abs() < 1e-12);
        assert_eq!(SkinProfile::from_points(&many[..1]).slope(3.0), 0.0);
        assert_eq!(SkinProfile::from_points(&[]).slope(3.0), 0.0);
        assert_eq!(
            SkinProfile::from_points(&[many[0], many[0], many[0]]).slope(3.0),
            0.0
        );
    }

    #[test]
    fn the_papers_table_3() {
        let far = skin_footprint(&Vector3::new(40.0, -2.0, 0.0), 0.0, 7800.0);
        assert!((far.spanwise_mm - 102.8).abs() < 0.05, "{far:?}");
        assert!((far.streamwise_mm - 5.1).abs() < 0.05);
        let near = skin_footprint(&Vector3::new(8.05, -2.0, 0.0), 0.0, 7800.0);
        assert!((near.spanwise_mm - 4.4).abs() < 0.05, "{near:?}");
        assert!((near.streamwise_mm - 1.1).abs() < 0.05);
    }

    #[test]
    fn footprints_agree_with_the_projection() {
        // Two points of a sloping skin, 1 mm apart along it, seen under the angle 1 mm / footprint px.
        let (slope, x) = (0.15f64, 30.0);
        let p = Vector3::new(x, -1.0, 0.0);
        let q = p + Vector3::new(1.0, slope, 0.0) / slope.hypot(1.0) * 1e-3;
        let angle = p.cross(&q).norm() / (p.norm() * q.norm());
        let predicted = 1.0 / skin_footprint(&p, slope, 7800.0).spanwise_mm;
        assert!((7800.0 * angle / predicted - 1.0).abs() < 1e-3);
    }
}
