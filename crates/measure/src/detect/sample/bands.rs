//! Bands around an edge in which pixels are used.

use std::ops::Range;

use crate::detect::numbers::GrowingLength;

/// Width over which a weight decreases to zero, px.
pub const FADE_PX: f64 = 1.0;
/// Semi-minor axis, blurs, below which a disc is thin: in a sharpened image the overshoots of both its edges meet.
pub const THIN_BLURS: f64 = 4.0;
/// Range of blurs, px, to which the width of bands is limited: from a sharp image to slightly more than the largest
/// measured blur.
const BLUR_RANGE: Range<f64> = 0.5..3.5;
/// Half width of the band that contains the position information of a blurred edge, by blur. Within 1.9 blurs lies 99 % of
/// that information.
const EDGE_BAND: GrowingLength<f32> = GrowingLength {
    factor: 1.4,
    px: 0.4,
};
/// Half width of the band that contains the flat background from which the grey levels are estimated, by blur. Chosen;
/// `tests/detect/fixtures.rs`.
const FLAT_BAND: GrowingLength<f32> = GrowingLength {
    factor: 3.5,
    px: 2.0,
};

/// Limits a blur, px, to the range for which bands are defined.
pub fn clamp_blur(blur: f64) -> f64 {
    blur.clamp(BLUR_RANGE.start, BLUR_RANGE.end)
}

/// Half widths of the bands around an edge, px: its blurred part, and with the flat background next to it.
#[derive(Clone, Copy)]
pub struct EdgeBands {
    pub edge: f32,
    pub flat: f32,
}

impl EdgeBands {
    /// Returns the bands for an edge with this blur, px.
    pub fn from_blur(blur: f64) -> Self {
        let blur = clamp_blur(blur) as f32;
        Self {
            edge: EDGE_BAND.at(blur),
            flat: FLAT_BAND.at(blur),
        }
    }

    /// Returns the bands for a disc of this semi-minor axis and blur, px, with at least the fraction `nearest` of the flat
    /// background.
    pub fn for_disc(minor: f64, blur: f64, nearest: f64) -> Self {
        let Self { edge, flat } = Self::from_blur(blur);
        Self {
            edge,
            flat: flat * (minor / (THIN_BLURS * blur)).clamp(nearest, 1.0) as f32,
        }
    }

    /// Returns the weight of a pixel at a distance from the edge, px, given the fractions that are kept at the edge and
    /// next to it.
    #[inline(always)]
    pub fn weight(self, keep: [f32; 2], distance: f32) -> f32 {
        let (edge, flat) = (
            keep[0] * fade_weight(self.edge - distance),
            keep[1] * fade_weight(self.flat - distance),
        );
        if edge > flat { edge } else { flat }
    }
}

/// Returns the factor, 0 to 1, of a weight at a distance before the middle of its decrease, px.
#[inline(always)]
pub fn fade_weight(before: f32) -> f32 {
    let share = before / FADE_PX as f32 + 0.5;
    let share = if share > 0.0 { share } else { 0.0 };
    if share < 1.0 { share } else { 1.0 }
}
