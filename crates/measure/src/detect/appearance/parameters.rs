//! Parameters of a marker's image, their slots, and the batches of grey values and derivatives.

use crate::detect::simd::lanes::{Lanes, each};
use crate::setup::Shape;

/// Number of parameters common to all markers' images.
pub const COMMON: usize = 18;
/// Number of parameters including those of narrow quadrants.
pub const N: usize = COMMON + 8;
/// Slot of the centre's u.
pub const X: usize = 0;
/// Slot of the centre's v.
pub const Y: usize = 1;
/// Slot of the direction of s, rad.
pub const ANGLE: usize = 2;
/// First of the three slots of the shape, whose meaning depends on the pattern ([`ShapeParameters`]).
pub const SHAPE: usize = 3;
/// Disc: slot of the semi-major axis, px.
pub const MAJOR: usize = SHAPE;
/// Disc: slot of the semi-minor axis, px.
pub const MINOR: usize = SHAPE + 1;
/// Disc: slot of the sag of the bent axis at its ends, px.
pub const SAG: usize = SHAPE + 2;
/// Quadrants: slot of the tangent of half the angle between the edges.
pub const TANGENT: usize = SHAPE;
/// Quadrants: slot of the curvature term of the first edge and, in the next slot, of the second, 1/px.
pub const BEND: usize = SHAPE + 1;
/// Slot of the blur including the pixel, standard deviation, px.
pub const BLUR: usize = 6;
/// Slots of the light: constant, along s, along t, along s squared.
pub const LIGHT: usize = 7;
/// Slots of the darkness: constant, along s, along t.
pub const DARK: usize = 11;
/// Slot of the exponent of the tone curve.
pub const GAMMA: usize = 14;
/// Disc: slot of the relative change of thickness from the centre to the end.
pub const TAPER: usize = 15;
/// Quadrants: slot of the excess of the first edge's blur over the mean of both, as a fraction.
pub const UNEVEN_BLUR: usize = TAPER;
/// Slot of the overshoot's amplitude in a sharpened image, a ratio ([`super::overshoot`]).
pub const OVERSHOOT: usize = 16;
/// Slot of the blur by which the copy for sharpening is more blurred, px; 0 for an image that was not sharpened.
pub const HALO: usize = 17;
/// First slot of narrow quadrants' outline, five numbers ([`super::quadrants`]).
pub const OUTLINE: usize = COMMON;
/// Slots of the skin's light around narrow quadrants relative to that of their white: constant, along s, along t.
pub const SKIN: usize = OUTLINE + 5;

/// Parameters of a marker's image.
pub type MarkerParameters = [f64; N];

/// Distance from an edge, blurs, at which it leaves 0.1 % of its contrast: the tail of the normal distribution.
pub const EDGE_END_BLURS: f64 = 3.0;
/// Distance from an edge, blurs, at which it leaves 1.4 % of its contrast: the tail of the normal distribution.
pub const EDGE_SKIRT_BLURS: f64 = 2.2;

/// Lightest grey value.
pub const WHITEST: f32 = u8::MAX as f32;

/// Returns the light `L` at a position in semi-axes along and across the marker, grey levels.
pub fn light_at(m: &MarkerParameters, p: f64, q: f64) -> f64 {
    m[LIGHT] + m[LIGHT + 1] * p + m[LIGHT + 2] * q + m[LIGHT + 3] * p * p
}

/// Pattern whose black the fraction `c` describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MarkerPattern {
    Disc,
    /// Black between the edges along s, white along t.
    BlackAlong,
    /// White between the edges along s, black along t.
    WhiteAlong,
}

impl MarkerPattern {
    /// Returns the shape of markers with this pattern.
    pub fn shape(self) -> Shape {
        match self {
            Self::Disc => Shape::Circle,
            _ => Shape::Quadrant,
        }
    }
}

/// Shape of a marker's image, from the slots of its pattern.
#[derive(Clone, Copy, Debug)]
pub enum ShapeParameters {
    /// Semi-axes of a disc, px.
    Disc { major: f64, minor: f64 },
    /// Tangent of half the angle between the edges of quadrants, and excess of the first one's blur over the mean of both,
    /// as a fraction.
    Quadrants { tangent: f64, uneven_blur: f64 },
}

impl ShapeParameters {
    /// Reads the shape from a pattern's parameters.
    pub fn from_parameters(pattern: MarkerPattern, m: &MarkerParameters) -> Self {
        match pattern {
            MarkerPattern::Disc => Self::Disc {
                major: m[MAJOR],
                minor: m[MINOR],
            },
            _ => Self::Quadrants {
                tangent: m[TANGENT],
                uneven_blur: m[UNEVEN_BLUR],
            },
        }
    }
}

/// Fraction of black and its derivatives with respect to s, t, the three slots of the shape, BLUR, and TAPER or
/// UNEVEN_BLUR.
#[derive(Clone, Debug, Default)]
pub struct BlackFraction {
    pub c: Lanes,
    pub s: Lanes,
    pub t: Lanes,
    pub first: Lanes,
    pub second: Lanes,
    pub third: Lanes,
    pub blur: Lanes,
    pub taper: Lanes,
}

/// Grey values of a batch and their derivatives.
#[derive(Clone, Debug)]
pub struct GreyBatch {
    pub value: Lanes,
    /// Derivatives with respect to the common parameters.
    pub gradient: [Lanes; COMMON],
    /// Derivatives with respect to the parameters of narrow quadrants.
    pub outline_gradient: Option<Box<OutlineGradient>>,
}

/// Derivatives with respect to the parameters of narrow quadrants.
pub type OutlineGradient = [Lanes; N - COMMON];

impl GreyBatch {
    /// Creates a batch with grey value 0 everywhere.
    #[inline(always)]
    pub fn new() -> Self {
        Self {
            value: Lanes::splat(0.0),
            gradient: [Lanes::splat(0.0); COMMON],
            outline_gradient: None,
        }
    }

    /// Returns the derivatives with respect to a parameter.
    #[inline(always)]
    pub fn derivative(&self, k: usize) -> &Lanes {
        const NONE: &Lanes = &Lanes::splat(0.0);
        match (self.gradient.get(k), &self.outline_gradient) {
            (Some(by), _) => by,
            (None, Some(outline_gradient)) => &outline_gradient[k - COMMON],
            (None, None) => NONE,
        }
    }
}

impl BlackFraction {
    #[inline(always)]
    /// Replaces the fraction of black by that of white.
    pub fn complement(&mut self) {
        self.c = each(|i| 1.0 - self.c[i]);
        let Self {
            c: _,
            s,
            t,
            first,
            second,
            third,
            blur,
            taper,
        } = self;
        for lanes in [s, t, first, second, third, blur, taper] {
            lanes.iter_mut().for_each(|v| *v = -*v);
        }
    }
}

/// Slot of half the outline's extent along the edges' bisector, px. The outline is given in the edges' frame.
pub const LENGTH: usize = OUTLINE;
/// Slot of half the outline's chord across at its centre, px.
pub const CHORD: usize = OUTLINE + 1;
/// Slot of the slope of the chords' midpoints.
pub const SHEAR: usize = OUTLINE + 2;
/// Slots of the outline's centre along and across, px.
pub const OFFSET: usize = OUTLINE + 3;

/// Returns the grey levels between white or skin and black.
pub fn grey_contrast(m: &MarkerParameters) -> f64 {
    m[LIGHT] * (1.0 - (1.0 - m[DARK]).max(0.0).powf(m[GAMMA]))
}
