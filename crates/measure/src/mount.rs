//! Movement of the camera between two frames of a static scene: rotation and shift from markers in both frames, in the
//! units in which an installation gives its tolerances.

use nalgebra::{Matrix6, SMatrix, Vector2, Vector3, Vector6};

use super::geometry::{Lens, cross_matrix};

/// Shift of a marker's image between two frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerShift {
    /// Surveyed position, camera frame, m.
    pub point_m: Vector3<f64>,
    /// Shift of the image, after minus before, px.
    pub moved_px: Vector2<f64>,
    /// Covariance of the shift, px^2.
    pub covariance_px2: nalgebra::Matrix2<f64>,
}

/// Movement of the camera between two frames.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraMovement {
    /// Number of markers in both frames.
    pub markers: usize,
    /// Root mean square length of the image shifts, px.
    pub moved_px: f64,
    /// Mean image shift, px.
    pub mean_px: Vector2<f64>,
    /// Rotation of the camera about its axes, rad.
    pub rotation_rad: Vector3<f64>,
    pub rotation_sigma_rad: Vector3<f64>,
    /// Shift of the projection centre along the camera's axes, m.
    pub shift_m: Vector3<f64>,
    pub shift_sigma_m: Vector3<f64>,
    /// Root mean square length of the residuals after rotation and shift, px.
    pub residual_px: f64,
    /// Weighted sum of squares of these residuals, less that of the residuals after a shift of the image alone.
    image_shift_gain: f64,
}

/// Gain from which a shift of the image is the cause: its logarithm of the probability is 15 larger, with four unknowns less.
const MIN_IMAGE_SHIFT_GAIN: f64 = 30.0;

impl CameraMovement {
    /// Returns whether a shift of the image explains the markers better than any movement of the camera, as stabilisation of
    /// lens or sensor does.
    pub fn is_image_shift(&self) -> bool {
        self.image_shift_gain > MIN_IMAGE_SHIFT_GAIN
    }
}

/// Minimum number of markers, for a rotation with redundancy.
const MIN_MARKERS: usize = 3;

/// Estimates the movement; `None` if too few markers are in both frames. `shift_sigma_m`: prior standard deviation of the
/// shift, because distant markers alone separate it poorly from a rotation.
pub fn estimate_movement(
    lens: &Lens,
    pairs: &[MarkerShift],
    shift_sigma_m: f64,
) -> Option<CameraMovement> {
    if pairs.len() < MIN_MARKERS {
        return None;
    }
    let mut normal = Matrix6::zeros();
    let mut right = Vector6::zeros();
    for k in 3..6 {
        normal[(k, k)] = shift_sigma_m.powi(-2);
    }
    let design = |pair: &MarkerShift| {
        let (_, by_point) = lens.project_with_jacobian(&pair.point_m)?;
        let mut rows = SMatrix::<f64, 2, 6>::zeros();
        // The scene turns and shifts the other way.
        rows.fixed_columns_mut::<3>(0)
            .copy_from(&(by_point * cross_matrix(&pair.point_m)));
        rows.fixed_columns_mut::<3>(3).copy_from(&-by_point);
        Some((rows, pair.covariance_px2.try_inverse()?))
    };
    for pair in pairs {
        let (rows, weight) = design(pair)?;
        normal += rows.transpose() * weight * rows;
        right += rows.transpose() * weight * pair.moved_px;
    }
    let covariance = normal.cholesky()?.inverse();
    let found = covariance * right;
    let n = pairs.len() as f64;
    let left: f64 = pairs
        .iter()
        .filter_map(|p| Some((p.moved_px - design(p)?.0 * found).norm_squared()))
        .sum();
    let moved: f64 = pairs.iter().map(|p| p.moved_px.norm_squared()).sum();
    let mean_px = pairs.iter().map(|p| p.moved_px).sum::<Vector2<f64>>() / n;
    let weighted = |pair: &MarkerShift, residual: Vector2<f64>| {
        let weight = pair.covariance_px2.try_inverse()?;
        Some(residual.dot(&(weight * residual)))
    };
    let gain = |pair: &MarkerShift| {
        let turned = weighted(pair, pair.moved_px - design(pair)?.0 * found)?;
        Some(turned - weighted(pair, pair.moved_px - mean_px)?)
    };
    let sigma = covariance.diagonal().map(f64::sqrt);
    Some(CameraMovement {
        markers: pairs.len(),
        moved_px: (moved / n).sqrt(),
        mean_px,
        rotation_rad: found.fixed_rows::<3>(0).into(),
        rotation_sigma_rad: sigma.fixed_rows::<3>(0).into(),
        shift_m: found.fixed_rows::<3>(3).into(),
        shift_sigma_m: sigma.fixed_rows::<3>(3).into(),
        residual_px: (left / n).sqrt(),
        image_shift_gain: pairs.iter().filter_map(gain).sum(),
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Rotation3};

    use super::*;

    #[test]
    fn a_rotation_and_a_shift_come_back() {
        let lens = Lens::pinhole(4000, 3000, 7800.0, 2000.0, 1500.0);
        let (turn, shift) = (
            Vector3::new(1e-4, -2e-4, 3e-4),
            Vector3::new(0.002, -0.001, 0.0005),
        );
        let camera = Rotation3::new(turn);
        let pair = |k: usize| {
            let z = 3.0 + 2.5 * k as f64;
            let point_m = Vector3::new(
                0.15 * z * (k as f64 * 1.7).sin(),
                0.1 * z * (k as f64 * 2.3).cos(),
                z,
            );
            let after = camera.inverse() * (point_m - shift);
            let moved_px = lens.project(&after).unwrap() - lens.project(&point_m).unwrap();
            MarkerShift {
                point_m,
                moved_px,
                covariance_px2: Matrix2::identity() * 0.05 * 0.05,
            }
        };
        let pairs: Vec<MarkerShift> = (0..14).map(pair).collect();
        let found = estimate_movement(&lens, &pairs, 1.0).unwrap();
        assert!((found.rotation_rad - turn).norm() < 1e-6, "{found:?}");
        assert!((found.shift_m - shift).norm() < 1e-5, "{found:?}");
        assert!(found.residual_px < 0.01, "{found:?}");
        assert!(estimate_movement(&lens, &pairs[..2], 1.0).is_none());
    }
}
