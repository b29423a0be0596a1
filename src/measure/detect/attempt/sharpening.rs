//! How a frame was sharpened, as the things tell that were noted while hypotheses were measured: the largest first, and no more
//! than are needed.

use nalgebra::Vector2;

use crate::detect::accept::verdict::fits_poorly;
use crate::detect::appearance::parameters::{BLUR, SAG, X, Y, contrast};
use crate::detect::attempt::measure::{darker_than, least_scale};
use crate::detect::attempt::suspects::{SharpeningCandidate, SharpeningCandidates};
use crate::detect::estimate::options::OVERSHOT;
use crate::detect::estimate::overshoot::{Sharpening, SharpeningEvidence, combine_evidence, is_outvoted, assess_sharpening};
use crate::detect::estimate::prior::select_unknowns;
use crate::detect::sample::select::{EdgeAppearance, FINAL, select_pixels};
use crate::raster::Raster;

/// How a picture of some noise, grey levels, was sharpened, as they agree.
pub fn estimate_sharpening(mut suspects: SharpeningCandidates, image: &Raster, noise: f64) -> Sharpening {
    let area = |s: &SharpeningCandidate| s.place.ellipse.major * s.place.ellipse.minor;
    suspects.all.sort_by(|one, other| area(other).total_cmp(&area(one)));
    suspects.all.truncate(OVERSHOT.max_examined);
    let mut sightings: Vec<SharpeningEvidence> = Vec::new();
    for (k, suspect) in suspects.all.iter().enumerate() {
        let shown = sightings.iter().filter(|seen| seen.best_fit().is_some()).count();
        let excluded = sightings.iter().filter(|seen| **seen == SharpeningEvidence::Excluded).count();
        let most = (shown + suspects.all.len() - k).min(OVERSHOT.enough_markers);
        let hopeless = most < OVERSHOT.min_markers || is_outvoted(most, suspects.without + excluded);
        if hopeless || shown >= OVERSHOT.enough_markers {
            break;
        }
        sightings.extend(marker_evidence(suspect, image, noise));
    }
    combine_evidence(&sightings, suspects.without)
}

/// What one shows of sharpening; `None` where it is no marker whether there is any or not: a letter says nothing.
fn marker_evidence(
    SharpeningCandidate { place, plain, scale, is_marker }: &SharpeningCandidate,
    image: &Raster,
    noise: f64,
) -> Option<SharpeningEvidence> {
    let (mut unknowns, bends) = select_unknowns(place);
    bends.iter().for_each(|&k| unknowns.free[k] = false);
    let floor = least_scale(noise);
    let sag = if place.edges.is_none() { plain[SAG] } else { 0.0 };
    let look = EdgeAppearance { crossing: Vector2::new(plain[X], plain[Y]), blur: plain[BLUR], sag };
    let pixels = select_pixels(image, darker_than(plain, floor), place, look, FINAL)?;
    let seen = assess_sharpening(&pixels, plain, *scale, &unknowns, floor);
    let is_marker = match seen.best_fit() {
        Some((rms, amplitude)) => !fits_poorly(image, place, rms, noise, (contrast(plain), amplitude)),
        None => *is_marker,
    };
    is_marker.then_some(seen)
}
