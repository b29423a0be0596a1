//! Bands about an edge in which pixels count.

/// Width over which a weight falls to zero, px.
pub const FADE: f64 = 1.0;
/// Blurs below which a disc is thin.
const THIN: f64 = 4.0;

/// Bands about an edge, px: where its blur reaches, and flat ground beside it.
#[derive(Clone, Copy)]
pub struct Bands {
    pub edge: f32,
    pub flat: f32,
}

impl Bands {
    /// For an edge with this blur, px. Within 1.9 times the blur is all but a hundredth of what an edge
    /// tells of its place.
    pub fn of(blur: f64) -> Self {
        let blur = blur.clamp(0.5, 3.5) as f32;
        Self { edge: 1.4 * blur + 0.4, flat: 3.5 * blur + 2.0 }
    }

    /// For a disc of this thickness with this blur, px, that uses at least a share of the flat ground.
    pub fn of_disc(minor: f64, blur: f64, nearest: f64) -> Self {
        let Self { edge, flat } = Self::of(blur);
        Self { edge, flat: flat * (minor / (THIN * blur)).clamp(nearest, 1.0) as f32 }
    }

    /// The weight of a pixel at a distance from the edge.
    #[inline(always)]
    pub fn weight(self, keep: [f32; 2], distance: f32) -> f32 {
        let fade = |band: f32| {
            let share = (band - distance) / FADE as f32 + 0.5;
            let share = if share > 0.0 { share } else { 0.0 };
            if share < 1.0 { share } else { 1.0 }
        };
        let (edge, flat) = (keep[0] * fade(self.edge), keep[1] * fade(self.flat));
        if edge > flat { edge } else { flat }
    }
}
