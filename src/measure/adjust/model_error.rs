//! What the model cannot promise, however sharp an image is.

use nalgebra::Matrix2;

/// Smallest standard deviation that an image coordinate is credited with, px. A detector finds a
/// near quadrant to 0.003 px, some micrometres on the wing; the beam (polynomial curvature, rigid
/// sections, one reference shape) and a lens calibration do not hold to that. On random tapered
/// wings seen with a detector's noise, position, lift and torsion scatter 1.2, 1.45 and 1.2 times
/// their standard deviations without it, 0.95, 0.92 and 1.0 times with it, and the height's error
/// falls by a tenth, in a flight by four tenths (`tests/adjust_coverage.rs`).
const SMALLEST_SIGMA_PX: f64 = 0.025;

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
        let sharp = Matrix2::new(0.01, 1e-5, 1e-5, 1e-5);
        let raised = image_covariance(&sharp);
        assert!((raised[(0, 0)] - 0.01).abs() < 1e-6 && (raised[(1, 1)] - 6.25e-4).abs() < 1e-6);
        assert!((raised[(0, 1)] - raised[(1, 0)]).abs() < 1e-15);
        let smallest = raised.symmetric_eigen().eigenvalues.min();
        assert!((smallest - 6.25e-4).abs() < 1e-12);
    }
}
