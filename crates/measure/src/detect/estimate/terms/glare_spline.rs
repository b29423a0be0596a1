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
    /// Creates a spline without glare for a disc of this outline.
    fn new(ellipse: &Ellipse) -> Self {
        let slant = f64::from(TERM.slants) * TERM.slant_step;
        let reach = TERM.reach.at(ellipse.major) + slant * ellipse.minor;
        let count = (2.0 * reach / TERM.knot_px).ceil() as usize + 3;
        Self {
            first: -reach,
            slant: 0.0,
            knots: vec![0.0; count],
        }
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

/// Returns index and position along and across the outline, px, of each pixel of a batch.
fn outline_positions<'a>(
    batch: &'a Batch,
    ellipse: &'a Ellipse,
) -> impl Iterator<Item = (usize, f64, f64)> + 'a {
    (0..batch.len).map(|i| {
        let (s, t) = outline_position(batch, i, ellipse);
        (i, s, t)
    })
}

/// Estimates the slant and the knots of the glare from skin and black alone.
pub fn estimate_glare(pixels: &Pixels, ellipse: &Ellipse, m: &MarkerParameters) -> GlareSpline {
    let mut signs: Vec<[f64; 3]> = Vec::new();
    for batch in &pixels.batches {
        for (i, s, t) in outline_positions(batch, ellipse) {
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
    let bins = (glare.knots.len() as f64 * TERM.knot_px / TERM.bin_px) as usize + 1;
    let scatter = |slant: f64| {
        let mut sums = vec![[0.0; 3]; bins];
        for [s, t, g] in &signs {
            let bin = ((s - slant * t - glare.first) / TERM.bin_px).max(0.0) as usize;
            if let Some(sum) = sums.get_mut(bin) {
                *sum = [sum[0] + 1.0, sum[1] + g, sum[2] + g * g];
            }
        }
        sums.iter()
            .filter(|s| s[0] > 0.0)
            .map(|s| s[2] - s[1] * s[1] / s[0])
            .sum::<f64>()
    };
    let slants = (-TERM.slants..=TERM.slants).map(|k| f64::from(k) * TERM.slant_step);
    glare.slant = slants
        .min_by(|a, b| scatter(*a).total_cmp(&scatter(*b)))
        .unwrap_or(0.0);
    // The second of the four knots around a position is the one at that position.
    let near = |k: usize| {
        let at = glare.first + (k as f64 - 1.0) * TERM.knot_px;
        let own = signs
            .iter()
            .filter(|[s, t, _]| (s - glare.slant * t - at).abs() < 0.5 * TERM.knot_px);
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
