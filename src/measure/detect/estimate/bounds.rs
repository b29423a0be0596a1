//! What the parameters of a marker's image can be at all, and by how much one step may change them.

use crate::detect::appearance::parameters::{
    ANGLE, BLUR, CHORD, DARK, GAMMA, Geometry, HALO, LENGTH, LIGHT, MAJOR, MINOR, OVERSHOOT, Parameters,
    Pattern, SHEAR, TANGENT, UNEVEN_BLUR, X, Y,
};
use crate::detect::estimate::normal_equations::Column;
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
const STEP: [(usize, f64); 7] =
    [(X, 3.0), (Y, 3.0), (BLUR, 0.5), (ANGLE, 0.2), (GAMMA, 0.2), (DARK, 0.1), (OVERSHOOT, 0.5)];
/// The same of a disc's semi-axes, shares of themselves.
const STEP_AXES: [(usize, f64); 2] = [(MAJOR, 0.2), (MINOR, 0.3)];
/// The same of quadrants' edges: a tangent, and a share of the blur.
const STEP_EDGES: [(usize, f64); 2] = [(TANGENT, 0.2), (UNEVEN_BLUR, 0.15)];
/// The same of their outline: a tangent; half length and half chord, shares of themselves.
const STEP_SHEAR: f64 = 0.1;
const STEP_OUTLINE: [(usize, f64); 2] = [(LENGTH, 0.15), (CHORD, 0.2)];

/// Keeps a step within what the linearisation can bear, its direction as it is.
pub fn limit(mut change: Column, m: &Parameters, pixels: &Pixels) -> Column {
    let mut factor: f64 = 1.0;
    let mut bound = |k: usize, most: f64| factor = factor.min(most / change[k].abs().max(TINY));
    STEP.into_iter().for_each(|(k, most)| bound(k, most));
    match pixels.pattern {
        Pattern::Disc => STEP_AXES.into_iter().for_each(|(k, share)| bound(k, share * m[k])),
        _ => STEP_EDGES.into_iter().for_each(|(k, most)| bound(k, most)),
    }
    if pixels.outlined {
        bound(SHEAR, STEP_SHEAR);
        STEP_OUTLINE.into_iter().for_each(|(k, share)| bound(k, share * m[k]));
    }
    change *= factor;
    change
}

/// Whether all parameters of a fit are within [`BOUNDS`].
pub fn is_plausible(pixels: &Pixels, m: &Parameters) -> bool {
    let outline = || m[LENGTH] > BOUNDS.outline_px[0] && m[CHORD] > BOUNDS.outline_px[1];
    is_sharp(m)
        && within(m[LIGHT], BOUNDS.light)
        && within(m[DARK], BOUNDS.dark)
        && has_shape(pixels.pattern, m)
        && (!pixels.outlined || outline())
        && within(m[OVERSHOOT], BOUNDS.overshoot)
        && (0.0..BOUNDS.halo_px).contains(&m[HALO])
}

/// Whether tone curve and shape are: of what glare lies over, light and darkness may be anything.
pub fn has_shape(pattern: Pattern, m: &Parameters) -> bool {
    within(m[GAMMA], BOUNDS.gamma)
        && match Geometry::of(pattern, m) {
            Geometry::Disc { major, minor } => major > BOUNDS.axes_px[0] && minor > BOUNDS.axes_px[1],
            Geometry::Quadrants { tangent, uneven_blur } => {
                within(tangent, BOUNDS.tangent) && uneven_blur.abs() < BOUNDS.uneven_blur
            }
        }
}

/// Whether all are numbers, and the blur is one of a marker's.
pub fn is_sharp(m: &Parameters) -> bool {
    m.iter().all(|v| v.is_finite()) && within(m[BLUR], BOUNDS.blur_px)
}

fn within(value: f64, (least, most): (f64, f64)) -> bool {
    value > least && value < most
}
