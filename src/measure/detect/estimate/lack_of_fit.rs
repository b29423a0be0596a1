//! What the image model leaves unexplained. Residuals that hang together along the outline
//! say that the light is more uneven than a plane, or that something else lies across the marker:
//! then the light is freed, the foreign pixels are left out, and the covariance grows by what stays.

use nalgebra::{Matrix2, Vector2};

use super::foreign_ground;
use super::gauss_newton::MarkerFit;
use super::prior::FitUnknowns;
use super::residuals::analyse_residuals;
use crate::detect::appearance::parameters::{X, Y};
use crate::detect::estimate::{options::LACK_OF_FIT, terms::light_field::fit_light_field};
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::Pixels;

/// The fit as it is, with the covariance that its residuals deserve; or a better one. What is left of
/// a marker that is not `whole` could not bear more unknowns.
pub fn improve_fit(pixels: &Pixels, fit: MarkerFit, unknowns: &FitUnknowns, floor: f64, whole: bool) -> MarkerFit {
    let scale = floor.max(fit.rms);
    let Some(seen) = analyse_residuals(pixels, &fit, scale) else { return fit };
    let left_out = seen.biweights.iter().zip(&pixels.batches);
    let left_out: usize = left_out.map(|(t, b)| t.iter().take(b.len).filter(|&&t| t <= 0.0).count()).sum();
    let foreign = left_out as f64 / pixels.count() as f64;
    let is_systematic = seen.uneven > LACK_OF_FIT.uneven
        || seen.ratio > LACK_OF_FIT.correlated
        || foreign > LACK_OF_FIT.foreign;
    // With few foreign pixels the first step tells.
    let least = (foreign <= LACK_OF_FIT.foreign).then_some(LACK_OF_FIT.min_first_gain);
    let freed = if whole && is_systematic {
        fit_light_field(pixels, &fit, &seen, unknowns, floor, least)
    } else {
        None
    };
    let beside = if foreign > LACK_OF_FIT.foreign {
        foreign_ground::foreign_edge_covariance(pixels, &fit, &seen, unknowns, scale)
    } else {
        Matrix2::zeros()
    };
    let mut out = MarkerFit { correlation: seen.mean, foreign_covariance: beside, is_systematic, ..fit };
    let mut centre = seen.covariance;
    if let Some(freed) = freed {
        let gain = (1.0 - (freed.rms / out.rms).powi(2)) * pixels.weight();
        // Between the two limits both stand, so that a small difference of a pixel or two decides nothing.
        let share =
            ((gain - LACK_OF_FIT.uncertain_gain) / (LACK_OF_FIT.certain_gain - LACK_OF_FIT.uncertain_gain)).clamp(0.0, 1.0);
        let between = |one: f64, other: f64| one + share * (other - one);
        let apart = Vector2::from([X, Y].map(|k| freed.parameters[k] - out.parameters[k]));
        // What the field leaves of the residuals that it is for may take the place as far as what it took, by its share of them.
        let beyond = |rms: f64| (rms * rms - floor * floor).max(0.0);
        let left = (beyond(freed.rms) / beyond(out.rms).max(TINY)).min(1.0);
        let doubt = share * (1.0 - share) + (share * left).powi(2);
        let own = freed.covariance.fixed_view::<2, 2>(X, X).into_owned();
        centre = centre.zip_map(&own, between) + apart * apart.transpose() * doubt;
        // The field was fitted without that ground.
        out.foreign_covariance *= 1.0 - share;
        out.white = out.white.zip_map(&freed.white, between);
        for (own, other) in out.parameters.iter_mut().zip(freed.parameters) {
            *own = between(*own, other);
        }
        out.rms = between(out.rms, freed.rms);
        out.inliers = between(out.inliers, freed.inliers);
    }
    out.covariance.fixed_view_mut::<2, 2>(X, X).copy_from(&centre);
    out
}
