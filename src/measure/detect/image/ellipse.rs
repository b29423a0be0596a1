//! A flat ellipse in the picture.

use std::f64::consts::PI;

use nalgebra::{Matrix2, Vector2};

/// A flat ellipse in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    /// Centre, px.
    pub centre: Vector2<f64>,
    /// Semi-major axis, px.
    pub major: f64,
    /// Semi-minor axis, px.
    pub minor: f64,
    /// Direction of the major axis, rad.
    pub angle: f64,
}

impl Ellipse {
    /// From a covariance, whose unit ellipse is scaled by `factor`.
    pub fn from_moments(centre: Vector2<f64>, covariance: Matrix2<f64>, factor: f64) -> Self {
        // Eigenvalues and direction of a symmetric matrix of two rows; the lesser one by the determinant, for it may be a
        // small difference of large numbers.
        let half = 0.5 * (covariance[(0, 0)] - covariance[(1, 1)]);
        let mixed = covariance[(0, 1)];
        let great = 0.5 * covariance.trace() + (half * half + mixed * mixed).sqrt();
        let small = if great > 0.0 { covariance.determinant() / great } else { 0.0 };
        Self {
            centre,
            major: factor * great.max(0.0).sqrt(),
            minor: factor * small.max(0.0).sqrt(),
            angle: half_turn(0.5 * mixed.atan2(half)),
        }
    }

    /// With semi-axes that are `factor` times as long, and `by` px longer.
    pub fn larger(&self, factor: f64, by: f64) -> Self {
        Self { major: factor * self.major + by, minor: factor * self.minor + by, ..*self }
    }

    /// Unit vector along.
    pub fn axis(&self) -> Vector2<f64> {
        Vector2::new(self.angle.cos(), self.angle.sin())
    }

    /// Unit vector across.
    pub fn across(&self) -> Vector2<f64> {
        let axis = self.axis();
        Vector2::new(-axis.y, axis.x)
    }

    /// Coordinates along and across.
    pub fn local(&self, at: Vector2<f64>) -> (f64, f64) {
        let (sin, cos) = self.angle.sin_cos();
        let d = at - self.centre;
        (d.x * cos + d.y * sin, d.y * cos - d.x * sin)
    }

    /// How far out a point, px, is: 0 at the centre, 1 on the outline.
    pub fn normalized_radius(&self, at: Vector2<f64>) -> f64 {
        let (s, t) = self.local(at);
        (s / self.major).hypot(t / self.minor)
    }

    /// Whether a point, px, lies within.
    pub fn contains(&self, at: Vector2<f64>) -> bool {
        self.normalized_radius(at) < 1.0
    }

    /// From the centre to the outline in a direction, whatever its length, px.
    pub fn radius(&self, direction: Vector2<f64>) -> f64 {
        direction.norm() / self.normalized_radius(self.centre + direction)
    }

    /// Share of the outline for which a test of the place, px, holds.
    pub fn share(&self, test: impl Fn(&Vector2<f64>) -> bool) -> f64 {
        /// Points of the outline that are tested: a share to 1.6 %.
        const POINTS: usize = 64;
        let (sin, cos) = self.angle.sin_cos();
        let count = (0..POINTS).filter(|&k| {
            let (b, a) = (std::f64::consts::TAU * k as f64 / POINTS as f64).sin_cos();
            let (s, t) = (self.major * a, self.minor * b);
            test(&(self.centre + Vector2::new(s * cos - t * sin, s * sin + t * cos)))
        });
        count.count() as f64 / POINTS as f64
    }

    /// Half the extent in u and v.
    pub fn extent(&self) -> Vector2<f64> {
        let (sin, cos) = self.angle.sin_cos();
        let (a, b) = (self.major, self.minor);
        Vector2::new((a * cos).hypot(b * sin), (a * sin).hypot(b * cos))
    }
}

/// Into (-pi/2, pi/2].
pub fn half_turn(angle: f64) -> f64 {
    let turned = angle.rem_euclid(PI);
    if turned > PI / 2.0 { turned - PI } else { turned }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_tell_an_ellipse_of_any_size_and_direction() {
        for (major, minor) in [(1.0, 1.0), (40.0, 2.0), (300.0, 299.0), (800.0, 0.6)] {
            for k in 0..24 {
                let angle = half_turn(0.13 + PI * f64::from(k) / 24.0);
                let axes = Matrix2::new(angle.cos(), -angle.sin(), angle.sin(), angle.cos());
                let squares = Matrix2::from_diagonal(&(Vector2::new(major * major, minor * minor) / 4.0));
                let seen = Ellipse::from_moments(Vector2::zeros(), axes * squares * axes.transpose(), 2.0);
                assert!((seen.major - major).abs() < 1e-9 * major, "{major} x {minor} at {angle}: {seen:?}");
                assert!((seen.minor - minor).abs() < 1e-6 * minor, "{major} x {minor} at {angle}: {seen:?}");
                let off = half_turn(seen.angle - angle).abs();
                assert!(major == minor || off < 1e-9 || PI - off < 1e-9, "{angle}: {seen:?}");
            }
        }
        // What is no covariance is no ellipse, and no panic.
        for none in [Matrix2::zeros(), -Matrix2::identity(), Matrix2::repeat(f64::NAN)] {
            let seen = Ellipse::from_moments(Vector2::zeros(), none, 2.0);
            assert_eq!((seen.major, seen.minor), (0.0, 0.0));
        }
    }
}
