//! Bands about an edge in which pixels count.

/// Width over which a weight falls to zero, px.
pub const FADE_PX: f64 = 1.0;
/// Blurs below which a disc is thin.
const THIN_BLURS: f64 = 4.0;
/// Blurs, px, by which bands are as wide: a sharp picture's at least, and little more than the greatest that is measured.
const BLUR_RANGE: (f64, f64) = (0.5, 3.5);
/// Where a blurred edge still tells its place, blurs and px. Within 1.9 times the blur is all but a hundredth of what it tells.
const EDGE_BAND: (f32, f32) = (1.4, 0.4);
/// Where flat ground ends that tells the levels, blurs and px. Chosen; `tests/detect/fixtures.rs`.
const FLAT_BAND: (f32, f32) = (3.5, 2.0);

/// A blur, px, within what bands are made for.
pub fn clamp_blur(blur: f64) -> f64 {
    blur.clamp(BLUR_RANGE.0, BLUR_RANGE.1)
}

/// Bands about an edge, px: where its blur reaches, and flat ground beside it.
#[derive(Clone, Copy)]
pub struct EdgeBands {
    pub edge: f32,
    pub flat: f32,
}

impl EdgeBands {
    /// For an edge with this blur, px.
    pub fn from_blur(blur: f64) -> Self {
        let blur = clamp_blur(blur) as f32;
        Self { edge: EDGE_BAND.0 * blur + EDGE_BAND.1, flat: FLAT_BAND.0 * blur + FLAT_BAND.1 }
    }

    /// For a disc of this thickness with this blur, px, that uses at least a share of the flat ground.
    pub fn for_disc(minor: f64, blur: f64, nearest: f64) -> Self {
        let Self { edge, flat } = Self::from_blur(blur);
        Self { edge, flat: flat * (minor / (THIN_BLURS * blur)).clamp(nearest, 1.0) as f32 }
    }

    /// The weight of a pixel at a distance from the edge.
    #[inline(always)]
    pub fn weight(self, keep: [f32; 2], distance: f32) -> f32 {
        let (edge, flat) = (keep[0] * fade_weight(self.edge - distance), keep[1] * fade_weight(self.flat - distance));
        if edge > flat { edge } else { flat }
    }
}

/// What is left of a weight so far before the middle of where it falls, px.
#[inline(always)]
pub fn fade_weight(before: f32) -> f32 {
    let share = before / FADE_PX as f32 + 0.5;
    let share = if share > 0.0 { share } else { 0.0 };
    if share < 1.0 { share } else { 1.0 }
}
