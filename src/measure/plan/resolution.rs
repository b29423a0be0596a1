//! What one pixel covers on the skin.

use nalgebra::Vector3;
use serde::Serialize;

/// Distance between two neighbouring pixels on the skin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Footprint {
    /// Along the span, d^2 / (h c), mm.
    pub spanwise_mm: f64,
    /// Along the flow, d / c, mm.
    pub streamwise_mm: f64,
}

/// For a point of the skin seen from the origin of the wing frame (m), with the skin's slope dY/dX
/// there; `focal_px` is the camera constant c. h is the height of the camera over the skin's tangent.
pub fn footprint(point: &Vector3<f64>, slope: f64, focal_px: f64) -> Footprint {
    let distance = point.norm();
    let height = (slope * point.x - point.y).abs() / slope.hypot(1.0);
    Footprint {
        spanwise_mm: 1e3 * distance * distance / (height * focal_px),
        streamwise_mm: 1e3 * distance / focal_px,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_table_3() {
        let far = footprint(&Vector3::new(40.0, -2.0, 0.0), 0.0, 7800.0);
        assert!((far.spanwise_mm - 102.8).abs() < 0.05, "{far:?}");
        assert!((far.streamwise_mm - 5.1).abs() < 0.05);
        let near = footprint(&Vector3::new(8.05, -2.0, 0.0), 0.0, 7800.0);
        assert!((near.spanwise_mm - 4.4).abs() < 0.05, "{near:?}");
        assert!((near.streamwise_mm - 1.1).abs() < 0.05);
    }

    #[test]
    fn a_pixel_covers_what_the_projection_says() {
        // Two points of a sloping skin, 1 mm apart along it, seen under the angle 1 mm / footprint px.
        let (slope, x) = (0.15f64, 30.0);
        let p = Vector3::new(x, -1.0, 0.0);
        let q = p + Vector3::new(1.0, slope, 0.0) / slope.hypot(1.0) * 1e-3;
        let angle = p.cross(&q).norm() / (p.norm() * q.norm());
        let predicted = 1.0 / footprint(&p, slope, 7800.0).spanwise_mm;
        assert!((7800.0 * angle / predicted - 1.0).abs() < 1e-3);
    }
}
