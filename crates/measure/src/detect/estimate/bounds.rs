//! Plausible ranges of a marker's parameters, and the largest change of each parameter in one iteration.

use std::ops::Range;

use crate::detect::appearance::parameters::{
    ANGLE, BLUR, CHORD, DARK, GAMMA, HALO, LENGTH, LIGHT, MAJOR, MINOR, MarkerParameters,
    MarkerPattern, OVERSHOOT, SHEAR, ShapeParameters, TANGENT, UNEVEN_BLUR, X, Y,
};
use crate::detect::estimate::normal_equations::ParameterVector;
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::Pixels;

numbers! {
    /// Plausible ranges of the parameters. A fit that leaves them has lost its marker. All values were chosen, far from
    /// those of real markers.
    BOUNDS: Bounds {
        /// Blur, px: from less than the blur of a pixel to more than is accepted.
        blur_px: Range<f64> = 0.2..4.0,
        /// Light of white or skin, grey levels: saturated white is lighter than 255.
        light: Range<f64> = 1.0..1500.0,
        /// Darkness as a fraction of the light: black that blur has not reached is above 1.
        dark: Range<f64> = 0.02..1.5,
        /// Exponent of the tone curve.
        gamma: Range<f64> = 0.15..3.0,
        /// Minimum semi-axes of a disc, px: major, minor.
        axes_px: [f64; 2] = [1.0, 0.2],
        /// Plausible tangent of half the angle between the edges of a quadrant marker.
        tangent: Range<f64> = 0.005..2.5,
        /// Maximum relative difference between the blur of either edge of quadrants and their mean blur.
        uneven_blur: f64 = 0.7,
        /// Amplitude of sharpening, a ratio: strong camera settings reach 2; a negative amplitude is blurring.
        overshoot: Range<f64> = -0.5..6.0,
        /// Maximum blur of the copy that sharpening subtracts, px.
        halo_px: f64 = 6.0,
        /// Minimum half length and half chord of the outline of quadrants, px.
        outline_px: [f64; 2] = [3.0, 1.0],
    }
}

/// Maximum change per iteration for which the linearisation is valid; all of these limits were chosen. Position and blur,
/// px; direction, rad; exponent of the tone curve; darkness, a fraction of the light; overshoot, a ratio.
const MAX_STEP: [(usize, f64); 7] = [
    (X, 3.0),
    (Y, 3.0),
    (BLUR, 0.5),
    (ANGLE, 0.2),
    (GAMMA, 0.2),
    (DARK, 0.1),
    (OVERSHOOT, 0.5),
];
/// Maximum change of a disc's semi-axes per iteration, as a fraction of each.
const MAX_STEP_AXES: [(usize, f64); 2] = [(MAJOR, 0.2), (MINOR, 0.3)];
/// Maximum change of the edges of quadrants per iteration: a tangent, and a fraction of the blur.
const MAX_STEP_EDGES: [(usize, f64); 2] = [(TANGENT, 0.2), (UNEVEN_BLUR, 0.15)];
/// Maximum change of the shear of the outline of quadrants per iteration, a tangent.
const MAX_STEP_SHEAR: f64 = 0.1;
const MAX_STEP_OUTLINE: [(usize, f64); 2] = [(LENGTH, 0.15), (CHORD, 0.2)];

/// Shortens a step to the range in which the linearisation is valid and keeps its direction.
pub fn limit_step(
    mut change: ParameterVector,
    m: &MarkerParameters,
    pixels: &Pixels,
) -> ParameterVector {
    let mut factor: f64 = 1.0;
    let mut bound = |k: usize, most: f64| factor = factor.min(most / change[k].abs().max(TINY));
    MAX_STEP.into_iter().for_each(|(k, most)| bound(k, most));
    match pixels.pattern {
        MarkerPattern::Disc => MAX_STEP_AXES
            .into_iter()
            .for_each(|(k, share)| bound(k, share * m[k])),
        _ => MAX_STEP_EDGES
            .into_iter()
            .for_each(|(k, most)| bound(k, most)),
    }
    if pixels.outlined {
        bound(SHEAR, MAX_STEP_SHEAR);
        MAX_STEP_OUTLINE
            .into_iter()
            .for_each(|(k, share)| bound(k, share * m[k]));
    }
    change *= factor;
    change
}

/// Returns true if all parameters of a fit are within [`BOUNDS`].
pub fn is_plausible(pixels: &Pixels, m: &MarkerParameters) -> bool {
    let outline = || m[LENGTH] > BOUNDS.outline_px[0] && m[CHORD] > BOUNDS.outline_px[1];
    is_sharp(m)
        && BOUNDS.light.contains(&m[LIGHT])
        && BOUNDS.dark.contains(&m[DARK])
        && has_shape(pixels.pattern, m)
        && (!pixels.outlined || outline())
        && BOUNDS.overshoot.contains(&m[OVERSHOOT])
        && (0.0..BOUNDS.halo_px).contains(&m[HALO])
}

/// Returns true if tone curve and shape are within [`BOUNDS`]. Light and darkness are not checked: under glare they can
/// have any value.
pub fn has_shape(pattern: MarkerPattern, m: &MarkerParameters) -> bool {
    BOUNDS.gamma.contains(&m[GAMMA])
        && match ShapeParameters::from_parameters(pattern, m) {
            ShapeParameters::Disc { major, minor } => {
                major > BOUNDS.axes_px[0] && minor > BOUNDS.axes_px[1]
            }
            ShapeParameters::Quadrants {
                tangent,
                uneven_blur,
            } => BOUNDS.tangent.contains(&tangent) && uneven_blur.abs() < BOUNDS.uneven_blur,
        }
}

/// Returns true if all parameters are finite and the blur is that of a marker.
pub fn is_sharp(m: &MarkerParameters) -> bool {
    m.iter().all(|v| v.is_finite()) && BOUNDS.blur_px.contains(&m[BLUR])
}
