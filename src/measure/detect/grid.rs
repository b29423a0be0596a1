//! Parameters put on a grid: so two ways to one marker go on from one and the same place.
//!
//! The grid is a part of a standard deviation for the place, which one more step then makes up for, and
//! coarse for the grey levels, in which the image model is all but linear. Two solutions that agree to a
//! hundredth of its step lie on different sides of a boundary in one case of a hundred, and then the step
//! makes them agree nearly as well.

use super::model::{ANGLE, BLUR, DARK, EGG, FIRST, GAMMA, LIGHT, N, Parameters, Pattern, THIRD, X, Y};

/// Steps per unit.
const PLACE: f64 = 256.0;
const TURN: f64 = 16_384.0;
const BEND: f64 = 4_194_304.0;
const GREY: f64 = 4.0;
const SHARE: f64 = 256.0;

/// The nearest parameters on the grid.
pub fn put(pattern: Pattern, m: &Parameters) -> Parameters {
    let mut steps = [SHARE; N];
    [X, Y, BLUR].iter().for_each(|&k| steps[k] = PLACE);
    steps[LIGHT..DARK].fill(GREY);
    steps[ANGLE] = TURN;
    let shape = if pattern == Pattern::Disc { [PLACE; 3] } else { [TURN, BEND, BEND] };
    steps[FIRST..=THIRD].copy_from_slice(&shape);
    (steps[GAMMA], steps[EGG]) = (SHARE, TURN);
    std::array::from_fn(|k| (m[k] * steps[k]).round() / steps[k])
}

/// The nearest level that grey values are compared with, which are whole numbers: it is coarse.
pub fn put_level(level: f64) -> f64 {
    const STEP: f64 = 4.0;
    (level / STEP).round() * STEP
}

/// The nearest scale of residuals on the grid, grey levels.
pub fn put_scale(scale: f64) -> f64 {
    (scale * GREY).round() / GREY
}
