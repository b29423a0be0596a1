//! What the model cannot promise, however sharp an image is.

use nalgebra::Matrix2;

/// Smallest standard deviation that an image coordinate is credited with, px: some micrometres on a
/// near quadrant, where neither a decal nor a lens calibration promises more.
const SMALLEST_SIGMA_PX: f64 = 0.005;

/// The covariance with which an image enters the spatial methods, px^2: standard deviations below
/// the smallest are raised to it, along the ellipse's axes.
pub fn image_covariance(stated_px2: &Matrix2<f64>) -> Matrix2<f64> {
    let least = SMALLEST_SIGMA_PX * SMALLEST_SIGMA_PX;
    let axes = stated_px2.symmetric_eigen();
    if axes.eigenvalues.min() >= least {
        return *stated_px2;
    }
    let raised = Matrix2::from_diagonal(&axes.eigenvalues.map(|v| v.max(least)));
    axes.eigenvectors * raised * axes.eigenvectors.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_too_sharp_is_raised() {
        let wide = Matrix2::new(0.01, 0.002, 0.002, 0.0025);
        assert_eq!(image_covariance(&wide), wide);
        let sharp = Matrix2::new(0.01, 1e-6, 1e-6, 1e-6);
        let raised = image_covariance(&sharp);
        assert!((raised[(0, 0)] - 0.01).abs() < 1e-7 && (raised[(1, 1)] - 2.5e-5).abs() < 1e-8);
        assert!((raised[(0, 1)] - raised[(1, 0)]).abs() < 1e-15);
        let smallest = raised.symmetric_eigen().eigenvalues.min();
        assert!((smallest - 2.5e-5).abs() < 1e-12);
    }
}
