//! Free parameters of the image model for a marker, and their priors.

use crate::detect::appearance::parameters::{
    ANGLE, BEND, BLUR, DARK, GAMMA, HALO, LIGHT, MAJOR, MINOR, MarkerPattern, N, OUTLINE,
    OVERSHOOT, SAG, TAPER, UNEVEN_BLUR,
};
use crate::detect::estimate::options::PRIOR;
use crate::detect::hypothesis::{Hypothesis, prior::PriorValue};

/// Free parameters of a fit and their priors.
#[derive(Clone, Debug)]
pub struct FitUnknowns {
    pub free: [bool; N],
    /// Prior of each parameter.
    pub prior: [PriorValue; N],
}

/// Parameters of the light that only a complete, thick marker determines.
const FINE_LIGHT: [usize; 4] = [LIGHT + 3, DARK + 1, DARK + 2, GAMMA];

/// Selects the parameters that a marker of this size determines. Returns them and the indices of its bend parameters.
pub fn select_unknowns(hypothesis: &Hypothesis) -> (FitUnknowns, &'static [usize]) {
    let ellipse = &hypothesis.ellipse;
    let disc = hypothesis.pattern == MarkerPattern::Disc;
    let bends: &[usize] = if disc {
        &[SAG, TAPER]
    } else {
        &[BEND, BEND + 1]
    };
    let thick = ellipse.minor >= PRIOR.thick_px;
    let mut free = [true; N];
    free[DARK + 1] = thick;
    free[DARK + 2] = ellipse.minor >= PRIOR.dark_px;
    free[GAMMA] = thick;
    free[LIGHT + 3] = thick && ellipse.major >= PRIOR.light_px;
    free[TAPER] = disc || thick;
    [OVERSHOOT, HALO]
        .into_iter()
        .chain(OUTLINE..N)
        .for_each(|k| free[k] = false);
    let part = hypothesis.is_under_decal();
    if part {
        // The visible outline determines an ellipse and no more.
        FINE_LIGHT.iter().for_each(|&k| free[k] = false);
    }
    // A hidden end does not constrain the bend.
    let shows_bend = thick || (disc && !part);
    let cut = hypothesis.is_in_glare() && hypothesis.prior.size.is_none();
    if !shows_bend || ellipse.major < PRIOR.bend_px || cut {
        bends.iter().for_each(|&k| free[k] = false);
    }
    (
        FitUnknowns {
            free,
            prior: hypothesis_prior(hypothesis),
        },
        bends,
    )
}

/// Selects the parameters of a coarse fit: an outline or two lines, their blur, and planes of light.
pub fn coarse_unknowns(hypothesis: &Hypothesis) -> FitUnknowns {
    let (mut unknowns, _) = select_unknowns(hypothesis);
    FINE_LIGHT.iter().for_each(|&k| unknowns.free[k] = false);
    unknowns.free[UNEVEN_BLUR] &=
        hypothesis.edges.is_none() || hypothesis.ellipse.minor > PRIOR.narrow_px;
    if hypothesis.edges.is_some() && hypothesis.ellipse.minor > PRIOR.narrow_px {
        // The first crossing may be far off; long edges reach the right one by bending.
        [BEND, BEND + 1]
            .iter()
            .for_each(|&k| unknowns.prior[k] = PriorValue::UNKNOWN);
    }
    unknowns
}

/// Fixes the light of a disc except for its brightness and the darkness of its black.
pub fn fix_fine_light(unknowns: &mut FitUnknowns) {
    FINE_LIGHT
        .iter()
        .chain(&[LIGHT + 1, LIGHT + 2])
        .for_each(|&k| unknowns.free[k] = false);
}

/// Returns the darkness at which the grey value is the fraction `left` of the light, with the default tone curve.
pub fn darkness_for_grey_ratio(left: f64) -> f64 {
    1.0 - left.powf(1.0 / PRIOR.gamma.value)
}

/// Returns the priors of all parameters.
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
    if let Some(size) = known
        .size
        .filter(|_| hypothesis.pattern == MarkerPattern::Disc)
    {
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
