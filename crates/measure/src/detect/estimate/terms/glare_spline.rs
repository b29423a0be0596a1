//! Light that the skin reflects over a disc, as a spline along it, and its first estimate from skin and black alone.

use crate::detect::appearance::parameters::{
    BLUR, DARK, EDGE_END_BLURS, GAMMA, MarkerParameters, light_at,
};
use crate::detect::estimate::options::TERM;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::Pixels;
use crate::detect::simd::batch::Batch;

/// Reflected light relative to the skin's own: a cubic spline.
pub struct GlareSpline {
    /// Position of the first knot along the disc, px.
    pub first: f64,
    /// Shift of the glare along the disc for each px across.
    pub slant: f64,
    /// Reflected light at the knots, relative to the skin's own.
    pub knots: Vec<f64>,
}

impl GlareSpline {
    /// Largest slant, to which the knots reach.
    const MAX_SLANT: f64 = TERM.slants as f64 * TERM.slant_step;

    /// Creates a spline without glare for a disc of this outline.
    fn new(ellipse: &Ellipse) -> Self {
        let reach = TERM.reach.at(ellipse.major) + Self::MAX_SLANT * ellipse.minor;
        let count = (2.0 * reach / TERM.knot_px).ceil() as usize + 3;
        Self {
            first: -reach,
            slant: 0.0,
            knots: vec![0.0; count],
        }
    }

    /// Returns true if the knots reach as far as the slant takes the pixels.
    pub fn covers_slant(&self) -> bool {
        self.slant.abs() <= Self::MAX_SLANT
    }

    /// Returns the position of a point along and across the disc, px, in units of the knot spacing.
    pub fn knot_position(&self, s: f64, t: f64) -> f64 {
        /// Margin before the last knot within which a position still lies between two knots.
        const BEFORE: f64 = 1e-6;
        ((s - self.slant * t - self.first) / TERM.knot_px)
            .clamp(0.0, (self.knots.len() - 3) as f64 - BEFORE)
    }
}

/// Returns the position of a pixel of a batch along and across the outline, px.
pub fn outline_position(batch: &Batch, i: usize, ellipse: &Ellipse) -> (f64, f64) {
    (
        f64::from(batch.p[i]) * ellipse.major,
        f64::from(batch.q[i]) * ellipse.minor,
    )
}

/// Estimates the knots of the glare, and its slant if that is not known yet, from skin and black alone.
pub fn estimate_glare(
    pixels: &Pixels,
    ellipse: &Ellipse,
    m: &MarkerParameters,
    slant: Option<f64>,
) -> GlareSpline {
    let mut signs: Vec<[f64; 3]> = Vec::new();
    for batch in &pixels.batches {
        for i in 0..batch.len {
            let (s, t) = outline_position(batch, i, ellipse);
            let (p, q) = (s / ellipse.major, t / ellipse.minor);
            let r = p.hypot(q).max(TINY);
            let slope = (p / ellipse.major).hypot(q / ellipse.minor).max(TINY);
            let distance = (r - 1.0) * r / slope;
            if distance.abs() > EDGE_END_BLURS * m[BLUR] {
                let own = if distance > 0.0 { 1.0 } else { 1.0 - m[DARK] };
                // A saturated pixel is lighter than its value, by an unknown amount.
                let value = f64::from(batch.value[i])
                    * if batch.value[i] < TERM.saturated {
                        1.0
                    } else {
                        TERM.saturated_factor
                    };
                let over = (value / light_at(m, p, q).max(1.0)).powf(1.0 / m[GAMMA]);
                signs.push([s, t, over - own]);
            }
        }
    }
    let mut glare = GlareSpline::new(ellipse);
    glare.slant = slant.unwrap_or_else(|| find_slant(&signs, &glare));
    // The second of the four knots around a position is the one at that position.
    let mut sums = vec![GlareSum::default(); glare.knots.len()];
    for [s, t, g] in &signs {
        let at = (s - glare.slant * t - glare.first) / TERM.knot_px + 1.0;
        if let Some(sum) = sums.get_mut(at.round() as usize) {
            sum.add(*g);
        }
    }
    let known: Vec<Option<f64>> = sums.iter().map(GlareSum::mean).collect();
    for k in 0..known.len() {
        let before = known[..=k].iter().rev().find_map(|v| *v);
        let after = known[k..].iter().find_map(|v| *v);
        glare.knots[k] = before.into_iter().chain(after).fold(0.0, f64::max).max(0.0);
    }
    glare
}

/// Finds the slant along which the estimates of the glare, given with their positions along and across the disc, scatter
/// least.
fn find_slant(signs: &[[f64; 3]], glare: &GlareSpline) -> f64 {
    let bins = (glare.knots.len() as f64 * TERM.knot_px / TERM.bin_px) as usize + 1;
    // The sum of all squares is equal for all slants: the least scatter explains most of it.
    let explained = |slant: f64| {
        let mut sums = vec![GlareSum::default(); bins];
        for [s, t, g] in signs {
            let bin = (s - slant * t - glare.first) * (1.0 / TERM.bin_px);
            sums[(bin.max(0.0) as usize).min(bins - 1)].add(*g);
        }
        let of_bin = |sum: &GlareSum| sum.mean().map_or(0.0, |mean| sum.total * mean);
        sums.iter().map(of_bin).sum::<f64>()
    };
    let slants = (-TERM.slants..=TERM.slants).map(|k| f64::from(k) * TERM.slant_step);
    let tried = slants.map(|slant| (slant, explained(slant)));
    let best = tried.reduce(|best, one| if one.1 > best.1 { one } else { best });
    best.map_or(0.0, |(slant, _)| slant)
}

/// Sum of estimates of the glare.
#[derive(Clone, Default)]
struct GlareSum {
    count: f64,
    total: f64,
}

impl GlareSum {
    fn add(&mut self, glare: f64) {
        self.count += 1.0;
        self.total += glare;
    }

    fn mean(&self) -> Option<f64> {
        (self.count > 0.0).then(|| self.total / self.count)
    }
}

/// Returns true if enough of both ends is not saturated.
pub fn shows_ends(pixels: &Pixels) -> bool {
    let mut seen = [[0.0; 2]; 2];
    for batch in &pixels.batches {
        for i in (0..batch.len)
            .filter(|&i| batch.p[i].abs() > 1.0 - TERM.tip && batch.p[i].hypot(batch.q[i]) < 1.0)
        {
            let end = &mut seen[usize::from(batch.p[i] > 0.0)];
            end[0] += 1.0;
            end[1] += f64::from(batch.value[i] < TERM.saturated);
        }
    }
    seen.iter()
        .all(|[all, open]| *open >= TERM.ends * all.max(1.0))
}

/// Returns the weights of the four knots around a position at the fraction `f` between the second and the third, and the
/// derivatives of these weights.
#[inline(always)]
pub fn spline_weights(f: f32) -> ([f32; 4], [f32; 4]) {
    let (e, ff) = (1.0 - f, f * f);
    let shares = [
        e * e * e,
        (3.0 * f - 6.0) * ff + 4.0,
        ((3.0 - 3.0 * f) * f + 3.0) * f + 1.0,
        ff * f,
    ];
    let slopes = [-e * e, (3.0 * f - 4.0) * f, (2.0 - 3.0 * f) * f + 1.0, ff];
    (shares.map(|v| v / 6.0), slopes.map(|v| 0.5 * v))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_are_smooth() {
        for k in 0..=20 {
            let f = k as f32 / 20.0;
            let (shares, slopes) = spline_weights(f);
            assert!(
                (shares.iter().sum::<f32>() - 1.0).abs() < 1e-6
                    && slopes.iter().sum::<f32>().abs() < 1e-6
            );
            let (low, high) = (spline_weights(f - 5e-3).0, spline_weights(f + 5e-3).0);
            for ((slope, low), high) in slopes.iter().zip(low).zip(high) {
                assert!((slope - (high - low) / 1e-2).abs() < 1e-3, "at {f}");
            }
        }
        // The end of one interval is the beginning of the next.
        let (end, begin) = (spline_weights(1.0).0, spline_weights(0.0).0);
        assert!((0..3).all(|i| (end[i + 1] - begin[i]).abs() < 1e-6) && end[0].abs() < 1e-6);
    }
}
