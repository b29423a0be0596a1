//! Whether a picture was sharpened, from the residuals of its markers; the term itself is in
//! [`crate::detect::appearance::overshoot`].
//!
//! Amplitude and halo are sought of single markers whose residuals are larger than noise explains. One alone may be dirt; several
//! that agree are the camera's. They are then known beforehand of all markers, with what single ones scatter by, so that each
//! marker's covariance has its price.

use super::cholesky::CholeskyFactor;
use super::gauss_newton::fit_final;
use super::normal_equations::{ParameterVector, linearise_model};
use super::prior::FitUnknowns;
use crate::detect::appearance::parameters::{BLUR, HALO, OVERSHOOT, MarkerParameters, contrast};
use crate::detect::detection::Overshoot;
use crate::detect::estimate::options::{ITERATION, OVERSHOT};
use crate::detect::hypothesis::prior::PriorValue;
use crate::detect::sample::pixels::Pixels;
use crate::estimation::robust::{SIGMA_OVER_MEDIAN, median};

/// What one marker shows of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SharpeningEvidence {
    /// Residuals that an amplitude explains, for each halo that is tried.
    Explained([HaloFit; HALOS]),
    /// An amplitude that would matter is excluded.
    Excluded,
    /// It tells neither.
    Undetermined,
}

/// What a marker shows with one halo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HaloFit {
    amplitude: f64,
    /// Root mean square of what it leaves, grey levels.
    rms: f64,
}

/// Halos that are tried.
const HALOS: usize = OVERSHOT.halos_px.len();

impl SharpeningEvidence {
    /// Least root mean square of what it leaves, grey levels, and the amplitude then.
    pub fn best_fit(&self) -> Option<(f64, f64)> {
        let Self::Explained(all) = self else { return None };
        let all = all.iter().map(|shown| (shown.rms, shown.amplitude));
        all.min_by(|one, other| one.0.total_cmp(&other.0))
    }
}

/// Whether a frame was sharpened.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Sharpening {
    /// Too few markers tell.
    #[default]
    Undetermined,
    /// Not so that it matters.
    Absent,
    /// As its markers agree.
    Sharpened(Overshoot),
}

impl Sharpening {
    /// How, where it was.
    pub fn overshoot(self) -> Option<Overshoot> {
        if let Self::Sharpened(overshoot) = self { Some(overshoot) } else { None }
    }
}

/// Puts what is known of it into first parameters.
pub fn set_overshoot_start(known: &Overshoot, m: &mut MarkerParameters) {
    (m[OVERSHOOT], m[HALO]) = (known.amplitude, known.halo_px);
}

/// Makes the amplitude known beforehand of a marker, and sought; residuals hardly tell the halo.
pub fn add_overshoot_prior(known: &Overshoot, unknowns: &mut FitUnknowns) {
    unknowns.free[OVERSHOOT] = true;
    unknowns.prior[OVERSHOOT] = PriorValue { value: known.amplitude, sigma: known.amplitude_sigma };
}

/// What markers show together, with the halo that leaves least, and so many besides that are explained without.
pub fn combine_evidence(sightings: &[SharpeningEvidence], without: usize) -> Sharpening {
    let shown: Vec<&[HaloFit; HALOS]> = sightings
        .iter()
        .filter_map(|seen| if let SharpeningEvidence::Explained(all) = seen { Some(all) } else { None })
        .collect();
    let without = without + sightings.iter().filter(|seen| **seen == SharpeningEvidence::Excluded).count();
    if is_outvoted(shown.len(), without) {
        return if without < OVERSHOT.min_markers { Sharpening::Undetermined } else { Sharpening::Absent };
    }
    let overshoot = if shown.len() < OVERSHOT.min_markers { None } else { common_overshoot(&shown) };
    overshoot.map_or(Sharpening::Undetermined, Sharpening::Sharpened)
}

/// Whether too few of the markers that tell show it.
pub fn is_outvoted(shown: usize, without: usize) -> bool {
    (shown as f64) < OVERSHOT.min_share * (shown + without) as f64
}

/// The amplitude that markers have in common, if it matters and is none by chance.
fn common_overshoot(shown: &[&[HaloFit; HALOS]]) -> Option<Overshoot> {
    let leaves = |halo: &usize| shown.iter().map(|shown| shown[*halo].rms.ln()).sum::<f64>();
    let halo = (0..HALOS).min_by(|one, other| leaves(one).total_cmp(&leaves(other)))?;
    let values: Vec<f64> = shown.iter().map(|shown| shown[halo].amplitude).collect();
    let amplitude = median(values.clone())?;
    let off = median(values.iter().map(|v| (v - amplitude).abs()).collect())?;
    let amplitude_sigma = (SIGMA_OVER_MEDIAN * off).max(OVERSHOT.min_scatter * amplitude);
    let chance = OVERSHOT.significance * amplitude_sigma / (values.len() as f64).sqrt();
    let halo_px = OVERSHOT.halos_px[halo];
    let sure = amplitude > OVERSHOT.min_amplitude && amplitude > chance;
    sure.then_some(Overshoot { amplitude, amplitude_sigma, halo_px })
}

/// What the residuals of a marker, root mean square, say at first: those of a sharpened edge are larger than noise, and no larger
/// than sharpening leaves; what is smaller than the image formula's own floor excludes it. `None` where they may be such.
pub fn preliminary_evidence(rms: f64, contrast: f64, noise: f64) -> Option<SharpeningEvidence> {
    let (least, most) = OVERSHOT.residual_range;
    match rms / contrast {
        share if share < least => Some(SharpeningEvidence::Excluded),
        share if rms > OVERSHOT.over_noise * noise && share < most => None,
        _ => Some(SharpeningEvidence::Undetermined),
    }
}

/// What a marker shows of sharpening, from parameters without it that leave residuals of some scale, grey levels. One linear step
/// tells whether it is worth a fit.
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
        Some(PriorValue { value, sigma }) if value < OVERSHOT.significance * sigma => {
            return SharpeningEvidence::Undetermined;
        }
        Some(_) => {}
    }
    let all = OVERSHOT.halos_px.map(|halo_px| fit_halo(pixels, plain, (scale, halo_px), unknowns, floor));
    let shown = all.map(|one| if let Some(Ok(shown)) = one { Some(shown) } else { None });
    if let [Some(one), Some(two), Some(three)] = shown {
        return SharpeningEvidence::Explained([one, two, three]);
    }
    let none = all.iter().all(|one| matches!(one, Some(Err(seen)) if excludes_sharpening(seen)));
    if none { SharpeningEvidence::Excluded } else { SharpeningEvidence::Undetermined }
}

/// Whether an amplitude that would matter is excluded.
fn excludes_sharpening(seen: &PriorValue) -> bool {
    seen.value + OVERSHOT.significance * seen.sigma < OVERSHOT.min_amplitude
}

/// First parameters and unknowns with an amplitude of which nothing is known.
fn with_free_amplitude(plain: &MarkerParameters, unknowns: &FitUnknowns, [amplitude, halo_px]: [f64; 2]) -> (MarkerParameters, FitUnknowns) {
    let first = Overshoot { amplitude, amplitude_sigma: f64::INFINITY, halo_px };
    let (mut start, mut unknowns) = (*plain, unknowns.clone());
    set_overshoot_start(&first, &mut start);
    add_overshoot_prior(&first, &mut unknowns);
    (start, unknowns)
}

/// The amplitude that one linear step from parameters without it tells.
fn estimate_in_one_step(
    pixels: &Pixels,
    plain: &MarkerParameters,
    scale: f64,
    unknowns: &FitUnknowns,
    floor: f64,
) -> Option<PriorValue> {
    let (start, unknowns) = with_free_amplitude(plain, unknowns, [0.0, OVERSHOT.halos_px[HALOS / 2]]);
    let step = linearise_model(pixels, &start, &unknowns, scale, floor, None);
    let factor = CholeskyFactor::new(&step.normal, &unknowns.free, ITERATION.final_damping)?;
    let count = unknowns.free.iter().filter(|&&free| free).count();
    let cofactor = factor.solve(&ParameterVector::ith(OVERSHOOT, 1.0))[OVERSHOOT];
    let sigma = (cofactor * step.variance(count)).max(0.0).sqrt();
    Some(PriorValue { value: factor.solve(&step.right)[OVERSHOOT], sigma })
}

/// What a fit with one halo shows, or the amplitude that it does not need; `None` where it does not settle.
fn fit_halo(
    pixels: &Pixels,
    plain: &MarkerParameters,
    (scale, halo_px): (f64, f64),
    unknowns: &FitUnknowns,
    floor: f64,
) -> Option<Result<HaloFit, PriorValue>> {
    let (mut start, unknowns) = with_free_amplitude(plain, unknowns, [OVERSHOT.first_amplitude, halo_px]);
    start[BLUR] = start[BLUR].max(OVERSHOT.min_first_blur_px);
    let found = fit_final(pixels, &start, scale.max(floor), &unknowns, floor)?;
    let m = &found.parameters;
    let sigma = found.covariance[(OVERSHOOT, OVERSHOOT)].max(0.0).sqrt();
    let gain = (1.0 - (found.rms / scale).powi(2)) * pixels.weight();
    let explains = m[OVERSHOOT] > OVERSHOT.significance * sigma
        && gain > OVERSHOT.min_gain
        && contrast(m) > OVERSHOT.min_contrast_ratio * contrast(plain);
    let amplitude = m[OVERSHOOT];
    Some(if explains {
        Ok(HaloFit { amplitude, rms: found.rms })
    } else {
        Err(PriorValue { value: amplitude, sigma })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sighting(amplitude: f64) -> SharpeningEvidence {
        SharpeningEvidence::Explained([3.0, 1.0, 2.0].map(|rms| HaloFit { amplitude, rms }))
    }

    #[test]
    fn markers_that_agree_show_sharpening_and_others_do_not() {
        let seen = [1.5, 1.6, 1.7, 1.55, 1.65].map(sighting);
        let told = combine_evidence(&seen, 0);
        let found = told.overshoot().expect("they agree");
        assert!((found.amplitude - 1.6).abs() < 1e-9 && found.amplitude_sigma >= 0.1 * 1.6);
        assert_eq!(found.halo_px, OVERSHOT.halos_px[1]);
        // What tells nothing says nothing.
        assert_eq!(combine_evidence(&[&seen[..], &[SharpeningEvidence::Undetermined; 9]].concat(), 0), told);
        // Too few; more that exclude it; too little to matter; no agreement.
        assert_eq!(combine_evidence(&seen[..3], 0), Sharpening::Undetermined);
        assert_eq!(combine_evidence(&[&seen[..], &[SharpeningEvidence::Excluded; 6]].concat(), 0), Sharpening::Absent);
        assert_eq!(combine_evidence(&seen, 6), Sharpening::Absent);
        assert_eq!(combine_evidence(&[0.05; 8].map(sighting), 0), Sharpening::Undetermined);
        assert_eq!(combine_evidence(&[0.2, 5.8, 0.3, 6.0, 3.0].map(sighting), 0), Sharpening::Undetermined);
    }
}
