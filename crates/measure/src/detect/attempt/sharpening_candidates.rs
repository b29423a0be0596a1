//! Candidates for the estimation of a frame's sharpening, recorded during the measurement of hypotheses.

use crate::detect::appearance::parameters::{BLUR, MarkerParameters, X, Y, grey_contrast};
use crate::detect::estimate::options::OVERSHOT;
use crate::detect::estimate::overshoot::{SharpeningEvidence, evidence_from_rms};
use crate::detect::hypothesis::{Hypothesis, prior::MarkerPrior};
use crate::detect::sample::bands::THIN_BLURS;

/// Possible marker whose residuals may be those of sharpened edges.
#[derive(Clone)]
pub struct SharpeningCandidate {
    pub hypothesis: Hypothesis,
    /// Parameters of the fit without sharpening.
    pub plain: MarkerParameters,
    /// Scale of its residuals, grey levels.
    pub scale: f64,
    /// True if it is a marker without sharpening.
    pub is_marker: bool,
}

impl SharpeningCandidate {
    /// Returns whether a fit is of the same marker.
    fn is_same_marker(&self, plain: &MarkerParameters) -> bool {
        (self.plain[X] - plain[X]).hypot(self.plain[Y] - plain[Y]) < OVERSHOT.apart_px
    }
}

/// Evidence on sharpening collected during a search.
#[derive(Clone, Default)]
pub struct SharpeningCandidates {
    pub candidates: Vec<SharpeningCandidate>,
    /// Number of markers that show no sharpening.
    pub unsharpened: usize,
}

impl SharpeningCandidates {
    /// Records a measured candidate: a marker, or a hypothesis that would be one with smaller residuals. Only whole and
    /// large ones are informative, and each counts once. `noise` in grey levels.
    pub fn add_if_informative(&mut self, candidate: SharpeningCandidate, noise: f64) {
        let SharpeningCandidate {
            hypothesis,
            plain,
            scale,
            is_marker,
        } = &candidate;
        let is_whole = hypothesis.excluded.is_empty() && hypothesis.prior == MarkerPrior::default();
        if !is_whole || hypothesis.ellipse.minor < THIN_BLURS * plain[BLUR] {
            return;
        }
        match evidence_from_rms(*scale, grey_contrast(plain), noise) {
            None if !self
                .candidates
                .iter()
                .any(|known| known.is_same_marker(plain)) =>
            {
                self.candidates.push(candidate)
            }
            Some(SharpeningEvidence::Excluded) if *is_marker => self.unsharpened += 1,
            _ => {}
        }
    }
}
