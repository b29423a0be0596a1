//! Did the camera move between two frames of a scene that did not? A rotation and a shift from the same
//! markers in both, in the units in which an installation states what it expects.

use nalgebra::{Matrix6, SMatrix, Vector2, Vector3, Vector6};

use super::geometry::{Lens, cross_matrix};

/// A marker in both frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// Where the survey puts it, camera frame, m.
    pub point_m: Vector3<f64>,
    /// After - before, px.
    pub moved_px: Vector2<f64>,
    /// Of the difference, px^2.
    pub covariance_px2: nalgebra::Matrix2<f64>,
}

/// The camera's movement.
#[derive(Clone, Debug, PartialEq)]
pub struct Movement {
    /// Markers in both frames.
    pub markers: usize,
    /// Root mean square movement in the picture (length), px.
    pub moved_px: f64,
    /// Mean movement, px.
    pub mean_px: Vector2<f64>,
    /// Rotation of the camera about its axes, rad.
    pub rotation_rad: Vector3<f64>,
    /// Standard deviations, rad.
    pub rotation_sigma_rad: Vector3<f64>,
    /// Shift of the projection centre along the camera's axes, m.
    pub shift_m: Vector3<f64>,
    /// Standard deviations, m.
    pub shift_sigma_m: Vector3<f64>,
    /// What rotation and shift leave over, root mean square length, px.
    pub left_px: f64,
}

/// Markers needed for a rotation and a check.
const MIN_MARKERS: usize = 3;

/// `None` where too few markers are in both frames. `shift_sigma_m` is what is known of the shift beforehand: far
/// markers alone tell it from a rotation badly.
pub fn movement(lens: &Lens, pairs: &[Pair], shift_sigma_m: f64) -> Option<Movement> {
    if pairs.len() < MIN_MARKERS {
        return None;
    }
    let mut normal = Matrix6::zeros();
    let mut right = Vector6::zeros();
    for k in 3..6 {
        normal[(k, k)] = shift_sigma_m.powi(-2);
    }
    let design = |pair: &Pair| {
        let (_, by_point) = lens.project_with_jacobian(&pair.point_m)?;
        let mut by = SMatrix::<f64, 2, 6>::zeros();
        // The scene turns and shifts the other way.
        by.fixed_columns_mut::<3>(0).copy_from(&(by_point * cross_matrix(&pair.point_m)));
        by.fixed_columns_mut::<3>(3).copy_from(&-by_point);
        Some((by, pair.covariance_px2.try_inverse()?))
    };
    for pair in pairs {
        let (by, weight) = design(pair)?;
        normal += by.transpose() * weight * by;
        right += by.transpose() * weight * pair.moved_px;
    }
    let covariance = normal.cholesky()?.inverse();
    let found = covariance * right;
    let n = pairs.len() as f64;
    let left: f64 =
        pairs.iter().filter_map(|p| Some((p.moved_px - design(p)?.0 * found).norm_squared())).sum();
    let moved: f64 = pairs.iter().map(|p| p.moved_px.norm_squared()).sum();
    let sigma = covariance.diagonal().map(f64::sqrt);
    Some(Movement {
        markers: pairs.len(),
        moved_px: (moved / n).sqrt(),
        mean_px: pairs.iter().map(|p| p.moved_px).sum::<Vector2<f64>>() / n,
        rotation_rad: found.fixed_rows::<3>(0).into(),
        rotation_sigma_rad: sigma.fixed_rows::<3>(0).into(),
        shift_m: found.fixed_rows::<3>(3).into(),
        shift_sigma_m: sigma.fixed_rows::<3>(3).into(),
        left_px: (left / n).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Rotation3};

    use super::*;

    #[test]
    fn a_rotation_and_a_shift_come_back() {
        let lens = Lens::pinhole(4000, 3000, 7800.0, 2000.0, 1500.0);
        let (turn, shift) = (Vector3::new(1e-4, -2e-4, 3e-4), Vector3::new(0.002, -0.001, 0.0005));
        let camera = Rotation3::new(turn);
        let pair = |k: usize| {
            let z = 3.0 + 2.5 * k as f64;
            let point_m =
                Vector3::new(0.15 * z * (k as f64 * 1.7).sin(), 0.1 * z * (k as f64 * 2.3).cos(), z);
            let after = camera.inverse() * (point_m - shift);
            let moved_px = lens.project(&after).unwrap() - lens.project(&point_m).unwrap();
            Pair { point_m, moved_px, covariance_px2: Matrix2::identity() * 0.05 * 0.05 }
        };
        let pairs: Vec<Pair> = (0..14).map(pair).collect();
        let found = movement(&lens, &pairs, 1.0).unwrap();
        assert!((found.rotation_rad - turn).norm() < 1e-6, "{found:?}");
        assert!((found.shift_m - shift).norm() < 1e-5, "{found:?}");
        assert!(found.left_px < 0.01, "{found:?}");
        assert!(movement(&lens, &pairs[..2], 1.0).is_none());
    }
}
