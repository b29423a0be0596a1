//! Things that may tell how a frame was sharpened, noted while hypotheses are measured.

use crate::detect::appearance::parameters::{BLUR, MarkerParameters, X, Y, contrast};
use crate::detect::attempt::options::MEASURE;
use crate::detect::estimate::options::OVERSHOT;
use crate::detect::estimate::overshoot::{SharpeningEvidence, preliminary_evidence};
use crate::detect::hypothesis::{Hypothesis, prior::MarkerPrior};

/// What may be a marker whose residuals may be those of sharpened edges.
#[derive(Clone)]
pub struct SharpeningCandidate {
    pub place: Hypothesis,
    /// The fit without sharpening.
    pub plain: MarkerParameters,
    /// Scale of its residuals, grey levels.
    pub scale: f64,
    /// Whether it is a marker without sharpening.
    pub is_marker: bool,
}

impl SharpeningCandidate {
    /// Whether another one is of the same thing.
    fn is_of(&self, plain: &MarkerParameters) -> bool {
        (self.plain[X] - plain[X]).hypot(self.plain[Y] - plain[Y]) < OVERSHOT.apart_px
    }
}

/// What tells of sharpening.
#[derive(Clone, Default)]
pub struct SharpeningCandidates {
    pub all: Vec<SharpeningCandidate>,
    /// Markers that need none.
    pub without: usize,
}

impl SharpeningCandidates {
    /// Notes what was measured, and with which noise, grey levels: what is a marker, and what would be one with smaller residuals.
    /// Only what is whole and large tells anything, once.
    pub fn note(&mut self, suspect: SharpeningCandidate, noise: f64) {
        let SharpeningCandidate { place, plain, scale, is_marker } = &suspect;
        let is_whole = place.excluded.is_empty() && place.prior == MarkerPrior::default();
        if !is_whole || place.ellipse.minor < MEASURE.tells_overshoot_blurs * plain[BLUR] {
            return;
        }
        match preliminary_evidence(*scale, contrast(plain), noise) {
            None if !self.all.iter().any(|known| known.is_of(plain)) => self.all.push(suspect),
            Some(SharpeningEvidence::Excluded) if *is_marker => self.without += 1,
            _ => {}
        }
    }
}
