//! Which of the image model's parameters are sought of a marker, and what is known of them beforehand.

use crate::detect::appearance::parameters::{
    ANGLE, BEND, BLUR, DARK, GAMMA, HALO, LIGHT, MAJOR, MINOR, N, OUTLINE, OVERSHOOT, MarkerPattern, SAG, TAPER,
    UNEVEN_BLUR,
};
use crate::detect::estimate::options::PRIOR;
use crate::detect::hypothesis::{Hypothesis, prior::PriorValue};

/// What is sought, and what is known of it beforehand.
#[derive(Clone, Debug)]
pub struct FitUnknowns {
    /// Parameters that are sought.
    pub free: [bool; N],
    /// What each is usually.
    pub prior: [PriorValue; N],
}

/// What only a whole thick marker tells of its light.
const FINE_LIGHT: [usize; 4] = [LIGHT + 3, DARK + 1, DARK + 2, GAMMA];

/// Which parameters a marker of this size can tell, and which of them are bends.
pub fn select_unknowns(hypothesis: &Hypothesis) -> (FitUnknowns, &'static [usize]) {
    let ellipse = &hypothesis.ellipse;
    let disc = hypothesis.pattern == MarkerPattern::Disc;
    let bends: &[usize] = if disc { &[SAG, TAPER] } else { &[BEND, BEND + 1] };
    let thick = ellipse.minor >= PRIOR.thick_px;
    let mut free = [true; N];
    free[DARK + 1] = thick;
    free[DARK + 2] = ellipse.minor >= PRIOR.dark_px;
    free[GAMMA] = thick;
    free[LIGHT + 3] = thick && ellipse.major >= PRIOR.light_px;
    free[TAPER] = disc || thick;
    [OVERSHOOT, HALO].into_iter().chain(OUTLINE..N).for_each(|k| free[k] = false);
    let part = hypothesis.is_under_decal();
    if part {
        // The outline that is left tells an ellipse, and no more.
        FINE_LIGHT.iter().for_each(|&k| free[k] = false);
    }
    // An end that is not seen tells no bend.
    let tells = thick || (disc && !part);
    let cut = hypothesis.is_in_glare() && hypothesis.prior.size.is_none();
    if !tells || ellipse.major < PRIOR.bend_px || cut {
        bends.iter().for_each(|&k| free[k] = false);
    }
    (FitUnknowns { free, prior: hypothesis_prior(hypothesis) }, bends)
}

/// What a first geometry takes: an outline or two lines, their blur, and planes of light.
pub fn coarse_unknowns(hypothesis: &Hypothesis) -> FitUnknowns {
    let (mut unknowns, _) = select_unknowns(hypothesis);
    FINE_LIGHT.iter().for_each(|&k| unknowns.free[k] = false);
    unknowns.free[UNEVEN_BLUR] &= hypothesis.edges.is_none() || hypothesis.ellipse.minor > PRIOR.narrow_px;
    if hypothesis.edges.is_some() && hypothesis.ellipse.minor > PRIOR.narrow_px {
        // The first crossing may be far off, and long edges reach the right one by bending.
        [BEND, BEND + 1].iter().for_each(|&k| unknowns.prior[k] = PriorValue::UNKNOWN);
    }
    unknowns
}

/// Of the light of a disc nothing is sought but how bright it is, and how dark its black.
pub fn fix_fine_light(unknowns: &mut FitUnknowns) {
    FINE_LIGHT.iter().chain(&[LIGHT + 1, LIGHT + 2]).for_each(|&k| unknowns.free[k] = false);
}

/// The darkness that leaves such a share of the light's grey value, with the usual tone curve.
pub fn darkness_for_grey_ratio(left: f64) -> f64 {
    1.0 - left.powf(1.0 / PRIOR.gamma.value)
}

/// What is known before the fit.
fn hypothesis_prior(hypothesis: &Hypothesis) -> [PriorValue; N] {
    let mut out = [PriorValue::UNKNOWN; N];
    let (ellipse, known) = (&hypothesis.ellipse, &hypothesis.prior);
    out[GAMMA] = PRIOR.gamma;
    if hypothesis.pattern == MarkerPattern::Disc {
        out[SAG] = PriorValue::zero(PRIOR.sag * ellipse.major);
        out[TAPER] = PriorValue::zero(PRIOR.taper);
    } else {
        out[BEND] = PriorValue::zero(2.0 * PRIOR.sag / ellipse.major);
        out[BEND + 1] = out[BEND];
        out[UNEVEN_BLUR] = PriorValue::zero(PRIOR.uneven_blur);
    }
    if known.twin {
        out[ANGLE] = PriorValue { value: ellipse.angle, sigma: PRIOR.twin_angle_rad };
        out[MAJOR] = PriorValue::to_share(ellipse.major, PRIOR.twin_major);
        out[MINOR] = PriorValue::to_share(ellipse.minor, PRIOR.twin_minor);
    }
    if let Some(size) = known.size.filter(|_| hypothesis.pattern == MarkerPattern::Disc) {
        out[MAJOR] = size.major;
        if let Some(slope) = size.slope {
            (out[MINOR], out[ANGLE]) = (slope.minor, slope.angle);
        }
    }
    if let Some(edge) = known.edge {
        (out[BLUR], out[DARK]) = (edge.blur, edge.dark);
    }
    out
}
