//! What the parameters of a marker's image can be at all, and by how much one step may change them.

use crate::detect::appearance::parameters::{
    ANGLE, BLUR, CHORD, DARK, GAMMA, ShapeParameters, HALO, LENGTH, LIGHT, MAJOR, MINOR, OVERSHOOT, MarkerParameters,
    MarkerPattern, SHEAR, TANGENT, UNEVEN_BLUR, X, Y,
};
use crate::detect::estimate::normal_equations::ParameterVector;
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::Pixels;

numbers! {
    /// Beyond these a fit has lost its marker. Chosen, all of them, far from what markers show.
    BOUNDS: Bounds {
        /// Blur, px: less than a pixel's own, and more than is accepted.
        blur_px: (f64, f64) = (0.2, 4.0),
        /// Light of white or skin, grey levels: saturated white is lighter than 255.
        light: (f64, f64) = (1.0, 1500.0),
        /// Darkness, a share of the light: more than 1 is black that blur has not reached.
        dark: (f64, f64) = (0.02, 1.5),
        /// Exponent of the tone curve.
        gamma: (f64, f64) = (0.15, 3.0),
        /// Least semi-axes of a disc, px: major, minor.
        axes_px: [f64; 2] = [1.0, 0.2],
        /// Tangent of half the angle between quadrants' edges.
        tangent: (f64, f64) = (0.005, 2.5),
        /// By how much the blurs of their edges differ from the mean, as a share.
        uneven_blur: f64 = 0.7,
        /// Amplitude of sharpening, a ratio: strong settings of cameras are 2, and blurring would be negative.
        overshoot: (f64, f64) = (-0.5, 6.0),
        /// The greatest blur of the copy that it is held against, px.
        halo_px: f64 = 6.0,
        /// Least half length and half chord of quadrants' outline, px.
        outline_px: [f64; 2] = [3.0, 1.0],
    }
}

/// Most by which one step changes parameters: what the linearisation can bear. Chosen, as all of these. Place and blur, px;
/// direction, rad; exponent of the tone curve; darkness, a share of the light; overshoot, a ratio.
const MAX_STEP: [(usize, f64); 7] =
    [(X, 3.0), (Y, 3.0), (BLUR, 0.5), (ANGLE, 0.2), (GAMMA, 0.2), (DARK, 0.1), (OVERSHOOT, 0.5)];
/// The same of a disc's semi-axes, shares of themselves.
const MAX_STEP_AXES: [(usize, f64); 2] = [(MAJOR, 0.2), (MINOR, 0.3)];
/// The same of quadrants' edges: a tangent, and a share of the blur.
const MAX_STEP_EDGES: [(usize, f64); 2] = [(TANGENT, 0.2), (UNEVEN_BLUR, 0.15)];
/// The same of their outline: a tangent; half length and half chord, shares of themselves.
const MAX_STEP_SHEAR: f64 = 0.1;
const MAX_STEP_OUTLINE: [(usize, f64); 2] = [(LENGTH, 0.15), (CHORD, 0.2)];

/// Keeps a step within what the linearisation can bear, its direction as it is.
pub fn limit_step(mut change: ParameterVector, m: &MarkerParameters, pixels: &Pixels) -> ParameterVector {
    let mut factor: f64 = 1.0;
    let mut bound = |k: usize, most: f64| factor = factor.min(most / change[k].abs().max(TINY));
    MAX_STEP.into_iter().for_each(|(k, most)| bound(k, most));
    match pixels.pattern {
        MarkerPattern::Disc => MAX_STEP_AXES.into_iter().for_each(|(k, share)| bound(k, share * m[k])),
        _ => MAX_STEP_EDGES.into_iter().for_each(|(k, most)| bound(k, most)),
    }
    if pixels.outlined {
        bound(SHEAR, MAX_STEP_SHEAR);
        MAX_STEP_OUTLINE.into_iter().for_each(|(k, share)| bound(k, share * m[k]));
    }
    change *= factor;
    change
}

/// Whether all parameters of a fit are within [`BOUNDS`].
pub fn is_plausible(pixels: &Pixels, m: &MarkerParameters) -> bool {
    let outline = || m[LENGTH] > BOUNDS.outline_px[0] && m[CHORD] > BOUNDS.outline_px[1];
    is_sharp(m)
        && is_within(m[LIGHT], BOUNDS.light)
        && is_within(m[DARK], BOUNDS.dark)
        && has_shape(pixels.pattern, m)
        && (!pixels.outlined || outline())
        && is_within(m[OVERSHOOT], BOUNDS.overshoot)
        && (0.0..BOUNDS.halo_px).contains(&m[HALO])
}

/// Whether tone curve and shape are: of what glare lies over, light and darkness may be anything.
pub fn has_shape(pattern: MarkerPattern, m: &MarkerParameters) -> bool {
    is_within(m[GAMMA], BOUNDS.gamma)
        && match ShapeParameters::of(pattern, m) {
            ShapeParameters::Disc { major, minor } => major > BOUNDS.axes_px[0] && minor > BOUNDS.axes_px[1],
            ShapeParameters::Quadrants { tangent, uneven_blur } => {
                is_within(tangent, BOUNDS.tangent) && uneven_blur.abs() < BOUNDS.uneven_blur
            }
        }
}

/// Whether all are numbers, and the blur is one of a marker's.
pub fn is_sharp(m: &MarkerParameters) -> bool {
    m.iter().all(|v| v.is_finite()) && is_within(m[BLUR], BOUNDS.blur_px)
}

fn is_within(value: f64, (least, most): (f64, f64)) -> bool {
    value > least && value < most
}
