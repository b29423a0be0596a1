//! Detection of sharpening in an image from the residuals of its markers; the term itself is in
//! [`crate::detect::appearance::overshoot`].
//!
//! Amplitude and halo are estimated for single markers whose residuals exceed the noise. One marker alone may be dirty;
//! several that agree indicate the camera. The common amplitude is then the prior of all markers, with the scatter between
//! them as standard deviation, so that it enters the covariance of each marker.

use super::cholesky::CholeskyFactor;
use super::gauss_newton::fit_final;
use super::normal_equations::{ParameterVector, linearise_model};
use super::prior::FitUnknowns;
use crate::detect::appearance::parameters::{
    BLUR, HALO, MarkerParameters, OVERSHOOT, grey_contrast,
};
use crate::detect::detection::Overshoot;
use crate::detect::estimate::options::{ITERATION, OVERSHOT};
use crate::detect::hypothesis::prior::PriorValue;
use crate::detect::numbers::{MIN_GROUP, SIGNIFICANT_SIGMAS};
use crate::detect::sample::pixels::Pixels;
use crate::estimation::robust::{SIGMA_OVER_MEDIAN, median};

/// Evidence of one marker on sharpening.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SharpeningEvidence {
    /// An amplitude explains the residuals; one fit for each halo that is tried.
    Explained([HaloFit; HALOS]),
    /// An amplitude with an effect is excluded.
    Excluded,
    /// Inconclusive.
    Undetermined,
}

/// Fit of one marker with one halo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HaloFit {
    amplitude: f64,
    /// Root mean square of the remaining residuals, grey levels.
    rms: f64,
}

/// Number of halos that are tried.
const HALOS: usize = OVERSHOT.halos_px.len();

impl SharpeningEvidence {
    /// Returns the minimum root mean square of the remaining residuals, grey levels, and the amplitude of that fit.
    pub fn best_fit(&self) -> Option<(f64, f64)> {
        let Self::Explained(all) = self else {
            return None;
        };
        let all = all.iter().map(|shown| (shown.rms, shown.amplitude));
        all.min_by(|one, other| one.0.total_cmp(&other.0))
    }
}

/// Sharpening of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Sharpening {
    /// Too few markers show or exclude it.
    #[default]
    Undetermined,
    /// No sharpening with an effect.
    Absent,
    /// Sharpening on which its markers agree.
    Sharpened(Overshoot),
}

impl Sharpening {
    /// Returns amplitude and halo if the frame is sharpened; `None` if it is not or if that is undetermined.
    pub fn overshoot(self) -> Option<Overshoot> {
        if let Self::Sharpened(overshoot) = self {
            Some(overshoot)
        } else {
            None
        }
    }
}

/// Sets amplitude and halo of first parameters to known values.
pub fn set_overshoot_start(known: &Overshoot, m: &mut MarkerParameters) {
    (m[OVERSHOOT], m[HALO]) = (known.amplitude, known.halo_px);
}

/// Frees the amplitude of a marker and sets its prior; the halo stays fixed because residuals hardly constrain it.
pub fn add_overshoot_prior(known: &Overshoot, unknowns: &mut FitUnknowns) {
    unknowns.free[OVERSHOOT] = true;
    unknowns.prior[OVERSHOOT] = PriorValue {
        value: known.amplitude,
        sigma: known.amplitude_sigma,
    };
}

/// Combines the evidence of several markers, with the halo of the smallest residuals. `without` is the number of further
/// markers whose residuals are explained without sharpening.
pub fn combine_evidence(evidence: &[SharpeningEvidence], without: usize) -> Sharpening {
    let shown: Vec<&[HaloFit; HALOS]> = evidence
        .iter()
        .filter_map(|seen| {
            if let SharpeningEvidence::Explained(all) = seen {
                Some(all)
            } else {
                None
            }
        })
        .collect();
    let without = without
        + evidence
            .iter()
            .filter(|seen| **seen == SharpeningEvidence::Excluded)
            .count();
    if is_outvoted(shown.len(), without) {
        return if without < MIN_GROUP {
            Sharpening::Undetermined
        } else {
            Sharpening::Absent
        };
    }
    let overshoot = if shown.len() < MIN_GROUP {
        None
    } else {
        common_overshoot(&shown)
    };
    overshoot.map_or(Sharpening::Undetermined, Sharpening::Sharpened)
}

/// Returns true if too few of the conclusive markers show sharpening.
pub fn is_outvoted(shown: usize, without: usize) -> bool {
    (shown as f64) < OVERSHOT.min_share * (shown + without) as f64
}

/// Returns the amplitude that the markers have in common, if it has an effect and is significant.
fn common_overshoot(shown: &[&[HaloFit; HALOS]]) -> Option<Overshoot> {
    let leaves = |halo: &usize| shown.iter().map(|shown| shown[*halo].rms.ln()).sum::<f64>();
    let halo = (0..HALOS).min_by(|one, other| leaves(one).total_cmp(&leaves(other)))?;
    let values: Vec<f64> = shown.iter().map(|shown| shown[halo].amplitude).collect();
    let amplitude = median(values.clone())?;
    let off = median(values.iter().map(|v| (v - amplitude).abs()).collect())?;
    let amplitude_sigma = (SIGMA_OVER_MEDIAN * off).max(OVERSHOT.min_scatter * amplitude);
    let chance = SIGNIFICANT_SIGMAS * amplitude_sigma / (values.len() as f64).sqrt();
    let halo_px = OVERSHOT.halos_px[halo];
    let sure = amplitude > OVERSHOT.min_amplitude && amplitude > chance;
    sure.then_some(Overshoot {
        amplitude,
        amplitude_sigma,
        halo_px,
    })
}

/// Returns the evidence on sharpening from the root mean square of a marker's residuals alone, or `None` if sharpening is possible and
/// must be tested. Residuals below the accuracy of the image formula exclude sharpening; residuals within the noise, or
/// larger than sharpening leaves, are inconclusive.
pub fn evidence_from_rms(rms: f64, contrast: f64, noise: f64) -> Option<SharpeningEvidence> {
    let tested = OVERSHOT.residual_range;
    match rms / contrast {
        share if share < tested.start => Some(SharpeningEvidence::Excluded),
        share if rms > OVERSHOT.over_noise * noise && share < tested.end => None,
        _ => Some(SharpeningEvidence::Undetermined),
    }
}

/// Tests a marker for sharpening, given its parameters without sharpening and the scale of their residuals, grey levels.
/// One linear step decides if a fit is necessary.
pub fn assess_sharpening(
    pixels: &Pixels,
    plain: &MarkerParameters,
    scale: f64,
    unknowns: &FitUnknowns,
    floor: f64,
) -> SharpeningEvidence {
    let at_once = estimate_in_one_step(pixels, plain, scale.max(floor), unknowns, floor);
    match at_once {
        None => return SharpeningEvidence::Undetermined,
        Some(seen) if excludes_sharpening(&seen) => return SharpeningEvidence::Excluded,
        Some(PriorValue { value, sigma }) if value < SIGNIFICANT_SIGMAS * sigma => {
            return SharpeningEvidence::Undetermined;
        }
        Some(_) => {}
    }
    let all = OVERSHOT
        .halos_px
        .map(|halo_px| fit_halo(pixels, plain, (scale, halo_px), unknowns, floor));
    let shown = all.map(|one| one.and_then(Result::ok));
    if let [Some(one), Some(two), Some(three)] = shown {
        return SharpeningEvidence::Explained([one, two, three]);
    }
    let none = all
        .iter()
        .all(|one| matches!(one, Some(Err(seen)) if excludes_sharpening(seen)));
    if none {
        SharpeningEvidence::Excluded
    } else {
        SharpeningEvidence::Undetermined
    }
}

/// Returns true if an amplitude with an effect is excluded.
fn excludes_sharpening(seen: &PriorValue) -> bool {
    seen.value + SIGNIFICANT_SIGMAS * seen.sigma < OVERSHOT.min_amplitude
}

/// Returns first parameters and unknowns with an unconstrained amplitude.
fn with_free_amplitude(
    plain: &MarkerParameters,
    unknowns: &FitUnknowns,
    [amplitude, halo_px]: [f64; 2],
) -> (MarkerParameters, FitUnknowns) {
    let first = Overshoot {
        amplitude,
        amplitude_sigma: f64::INFINITY,
        halo_px,
    };
    let (mut start, mut unknowns) = (*plain, unknowns.clone());
    set_overshoot_start(&first, &mut start);
    add_overshoot_prior(&first, &mut unknowns);
    (start, unknowns)
}

/// Estimates the amplitude by one linear step from parameters without sharpening.
fn estimate_in_one_step(
    pixels: &Pixels,
    plain: &MarkerParameters,
    scale: f64,
    unknowns: &FitUnknowns,
    floor: f64,
) -> Option<PriorValue> {
    let (start, unknowns) =
        with_free_amplitude(plain, unknowns, [0.0, OVERSHOT.halos_px[HALOS / 2]]);
    let step = linearise_model(pixels, &start, &unknowns, scale, floor, None);
    let factor = CholeskyFactor::new(&step.normal, &unknowns.free, ITERATION.final_damping)?;
    let count = unknowns.free.iter().filter(|&&free| free).count();
    let cofactor = factor.solve(&ParameterVector::ith(OVERSHOOT, 1.0))[OVERSHOOT];
    let sigma = (cofactor * step.variance(count)).max(0.0).sqrt();
    Some(PriorValue {
        value: factor.solve(&step.right)[OVERSHOOT],
        sigma,
    })
}

/// Fits a marker with one halo. Returns the fit, or as an error the amplitude that is not significant; `None` if the fit
/// does not converge.
fn fit_halo(
    pixels: &Pixels,
    plain: &MarkerParameters,
    (scale, halo_px): (f64, f64),
    unknowns: &FitUnknowns,
    floor: f64,
) -> Option<Result<HaloFit, PriorValue>> {
    let (mut start, unknowns) =
        with_free_amplitude(plain, unknowns, [OVERSHOT.first_amplitude, halo_px]);
    start[BLUR] = start[BLUR].max(OVERSHOT.min_first_blur_px);
    let found = fit_final(pixels, &start, scale.max(floor), &unknowns, floor)?;
    let m = &found.parameters;
    let sigma = found.covariance[(OVERSHOOT, OVERSHOOT)].max(0.0).sqrt();
    let gain = (1.0 - (found.rms / scale).powi(2)) * pixels.weight();
    let explains = m[OVERSHOOT] > SIGNIFICANT_SIGMAS * sigma
        && gain > OVERSHOT.min_gain
        // Otherwise the overshoot would replace the edge itself.
        && grey_contrast(m) > 0.5 * grey_contrast(plain);
    let amplitude = m[OVERSHOOT];
    Some(if explains {
        Ok(HaloFit {
            amplitude,
            rms: found.rms,
        })
    } else {
        Err(PriorValue {
            value: amplitude,
            sigma,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evidence(amplitude: f64) -> SharpeningEvidence {
        SharpeningEvidence::Explained([3.0, 1.0, 2.0].map(|rms| HaloFit { amplitude, rms }))
    }

    #[test]
    fn agreeing_markers_show_sharpening() {
        let seen = [1.5, 1.6, 1.7, 1.55, 1.65].map(evidence);
        let combined = combine_evidence(&seen, 0);
        let found = combined.overshoot().expect("they agree");
        assert!((found.amplitude - 1.6).abs() < 1e-9 && found.amplitude_sigma >= 0.1 * 1.6);
        assert_eq!(found.halo_px, OVERSHOT.halos_px[1]);
        // Inconclusive evidence has no effect.
        assert_eq!(
            combine_evidence(
                &[&seen[..], &[SharpeningEvidence::Undetermined; 9]].concat(),
                0
            ),
            combined
        );
        // Too few; more that exclude it; too little to matter; no agreement.
        assert_eq!(combine_evidence(&seen[..3], 0), Sharpening::Undetermined);
        assert_eq!(
            combine_evidence(&[&seen[..], &[SharpeningEvidence::Excluded; 6]].concat(), 0),
            Sharpening::Absent
        );
        assert_eq!(combine_evidence(&seen, 6), Sharpening::Absent);
        assert_eq!(
            combine_evidence(&[0.05; 8].map(evidence), 0),
            Sharpening::Undetermined
        );
        assert_eq!(
            combine_evidence(&[0.2, 5.8, 0.3, 6.0, 3.0].map(evidence), 0),
            Sharpening::Undetermined
        );
    }
}
