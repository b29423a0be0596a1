//! Residuals beyond noise that the image formula leaves of a marker: image processing of a phone, uneven light within it, a
//! streak of fluid, paint.
//!
//! A grey-level bias at an edge shifts it by the fraction (bias over contrast) of the edge's width. The fit follows the
//! bias common to all edges; differing biases of its parts show as residuals, but not in which direction they shift it.

use std::f64::consts::TAU;

use super::verdict::MeasuredMarker;
use crate::detect::accept::options::{MISFIT, VERDICT};
use crate::detect::detection::covariance::CovarianceSource;
use crate::detect::estimate::options::WEIGHT;
use crate::detect::image::noise;
use crate::raster::Raster;
use crate::setup::Shape;

/// Adds the variance due to misfit to a marker's covariance, in proportion to the fit's own covariance along and across.
/// `noise` is that of the frame, grey levels.
pub fn inflate_for_misfit(image: &Raster, marker: &mut MeasuredMarker, noise: f64) {
    let px = shift_px(image, marker, noise);
    let covariance = &mut marker.detection.covariance_px2;
    let fit = covariance.contribution(CovarianceSource::Fit);
    let least = fit.symmetric_eigenvalues().min();
    if px > 0.0 && least > 0.0 {
        covariance.add(CovarianceSource::Misfit, fit * (px * px / least));
    }
}

/// Returns the standard deviation of the centre in its best-determined direction, px; 0 if the residuals are noise alone,
/// of which JPEG leaves more at edges than elsewhere.
fn shift_px(image: &Raster, marker: &MeasuredMarker, noise: f64) -> f64 {
    if !marker.is_systematic {
        return 0.0;
    }
    let detection = &marker.detection;
    let contrast = detection.contrast;
    let beyond = |noise: f64| {
        let explained =
            (VERDICT.max_rms_over_noise * noise).powi(2) + (WEIGHT.floor * contrast).powi(2);
        (detection.fit_rms.powi(2) - explained).max(0.0)
    };
    let mut left = beyond(noise);
    if left > 0.0 && detection.shape == Shape::Circle {
        let about = noise::noise_around(image, &detection.ellipse()).max(VERDICT.edge_noise);
        left = left.min(beyond(about));
    }
    // The width of a blurred edge: contrast over its slope.
    MISFIT.edge_fraction * TAU.sqrt() * marker.blur * left.sqrt() / contrast
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;
    use crate::detect::detection::Detection;
    use crate::detect::detection::covariance::Covariance;
    use crate::setup::Shape;

    /// Returns the standard deviation along and across, px, that a disc gets for given residuals, grey levels, systematic
    /// or not.
    fn inflations(fit_rms: f64, is_systematic: bool) -> [f64; 2] {
        let fit = Matrix2::new(0.0025, 0.0, 0.0, 0.0001);
        let detection = Detection {
            shape: Shape::Circle,
            centre_px: Vector2::new(300.0, 200.0),
            covariance_px2: Covariance::from_fit(fit, fit),
            semi_major_px: 60.0,
            semi_minor_px: 8.0,
            angle_rad: 0.0,
            fit_rms,
            contrast: 100.0,
            marker: None,
        };
        let mut disc = MeasuredMarker {
            blur: 0.8,
            is_systematic,
            ..MeasuredMarker::whole(detection)
        };
        let even = Raster::new(600, 400, vec![160; 600 * 400]).expect("a value for each pixel");
        inflate_for_misfit(&even, &mut disc, 1.0);
        let misfit = disc
            .detection
            .covariance_px2
            .contribution(CovarianceSource::Misfit);
        [misfit[(0, 0)].sqrt(), misfit[(1, 1)].sqrt()]
    }

    #[test]
    fn only_unexplained_residuals_inflate_the_covariance() {
        assert_eq!(
            [inflations(2.5, true), inflations(6.0, false)],
            [[0.0; 2]; 2]
        );
        let [along, across] = inflations(6.0, true);
        // Half of 5.4 % of an edge of 2 px.
        assert!(
            (across - 0.054).abs() < 0.001 && (along - 5.0 * across).abs() < 1e-9,
            "{along} {across}"
        );
    }
}
