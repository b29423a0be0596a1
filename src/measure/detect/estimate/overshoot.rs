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
    amplitude: Estimate,
    halo_px: f64,
    /// Whether it takes away what was more than a marker's residuals.
    explains: bool,
    /// Place, px.
    at: Vector2<f64>,
    /// Root mean square of what it leaves, grey levels.
    pub rms: f64,
}

impl Sighting {
    /// Whether another one is of the same thing.
    pub fn is_of(&self, at: &Vector2<f64>) -> bool {
        (self.at - at).norm() < OVERSHOT.apart_px
    }
}

/// Puts what is known of it into first parameters.
pub fn begin(known: &Overshoot, m: &mut Parameters) {
    (m[OVERSHOOT], m[HALO]) = (known.amplitude, known.halo_px);
}

/// Makes it known beforehand of a marker, and sought.
pub fn know(known: &Overshoot, unknowns: &mut Unknowns) {
    let amplitude = Estimate { value: known.amplitude, sigma: known.amplitude_sigma };
    let halo_px = Estimate { value: known.halo_px, sigma: known.halo_sigma_px };
    for (k, known) in [(OVERSHOOT, amplitude), (HALO, halo_px)] {
        unknowns.free[k] = true;
        unknowns.prior[k] = known;
    }
}

/// What markers show together; `None` where they do not agree that there is any.
pub fn agreed(sightings: &[Sighting]) -> Option<Overshoot> {
    let all = |value: fn(&Sighting) -> f64| -> Option<Estimate> {
        let values: Vec<f64> = sightings.iter().filter(|s| s.explains).map(value).collect();
        let usual = median(values.clone())?;
        let off = median(values.iter().map(|v| (v - usual).abs()).collect())?;
        Some(Estimate { value: usual, sigma: (SIGMA_OVER_MEDIAN * off).max(OVERSHOT.same * usual) })
    };
    let count = sightings.iter().filter(|s| s.explains).count();
    if count < OVERSHOT.least || (count as f64) < OVERSHOT.most_of * sightings.len() as f64 {
        return None;
    }
    let (amplitude, halo_px) = (all(|s| s.amplitude.value)?, all(|s| s.halo_px)?);
    let chance = OVERSHOT.chance * amplitude.sigma / (count as f64).sqrt();
    (amplitude.value > OVERSHOT.matters && amplitude.value > chance).then_some(Overshoot {
        amplitude: amplitude.value,
        amplitude_sigma: amplitude.sigma,
        halo_px: halo_px.value,
        halo_sigma_px: halo_px.sigma,
    })
}

/// Whether the residuals of a marker, root mean square, may be those of a sharpened edge: larger than noise, and no larger than
/// sharpening leaves.
pub fn may_show(rms: f64, contrast: f64, noise: f64) -> bool {
    let share = rms / contrast;
    rms > OVERSHOT.over_noise * noise && (OVERSHOT.leaves.0..OVERSHOT.leaves.1).contains(&share)
}

/// What a marker shows of sharpening, from parameters without it that leave residuals of some scale, grey levels; `None` where
/// the fit with it does not settle.
pub fn sought(
    pixels: &Pixels,
    plain: &Parameters,
    scale: f64,
    unknowns: &Unknowns,
    floor: f64,
) -> Option<Sighting> {
    let mut start = *plain;
    let first = Overshoot {
        amplitude: OVERSHOT.amplitude.value,
        amplitude_sigma: OVERSHOT.amplitude.sigma,
        halo_px: OVERSHOT.halo_px.value,
        halo_sigma_px: OVERSHOT.halo_px.sigma,
    };
    begin(&first, &mut start);
    start[BLUR] = start[BLUR].max(OVERSHOT.blur_px);
    let mut unknowns = unknowns.clone();
    know(&first, &mut unknowns);
    let found = fit(pixels, &start, scale.max(floor), &unknowns, floor)?;
    let m = &found.parameters;
    let sigma = found.covariance[(OVERSHOOT, OVERSHOOT)].max(0.0).sqrt();
    let gain = (1.0 - (found.rms / scale).powi(2)) * pixels.weight();
    let explains =
        m[OVERSHOOT] > OVERSHOT.chance * sigma && gain > OVERSHOT.gain && contrast(m) > 0.5 * contrast(plain);
    let amplitude = Estimate { value: m[OVERSHOOT], sigma };
    Some(Sighting { amplitude, halo_px: m[HALO], explains, at: Vector2::new(m[X], m[Y]), rms: found.rms })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sighting(amplitude: f64, explains: bool) -> Sighting {
        let amplitude = Estimate { value: amplitude, sigma: 0.05 };
        Sighting { amplitude, halo_px: 1.4, explains, at: Vector2::zeros(), rms: 1.0 }
    }

    #[test]
    fn markers_that_agree_show_sharpening_and_others_do_not() {
        let seen = [1.5, 1.6, 1.7, 1.55, 1.65].map(|a| sighting(a, true));
        let found = agreed(&seen).expect("they agree");
        assert!((found.amplitude - 1.6).abs() < 1e-9 && found.amplitude_sigma >= 0.1 * 1.6);
        // Too few; half of them dirt; too little to matter; no agreement.
        assert_eq!(agreed(&seen[..3]), None);
        let dirt = [sighting(1.6, false); 6];
        assert_eq!(agreed(&[&seen[..], &dirt].concat()), None);
        assert_eq!(agreed(&[0.05; 8].map(|a| sighting(a, true))), None);
        assert_eq!(agreed(&[0.2, 3.0, 0.3, 6.0, 5.0].map(|a| sighting(a, true))), None);
    }
}
