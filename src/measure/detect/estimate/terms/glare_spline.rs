//! Light that the skin mirrors over a disc, as a spline along it, and what skin and black alone tell of it.

use crate::detect::appearance::parameters::{BLUR, DARK, GAMMA, MarkerParameters, light_at};
use crate::detect::estimate::options::TERM;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::Pixels;
use crate::detect::simd::batch::Batch;

/// Mirrored light over the skin's own: a cubic spline.
pub struct GlareSpline {
    /// Where the first knot lies along the disc, px.
    pub first: f64,
    /// By how much the band is farther along for each px across.
    pub slant: f64,
    /// The knots' light over the skin's own.
    pub knots: Vec<f64>,
}

impl GlareSpline {
    /// None yet on a disc of this outline.
    fn new(ellipse: &Ellipse) -> Self {
        let reach = TERM.reach.0 * ellipse.major + TERM.reach.1 * ellipse.minor + TERM.reach.2;
        let count = (2.0 * reach / TERM.knot_px).ceil() as usize + 3;
        Self { first: -reach, slant: 0.0, knots: vec![0.0; count] }
    }

    /// The place of a point along and across the disc, px, counted in knots.
    pub fn knot_position(&self, s: f64, t: f64) -> f64 {
        /// So far before the last knot a place still lies between two.
        const BEFORE: f64 = 1e-6;
        ((s - self.slant * t - self.first) / TERM.knot_px).clamp(0.0, (self.knots.len() - 3) as f64 - BEFORE)
    }
}

/// Where along and across the outline a pixel of a batch lies, px.
pub fn outline_position(batch: &Batch, i: usize, ellipse: &Ellipse) -> (f64, f64) {
    (f64::from(batch.p[i]) * ellipse.major, f64::from(batch.q[i]) * ellipse.minor)
}

/// The pixels of a batch, and where along and across the outline they lie, px.
fn outline_positions<'a>(batch: &'a Batch, ellipse: &'a Ellipse) -> impl Iterator<Item = (usize, f64, f64)> + 'a {
    (0..batch.len).map(|i| {
        let (s, t) = outline_position(batch, i, ellipse);
        (i, s, t)
    })
}

/// What skin and black alone tell of the glare: slant and knots.
pub fn estimate_glare(pixels: &Pixels, ellipse: &Ellipse, m: &MarkerParameters) -> GlareSpline {
    let mut signs: Vec<[f64; 3]> = Vec::new();
    for batch in &pixels.batches {
        for (i, s, t) in outline_positions(batch, ellipse) {
            let (p, q) = (s / ellipse.major, t / ellipse.minor);
            let r = p.hypot(q).max(TINY);
            let slope = (p / ellipse.major).hypot(q / ellipse.minor).max(TINY);
            let distance = (r - 1.0) * r / slope;
            if distance.abs() > TERM.clear_blurs * m[BLUR] {
                let own = if distance > 0.0 { 1.0 } else { 1.0 - m[DARK] };
                // What is saturated is lighter than it looks, by how much is not known.
                let value =
                    f64::from(batch.value[i]) * if batch.value[i] < TERM.saturated { 1.0 } else { TERM.saturated_factor };
                let over = (value / light_at(m, p, q).max(1.0)).powf(1.0 / m[GAMMA]);
                signs.push([s, t, over - own]);
            }
        }
    }
    let mut glare = GlareSpline::new(ellipse);
    let bins = (glare.knots.len() as f64 * TERM.knot_px / TERM.bin_px) as usize + 1;
    let scatter = |slant: f64| {
        let mut sums = vec![[0.0; 3]; bins];
        for [s, t, g] in &signs {
            let bin = ((s - slant * t - glare.first) / TERM.bin_px).max(0.0) as usize;
            if let Some(sum) = sums.get_mut(bin) {
                *sum = [sum[0] + 1.0, sum[1] + g, sum[2] + g * g];
            }
        }
        sums.iter().filter(|s| s[0] > 0.0).map(|s| s[2] - s[1] * s[1] / s[0]).sum::<f64>()
    };
    let slants = (-TERM.slants..=TERM.slants).map(|k| f64::from(k) * TERM.slant_step);
    glare.slant = slants.min_by(|a, b| scatter(*a).total_cmp(&scatter(*b))).unwrap_or(0.0);
    // The second of the four knots about a place is the one that lies there.
    let near = |k: usize| {
        let at = glare.first + (k as f64 - 1.0) * TERM.knot_px;
        let own = signs.iter().filter(|[s, t, _]| (s - glare.slant * t - at).abs() < 0.5 * TERM.knot_px);
        let (sum, count) = own.fold((0.0, 0.0), |(sum, count), [_, _, g]| (sum + g, count + 1.0));
        (count > 0.0).then_some(sum / count)
    };
    let known: Vec<Option<f64>> = (0..glare.knots.len()).map(near).collect();
    for k in 0..known.len() {
        let before = known[..=k].iter().rev().find_map(|v| *v);
        let after = known[k..].iter().find_map(|v| *v);
        glare.knots[k] = before.into_iter().chain(after).fold(0.0, f64::max).max(0.0);
    }
    glare
}

/// Whether enough of both ends is not saturated.
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
    seen.iter().all(|[all, open]| *open >= TERM.ends * all.max(1.0))
}

/// The shares of the four knots about a place that is so far between the second and the third; and their derivatives.
#[inline(always)]
pub fn spline_weights(f: f32) -> ([f32; 4], [f32; 4]) {
    let (e, ff) = (1.0 - f, f * f);
    let shares = [e * e * e, (3.0 * f - 6.0) * ff + 4.0, ((3.0 - 3.0 * f) * f + 3.0) * f + 1.0, ff * f];
    let slopes = [-e * e, (3.0 * f - 4.0) * f, (2.0 - 3.0 * f) * f + 1.0, ff];
    (shares.map(|v| v / 6.0), slopes.map(|v| 0.5 * v))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shares_are_a_smooth_whole() {
        for k in 0..=20 {
            let f = k as f32 / 20.0;
            let (shares, slopes) = spline_weights(f);
            assert!(
                (shares.iter().sum::<f32>() - 1.0).abs() < 1e-6 && slopes.iter().sum::<f32>().abs() < 1e-6
            );
            let (low, high) = (spline_weights(f - 5e-3).0, spline_weights(f + 5e-3).0);
            for ((slope, low), high) in slopes.iter().zip(low).zip(high) {
                assert!((slope - (high - low) / 1e-2).abs() < 1e-3, "at {f}");
            }
        }
        // One interval's end is the next one's beginning.
        let (end, begin) = (spline_weights(1.0).0, spline_weights(0.0).0);
        assert!((0..3).all(|i| (end[i + 1] - begin[i]).abs() < 1e-6) && end[0].abs() < 1e-6);
    }
}
