//! The parameters of a marker's image, their slots, and what a pattern says at a batch of pixels.

use crate::detect::simd::lanes::{Lanes, each};

/// Parameters of all markers' images.
pub const COMMON: usize = 18;
/// Those, and narrow quadrants' own.
pub const N: usize = COMMON + 8;
/// Centre u.
pub const X: usize = 0;
/// Centre v.
pub const Y: usize = 1;
/// Direction of s, rad.
pub const ANGLE: usize = 2;
/// First of the three slots of the shape, whose meaning the pattern tells ([`Geometry`]).
pub const SHAPE: usize = 3;
/// Disc: semi-major axis, px.
pub const MAJOR: usize = SHAPE;
/// Disc: semi-minor axis, px.
pub const MINOR: usize = SHAPE + 1;
/// Disc: sag of the bent axis at its ends, px.
pub const SAG: usize = SHAPE + 2;
/// Quadrants: tangent of half the angle between the edges.
pub const TANGENT: usize = SHAPE;
/// Quadrants: curvature term of the first edge and, in the next slot, of the second, 1/px.
pub const BEND: usize = SHAPE + 1;
/// Blur, pixel included, px.
pub const BLUR: usize = 6;
/// Light: constant, along s, along t, along s squared.
pub const LIGHT: usize = 7;
/// Darkness: constant, along s, along t.
pub const DARK: usize = 11;
/// Exponent of the tone curve.
pub const GAMMA: usize = 14;
/// Disc: relative change of its thickness from the centre to its end.
pub const TAPER: usize = 15;
/// Quadrants: by how much the first edge's blur is more than the mean of both, as a share.
pub const UNEVEN_BLUR: usize = TAPER;
/// Overshoot of a sharpened picture: amplitude, a ratio ([`super::overshoot`]).
pub const OVERSHOOT: usize = 16;
/// The same: by how much the copy is more blurred that the picture was held against, px; 0 of a picture that was not sharpened.
pub const HALO: usize = 17;
/// Narrow quadrants' outline, five numbers ([`super::quadrants`]).
pub const OUTLINE: usize = COMMON;
/// The skin's light about narrow quadrants over that of their white: constant, along s, along t.
pub const SKIN: usize = OUTLINE + 5;

/// Parameters of a marker's image.
pub type MarkerParameters = [f64; N];

/// The lightest grey value.
pub const WHITEST: f32 = u8::MAX as f32;

/// The light `L` of a place, in semi-axes along and across the marker, grey levels.
pub fn light_at(m: &MarkerParameters, p: f64, q: f64) -> f64 {
    m[LIGHT] + m[LIGHT + 1] * p + m[LIGHT + 2] * q + m[LIGHT + 3] * p * p
}

/// Which pattern `c` describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MarkerPattern {
    /// A black disc.
    Disc,
    /// Black between the edges along s, white along t.
    BlackAlong,
    /// White between the edges along s, black along t.
    WhiteAlong,
}

/// What the slots of a marker's shape hold, by its pattern.
#[derive(Clone, Copy, Debug)]
pub enum ShapeParameters {
    /// A disc's semi-axes, px.
    Disc { major: f64, minor: f64 },
    /// Tangent of half the angle between the edges of quadrants, and by how much the first one's blur is more than the mean of
    /// both, as a share.
    Quadrants { tangent: f64, uneven_blur: f64 },
}

impl ShapeParameters {
    /// Of a pattern's parameters.
    pub fn of(pattern: MarkerPattern, m: &MarkerParameters) -> Self {
        match pattern {
            MarkerPattern::Disc => Self::Disc { major: m[MAJOR], minor: m[MINOR] },
            _ => Self::Quadrants { tangent: m[TANGENT], uneven_blur: m[UNEVEN_BLUR] },
        }
    }
}

/// Share of black and its derivatives by s, t, the three slots of the shape, BLUR and TAPER or UNEVEN_BLUR.
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

/// Grey values and their derivatives.
#[derive(Clone, Debug)]
pub struct GreyBatch {
    pub value: Lanes,
    /// By the common parameters.
    pub gradient: [Lanes; COMMON],
    /// By those of narrow quadrants only.
    pub outline_gradient: Option<Box<OutlineGradient>>,
}

/// Derivatives by the parameters of narrow quadrants only.
pub type OutlineGradient = [Lanes; N - COMMON];

impl GreyBatch {
    /// Grey value 0 everywhere.
    #[inline(always)]
    pub fn new() -> Self {
        Self { value: Lanes::of(0.0), gradient: [Lanes::of(0.0); COMMON], outline_gradient: None }
    }

    /// The derivatives by a parameter.
    #[inline(always)]
    pub fn by(&self, k: usize) -> &Lanes {
        const NONE: &Lanes = &Lanes::of(0.0);
        match (self.gradient.get(k), &self.outline_gradient) {
            (Some(by), _) => by,
            (None, Some(outline_gradient)) => &outline_gradient[k - COMMON],
            (None, None) => NONE,
        }
    }
}

impl BlackFraction {
    #[inline(always)]
    /// Of white instead of black.
    pub fn complement(&mut self) {
        self.c = each(|i| 1.0 - self.c[i]);
        let Self { c: _, s, t, first, second, third, blur, taper } = self;
        for lanes in [s, t, first, second, third, blur, taper] {
            lanes.iter_mut().for_each(|v| *v = -*v);
        }
    }
}

/// The outline in the edges' frame: half its extent along their bisector, px; half its chord across at the centre, px; slope
/// of the chords' middles; the centre's place along and across, px.
pub const LENGTH: usize = OUTLINE;
/// Slot of the second of these.
pub const CHORD: usize = OUTLINE + 1;
/// Slot of the third.
pub const SHEAR: usize = OUTLINE + 2;
/// Slots of the fourth and fifth.
pub const ASIDE: usize = OUTLINE + 3;

/// Grey levels between white or skin and black.
pub fn contrast(m: &MarkerParameters) -> f64 {
    m[LIGHT] * (1.0 - (1.0 - m[DARK]).max(0.0).powf(m[GAMMA]))
}
