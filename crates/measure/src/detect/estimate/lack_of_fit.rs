//! Lack of fit of the image model. Residuals that are correlated along the outline indicate that the light is more uneven
//! than a plane, or that a foreign object lies across the marker: a light field is then estimated, the foreign pixels are
//! excluded, and the covariance is increased for the remaining residuals.

use nalgebra::Vector2;

use super::gauss_newton::MarkerFit;
use super::prior::FitUnknowns;
use super::residuals::analyse_residuals;
use crate::detect::appearance::parameters::{X, Y};
use crate::detect::estimate::{options::LACK_OF_FIT, terms::light_field::fit_light_field};
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::Pixels;

/// Returns the fit with a covariance that accounts for its residuals, improved by a light field if necessary. A marker that
/// is not `whole` has too few pixels for additional unknowns.
pub fn improve_fit(
    pixels: &Pixels,
    fit: MarkerFit,
    unknowns: &FitUnknowns,
    floor: f64,
    whole: bool,
) -> MarkerFit {
    let scale = floor.max(fit.rms);
    let Some(seen) = analyse_residuals(pixels, &fit, scale) else {
        return fit;
    };
    let excluded = seen.biweights.iter().zip(&pixels.batches);
    let excluded: usize = excluded
        .map(|(t, b)| t.iter().take(b.len).filter(|&&t| t <= 0.0).count())
        .sum();
    let foreign = excluded as f64 / pixels.count() as f64;
    let is_systematic = seen.uneven > LACK_OF_FIT.uneven
        || seen.ratio > LACK_OF_FIT.correlated
        || foreign > LACK_OF_FIT.foreign;
    // With few foreign pixels the first step predicts the reduction reliably.
    // Half of the gain from which on the field is used.
    let least = (foreign <= LACK_OF_FIT.foreign).then_some(0.5 * LACK_OF_FIT.uncertain_gain);
    let freed = if whole && is_systematic {
        fit_light_field(pixels, &fit, &seen, unknowns, floor, least)
    } else {
        None
    };
    let mut out = MarkerFit {
        correlation: seen.mean,
        is_systematic,
        ..fit
    };
    let mut centre = seen.covariance;
    if let Some(freed) = freed {
        let gain = (1.0 - (freed.rms / out.rms).powi(2)) * pixels.weight();
        // Between the two limits both fits are averaged, so that a difference of one or two pixels changes little.
        let share = ((gain - LACK_OF_FIT.uncertain_gain)
            / (LACK_OF_FIT.certain_gain - LACK_OF_FIT.uncertain_gain))
            .clamp(0.0, 1.0);
        let between = |one: f64, other: f64| one + share * (other - one);
        let offset = Vector2::from([X, Y].map(|k| freed.parameters[k] - out.parameters[k]));
        // The residuals that remain may shift the position as far as those that the field removed, in proportion.
        let beyond = |rms: f64| (rms * rms - floor * floor).max(0.0);
        let left = (beyond(freed.rms) / beyond(out.rms).max(TINY)).min(1.0);
        let doubt = share * (1.0 - share) + (share * left).powi(2);
        let own = freed.covariance.fixed_view::<2, 2>(X, X).into_owned();
        centre = centre.zip_map(&own, between) + offset * offset.transpose() * doubt;
        out.white = out.white.zip_map(&freed.white, between);
        for (own, other) in out.parameters.iter_mut().zip(freed.parameters) {
            *own = between(*own, other);
        }
        out.rms = between(out.rms, freed.rms);
        out.inliers = between(out.inliers, freed.inliers);
    }
    out.covariance
        .fixed_view_mut::<2, 2>(X, X)
        .copy_from(&centre);
    out
}
