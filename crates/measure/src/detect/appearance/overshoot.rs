//! Overshoot: the effect of sharpening on a marker's image.
//!
//! Cameras, above all in phones, add to an image its difference from a blurred copy of itself: `I + a (I - G_w * I)`, with
//! an amplitude `a` and the copy's blur `w`. An edge with a blur `b` has the blur `sqrt(b^2 + w^2)` in the copy, so both
//! come from one image formula `M`, of discs and of quadrants:
//!
//! `I = (1 + a) M(b) - a M(sqrt(b^2 + w^2))`
//!
//! This is exact except for the tone curve, through which the copy is taken; the error is below 10 % of the overshoot.
//!
//! Rule of thumb: it matters from `a = 0.15` on, which is 2 % of the contrast at an edge. Unknowns: the amplitude, with a
//! prior from the frame's markers. It is estimated if the frame's residuals show it
//! ([`super::super::estimate::overshoot`]). Tested by `tests/detect/sharpened.rs`. The halo is the best of three values,
//! and fixed.

use super::formula::{self, MarkerModel};
use super::parameters::{BLUR, GreyBatch, HALO, MarkerParameters, OVERSHOOT, WHITEST};
use super::quadrants;
use crate::detect::simd::batch::Batch;
use crate::detect::simd::lanes::{LANES, Lanes};
use crate::dispatch::wide;

/// Image of a marker and its image in the blurred copy.
pub struct SharpenedModel {
    own: MarkerModel,
    copy: MarkerModel,
    /// Derivative of the copy's blur with respect to the marker's.
    by_blur: f32,
}

/// Returns whether the image was sharpened.
pub fn is_sharpened(m: &MarkerParameters) -> bool {
    m[HALO] > 0.0
}

impl SharpenedModel {
    /// Creates the model for batches whose coordinates count from an origin, px.
    pub fn new(own: MarkerModel, m: &MarkerParameters, origin: [f64; 2]) -> Self {
        let blur = m[BLUR].hypot(m[HALO]);
        let mut blurred = *m;
        blurred[BLUR] = blur;
        let copy = MarkerModel::new(own.pattern, &blurred, origin);
        Self {
            own,
            copy,
            by_blur: (m[BLUR] / blur) as f32,
        }
    }
}

wide! {
    /// Computes the grey values of a batch and their derivatives; clipped, with zero derivatives, at 0 and 255.
    pub fn sharpened_grey_values(
        model: &SharpenedModel,
        batch: &Batch,
        out: &mut GreyBatch,
        copy: &mut GreyBatch,
    ) = sharpened_grey_generic
}

#[inline(always)]
fn sharpened_grey_generic(
    model: &SharpenedModel,
    batch: &Batch,
    out: &mut GreyBatch,
    copy: &mut GreyBatch,
) {
    formula::grey_values(&model.own, batch, out);
    formula::grey_values(&model.copy, batch, copy);
    apply_overshoot(model, out, copy);
}

/// Computes the sharpened grey values of narrow quadrants, by edges and outline together.
pub fn sharpened_outlined_grey_values(
    model: &SharpenedModel,
    batch: &Batch,
    out: &mut GreyBatch,
    copy: &mut GreyBatch,
) {
    quadrants::outlined_grey_values(&model.own, batch, out);
    quadrants::outlined_grey_values(&model.copy, batch, copy);
    apply_overshoot(model, out, copy);
}

/// Applies the overshoot, given the image before sharpening and the blurred copy.
#[inline(always)]
fn apply_overshoot(model: &SharpenedModel, out: &mut GreyBatch, copy: &GreyBatch) {
    let a = model.own.k[OVERSHOOT];
    let mut open = Lanes::splat(1.0);
    let mut apart = Lanes::splat(0.0);
    for i in 0..LANES {
        apart[i] = out.value[i] - copy.value[i];
        let value = out.value[i] + a * apart[i];
        open[i] = if value > 0.0 && value < WHITEST {
            1.0
        } else {
            0.0
        };
        let value = if value > 0.0 { value } else { 0.0 };
        out.value[i] = if value < WHITEST { value } else { WHITEST };
    }
    let mix = |own: &mut Lanes, of_copy: &Lanes, by: f32| {
        for i in 0..LANES {
            own[i] = open[i] * (own[i] + a * (own[i] - by * of_copy[i]));
        }
    };
    for k in 0..OVERSHOOT {
        mix(
            &mut out.gradient[k],
            &copy.gradient[k],
            if k == BLUR { model.by_blur } else { 1.0 },
        );
    }
    if let (Some(own), Some(of_copy)) = (&mut out.outline_gradient, &copy.outline_gradient) {
        own.iter_mut()
            .zip(of_copy.iter())
            .for_each(|(own, of_copy)| mix(own, of_copy, 1.0));
    }
    for i in 0..LANES {
        out.gradient[OVERSHOOT][i] = open[i] * apart[i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::appearance::parameters::{COMMON, MarkerPattern, N};

    fn disc() -> MarkerParameters {
        let known = [
            20.3, 19.8, -0.4, 30.0, 4.0, 0.4, 0.9, 150.0, 6.0, -3.0, 2.0, 0.6, 0.05, -0.02, 0.5,
            0.02, 1.2, 1.4,
        ];
        std::array::from_fn(|k| known.get(k).copied().unwrap_or(0.0))
    }

    fn quadrants() -> MarkerParameters {
        let mut m = disc();
        (m[3], m[4], m[5], m[15]) = (0.4, 1e-3, -1e-3, 0.03);
        let outline = [30.0, 8.0, 0.1, 0.3, -0.2, 0.5, 0.05, -0.04];
        m[COMMON..].copy_from_slice(&outline);
        m
    }

    fn one(
        pattern: MarkerPattern,
        outlined: bool,
        m: &MarkerParameters,
        [x, y]: [f64; 2],
    ) -> (f64, MarkerParameters) {
        let mut batch = Batch::new();
        batch.push((x - 20.0) as f32, (y - 20.0) as f32, 0.0);
        (batch.p[0], batch.q[0]) = (((x - 20.0) / 30.0) as f32, ((y - 20.0) / 10.0) as f32);
        batch.fill_lanes();
        let model = SharpenedModel::new(MarkerModel::new(pattern, m, [20.0; 2]), m, [20.0; 2]);
        let (mut out, mut copy) = (GreyBatch::new(), GreyBatch::new());
        let grey = if outlined {
            sharpened_outlined_grey_values
        } else {
            sharpened_grey_values
        };
        grey(&model, &batch, &mut out, &mut copy);
        (
            f64::from(out.value[0]),
            std::array::from_fn(|k| f64::from(out.derivative(k)[0])),
        )
    }

    #[test]
    fn derivatives_match_differences() {
        let all = [
            (MarkerPattern::Disc, false, disc()),
            (MarkerPattern::BlackAlong, false, quadrants()),
            (MarkerPattern::WhiteAlong, true, quadrants()),
        ];
        for (pattern, outlined, m) in all {
            for k in [0, 1, 2, BLUR, 7, 11, 14, OVERSHOOT] {
                let (mut own, mut off) = (0.0, 0.0);
                for i in 0..60 {
                    let at = [f64::from(i * 7 % 60) - 8.3, f64::from(i * 3 % 29) + 6.7];
                    let gradient = one(pattern, outlined, &m, at).1[k];
                    let (mut low, mut high) = (m, m);
                    low[k] -= 4e-3;
                    high[k] += 4e-3;
                    let [low, high] = [low, high].map(|m| one(pattern, outlined, &m, at).0);
                    own += gradient.powi(2);
                    off += (gradient - (high - low) / 8e-3).powi(2);
                }
                // 10 %, as for the formula without overshoot (tips, and edges that meet the outline between two
                // chords); the errors of (1 + a) times one blur and of a times another add up.
                let rough: f64 = 0.1 * (1.0 + 2.0 * m[OVERSHOOT]);
                assert!(
                    own > 0.0 && off < rough.powi(2) * own,
                    "{pattern:?} {k}: {off} of {own}"
                );
            }
        }
    }

    #[test]
    fn an_edge_overshoots_on_both_sides() {
        // Across the middle of the disc, through skin, halo, black.
        let mut m = disc();
        (m[2], m[5], m[8], m[9], m[10], m[12], m[13], m[15]) =
            (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let at =
            |m: &MarkerParameters, t: f64| one(MarkerPattern::Disc, false, m, [m[0], m[1] + t]).0;
        let mut plain = m;
        plain[OVERSHOOT] = 0.0;
        let [skin, black] = [12.0, 0.0].map(|t| at(&plain, t));
        let brightest = (40..90)
            .map(|k| at(&m, 0.1 * f64::from(k)))
            .fold(0.0, f64::max);
        let contrast = skin - black;
        assert!(
            (0.08..0.35).contains(&((brightest - skin) / contrast)),
            "{brightest} of {skin} and {black}"
        );
        assert!((at(&m, 12.0) - skin).abs() < 0.01 * contrast);
        assert_eq!(N, COMMON + 8);
    }
}
