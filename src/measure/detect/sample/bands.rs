//! Bands about an edge in which pixels count.

/// Width over which a weight falls to zero, px.
pub const FADE: f64 = 1.0;
/// Blurs below which a disc is thin.
const THIN: f64 = 4.0;
/// Blurs, px, by which bands are as wide: a sharp picture's at least, and little more than the greatest that is measured.
const BLUR: (f64, f64) = (0.5, 3.5);
/// Where a blurred edge still tells its place, blurs and px. Within 1.9 times the blur is all but a hundredth of what it tells.
const EDGE: (f32, f32) = (1.4, 0.4);
/// Where flat ground ends that tells the levels, blurs and px. Chosen; `tests/detect/fixtures.rs`.
const FLAT: (f32, f32) = (3.5, 2.0);

/// A blur, px, within what bands are made for.
pub fn blur_within(blur: f64) -> f64 {
    blur.clamp(BLUR.0, BLUR.1)
}

/// Bands about an edge, px: where its blur reaches, and flat ground beside it.
#[derive(Clone, Copy)]
pub struct Bands {
    pub edge: f32,
    pub flat: f32,
}

impl Bands {
    /// For an edge with this blur, px.
    pub fn of(blur: f64) -> Self {
        let blur = blur_within(blur) as f32;
        Self { edge: EDGE.0 * blur + EDGE.1, flat: FLAT.0 * blur + FLAT.1 }
    }

    /// For a disc of this thickness with this blur, px, that uses at least a share of the flat ground.
    pub fn of_disc(minor: f64, blur: f64, nearest: f64) -> Self {
        let Self { edge, flat } = Self::of(blur);
        Self { edge, flat: flat * (minor / (THIN * blur)).clamp(nearest, 1.0) as f32 }
    }

    /// The weight of a pixel at a distance from the edge.
    #[inline(always)]
    pub fn weight(self, keep: [f32; 2], distance: f32) -> f32 {
        let (edge, flat) = (keep[0] * fade(self.edge - distance), keep[1] * fade(self.flat - distance));
        if edge > flat { edge } else { flat }
    }
}

/// What is left of a weight so far before the middle of where it falls, px.
#[inline(always)]
pub fn fade(before: f32) -> f32 {
    let share = before / FADE as f32 + 0.5;
    let share = if share > 0.0 { share } else { 0.0 };
    if share < 1.0 { share } else { 1.0 }
}
