//! Estimation of a frame's sharpening from the candidates recorded during the measurement of hypotheses: the largest first,
//! and no more than needed.

use nalgebra::Vector2;

use crate::detect::accept::verdict::fits_poorly;
use crate::detect::appearance::parameters::{BLUR, X, Y, grey_contrast};
use crate::detect::attempt::measure::{exclude_darker_surroundings, min_scale};
use crate::detect::attempt::sharpening_candidates::{SharpeningCandidate, SharpeningCandidates};
use crate::detect::estimate::options::OVERSHOT;
use crate::detect::estimate::overshoot::{
    Sharpening, SharpeningEvidence, assess_sharpening, combine_evidence, is_outvoted,
};
use crate::detect::estimate::prior::select_unknowns;
use crate::detect::numbers::MIN_GROUP;
use crate::detect::sample::select::{EdgeAppearance, FINAL, select_pixels};
use crate::ordering::sort_by_value;
use crate::raster::Raster;

/// Estimates the sharpening of an image with some noise, grey levels, on which its markers agree.
pub fn estimate_sharpening(
    mut collected: SharpeningCandidates,
    image: &Raster,
    noise: f64,
) -> Sharpening {
    let area = |s: &SharpeningCandidate| s.hypothesis.ellipse.major * s.hypothesis.ellipse.minor;
    sort_by_value(&mut collected.candidates, |one| -area(one));
    collected.candidates.truncate(OVERSHOT.max_examined);
    let mut evidence: Vec<SharpeningEvidence> = Vec::new();
    for (k, candidate) in collected.candidates.iter().enumerate() {
        let shown = evidence
            .iter()
            .filter(|assessment| assessment.best_fit().is_some())
            .count();
        let excluded = evidence
            .iter()
            .filter(|assessment| **assessment == SharpeningEvidence::Excluded)
            .count();
        let most = (shown + collected.candidates.len() - k).min(OVERSHOT.enough_markers);
        let hopeless = most < MIN_GROUP || is_outvoted(most, collected.unsharpened + excluded);
        if hopeless || shown >= OVERSHOT.enough_markers {
            break;
        }
        evidence.extend(marker_evidence(candidate, image, noise));
    }
    combine_evidence(&evidence, collected.unsharpened)
}

/// Returns the evidence of one candidate on sharpening; `None` if it is not a marker, sharpened or not: letters provide no
/// evidence.
fn marker_evidence(
    SharpeningCandidate {
        hypothesis,
        plain,
        scale,
        is_marker,
    }: &SharpeningCandidate,
    image: &Raster,
    noise: f64,
) -> Option<SharpeningEvidence> {
    let (mut unknowns, bends) = select_unknowns(hypothesis);
    bends.iter().for_each(|&k| unknowns.free[k] = false);
    let floor = min_scale(noise);
    let appearance = EdgeAppearance {
        crossing: Vector2::new(plain[X], plain[Y]),
        blur: plain[BLUR],
    };
    let pixels = select_pixels(
        image,
        exclude_darker_surroundings(plain, floor),
        hypothesis,
        appearance,
        FINAL,
    )?;
    let assessment = assess_sharpening(&pixels, plain, *scale, &unknowns, floor);
    let is_marker = match assessment.best_fit() {
        Some((rms, amplitude)) => !fits_poorly(
            image,
            hypothesis,
            rms,
            noise,
            (grey_contrast(plain), amplitude),
        ),
        None => *is_marker,
    };
    is_marker.then_some(assessment)
}
