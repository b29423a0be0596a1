//! Whether a picture was sharpened, from the residuals of its markers; the term itself is in
//! [`crate::detect::appearance::overshoot`].
//!
//! Amplitude and halo are sought of single markers whose residuals are larger than noise explains. One alone may be dirt; several
//! that agree are the camera's. They are then known beforehand of all markers, with what single ones scatter by, so that each
//! marker's covariance has its price.

use nalgebra::Vector2;

use super::gauss_newton::fit;
use super::prior::Unknowns;
use crate::detect::appearance::parameters::{BLUR, HALO, OVERSHOOT, Parameters, X, Y, contrast};
use crate::detect::detection::Overshoot;
use crate::detect::estimate::options::OVERSHOT;
use crate::detect::hypothesis::prior::Estimate;
use crate::detect::sample::pixels::Pixels;
use crate::estimation::robust::{SIGMA_OVER_MEDIAN, median};

/// What one marker shows of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// For each halo that is tried.
    with: [Option<Shown>; HALOS],
    /// Place, px.
    at: Vector2<f64>,
}

/// What a marker shows with one halo.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shown {
    amplitude: f64,
    /// Root mean square of what it leaves, grey levels.
    rms: f64,
    /// Whether it takes away what was more than a marker's residuals.
    explains: bool,
}

/// Halos that are tried.
const HALOS: usize = OVERSHOT.halos_px.len();

impl Sighting {
    /// Where the fits settled with every halo.
    fn settled(&self) -> Option<[Shown; HALOS]> {
        let [one, two, three] = self.with;
        Some([one?, two?, three?])
    }

    /// Least root mean square of what it leaves, grey levels, and the amplitude then; infinite where no fit settled.
    pub fn best(&self) -> (f64, f64) {
        let all = self.with.iter().flatten().map(|shown| (shown.rms, shown.amplitude));
        all.min_by(|one, other| one.0.total_cmp(&other.0)).unwrap_or((f64::INFINITY, 0.0))
    }

    /// Whether another one is of the same thing.
    pub fn is_of(&self, at: &Vector2<f64>) -> bool {
        (self.at - at).norm() < OVERSHOT.apart_px
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

/// What markers show together, with the halo that leaves least; `None` where they do not agree that there is any.
pub fn agreed(sightings: &[Sighting]) -> Option<Overshoot> {
    let settled: Vec<[Shown; HALOS]> = sightings.iter().filter_map(Sighting::settled).collect();
    let leaves = |halo: &usize| settled.iter().map(|shown| shown[*halo].rms.ln()).sum::<f64>();
    let halo = (0..HALOS).min_by(|one, other| leaves(one).total_cmp(&leaves(other)))?;
    let shown = settled.iter().map(|shown| &shown[halo]).filter(|shown| shown.explains);
    let values: Vec<f64> = shown.map(|shown| shown.amplitude).collect();
    let count = values.len();
    if count < OVERSHOT.least || (count as f64) < OVERSHOT.most_of * settled.len() as f64 {
        return None;
    }
    let amplitude = median(values.clone())?;
    let off = median(values.iter().map(|v| (v - amplitude).abs()).collect())?;
    let amplitude_sigma = (SIGMA_OVER_MEDIAN * off).max(OVERSHOT.same * amplitude);
    let chance = OVERSHOT.chance * amplitude_sigma / (count as f64).sqrt();
    let halo_px = OVERSHOT.halos_px[halo];
    let sure = amplitude > OVERSHOT.matters && amplitude > chance;
    sure.then_some(Overshoot { amplitude, amplitude_sigma, halo_px })
}

/// Whether the residuals of a marker, root mean square, may be those of a sharpened edge: larger than noise, and no larger than
/// sharpening leaves.
pub fn may_show(rms: f64, contrast: f64, noise: f64) -> bool {
    let share = rms / contrast;
    rms > OVERSHOT.over_noise * noise && (OVERSHOT.leaves.0..OVERSHOT.leaves.1).contains(&share)
}

/// What a marker shows of sharpening, from parameters without it that leave residuals of some scale, grey levels.
pub fn sought(pixels: &Pixels, plain: &Parameters, scale: f64, unknowns: &Unknowns, floor: f64) -> Sighting {
    let with = OVERSHOT.halos_px.map(|halo_px| {
        let (amplitude, amplitude_sigma) = (OVERSHOT.amplitude, f64::INFINITY);
        let first = Overshoot { amplitude, amplitude_sigma, halo_px };
        let (mut start, mut unknowns) = (*plain, unknowns.clone());
        begin(&first, &mut start);
        know(&first, &mut unknowns);
        start[BLUR] = start[BLUR].max(OVERSHOT.blur_px);
        let found = fit(pixels, &start, scale.max(floor), &unknowns, floor)?;
        let m = &found.parameters;
        let sigma = found.covariance[(OVERSHOOT, OVERSHOOT)].max(0.0).sqrt();
        let gain = (1.0 - (found.rms / scale).powi(2)) * pixels.weight();
        let explains = m[OVERSHOOT] > OVERSHOT.chance * sigma
            && gain > OVERSHOT.gain
            && contrast(m) > OVERSHOT.faded * contrast(plain);
        Some(Shown { amplitude: m[OVERSHOOT], rms: found.rms, explains })
    });
    Sighting { with, at: Vector2::new(plain[X], plain[Y]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sighting(amplitude: f64, explains: bool) -> Sighting {
        let shown = |rms: f64| Some(Shown { amplitude, rms, explains });
        Sighting { with: [shown(3.0), shown(1.0), shown(2.0)], at: Vector2::zeros() }
    }

    #[test]
    fn markers_that_agree_show_sharpening_and_others_do_not() {
        let seen = [1.5, 1.6, 1.7, 1.55, 1.65].map(|a| sighting(a, true));
        let found = agreed(&seen).expect("they agree");
        assert!((found.amplitude - 1.6).abs() < 1e-9 && found.amplitude_sigma >= 0.1 * 1.6);
        assert_eq!(found.halo_px, OVERSHOT.halos_px[1]);
        // What no fit settles of says nothing.
        let lost = Sighting { with: [None; HALOS], at: Vector2::zeros() };
        assert_eq!(agreed(&[&seen[..], &[lost; 9]].concat()), Some(found));
        // Too few; half of them dirt; too little to matter; no agreement.
        assert_eq!(agreed(&seen[..3]), None);
        let dirt = [sighting(1.6, false); 6];
        assert_eq!(agreed(&[&seen[..], &dirt].concat()), None);
        assert_eq!(agreed(&[0.05; 8].map(|a| sighting(a, true))), None);
        assert_eq!(agreed(&[0.2, 5.8, 0.3, 6.0, 3.0].map(|a| sighting(a, true))), None);
    }
}
