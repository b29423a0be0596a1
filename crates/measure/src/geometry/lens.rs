//! Interior orientation: pinhole with Brown's distortion in OpenCV's form (docs/conventions.md), for wide lenses divided by a
//! polynomial of the same degree (OpenCV's rational model).

use nalgebra::{Matrix2, Matrix2x3, Matrix3x2, SMatrix, SVector, Vector2, Vector3};

/// Number of interior parameters of Brown's model.
pub const BROWN: usize = 9;

/// Calibrated camera. Camera frame: x right, y down, z forward. Pixel (0, 0) is the centre of the top-left pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    pub width: u32,
    pub height: u32,
    /// Focal length in u, px.
    pub fx: f64,
    /// Focal length in v, px.
    pub fy: f64,
    /// Principal point u, px.
    pub cx: f64,
    /// Principal point v, px.
    pub cy: f64,
    /// Radial distortion r^2.
    pub k1: f64,
    /// Radial distortion r^4.
    pub k2: f64,
    /// Radial distortion r^6.
    pub k3: f64,
    /// Tangential distortion.
    pub p1: f64,
    /// Tangential distortion.
    pub p2: f64,
    /// Terms r^2, r^4, r^6 of the radial distortion's denominator (OpenCV's k4, k5, k6); 0 for Brown's model.
    pub denominator: [f64; 3],
}

/// Reason why a pixel has no ray.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LensError {
    /// Distortion without an inverse there, or no convergence.
    #[error(
        "the lens distortion cannot be inverted at pixel ({u_px:.1}, {v_px:.1}); check k1 to p2 in camera.toml"
    )]
    NoInverse { u_px: f64, v_px: f64 },
}

const MAX_ITERATIONS: usize = 50;
/// Maximum residual of the inverse in normalised coordinates; about 1e-9 px at f = 8000 px.
const INVERSE_TOLERANCE: f64 = 1e-13;

impl Lens {
    /// Names of Brown's parameters, in the order of every vector and covariance of them.
    pub const PARAMETERS: [&str; BROWN] = ["fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2"];

    /// Creates a camera without distortion.
    pub fn pinhole(width: u32, height: u32, f_px: f64, cx: f64, cy: f64) -> Self {
        let (fx, fy) = (f_px, f_px);
        Self {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            k1: 0.0,
            k2: 0.0,
            k3: 0.0,
            p1: 0.0,
            p2: 0.0,
            denominator: [0.0; 3],
        }
    }

    /// Distorts normalised coordinates; returns also the 2x2 Jacobian d(distorted)/d(undistorted).
    pub fn distort(&self, n: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let [above, below] = self.radial_polynomials(r2);
        let radial = above / below;
        let [k4, k5, k6] = self.denominator;
        let rise = |a: f64, b: f64, c: f64| a + r2 * (2.0 * b + 3.0 * r2 * c);
        let slope = 2.0 * (rise(self.k1, self.k2, self.k3) - radial * rise(k4, k5, k6)) / below;
        let xd = x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x);
        let yd = y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y;
        let cross = slope * x * y + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
        let jacobian = Matrix2::new(
            radial + slope * x * x + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            cross,
            cross,
            radial + slope * y * y + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        );
        (Vector2::new(xd, yd), jacobian)
    }

    /// Returns numerator and denominator of the radial distortion.
    fn radial_polynomials(&self, r2: f64) -> [f64; 2] {
        let polynomial = |a: f64, b: f64, c: f64| 1.0 + r2 * (a + r2 * (b + r2 * c));
        let [k4, k5, k6] = self.denominator;
        [
            polynomial(self.k1, self.k2, self.k3),
            polynomial(k4, k5, k6),
        ]
    }

    /// Returns Brown's parameters, in the order of [`Lens::PARAMETERS`].
    pub fn parameters(&self) -> SVector<f64, BROWN> {
        [
            self.fx, self.fy, self.cx, self.cy, self.k1, self.k2, self.k3, self.p1, self.p2,
        ]
        .into()
    }

    /// Returns the lens with changes added to Brown's parameters, in the order of [`Lens::PARAMETERS`].
    pub fn with_changes(&self, change: &SVector<f64, BROWN>) -> Self {
        Self {
            fx: self.fx + change[0],
            fy: self.fy + change[1],
            cx: self.cx + change[2],
            cy: self.cy + change[3],
            k1: self.k1 + change[4],
            k2: self.k2 + change[5],
            k3: self.k3 + change[6],
            p1: self.p1 + change[7],
            p2: self.p2 + change[8],
            ..*self
        }
    }

    /// Returns the lens in flight: focal lengths along u and v multiplied by `factors`, principal point shifted, px.
    pub fn with_flight_change(
        &self,
        factors: &Vector2<f64>,
        principal_point_px: &Vector2<f64>,
    ) -> Self {
        Self {
            fx: self.fx * factors.x,
            fy: self.fy * factors.y,
            cx: self.cx + principal_point_px.x,
            cy: self.cy + principal_point_px.y,
            ..*self
        }
    }

    /// Returns d pixel / d Brown's parameters at a camera-frame point, in the order of [`Lens::PARAMETERS`].
    pub fn parameter_jacobian(&self, p: &Vector3<f64>) -> SMatrix<f64, 2, BROWN> {
        let n = Vector2::new(p.x / p.z, p.y / p.z);
        let (x, y, r2) = (n.x, n.y, n.norm_squared());
        let (d, _) = self.distort(&n);
        let radial = [r2, r2 * r2, r2 * r2 * r2].map(|r| r / self.radial_polynomials(r2)[1]);
        let mut by = SMatrix::zeros();
        (by[(0, 0)], by[(1, 1)], by[(0, 2)], by[(1, 3)]) = (d.x, d.y, 1.0, 1.0);
        for (k, r) in radial.into_iter().enumerate() {
            (by[(0, 4 + k)], by[(1, 4 + k)]) = (self.fx * x * r, self.fy * y * r);
        }
        (by[(0, 7)], by[(1, 7)]) = (self.fx * 2.0 * x * y, self.fy * (r2 + 2.0 * y * y));
        (by[(0, 8)], by[(1, 8)]) = (self.fx * (r2 + 2.0 * x * x), self.fy * 2.0 * x * y);
        by
    }

    /// Returns d pixel / d denominator at a camera-frame point.
    pub fn denominator_jacobian(&self, p: &Vector3<f64>) -> SMatrix<f64, 2, 3> {
        let n = Vector2::new(p.x / p.z, p.y / p.z);
        let [above, below] = self.radial_polynomials(n.norm_squared());
        let r2 = n.norm_squared();
        SMatrix::from_fn(|i, k| {
            let f = [self.fx, self.fy][i];
            -f * n[i] * r2.powi(k as i32 + 1) * above / (below * below)
        })
    }

    /// Projects a camera-frame point, m, to its pixel; `None` behind the camera.
    pub fn project(&self, p: &Vector3<f64>) -> Option<Vector2<f64>> {
        (p.z > 0.0).then(|| {
            let (d, _) = self.distort(&Vector2::new(p.x / p.z, p.y / p.z));
            Vector2::new(self.fx * d.x + self.cx, self.fy * d.y + self.cy)
        })
    }

    /// Projects a camera-frame point to its pixel with the Jacobian d(pixel)/d(point), px/m; `None` behind the camera.
    pub fn project_with_jacobian(
        &self,
        p: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        if p.z <= 0.0 {
            return None;
        }
        let n = Vector2::new(p.x / p.z, p.y / p.z);
        let (d, distortion) = self.distort(&n);
        let iz = 1.0 / p.z;
        let perspective = Matrix2x3::new(iz, 0.0, -n.x * iz, 0.0, iz, -n.y * iz);
        let focal = Matrix2::new(self.fx, 0.0, 0.0, self.fy);
        let pixel = Vector2::new(self.fx * d.x + self.cx, self.fy * d.y + self.cy);
        Some((pixel, focal * distortion * perspective))
    }

    /// Returns the undistorted normalised coordinates (x/z, y/z) of a pixel, by Newton's iteration with the exact Jacobian
    /// and step halving.
    ///
    /// # Errors
    /// Returns an error if the distortion has no inverse there.
    pub fn undistort(&self, pixel: &Vector2<f64>) -> Result<Vector2<f64>, LensError> {
        let fail = LensError::NoInverse {
            u_px: pixel.x,
            v_px: pixel.y,
        };
        let target = Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        let mut n = target;
        let (mut d, mut jacobian) = self.distort(&n);
        for _ in 0..MAX_ITERATIONS {
            let residual = target - d;
            if residual.norm() < INVERSE_TOLERANCE {
                // Beyond the fold of the distortion a second, mirrored solution exists.
                let [_, below] = self.radial_polynomials(n.norm_squared());
                let regular = below > 0.0 && jacobian.determinant() > 0.0 && jacobian.trace() > 0.0;
                return if regular { Ok(n) } else { Err(fail) };
            }
            let inverse = jacobian.try_inverse().ok_or(fail)?;
            let step = inverse * residual;
            let mut scale = 1.0;
            loop {
                let candidate = n + step * scale;
                let (next, next_jacobian) = self.distort(&candidate);
                if (target - next).norm() < residual.norm() {
                    (n, d, jacobian) = (candidate, next, next_jacobian);
                    break;
                }
                scale *= 0.5;
                if scale < 1e-6 {
                    let good_enough = residual.norm() < 1e-11 && jacobian.determinant() > 0.0;
                    return if good_enough { Ok(n) } else { Err(fail) };
                }
            }
        }
        Err(fail)
    }

    /// Returns the unit direction of the ray through a pixel, camera frame (paper, equation 9).
    ///
    /// # Errors
    /// Returns an error if the distortion has no inverse there.
    pub fn ray(&self, pixel: &Vector2<f64>) -> Result<Vector3<f64>, LensError> {
        let n = self.undistort(pixel)?;
        Ok(Vector3::new(n.x, n.y, 1.0).normalize())
    }

    /// Checks that a ray belongs to every pixel on the edge of the image.
    ///
    /// # Errors
    /// Returns an error for the first pixel without a ray.
    pub fn check_edge(&self) -> Result<(), LensError> {
        let (w, h) = (f64::from(self.width), f64::from(self.height));
        let steps = (0..=20).map(|k| f64::from(k) / 20.0);
        let mut edge = steps.flat_map(|t| [(t * w, 0.0), (t * w, h), (0.0, t * h), (w, t * h)]);
        edge.try_for_each(|(u, v)| self.ray(&Vector2::new(u - 0.5, v - 0.5)).map(|_| ()))
    }

    /// Returns the ray and its Jacobian d(unit direction)/d(pixel), 1/px, including the distortion.
    ///
    /// # Errors
    /// Returns an error if the distortion has no inverse there.
    pub fn ray_with_jacobian(
        &self,
        pixel: &Vector2<f64>,
    ) -> Result<(Vector3<f64>, Matrix3x2<f64>), LensError> {
        let n = self.undistort(pixel)?;
        let (_, distortion) = self.distort(&n);
        let fail = LensError::NoInverse {
            u_px: pixel.x,
            v_px: pixel.y,
        };
        let normalised = distortion.try_inverse().ok_or(fail)?
            * Matrix2::new(1.0 / self.fx, 0.0, 0.0, 1.0 / self.fy);
        let p = Vector3::new(n.x, n.y, 1.0);
        let length = p.norm();
        let unit = p / length;
        let normalise = (nalgebra::Matrix3::identity() - unit * unit.transpose()) / length;
        let deflection = Matrix3x2::new(1.0, 0.0, 0.0, 1.0, 0.0, 0.0);
        Ok((unit, normalise * deflection * normalised))
    }

    /// Returns true if a pixel is on the sensor.
    pub fn contains(&self, pixel: &Vector2<f64>) -> bool {
        pixel.x >= -0.5
            && pixel.y >= -0.5
            && pixel.x <= f64::from(self.width) - 0.5
            && pixel.y <= f64::from(self.height) - 0.5
    }

    /// Returns the mean focal length, px.
    pub fn focal_px(&self) -> f64 {
        0.5 * (self.fx + self.fy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lens(k1: f64, k2: f64, p1: f64, p2: f64) -> Lens {
        Lens {
            k1,
            k2,
            k3: -0.02,
            p1,
            p2,
            fy: 7795.0,
            ..Lens::pinhole(4000, 3000, 7800.0, 1986.0, 1513.0)
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        #[test]
        fn the_inverse_returns_the_pixel(
            u in 0.0..3999.0f64, v in 0.0..2999.0f64, k1 in -0.3..0.3f64, k2 in -0.3..0.3f64,
            p1 in -2e-3..2e-3f64, p2 in -2e-3..2e-3f64, depth in 1.0..50.0f64,
        ) {
            let lens = lens(k1, k2, p1, p2);
            let pixel = Vector2::new(u, v);
            let ray = lens.ray(&pixel).unwrap();
            let back = lens.project(&(ray * depth)).unwrap();
            prop_assert!((back - pixel).norm() < 1e-8);
        }

        #[test]
        fn jacobians_match_differences(
            x in -0.25..0.25f64, y in -0.19..0.19f64, k1 in -0.3..0.3f64, p1 in -2e-3..2e-3f64,
        ) {
            let lens = lens(k1, 0.1, p1, 1e-3);
            let p = Vector3::new(x, y, 1.0) * 7.0;
            let (pixel, jacobian) = lens.project_with_jacobian(&p).unwrap();
            let (ray, ray_jacobian) = lens.ray_with_jacobian(&pixel).unwrap();
            prop_assert!((ray - p.normalize()).norm() < 1e-11);
            for axis in 0..3 {
                let mut step = Vector3::zeros();
                step[axis] = 1e-5;
                let difference = (lens.project(&(p + step)).unwrap() - lens.project(&(p - step)).unwrap()) / 2e-5;
                prop_assert!((difference - jacobian.column(axis)).norm() < 1e-3);
            }
            for axis in 0..2 {
                let mut step = Vector2::zeros();
                step[axis] = 1e-2;
                let difference = (lens.ray(&(pixel + step)).unwrap() - lens.ray(&(pixel - step)).unwrap()) / 2e-2;
                prop_assert!((difference - ray_jacobian.column(axis)).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn a_rational_lens_has_its_inverse_and_its_derivatives() {
        // A lens with a field of view of 120 degrees.
        let lens = Lens {
            k1: 0.3,
            k2: 0.02,
            k3: 0.001,
            p1: 1e-4,
            denominator: [0.55, 0.08, 0.003],
            ..Lens::pinhole(1280, 960, 560.0, 650.0, 498.0)
        };
        for (u, v) in [(0.0, 0.0), (1279.0, 0.0), (640.0, 959.0), (300.0, 700.0)] {
            let ray = lens.ray(&Vector2::new(u, v)).unwrap();
            let point = ray / ray.z * 3.0;
            let (pixel, by_point) = lens.project_with_jacobian(&point).unwrap();
            assert!((pixel - Vector2::new(u, v)).norm() < 1e-8);
            let mut differences = vec![];
            for axis in 0..3 {
                let mut step = Vector3::zeros();
                step[axis] = 1e-5;
                let by = (lens.project(&(point + step)).unwrap()
                    - lens.project(&(point - step)).unwrap())
                    / 2e-5;
                differences.push((by - by_point.column(axis)).norm());
            }
            for k in 0..3 {
                let at = |sign: f64| {
                    let mut other = lens;
                    other.denominator[k] += sign * 1e-7;
                    other.project(&point).unwrap()
                };
                let by = (at(1.0) - at(-1.0)) / 2e-7;
                differences.push((by - lens.denominator_jacobian(&point).column(k)).norm());
            }
            let by = |k1: f64| Lens { k1, ..lens }.project(&point).unwrap();
            let by_k1 = (by(lens.k1 + 1e-6) - by(lens.k1 - 1e-6)) / 2e-6;
            differences.push((by_k1 - lens.parameter_jacobian(&point).column(4)).norm());
            assert!(differences.iter().all(|d| *d < 1e-3), "{differences:?}");
        }
    }

    #[test]
    fn a_folding_distortion_is_refused_not_guessed() {
        let lens = Lens {
            k1: -30.0,
            ..Lens::pinhole(4000, 3000, 7800.0, 2000.0, 1500.0)
        };
        assert!(lens.ray(&Vector2::new(3990.0, 10.0)).is_err());
        assert!(lens.ray(&Vector2::new(2000.0, 1500.0)).is_ok());
        assert!(lens.ray(&Vector2::new(f64::NAN, 0.0)).is_err());
    }

    #[test]
    fn points_behind_the_camera_are_not_projected() {
        let lens = Lens::pinhole(4000, 3000, 7800.0, 2000.0, 1500.0);
        assert!(lens.project(&Vector3::new(0.0, 0.0, -1.0)).is_none());
    }
}
