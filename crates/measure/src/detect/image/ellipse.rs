//! Ellipses in the image.

use std::f64::consts::PI;

use nalgebra::{Matrix2, Vector2};

/// Ellipse in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    pub centre: Vector2<f64>,
    /// Semi-major axis, px.
    pub major: f64,
    /// Semi-minor axis, px.
    pub minor: f64,
    /// Direction of the major axis, rad.
    pub angle: f64,
}

impl Ellipse {
    /// Creates an ellipse from a covariance, whose unit ellipse is scaled by `factor`.
    pub fn from_moments(centre: Vector2<f64>, covariance: Matrix2<f64>, factor: f64) -> Self {
        // Eigenvalues and direction of a symmetric matrix of two rows; the smaller one from the determinant,
        // because it may be a small difference of large numbers.
        let half = 0.5 * (covariance[(0, 0)] - covariance[(1, 1)]);
        let mixed = covariance[(0, 1)];
        let great = 0.5 * covariance.trace() + (half * half + mixed * mixed).sqrt();
        let small = if great > 0.0 {
            covariance.determinant() / great
        } else {
            0.0
        };
        Self {
            centre,
            major: factor * great.max(0.0).sqrt(),
            minor: factor * small.max(0.0).sqrt(),
            angle: wrap_half_turn(0.5 * mixed.atan2(half)),
        }
    }

    /// Returns the ellipse with semi-axes scaled by `factor` and then lengthened by `margin` px.
    pub fn enlarged(&self, factor: f64, margin: f64) -> Self {
        Self {
            major: factor * self.major + margin,
            minor: factor * self.minor + margin,
            ..*self
        }
    }

    /// Returns the unit vector along the major axis.
    pub fn major_direction(&self) -> Vector2<f64> {
        Vector2::new(self.angle.cos(), self.angle.sin())
    }

    /// Returns the unit vector along the minor axis.
    pub fn minor_direction(&self) -> Vector2<f64> {
        let axis = self.major_direction();
        Vector2::new(-axis.y, axis.x)
    }

    /// Returns the coordinates of a point along and across the major axis, from the centre, px.
    pub fn local_position(&self, at: Vector2<f64>) -> (f64, f64) {
        let (sin, cos) = self.angle.sin_cos();
        let d = at - self.centre;
        (d.x * cos + d.y * sin, d.y * cos - d.x * sin)
    }

    /// Returns the normalised radius of a point, px: 0 at the centre, 1 on the outline.
    pub fn normalized_radius(&self, at: Vector2<f64>) -> f64 {
        let (s, t) = self.local_position(at);
        (s / self.major).hypot(t / self.minor)
    }

    /// Returns whether a point, px, is inside.
    pub fn contains(&self, at: Vector2<f64>) -> bool {
        self.normalized_radius(at) < 1.0
    }

    /// Returns the distance from the centre to the outline in a direction of any length, px.
    pub fn radius_along(&self, direction: Vector2<f64>) -> f64 {
        direction.norm() / self.normalized_radius(self.centre + direction)
    }

    /// Returns the fraction of the outline for which a test of the position, px, is true.
    pub fn outline_fraction(&self, test: impl Fn(&Vector2<f64>) -> bool) -> f64 {
        /// Number of tested points of the outline: a fraction to 1.6 %.
        const POINTS: usize = 64;
        let (sin, cos) = self.angle.sin_cos();
        let count = (0..POINTS).filter(|&k| {
            let (b, a) = (std::f64::consts::TAU * k as f64 / POINTS as f64).sin_cos();
            let (s, t) = (self.major * a, self.minor * b);
            test(&(self.centre + Vector2::new(s * cos - t * sin, s * sin + t * cos)))
        });
        count.count() as f64 / POINTS as f64
    }

    /// Returns half the extent in u and v, px.
    pub fn half_extent(&self) -> Vector2<f64> {
        let (sin, cos) = self.angle.sin_cos();
        let (a, b) = (self.major, self.minor);
        Vector2::new((a * cos).hypot(b * sin), (a * sin).hypot(b * cos))
    }
}

/// Wraps an angle into (-pi/2, pi/2].
pub fn wrap_half_turn(angle: f64) -> f64 {
    let turned = angle.rem_euclid(PI);
    if turned > PI / 2.0 {
        turned - PI
    } else {
        turned
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_determine_an_ellipse_of_any_size_and_direction() {
        for (major, minor) in [(1.0, 1.0), (40.0, 2.0), (300.0, 299.0), (800.0, 0.6)] {
            for k in 0..24 {
                let angle = wrap_half_turn(0.13 + PI * f64::from(k) / 24.0);
                let axes = Matrix2::new(angle.cos(), -angle.sin(), angle.sin(), angle.cos());
                let squares =
                    Matrix2::from_diagonal(&(Vector2::new(major * major, minor * minor) / 4.0));
                let seen =
                    Ellipse::from_moments(Vector2::zeros(), axes * squares * axes.transpose(), 2.0);
                assert!(
                    (seen.major - major).abs() < 1e-9 * major,
                    "{major} x {minor} at {angle}: {seen:?}"
                );
                assert!(
                    (seen.minor - minor).abs() < 1e-6 * minor,
                    "{major} x {minor} at {angle}: {seen:?}"
                );
                let off = wrap_half_turn(seen.angle - angle).abs();
                assert!(
                    major == minor || off < 1e-9 || PI - off < 1e-9,
                    "{angle}: {seen:?}"
                );
            }
        }
        // An invalid covariance yields no ellipse and does not panic.
        for none in [
            Matrix2::zeros(),
            -Matrix2::identity(),
            Matrix2::repeat(f64::NAN),
        ] {
            let seen = Ellipse::from_moments(Vector2::zeros(), none, 2.0);
            assert_eq!((seen.major, seen.minor), (0.0, 0.0));
        }
    }
}
