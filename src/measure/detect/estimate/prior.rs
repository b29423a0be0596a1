//! Which of the image model's parameters are sought of a marker, and what is known of them beforehand.

use super::unknowns::Unknowns;
use crate::measure::detect::appearance::parameters::{
    ANGLE, BLUR, DARK, FIRST, GAMMA, LIGHT, N, OUTLINE, Pattern, SECOND, TAPER, THIRD,
};
use crate::measure::detect::estimate::options::PRIOR;
use crate::measure::detect::hypothesis::Hypothesis;

/// What only a whole thick marker tells of its light.
const FINE_LIGHT: [usize; 4] = [LIGHT + 3, DARK + 1, DARK + 2, GAMMA];

/// Which parameters a marker of this size can tell, and which of them are bends.
pub fn unknowns(hypothesis: &Hypothesis) -> (Unknowns, &'static [usize]) {
    let ellipse = &hypothesis.ellipse;
    let disc = hypothesis.pattern == Pattern::Disc;
    let bends: &[usize] = if disc { &[THIRD, TAPER] } else { &[SECOND, THIRD] };
    let thick = ellipse.minor >= PRIOR.thick_px;
    let mut free = [true; N];
    free[DARK + 1] = thick;
    free[DARK + 2] = ellipse.minor >= 6.0;
    free[GAMMA] = thick;
    free[LIGHT + 3] = thick && ellipse.major >= 15.0;
    free[TAPER] = disc || thick;
    (OUTLINE..N).for_each(|k| free[k] = false);
    let part = hypothesis.is_under_decal();
    if part {
        // The outline that is left tells an ellipse, and no more.
        FINE_LIGHT.iter().for_each(|&k| free[k] = false);
    }
    // An end that is not seen tells no bend.
    let tells = thick || (disc && !part);
    let cut = hypothesis.is_in_glare() && hypothesis.prior.size.is_none();
    if !tells || ellipse.major < 12.0 || cut {
        bends.iter().for_each(|&k| free[k] = false);
    }
    (Unknowns { free, prior: prior(hypothesis) }, bends)
}

/// What a first geometry takes: an outline or two lines, their blur, and planes of light.
pub fn few_unknowns(hypothesis: &Hypothesis) -> Unknowns {
    let (mut unknowns, _) = unknowns(hypothesis);
    FINE_LIGHT.iter().for_each(|&k| unknowns.free[k] = false);
    unknowns.free[TAPER] &= hypothesis.edges.is_none() || hypothesis.ellipse.minor > PRIOR.narrow_px;
    if hypothesis.edges.is_some() && hypothesis.ellipse.minor > PRIOR.narrow_px {
        // The first crossing may be far off, and long edges reach the right one by bending.
        [SECOND, THIRD].iter().for_each(|&k| unknowns.prior[k].1 = f64::INFINITY);
    }
    unknowns
}

/// Of the light of a disc nothing is sought but how bright it is, and how dark its black.
pub fn without_fine_light(unknowns: &mut Unknowns) {
    FINE_LIGHT.iter().chain(&[LIGHT + 1, LIGHT + 2]).for_each(|&k| unknowns.free[k] = false);
}

/// The darkness that leaves such a share of the light's grey value, with the usual tone curve.
pub fn darkness_leaving(left: f64) -> f64 {
    1.0 - left.powf(1.0 / PRIOR.gamma.0)
}

/// What is known before the fit.
fn prior(hypothesis: &Hypothesis) -> [(f64, f64); N] {
    let mut out = [(0.0, f64::INFINITY); N];
    let ellipse = &hypothesis.ellipse;
    out[GAMMA] = PRIOR.gamma;
    if hypothesis.pattern == Pattern::Disc {
        out[THIRD] = (0.0, PRIOR.sag * ellipse.major);
        out[TAPER] = (0.0, PRIOR.taper);
    } else {
        out[SECOND] = (0.0, 2.0 * PRIOR.sag / ellipse.major);
        out[THIRD] = out[SECOND];
        out[TAPER] = (0.0, PRIOR.uneven_blur);
    }
    if hypothesis.prior.twin {
        out[ANGLE] = (ellipse.angle, PRIOR.twin_angle_rad);
        out[FIRST] = (ellipse.major, PRIOR.twin_major * ellipse.major);
        out[SECOND] = (ellipse.minor, PRIOR.twin_minor * ellipse.minor);
    }
    if let Some(known) = hypothesis.prior.size.filter(|_| hypothesis.pattern == Pattern::Disc) {
        out[FIRST] = known.major;
        if let Some(slope) = known.slope {
            out[SECOND] = slope.minor;
            out[ANGLE] = slope.angle;
        }
    }
    if let Some(edge) = hypothesis.prior.edge {
        out[BLUR] = edge.blur;
        out[DARK] = edge.dark;
    }
    out
}
