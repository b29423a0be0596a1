//! Image model: grey values of a blurred marker, with derivatives.
//!
//! `I = L (1 - k c)^g`: `L` is the grey value of the white or the skin (a plane, with a quadratic term along the marker),
//! `k` the marker's darkness (a plane), `c` in 0..1 the blurred fraction of black; `g` is the exponent of the tone curve,
//! because blur acts on light and not on grey values. Both shapes give `c` in their own frame: `s` along the main
//! direction, `t` across it.

use super::crossing::wedge_fraction;
use super::disc::disc_fraction;
use super::parameters::{
    ANGLE, BLUR, BlackFraction, COMMON, DARK, GAMMA, GreyBatch, LIGHT, MarkerParameters,
    MarkerPattern, N, SHAPE, TAPER, WHITEST, X, Y,
};
use crate::detect::simd::batch::Batch;
use crate::detect::simd::functions::{exp, ln};
use crate::detect::simd::lanes::{LANES, Lanes, each};

/// Smallest light relative to white, for which the logarithm is taken: 4 % of its grey value under the default tone curve.
const DARKEST: f32 = 1e-3;

/// Image of a marker with given parameters, for batches of one origin.
pub struct MarkerModel {
    pub pattern: MarkerPattern,
    m: MarkerParameters,
    /// Parameters in single precision.
    pub k: [f32; N],
    /// Centre from the batches' origin, px.
    centre: [f32; 2],
    trig: [f32; 2],
}

/// Light and its value through the tone curve.
pub struct Tone {
    /// Light, above zero; `log` is its natural logarithm.
    pub linear: f32,
    pub log: f32,
    /// Light raised to the exponent of the tone curve.
    pub through: f32,
}

impl MarkerModel {
    /// Creates the model for batches whose coordinates count from an origin, px.
    #[inline(always)]
    pub fn new(pattern: MarkerPattern, m: &MarkerParameters, origin: [f64; 2]) -> Self {
        let (sin, cos) = m[ANGLE].sin_cos();
        Self {
            pattern,
            m: *m,
            k: m.map(|v| v as f32),
            centre: [(m[X] - origin[0]) as f32, (m[Y] - origin[1]) as f32],
            trig: [sin as f32, cos as f32],
        }
    }

    /// Returns the coordinates of a batch along s and across it, from the centre, px.
    #[inline(always)]
    pub fn along_and_across(&self, batch: &Batch) -> (Lanes, Lanes) {
        let ([cx, cy], [sin, cos]) = (self.centre, self.trig);
        let s = each(|i| (batch.x[i] - cx) * cos + (batch.y[i] - cy) * sin);
        let t = each(|i| (batch.y[i] - cy) * cos - (batch.x[i] - cx) * sin);
        (s, t)
    }

    /// Computes the blurred fraction of black of either shape.
    #[inline(always)]
    pub fn black_fraction(&self, s: &Lanes, t: &Lanes) -> BlackFraction {
        let mut fraction = match self.pattern {
            MarkerPattern::Disc => disc_fraction(s, t, &self.m),
            _ => wedge_fraction(s, t, &self.m),
        };
        if self.pattern == MarkerPattern::WhiteAlong {
            fraction.complement();
        }
        fraction
    }

    /// Returns the light `L` at a position in semi-axes, grey levels.
    #[inline(always)]
    pub fn light_value(&self, [p, q]: [f32; 2]) -> f32 {
        let k = &self.k;
        k[LIGHT] + k[LIGHT + 1] * p + k[LIGHT + 2] * q + k[LIGHT + 3] * p * p
    }

    /// Returns the darkness `k` at a position in semi-axes.
    #[inline(always)]
    pub fn darkness(&self, [p, q]: [f32; 2]) -> f32 {
        let k = &self.k;
        k[DARK] + k[DARK + 1] * p + k[DARK + 2] * q
    }

    /// Applies the tone curve to light.
    #[inline(always)]
    pub fn apply_tone_curve(&self, linear: f32) -> Tone {
        let linear = if linear > DARKEST { linear } else { DARKEST };
        let log = ln(linear);
        Tone {
            linear,
            log,
            through: exp(self.k[GAMMA] * log),
        }
    }

    /// Returns the derivatives with respect to the centre's u and v and the direction, from those along and across and the
    /// position along and across, px.
    #[inline(always)]
    pub fn position_derivatives(&self, [by_s, by_t]: [f32; 2], [s, t]: [f32; 2]) -> [f32; 3] {
        let [sin, cos] = self.trig;
        [
            by_t * sin - by_s * cos,
            -(by_s * sin + by_t * cos),
            by_s * t - by_t * s,
        ]
    }
}

/// Computes the grey values of a batch and their derivatives; clipped, with zero derivatives, at 255.
#[inline(always)]
pub fn grey_values(model: &MarkerModel, batch: &Batch, out: &mut GreyBatch) {
    let (s, t) = model.along_and_across(batch);
    let fraction = model.black_fraction(&s, &t);
    let mut slopes = GreyDerivatives::default();
    for i in 0..LANES {
        let (at, c) = ([batch.p[i], batch.q[i]], fraction.c[i]);
        let dark = model.darkness(at);
        let Tone {
            linear,
            log,
            through,
        } = model.apply_tone_curve(1.0 - dark * c);
        let value = model.light_value(at) * through;
        let clipped = value >= WHITEST;
        let (value, through) = if clipped {
            (WHITEST, 0.0)
        } else {
            (value, through)
        };
        let open = if clipped { 0.0 } else { 1.0 };
        let slope = open * model.k[GAMMA] * value / linear;
        out.value[i] = value;
        (slopes.black_fraction[i], slopes.dark[i]) = (-slope * dark, -slope * c);
        (slopes.light[i], slopes.gamma[i]) = (through, open * value * log);
    }
    slopes.write_gradient(model, &fraction, [&s, &t], batch, &mut out.gradient);
}

/// Derivatives of a batch's grey values with respect to fraction of black, darkness, light and exponent.
#[derive(Default)]
pub struct GreyDerivatives {
    pub black_fraction: Lanes,
    pub dark: Lanes,
    pub light: Lanes,
    pub gamma: Lanes,
}

impl GreyDerivatives {
    /// Writes the derivatives with respect to the parameters, from those of the fraction and the pixels' positions along
    /// and across the marker, px.
    #[inline(always)]
    pub fn write_gradient(
        &self,
        model: &MarkerModel,
        fraction: &BlackFraction,
        [s, t]: [&Lanes; 2],
        batch: &Batch,
        gradient: &mut [Lanes; COMMON],
    ) {
        // One slot at a time, because a loop that writes all of them is not always vectorised.
        let moved =
            |i: usize| model.position_derivatives([fraction.s[i], fraction.t[i]], [s[i], t[i]]);
        gradient[X] = each(|i| self.black_fraction[i] * moved(i)[0]);
        gradient[Y] = each(|i| self.black_fraction[i] * moved(i)[1]);
        gradient[ANGLE] = each(|i| self.black_fraction[i] * moved(i)[2]);
        gradient[SHAPE] = each(|i| self.black_fraction[i] * fraction.first[i]);
        gradient[SHAPE + 1] = each(|i| self.black_fraction[i] * fraction.second[i]);
        gradient[SHAPE + 2] = each(|i| self.black_fraction[i] * fraction.third[i]);
        gradient[BLUR] = each(|i| self.black_fraction[i] * fraction.blur[i]);
        self.write_light_gradient(batch, gradient);
        gradient[TAPER] = each(|i| self.black_fraction[i] * fraction.taper[i]);
    }

    /// Writes the derivatives with respect to light, darkness and exponent.
    #[inline(always)]
    pub fn write_light_gradient(&self, Batch { p, q, .. }: &Batch, gradient: &mut [Lanes; COMMON]) {
        gradient[LIGHT] = self.light;
        gradient[LIGHT + 1] = each(|i| self.light[i] * p[i]);
        gradient[LIGHT + 2] = each(|i| self.light[i] * q[i]);
        gradient[LIGHT + 3] = each(|i| self.light[i] * p[i] * p[i]);
        gradient[DARK] = self.dark;
        gradient[DARK + 1] = each(|i| self.dark[i] * p[i]);
        gradient[DARK + 2] = each(|i| self.dark[i] * q[i]);
        gradient[GAMMA] = self.gamma;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::appearance::parameters::{BEND, MAJOR, MINOR, SAG, TANGENT};

    /// Column and row of a pixel.
    type Place = [f64; 2];

    /// Completes shapes to marker parameters with the same grey levels.
    fn lit<const COUNT: usize>(shapes: [[f64; 7]; COUNT]) -> Vec<MarkerParameters> {
        let light = [180.0, 6.0, -3.0, 2.0, 0.7, 0.05, -0.02, 0.5, 0.02];
        let all =
            |s: [f64; 7]| std::array::from_fn(|i| *s.iter().chain(&light).nth(i).unwrap_or(&0.0));
        shapes.map(all).to_vec()
    }

    fn discs() -> Vec<MarkerParameters> {
        lit([
            [20.3, 19.8, 0.3, 30.0, 15.0, 0.0, 0.8],
            [20.3, 19.8, -0.4, 30.0, 4.0, 0.4, 0.8],
            [20.3, 19.8, 1.2, 20.0, 1.2, 0.0, 0.9],
            [20.3, 19.8, 0.1, 6.0, 5.0, 0.0, 1.6],
        ])
    }

    fn quadrants() -> Vec<MarkerParameters> {
        lit([
            [20.3, 19.8, 0.3, 0.9, 0.0, 0.0, 0.8],
            [20.3, 19.8, -0.4, 0.1, 4e-4, 2e-4, 0.8],
            [20.3, 19.8, 1.2, 0.4, -1e-3, 0.0, 1.5],
        ])
    }

    /// Returns value and derivatives at one pixel.
    fn one(pattern: MarkerPattern, m: &MarkerParameters, [x, y]: Place) -> (f64, MarkerParameters) {
        let mut batch = Batch::new();
        batch.push((x - 20.0) as f32, (y - 20.0) as f32, 0.0);
        (batch.p[0], batch.q[0]) = (((x - 20.0) / 30.0) as f32, ((y - 20.0) / 10.0) as f32);
        batch.fill_lanes();
        let mut out = GreyBatch::new();
        grey_values(
            &MarkerModel::new(pattern, m, [20.0, 20.0]),
            &batch,
            &mut out,
        );
        (
            f64::from(out.value[0]),
            std::array::from_fn(|k| f64::from(out.derivative(k)[0])),
        )
    }

    /// Computes the fraction of black by brute force: the sharp pattern, sampled finely, blurred.
    fn sampled(pattern: MarkerPattern, m: &MarkerParameters, [x, y]: Place) -> f64 {
        let (sin, cos) = m[ANGLE].sin_cos();
        let (mut sum, mut weights) = (0.0, 0.0);
        let n = 160;
        for i in -n..=n {
            for j in -n..=n {
                let (gx, gy) = (
                    f64::from(i) * 5.0 / f64::from(n),
                    f64::from(j) * 5.0 / f64::from(n),
                );
                let w = (-0.5 * (gx * gx + gy * gy)).exp();
                let (dx, dy) = (x + gx * m[BLUR] - m[X], y + gy * m[BLUR] - m[Y]);
                let (s, t) = (dx * cos + dy * sin, dy * cos - dx * sin);
                let inside = match pattern {
                    MarkerPattern::Disc => {
                        let t = t - m[SAG] * (s / m[MAJOR]).powi(2);
                        (s / m[MAJOR]).powi(2) + (t / m[MINOR]).powi(2) < 1.0
                    }
                    _ => {
                        let one = t - m[TANGENT] * s - m[BEND] * s * s;
                        let other = t + m[TANGENT] * s - m[BEND + 1] * s * s;
                        (one * other < 0.0) == (pattern == MarkerPattern::BlackAlong)
                    }
                };
                sum += if inside { w } else { 0.0 };
                weights += w;
            }
        }
        sum / weights
    }

    fn black(pattern: MarkerPattern, m: &MarkerParameters, at: Place) -> f64 {
        let mut flat = *m;
        flat[LIGHT..COMMON]
            .copy_from_slice(&[100.0, 0.0, 0.0, 0.0, 0.9, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        (1.0 - one(pattern, &flat, at).0 / 100.0) / 0.9
    }

    #[test]
    fn the_closed_forms_match_a_sampled_blur() {
        for (pattern, sets) in [
            (MarkerPattern::Disc, discs()),
            (MarkerPattern::BlackAlong, quadrants()),
            (MarkerPattern::WhiteAlong, quadrants()),
        ] {
            for m in sets {
                for i in 0..60 {
                    let at = [f64::from(i * 7 % 60) - 8.0, f64::from(i * 3 % 29) + 6.3];
                    let (got, want) = (black(pattern, &m, at), sampled(pattern, &m, at));
                    assert!(
                        (got - want).abs() < 6e-3,
                        "{pattern:?} {m:?} {at:?}: {got} against {want}"
                    );
                }
            }
        }
    }

    #[test]
    fn derivatives_match_differences() {
        for (pattern, sets) in [
            (MarkerPattern::Disc, discs()),
            (MarkerPattern::BlackAlong, quadrants()),
        ] {
            for m in sets {
                for i in 0..60 {
                    let at = [f64::from(i * 7 % 60) - 8.3, f64::from(i * 3 % 29) + 6.7];
                    let (_, gradient) = one(pattern, &m, at);
                    for k in 0..COMMON {
                        let step = if [BEND, BEND + 1].contains(&k) && m[k] < 0.1 {
                            1e-5
                        } else {
                            4e-3
                        };
                        let (mut low, mut high) = (m, m);
                        low[k] -= step;
                        high[k] += step;
                        let difference =
                            (one(pattern, &high, at).0 - one(pattern, &low, at).0) / (2.0 * step);
                        let scale = difference
                            .abs()
                            .max(if step < 1e-4 { 2000.0 } else { 10.0 });
                        assert!(
                            (gradient[k] - difference).abs() < 0.06 * scale,
                            "{pattern:?} {m:?} {at:?} parameter {k}: {} against {difference}",
                            gradient[k]
                        );
                    }
                }
            }
        }
    }
}
