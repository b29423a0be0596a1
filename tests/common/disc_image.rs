//! The image of a flat disc, from a dense polygon.

use nalgebra::{Matrix2, Vector2, Vector3};
use wingd::measure::geometry::Lens;

#[derive(Clone, Copy)]
pub struct DiscImage {
    pub point: Vector2<f64>,
    pub centre: Vector2<f64>,
    pub major: f64,
    pub minor: f64,
    pub angle: f64,
}

/// Outline of a flat disc (a detector allows for the curvature from a crowned skin): centroid of
/// area of a dense polygon, axes from its second moments.
pub fn image_of_disc(
    lens: &Lens,
    p: &Vector3<f64>,
    n: &Vector3<f64>,
    radius: f64,
) -> Option<DiscImage> {
    let e1 = n.cross(&Vector3::new(0.31, 0.2, 0.93)).normalize();
    let e2 = n.cross(&e1);
    let count = 720;
    let mut points = Vec::with_capacity(count);
    for k in 0..count {
        let (s, c) = (std::f64::consts::TAU * k as f64 / count as f64).sin_cos();
        points.push(lens.project(&(p + (e1 * c + e2 * s) * radius))?);
    }
    let point = lens.project(p)?;
    let (mut area, mut first) = (0.0, Vector2::zeros());
    let mut second = Matrix2::zeros();
    for k in 0..count {
        let (a, b) = (points[k] - point, points[(k + 1) % count] - point);
        let cross = a.perp(&b);
        area += 0.5 * cross;
        first += (a + b) * (cross / 6.0);
        second += (a * a.transpose() + b * b.transpose() + (a + b) * (a + b).transpose())
            * (cross / 24.0);
    }
    let centroid = first / area;
    let shape = (second / area - centroid * centroid.transpose()) * 4.0;
    let eigen = shape.symmetric_eigen();
    let large = if eigen.eigenvalues[0] > eigen.eigenvalues[1] {
        0
    } else {
        1
    };
    let axis = eigen.eigenvectors.column(large);
    Some(DiscImage {
        point,
        centre: point + centroid,
        major: eigen.eigenvalues[large].max(0.0).sqrt(),
        minor: eigen.eigenvalues[1 - large].max(0.0).sqrt(),
        angle: (axis[1] / axis[0]).atan(),
    })
}
