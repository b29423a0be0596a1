//! Which of the image model's parameters are sought of a marker, and what is known of them beforehand.

use super::unknowns::Unknowns;
use crate::measure::detect::appearance::parameters::{
    ANGLE, BLUR, DARK, EGG, FIRST, GAMMA, LIGHT, N, OUTLINE, Pattern, SECOND, THIRD,
};
use crate::measure::detect::hypothesis::candidate::Candidate;

/// The tone curve of pictures made for the eye, and how far cameras depart from it.
pub const USUAL_GAMMA: (f64, f64) = (1.0 / 2.2, 0.15);
/// A disc's sag over its semi-major axis, and the change of its thickness, on the skin of a wing. A
/// whole outline tells them better; half an outline needs to know that they are small.
const SAG_SPREAD: f64 = 0.01;
pub const EGG_SPREAD: f64 = 0.05;
/// How far the blurs of quadrants' edges differ from their mean, as a share: motion blurs them by their direction.
const UNEVEN_BLUR: f64 = 0.1;
/// How far discs side by side differ: direction, rad, relative length and thickness.
const ALIKE_ANGLE: f64 = 0.02;
const ALIKE_MAJOR: f64 = 0.03;
const ALIKE_MINOR: f64 = 0.1;
/// Semi-minor axis from which on a marker tells more of its light, and quadrants tell their bends, px.
const THICK: f64 = 2.5;
/// Semi-minor axis of quadrants, px, up to which one of their edges may be too short to tell its bend.
const NARROW: f64 = 10.0;
/// What only a whole thick marker tells of its light.
const FINE_LIGHT: [usize; 4] = [LIGHT + 3, DARK + 1, DARK + 2, GAMMA];

/// Which parameters a marker of this size can tell, and which of them are bends.
pub fn unknowns(candidate: &Candidate) -> (Unknowns, &'static [usize]) {
    let outline = &candidate.outline;
    let disc = candidate.pattern == Pattern::Disc;
    let bends: &[usize] = if disc { &[THIRD, EGG] } else { &[SECOND, THIRD] };
    let thick = outline.minor >= THICK;
    let mut free = [true; N];
    free[DARK + 1] = thick;
    free[DARK + 2] = outline.minor >= 6.0;
    free[GAMMA] = thick;
    free[LIGHT + 3] = thick && outline.major >= 15.0;
    free[EGG] = disc || thick;
    (OUTLINE..N).for_each(|k| free[k] = false);
    let part = !candidate.hidden.is_empty();
    if part {
        // The outline that is left tells an ellipse, and no more.
        FINE_LIGHT.iter().for_each(|&k| free[k] = false);
    }
    // An end that is not seen tells no bend.
    let tells = thick || (disc && !part);
    let cut = !candidate.bands.is_empty() && candidate.foretold.is_none();
    if !tells || outline.major < 12.0 || cut {
        bends.iter().for_each(|&k| free[k] = false);
    }
    (Unknowns { free, usual: usual(candidate) }, bends)
}

/// What a first geometry takes: an outline or two lines, their blur, and planes of light.
pub fn few_unknowns(candidate: &Candidate) -> Unknowns {
    let (mut unknowns, _) = unknowns(candidate);
    FINE_LIGHT.iter().for_each(|&k| unknowns.free[k] = false);
    unknowns.free[EGG] &= candidate.edges.is_none() || candidate.outline.minor > NARROW;
    if candidate.edges.is_some() && candidate.outline.minor > NARROW {
        // The first crossing may be far off, and long edges reach the right one by bending.
        [SECOND, THIRD].iter().for_each(|&k| unknowns.usual[k].1 = f64::INFINITY);
    }
    unknowns
}

/// The darkness that leaves such a share of the light's grey value, with the usual tone curve.
pub fn usual_dark(left: f64) -> f64 {
    1.0 - left.powf(1.0 / USUAL_GAMMA.0)
}

/// What is known before the fit.
fn usual(candidate: &Candidate) -> [(f64, f64); N] {
    let mut out = [(0.0, f64::INFINITY); N];
    let outline = &candidate.outline;
    out[GAMMA] = USUAL_GAMMA;
    if candidate.pattern == Pattern::Disc {
        out[THIRD] = (0.0, SAG_SPREAD * outline.major);
        out[EGG] = (0.0, EGG_SPREAD);
    } else {
        out[SECOND] = (0.0, 2.0 * SAG_SPREAD / outline.major);
        out[THIRD] = out[SECOND];
        out[EGG] = (0.0, UNEVEN_BLUR);
    }
    if candidate.alike {
        out[ANGLE] = (outline.angle, ALIKE_ANGLE);
        out[FIRST] = (outline.major, ALIKE_MAJOR * outline.major);
        out[SECOND] = (outline.minor, ALIKE_MINOR * outline.minor);
    }
    if let Some(known) = candidate.foretold.filter(|_| candidate.pattern == Pattern::Disc) {
        out[FIRST] = known.major;
        if let Some(slope) = known.slope {
            out[SECOND] = slope.minor;
            out[ANGLE] = slope.angle;
        }
    }
    if let Some(like) = candidate.like {
        out[BLUR] = like.blur;
        out[DARK] = like.dark;
    }
    out
}
