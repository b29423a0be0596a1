//! Whether a picture was sharpened, from the residuals of its markers; the term itself is in
//! [`crate::detect::appearance::overshoot`].
//!
//! Amplitude and halo are sought of single markers whose residuals are larger than noise explains. One alone may be dirt; several
//! that agree are the camera's. They are then known beforehand of all markers, with what single ones scatter by, so that each
//! marker's covariance has its price.

use super::cholesky::Factor;
use super::gauss_newton::fit;
use super::normal_equations::{Column, linearise};
use super::prior::Unknowns;
use crate::detect::appearance::parameters::{BLUR, HALO, OVERSHOOT, Parameters, contrast};
use crate::detect::detection::Overshoot;
use crate::detect::estimate::options::{ITERATION, OVERSHOT};
use crate::detect::hypothesis::prior::Estimate;
use crate::detect::sample::pixels::Pixels;
use crate::estimation::robust::{SIGMA_OVER_MEDIAN, median};

/// What one marker shows of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SharpeningEvidence {
    /// Residuals that an amplitude explains, for each halo that is tried.
    Of([Shown; HALOS]),
    /// An amplitude that would matter is excluded.
    None,
    /// It tells neither.
    Open,
}

/// What a marker shows with one halo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shown {
    amplitude: f64,
    /// Root mean square of what it leaves, grey levels.
    rms: f64,
}

/// Halos that are tried.
const HALOS: usize = OVERSHOT.halos_px.len();

impl SharpeningEvidence {
    /// Least root mean square of what it leaves, grey levels, and the amplitude then.
    pub fn best(&self) -> Option<(f64, f64)> {
        let Self::Of(all) = self else { return None };
        let all = all.iter().map(|shown| (shown.rms, shown.amplitude));
        all.min_by(|one, other| one.0.total_cmp(&other.0))
    }
}

/// Whether a frame was sharpened.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Sharpening {
    /// Too few markers tell.
    #[default]
    Open,
    /// Not so that it matters.
    None,
    /// As its markers agree.
    Of(Overshoot),
}

impl Sharpening {
    /// How, where it was.
    pub fn overshoot(self) -> Option<Overshoot> {
        if let Self::Of(overshoot) = self { Some(overshoot) } else { None }
    }
}

/// Puts what is known of it into first parameters.
pub fn begin(known: &Overshoot, m: &mut Parameters) {
    (m[OVERSHOOT], m[HALO]) = (known.amplitude, known.halo_px);
}

/// Makes the amplitude known beforehand of a marker, and sought; residuals hardly tell the halo.
pub fn know(known: &Overshoot, unknowns: &mut Unknowns) {
    unknowns.free[OVERSHOOT] = true;
    unknowns.prior[OVERSHOOT] = Estimate { value: known.amplitude, sigma: known.amplitude_sigma };
}

/// What markers show together, with the halo that leaves least, and so many besides that are explained without.
pub fn agreed(sightings: &[SharpeningEvidence], without: usize) -> Sharpening {
    let shown: Vec<&[Shown; HALOS]> = sightings
        .iter()
        .filter_map(|seen| if let SharpeningEvidence::Of(all) = seen { Some(all) } else { None })
        .collect();
    let without = without + sightings.iter().filter(|seen| **seen == SharpeningEvidence::None).count();
    if outvoted(shown.len(), without) {
        return if without < OVERSHOT.least { Sharpening::Open } else { Sharpening::None };
    }
    let overshoot = if shown.len() < OVERSHOT.least { None } else { common(&shown) };
    overshoot.map_or(Sharpening::Open, Sharpening::Of)
}

/// Whether too few of the markers that tell show it.
pub fn outvoted(shown: usize, without: usize) -> bool {
    (shown as f64) < OVERSHOT.most_of * (shown + without) as f64
}

/// The amplitude that markers have in common, if it matters and is none by chance.
fn common(shown: &[&[Shown; HALOS]]) -> Option<Overshoot> {
    let leaves = |halo: &usize| shown.iter().map(|shown| shown[*halo].rms.ln()).sum::<f64>();
    let halo = (0..HALOS).min_by(|one, other| leaves(one).total_cmp(&leaves(other)))?;
    let values: Vec<f64> = shown.iter().map(|shown| shown[halo].amplitude).collect();
    let amplitude = median(values.clone())?;
    let off = median(values.iter().map(|v| (v - amplitude).abs()).collect())?;
    let amplitude_sigma = (SIGMA_OVER_MEDIAN * off).max(OVERSHOT.same * amplitude);
    let chance = OVERSHOT.chance * amplitude_sigma / (values.len() as f64).sqrt();
    let halo_px = OVERSHOT.halos_px[halo];
    let sure = amplitude > OVERSHOT.matters && amplitude > chance;
    sure.then_some(Overshoot { amplitude, amplitude_sigma, halo_px })
}

/// What the residuals of a marker, root mean square, say at first: those of a sharpened edge are larger than noise, and no larger
/// than sharpening leaves; what is smaller than the image formula's own floor excludes it. `None` where they may be such.
pub fn excluded(rms: f64, contrast: f64, noise: f64) -> Option<SharpeningEvidence> {
    let (least, most) = OVERSHOT.leaves;
    match rms / contrast {
        share if share < least => Some(SharpeningEvidence::None),
        share if rms > OVERSHOT.over_noise * noise && share < most => None,
        _ => Some(SharpeningEvidence::Open),
    }
}

/// What a marker shows of sharpening, from parameters without it that leave residuals of some scale, grey levels. One linear step
/// tells whether it is worth a fit.
pub fn sought(
    pixels: &Pixels,
    plain: &Parameters,
    scale: f64,
    unknowns: &Unknowns,
    floor: f64,
) -> SharpeningEvidence {
    let at_once = one_step(pixels, plain, scale.max(floor), unknowns, floor);
    match at_once {
        None => return SharpeningEvidence::Open,
        Some(seen) if excludes(&seen) => return SharpeningEvidence::None,
        Some(Estimate { value, sigma }) if value < OVERSHOT.chance * sigma => {
            return SharpeningEvidence::Open;
        }
        Some(_) => {}
    }
    let all = OVERSHOT.halos_px.map(|halo_px| with_halo(pixels, plain, (scale, halo_px), unknowns, floor));
    let shown = all.map(|one| if let Some(Ok(shown)) = one { Some(shown) } else { None });
    if let [Some(one), Some(two), Some(three)] = shown {
        return SharpeningEvidence::Of([one, two, three]);
    }
    let none = all.iter().all(|one| matches!(one, Some(Err(seen)) if excludes(seen)));
    if none { SharpeningEvidence::None } else { SharpeningEvidence::Open }
}

/// Whether an amplitude that would matter is excluded.
fn excludes(seen: &Estimate) -> bool {
    seen.value + OVERSHOT.chance * seen.sigma < OVERSHOT.matters
}

/// First parameters and unknowns with an amplitude of which nothing is known.
fn opened(plain: &Parameters, unknowns: &Unknowns, [amplitude, halo_px]: [f64; 2]) -> (Parameters, Unknowns) {
    let first = Overshoot { amplitude, amplitude_sigma: f64::INFINITY, halo_px };
    let (mut start, mut unknowns) = (*plain, unknowns.clone());
    begin(&first, &mut start);
    know(&first, &mut unknowns);
    (start, unknowns)
}

/// The amplitude that one linear step from parameters without it tells.
fn one_step(
    pixels: &Pixels,
    plain: &Parameters,
    scale: f64,
    unknowns: &Unknowns,
    floor: f64,
) -> Option<Estimate> {
    let (start, unknowns) = opened(plain, unknowns, [0.0, OVERSHOT.halos_px[HALOS / 2]]);
    let step = linearise(pixels, &start, &unknowns, scale, floor, None);
    let factor = Factor::new(&step.normal, &unknowns.free, ITERATION.undamped)?;
    let count = unknowns.free.iter().filter(|&&free| free).count();
    let cofactor = factor.solve(&Column::ith(OVERSHOOT, 1.0))[OVERSHOOT];
    let sigma = (cofactor * step.variance(count)).max(0.0).sqrt();
    Some(Estimate { value: factor.solve(&step.right)[OVERSHOOT], sigma })
}

/// What a fit with one halo shows, or the amplitude that it does not need; `None` where it does not settle.
fn with_halo(
    pixels: &Pixels,
    plain: &Parameters,
    (scale, halo_px): (f64, f64),
    unknowns: &Unknowns,
    floor: f64,
) -> Option<Result<Shown, Estimate>> {
    let (mut start, unknowns) = opened(plain, unknowns, [OVERSHOT.amplitude, halo_px]);
    start[BLUR] = start[BLUR].max(OVERSHOT.blur_px);
    let found = fit(pixels, &start, scale.max(floor), &unknowns, floor)?;
    let m = &found.parameters;
    let sigma = found.covariance[(OVERSHOOT, OVERSHOOT)].max(0.0).sqrt();
    let gain = (1.0 - (found.rms / scale).powi(2)) * pixels.weight();
    let explains = m[OVERSHOOT] > OVERSHOT.chance * sigma
        && gain > OVERSHOT.gain
        && contrast(m) > OVERSHOT.faded * contrast(plain);
    let amplitude = m[OVERSHOOT];
    Some(if explains {
        Ok(Shown { amplitude, rms: found.rms })
    } else {
        Err(Estimate { value: amplitude, sigma })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sighting(amplitude: f64) -> SharpeningEvidence {
        SharpeningEvidence::Of([3.0, 1.0, 2.0].map(|rms| Shown { amplitude, rms }))
    }

    #[test]
    fn markers_that_agree_show_sharpening_and_others_do_not() {
        let seen = [1.5, 1.6, 1.7, 1.55, 1.65].map(sighting);
        let told = agreed(&seen, 0);
        let found = told.overshoot().expect("they agree");
        assert!((found.amplitude - 1.6).abs() < 1e-9 && found.amplitude_sigma >= 0.1 * 1.6);
        assert_eq!(found.halo_px, OVERSHOT.halos_px[1]);
        // What tells nothing says nothing.
        assert_eq!(agreed(&[&seen[..], &[SharpeningEvidence::Open; 9]].concat(), 0), told);
        // Too few; more that exclude it; too little to matter; no agreement.
        assert_eq!(agreed(&seen[..3], 0), Sharpening::Open);
        assert_eq!(agreed(&[&seen[..], &[SharpeningEvidence::None; 6]].concat(), 0), Sharpening::None);
        assert_eq!(agreed(&seen, 6), Sharpening::None);
        assert_eq!(agreed(&[0.05; 8].map(sighting), 0), Sharpening::Open);
        assert_eq!(agreed(&[0.2, 5.8, 0.3, 6.0, 3.0].map(sighting), 0), Sharpening::Open);
    }
}
