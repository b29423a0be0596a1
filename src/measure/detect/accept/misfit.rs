//! What the image formula leaves of a marker beyond noise: a phone's processing, another light within it, a streak of fluid, paint.
//!
//! A bias of some grey levels at an edge shifts it by that part of its width which they are of the contrast. The fit follows what
//! all edges have in common; that its parts are biased each by its own shows as residuals, and to which side does not.

use std::f64::consts::TAU;

use super::verdict::MeasuredMarker;
use crate::detect::accept::options::{MISFIT, VERDICT};
use crate::detect::detection::covariance::CovarianceSource;
use crate::detect::estimate::options::WEIGHT;
use crate::detect::image::noise;
use crate::raster::Raster;
use crate::setup::Shape;

/// Adds that to the covariance, in a frame with some noise, grey levels: along and across the marker as its own fit tells the two.
pub fn inflate_for_misfit(image: &Raster, marker: &mut MeasuredMarker, noise: f64) {
    let px = shift_px(image, marker, noise);
    let covariance = &mut marker.detection.covariance_px2;
    let fit = covariance.of(CovarianceSource::Fit);
    let least = fit.symmetric_eigenvalues().min();
    if px > 0.0 && least > 0.0 {
        covariance.add(CovarianceSource::Misfit, fit * (px * px / least));
    }
}

/// Standard deviation of the centre where the fit tells it best, px; 0 where residuals are noise alone, of which JPEG leaves
/// more at edges than elsewhere.
fn shift_px(image: &Raster, marker: &MeasuredMarker, noise: f64) -> f64 {
    if !marker.is_systematic {
        return 0.0;
    }
    let detection = &marker.detection;
    let contrast = detection.contrast;
    let beyond = |noise: f64| {
        let explained = (VERDICT.poor.0 * noise).powi(2) + (WEIGHT.floor * contrast).powi(2);
        (detection.fit_rms.powi(2) - explained).max(0.0)
    };
    let mut left = beyond(noise);
    if left > 0.0 && detection.shape == Shape::Circle {
        let about = noise::about(image, &detection.ellipse()).max(VERDICT.lost_noise);
        left = left.min(beyond(about));
    }
    // The width of a blurred edge: contrast over its slope.
    MISFIT.of_width * TAU.sqrt() * marker.blur * left.sqrt() / contrast
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;
    use crate::detect::detection::Detection;
    use crate::detect::detection::covariance::Covariance;
    use crate::setup::Shape;

    /// What a disc's place is doubted by along and across it, px, whose fit leaves so many grey levels, of noise alone or not.
    fn doubts(fit_rms: f64, is_systematic: bool) -> [f64; 2] {
        let fit = Matrix2::new(0.0025, 0.0, 0.0, 0.0001);
        let detection = Detection {
            shape: Shape::Circle,
            centre_px: Vector2::new(300.0, 200.0),
            covariance_px2: Covariance::of_fit(fit, fit),
            semi_major_px: 60.0,
            semi_minor_px: 8.0,
            angle_rad: 0.0,
            fit_rms,
            contrast: 100.0,
        };
        let mut disc = MeasuredMarker { blur: 0.8, is_systematic, ..MeasuredMarker::whole(detection) };
        let even = Raster::new(600, 400, vec![160; 600 * 400]).expect("a value for each pixel");
        inflate_for_misfit(&even, &mut disc, 1.0);
        let doubt = disc.detection.covariance_px2.of(CovarianceSource::Misfit);
        [doubt[(0, 0)].sqrt(), doubt[(1, 1)].sqrt()]
    }

    #[test]
    fn what_noise_and_the_formula_explain_costs_nothing_and_more_does() {
        assert_eq!([doubts(2.5, true), doubts(6.0, false)], [[0.0; 2]; 2]);
        let [along, across] = doubts(6.0, true);
        // Half of 5.4 % of an edge of 2 px.
        assert!((across - 0.054).abs() < 0.001 && (along - 5.0 * across).abs() < 1e-9, "{along} {across}");
    }
}
