//! Image model of narrow quadrants: edges and outline together.
//!
//! `I = L (e - k c + (1 - e) u)^g`: as for wide quadrants ([`super::formula`]), but only the fraction `e` of the light,
//! that of a blurred ellipse, comes from the marker, and black ends with it; the rest is skin, whose light is `u` (a plane)
//! times that of the white. Both fractions are summed over chords across the edges' bisector, whose ends are outline and
//! edges: exact except for the step from chord to chord, a fraction of the blur.
//!
//! Rule of thumb: it matters if the semi-minor axis of quadrants is less than 7.5 blurs, because blur then mixes edges and
//! outline. Unknowns: eight in addition to those of the formula, five of the outline and three of the skin's light. Tested
//! by `tests/detect/sweep.rs` (narrow quadrants under strong blur, against the Cramer-Rao bound) and by the tests of this
//! file.

use super::formula::{GreyDerivatives, MarkerModel, Tone};
use super::parameters::{
    ANGLE, BEND, BLUR, CHORD, COMMON, GAMMA, GreyBatch, LENGTH, MarkerPattern, N, OFFSET,
    OutlineGradient, SHEAR, SKIN, TANGENT, WHITEST, X, Y,
};
use crate::detect::simd::batch::Batch;
use crate::detect::simd::functions::{PEAK, asin, exp, normal_distributions};
use crate::detect::simd::lanes::{LANES, Lanes, each};
use crate::dispatch::wide;

/// Number of chords around a pixel. With the step they reach 3.9 blurs to both sides, beyond which 0.01 % is left.
const CHORDS: i32 = 12;
/// Step between chords, blurs. Accurate to 0.3 grey levels compared with a sampled blur, as tested in this file.
const STEP: f32 = 0.65;

/// Fraction of the blurred marker, and its derivatives.
#[derive(Default)]
struct BlurredFraction {
    c: Lanes,
    s: Lanes,
    t: Lanes,
    blur: Lanes,
    ellipse: [Lanes; 5],
    bend: Lanes,
}

/// Fractions between the edges and within the outline, at positions along and across the edges' bisector.
#[derive(Default)]
struct ChordSums {
    between: BlurredFraction,
    edges: [Lanes; 3],
    own: BlurredFraction,
}

/// Contribution of a chord to a fraction; `low` and `high` are its derivatives with respect to both ends.
#[derive(Default)]
struct ChordSegment {
    c: Lanes,
    t: Lanes,
    blur: Lanes,
    low: Lanes,
    high: Lanes,
}

/// Chord of the outline: position and weight, distance `z` from the pixel along in blurs, position along from the outline's
/// centre, px; and the derivatives of half its length with respect to position, the outline's length and the chord at the
/// centre.
struct Chord {
    at: Lanes,
    weight: Lanes,
    z: Lanes,
    along: Lanes,
    by_along: Lanes,
    by_length: Lanes,
    by_chord: Lanes,
}

impl Chord {
    /// Computes the chords at positions along.
    #[inline(always)]
    fn new(at: Lanes, s: &Lanes, k: &[f32; N]) -> Self {
        let by_sigma = 1.0 / k[BLUR];
        let step = STEP * k[BLUR];
        let by_step = 1.0 / step;
        let by_length = 1.0 / k[LENGTH];
        // Reciprocal of the step as a fraction of the length.
        let by_width = k[LENGTH] * by_step;
        let z = each(|i| (s[i] - at[i]) * by_sigma);
        let weight = each(|i| STEP * PEAK * exp(-0.5 * z[i] * z[i]));
        let along = each(|i| at[i] - k[OFFSET]);
        let fraction = each(|i| along[i] * by_length);
        // Mean over a step, so that a chord that ends within it vanishes gradually.
        let [before, behind] = [-0.5, 0.5].map(|by| by * step * by_length).map(|by| {
            let at = each(|i| clamp_to_unit(fraction[i] + by));
            (at, each(|i| half_chord(at[i])))
        });
        let half = each(|i| {
            let ends = behind.0[i] * behind.1[i] - before.0[i] * before.1[i] + asin(behind.0[i])
                - asin(before.0[i]);
            0.5 * ends * by_width
        });
        let steep = each(|i| (before.1[i] - behind.1[i]) * by_width * by_length * k[CHORD]);
        let wider = each(|i| k[CHORD] * by_length * (half[i] - 0.5 * (before.1[i] + behind.1[i])));
        let by_along = steep;
        let by_length = each(|i| steep[i] * fraction[i] + wider[i]);
        Self {
            at,
            weight,
            z,
            along,
            by_along,
            by_length,
            by_chord: half,
        }
    }
}

/// Adds a number to each lane.
#[inline(always)]
fn add_to_lanes(to: &mut Lanes, value: impl Fn(usize) -> f32) {
    *to = each(|i| to[i] + value(i));
}

impl BlurredFraction {
    /// Adds the contribution of a chord.
    #[inline(always)]
    fn add_chord(&mut self, part: &ChordSegment, chord: &Chord, k: &[f32; N]) {
        let (by_sigma, shear) = (1.0 / k[BLUR], k[SHEAR]);
        let Chord { weight: w, z, .. } = chord;
        let both = each(|i| w[i] * (part.low[i] + part.high[i]));
        let apart = each(|i| w[i] * (part.high[i] - part.low[i]));
        let c = each(|i| w[i] * part.c[i]);
        add_to_lanes(&mut self.c, |i| c[i]);
        add_to_lanes(&mut self.s, |i| -z[i] * by_sigma * c[i]);
        add_to_lanes(&mut self.t, |i| w[i] * part.t[i]);
        add_to_lanes(&mut self.blur, |i| {
            (z[i] * z[i] - 1.0) * by_sigma * c[i] + w[i] * part.blur[i]
        });
        add_to_lanes(&mut self.ellipse[0], |i| apart[i] * chord.by_length[i]);
        add_to_lanes(&mut self.ellipse[1], |i| apart[i] * chord.by_chord[i]);
        add_to_lanes(&mut self.ellipse[2], |i| both[i] * chord.along[i]);
        add_to_lanes(&mut self.ellipse[3], |i| {
            apart[i] * chord.by_along[i] - both[i] * shear
        });
        add_to_lanes(&mut self.ellipse[4], |i| both[i]);
        add_to_lanes(&mut self.bend, |i| {
            0.5 * both[i] * chord.at[i] * chord.at[i]
        });
    }
}

/// Computes the fraction between two ends across, in blurs from the pixel, and its derivatives with respect to both.
#[inline(always)]
fn segment_fraction(low: &Lanes, high: &Lanes, by_sigma: f32) -> ChordSegment {
    let mut out = ChordSegment::default();
    for i in 0..LANES {
        let [(d_low, c_low), (d_high, c_high)] = normal_distributions([low[i], high[i]]);
        out.c[i] = c_low - c_high;
        out.t[i] = (d_low - d_high) * by_sigma;
        out.blur[i] = (high[i] * d_high - low[i] * d_low) * by_sigma;
        out.low[i] = -d_low * by_sigma;
        out.high[i] = d_high * by_sigma;
    }
    out
}

/// Limits a relative position along to the tips at -1 and 1.
#[inline(always)]
fn clamp_to_unit(x: f32) -> f32 {
    let x = if x > -1.0 { x } else { -1.0 };
    if x < 1.0 { x } else { 1.0 }
}

/// Returns half the chord of a unit circle.
#[inline(always)]
fn half_chord(x: f32) -> f32 {
    let rest = 1.0 - x * x;
    if rest > 0.0 { rest } else { 0.0 }.sqrt()
}

wide! {
    /// Sums over the chords around each position.
    fn sum_chords(s: &Lanes, t: &Lanes, k: &[f32; N]) -> ChordSums = sum_outline_chords_generic
}

#[inline(always)]
fn sum_outline_chords_generic(s: &Lanes, t: &Lanes, k: &[f32; N]) -> ChordSums {
    let mut out = ChordSums::default();
    let by_sigma = 1.0 / k[BLUR];
    let step = STEP * k[BLUR];
    let by_step = 1.0 / step;
    let first = each(|i| (s[i] * by_step).floor());
    for node in 0..CHORDS {
        let turn = (node - CHORDS / 2 + 1) as f32 - 0.5;
        let at = each(|i| (first[i] + turn) * step);
        let chord = Chord::new(at, s, k);
        // The outline bends with the edges, on the same skin.
        let bend = 0.5 * (k[BEND] + k[BEND + 1]);
        let middle = each(|i| k[OFFSET + 1] + k[SHEAR] * chord.along[i] + bend * at[i] * at[i]);
        let low = each(|i| middle[i] - k[CHORD] * chord.by_chord[i]);
        let high = each(|i| middle[i] + k[CHORD] * chord.by_chord[i]);
        let one = each(|i| at[i] * (k[TANGENT] + k[BEND] * at[i]));
        let other = each(|i| at[i] * (k[BEND + 1] * at[i] - k[TANGENT]));
        let lower = each(|i| if at[i] < 0.0 { one[i] } else { other[i] });
        let upper = each(|i| if at[i] < 0.0 { other[i] } else { one[i] });
        let blurs = |v: &Lanes| each(|i| (t[i] - v[i]) * by_sigma);
        out.own.add_chord(
            &segment_fraction(&blurs(&low), &blurs(&high), by_sigma),
            &chord,
            k,
        );
        // White or black ends at an edge or, if that is outside the outline, at the outline.
        let clip = |v: &Lanes| {
            each(|i| {
                let v = if v[i] > low[i] { v[i] } else { low[i] };
                if v < high[i] { v } else { high[i] }
            })
        };
        let mut between = segment_fraction(&blurs(&clip(&lower)), &blurs(&clip(&upper)), by_sigma);
        let inside = |v: f32, i: usize| if v > low[i] && v < high[i] { 1.0 } else { 0.0 };
        let from = each(|i| between.low[i] * inside(lower[i], i));
        let to = each(|i| between.high[i] * inside(upper[i], i));
        let (by_low, by_high) = (between.low, between.high);
        let under = |v: f32, i: usize| if v <= low[i] { 1.0 } else { 0.0 };
        let over = |v: f32, i: usize| if v > low[i] && v >= high[i] { 1.0 } else { 0.0 };
        between.low = each(|i| by_low[i] * under(lower[i], i) + by_high[i] * under(upper[i], i));
        between.high = each(|i| by_low[i] * over(lower[i], i) + by_high[i] * over(upper[i], i));
        out.between.add_chord(&between, &chord, k);
        let weight = &chord.weight;
        let by_one = each(|i| weight[i] * at[i] * if at[i] < 0.0 { from[i] } else { to[i] });
        let by_other = each(|i| weight[i] * at[i] * if at[i] < 0.0 { to[i] } else { from[i] });
        add_to_lanes(&mut out.edges[0], |i| by_one[i] - by_other[i]);
        add_to_lanes(&mut out.edges[1], |i| by_one[i] * at[i]);
        add_to_lanes(&mut out.edges[2], |i| by_other[i] * at[i]);
    }
    correct_at_crossing(s, t, k, &mut out);
    out
}

/// Corrects the sums for the kink of the edges at the crossing, half a step from a chord on each side (Euler-Maclaurin
/// term).
#[inline(always)]
fn correct_at_crossing(s: &Lanes, t: &Lanes, k: &[f32; N], out: &mut ChordSums) {
    let by_sigma = 1.0 / k[BLUR];
    let turn = each(|i| {
        let (p, q) = (s[i] * by_sigma, t[i] * by_sigma);
        STEP * STEP / 6.0 * PEAK * PEAK * exp(-0.5 * (p * p + q * q))
    });
    add_to_lanes(&mut out.edges[0], |i| -turn[i]);
    let turn = each(|i| turn[i] * k[TANGENT]);
    add_to_lanes(&mut out.between.c, |i| -turn[i]);
    add_to_lanes(&mut out.between.s, |i| turn[i] * s[i] * by_sigma * by_sigma);
    add_to_lanes(&mut out.between.t, |i| turn[i] * t[i] * by_sigma * by_sigma);
    add_to_lanes(&mut out.between.blur, |i| {
        -turn[i] * (s[i] * s[i] + t[i] * t[i]) * by_sigma * by_sigma * by_sigma
    });
}

wide! {
    /// Computes the grey values of a batch and their derivatives; clipped, with zero derivatives, at 255.
    pub fn outlined_grey_values(model: &MarkerModel, batch: &Batch, out: &mut GreyBatch) = outlined_grey_generic
}

#[inline(always)]
fn outlined_grey_generic(model: &MarkerModel, batch: &Batch, out: &mut GreyBatch) {
    let (s, t) = model.along_and_across(batch);
    let k = &model.k;
    let chords = sum_chords(&s, &t, k);
    let ChordSums {
        between,
        own,
        edges,
    } = &chords;
    // Black is the fraction between the edges, or the rest of the fraction within the outline.
    let white_along = model.pattern == MarkerPattern::WhiteAlong;
    let GreyBatch {
        value: grey,
        gradient,
        outline_gradient,
    } = out;
    let outline_gradient: &mut OutlineGradient =
        outline_gradient.get_or_insert_with(|| Box::new([Lanes::splat(0.0); N - COMMON]));
    let mut slopes = GreyDerivatives::default();
    for i in 0..LANES {
        let (p, q) = (batch.p[i], batch.q[i]);
        let skin = k[SKIN] + k[SKIN + 1] * p + k[SKIN + 2] * q;
        let dark = model.darkness([p, q]);
        let black = if white_along {
            own.c[i] - between.c[i]
        } else {
            between.c[i]
        };
        let Tone {
            linear,
            log,
            through,
        } = model.apply_tone_curve(skin + own.c[i] * (1.0 - skin) - dark * black);
        let value = model.light_value([p, q]) * through;
        let clipped = value >= WHITEST;
        let open = if clipped { 0.0 } else { 1.0 };
        grey[i] = if clipped { WHITEST } else { value };
        let slope = open * k[GAMMA] * value / linear;
        let by_between = if white_along {
            slope * dark
        } else {
            -slope * dark
        };
        let by_own = slope * (1.0 - skin) - if white_along { slope * dark } else { 0.0 };
        let sum = |of_between: f32, of_own: f32| by_between * of_between + by_own * of_own;
        let (by_s, by_t) = (sum(between.s[i], own.s[i]), sum(between.t[i], own.t[i]));
        [gradient[X][i], gradient[Y][i], gradient[ANGLE][i]] =
            model.position_derivatives([by_s, by_t], [s[i], t[i]]);
        gradient[TANGENT][i] = by_between * edges[0][i];
        let by_bend = sum(between.bend[i], own.bend[i]);
        gradient[BEND][i] = by_between * edges[1][i] + by_bend;
        gradient[BEND + 1][i] = by_between * edges[2][i] + by_bend;
        gradient[BLUR][i] = sum(between.blur[i], own.blur[i]);
        for (j, (of_between, of_own)) in between.ellipse.iter().zip(&own.ellipse).enumerate() {
            outline_gradient[j][i] = sum(of_between[i], of_own[i]);
        }
        let light = open * through;
        (slopes.dark[i], slopes.light[i], slopes.gamma[i]) =
            (-slope * black, light, open * value * log);
        let by_skin = slope * (1.0 - own.c[i]);
        outline_gradient[SKIN - COMMON][i] = by_skin;
        outline_gradient[SKIN - COMMON + 1][i] = by_skin * p;
        outline_gradient[SKIN - COMMON + 2][i] = by_skin * q;
    }
    slopes.write_light_gradient(batch, gradient);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::appearance::parameters::{
        DARK, HALO, LIGHT, MarkerParameters, OVERSHOOT, UNEVEN_BLUR,
    };

    fn narrow() -> MarkerParameters {
        let mut m = [0.0; N];
        (m[X], m[Y], m[ANGLE], m[TANGENT], m[BLUR]) = (20.3, 19.8, -0.3, 0.3, 1.8);
        (m[BEND], m[BEND + 1]) = (2e-3, -1e-3);
        (m[LENGTH], m[CHORD], m[SHEAR], m[OFFSET], m[OFFSET + 1]) = (30.0, 7.0, 0.1, 0.4, -0.3);
        (m[LIGHT], m[LIGHT + 1], m[DARK], m[DARK + 2], m[GAMMA]) = (210.0, 3.0, 0.9, 0.02, 0.45);
        (m[SKIN], m[SKIN + 1], m[SKIN + 2]) = (0.5, 0.05, -0.04);
        m
    }

    /// Returns value and derivatives at a position.
    fn one(m: &MarkerParameters, x: f64, y: f64) -> (f64, MarkerParameters) {
        let mut batch = Batch::new();
        batch.push((x - 20.0) as f32, (y - 20.0) as f32, 0.0);
        (batch.p[0], batch.q[0]) = (((x - 20.0) / 30.0) as f32, ((y - 20.0) / 7.0) as f32);
        batch.fill_lanes();
        let mut out = GreyBatch::new();
        outlined_grey_values(
            &MarkerModel::new(MarkerPattern::WhiteAlong, m, [20.0, 20.0]),
            &batch,
            &mut out,
        );
        (
            f64::from(out.value[0]),
            std::array::from_fn(|k| f64::from(out.derivative(k)[0])),
        )
    }

    /// Computes the light by brute force: the sharp pattern, sampled finely, blurred.
    fn sampled(m: &MarkerParameters, x: f64, y: f64) -> f64 {
        const STEPS: i32 = 600;
        let (sin, cos) = m[ANGLE].sin_cos();
        let (mut sums, mut weights) = ([0.0; 2], 0.0);
        for i in -STEPS..=STEPS {
            for j in -STEPS..=STEPS {
                let [gx, gy] = [i, j].map(|k| f64::from(k) * 5.0 / f64::from(STEPS));
                let w = (-0.5 * (gx * gx + gy * gy)).exp();
                weights += w;
                let (dx, dy) = (x + gx * m[BLUR] - m[X], y + gy * m[BLUR] - m[Y]);
                let (s, t) = (dx * cos + dy * sin, dy * cos - dx * sin);
                let along = s - m[OFFSET];
                let across =
                    t - m[OFFSET + 1] - m[SHEAR] * along - 0.5 * (m[BEND] + m[BEND + 1]) * s * s;
                if (along / m[LENGTH]).powi(2) + (across / m[CHORD]).powi(2) < 1.0 {
                    let (one, other) = (
                        m[TANGENT] * s + m[BEND] * s * s,
                        -m[TANGENT] * s + m[BEND + 1] * s * s,
                    );
                    sums[usize::from((t - one) * (t - other) > 0.0)] += w;
                }
            }
        }
        let [white, black] = sums.map(|sum| sum / weights);
        let (p, q) = ((x - 20.0) / 30.0, (y - 20.0) / 7.0);
        let skin = m[SKIN] + m[SKIN + 1] * p + m[SKIN + 2] * q;
        let dark = m[DARK] + m[DARK + 1] * p + m[DARK + 2] * q;
        let light = skin * (1.0 - white - black) + white + black * (1.0 - dark);
        (m[LIGHT] + m[LIGHT + 1] * p) * light.powf(m[GAMMA])
    }

    #[test]
    fn the_chords_match_a_sampled_blur() {
        let m = narrow();
        for i in 0..40 {
            let (x, y) = (f64::from(i * 7 % 80) - 19.7, f64::from(i * 3 % 29) + 6.3);
            let (got, want) = (one(&m, x, y).0, sampled(&m, x, y));
            assert!((got - want).abs() < 0.3, "({x}, {y}): {got} against {want}");
        }
    }

    #[test]
    fn derivatives_match_differences() {
        let m = narrow();
        let (mut own, mut off) = ([0.0; N], [0.0; N]);
        for i in 0..80 {
            let (x, y) = (f64::from(i * 7 % 80) - 19.7, f64::from(i * 3 % 29) + 6.3);
            let gradient = one(&m, x, y).1;
            for k in 0..N {
                let step = if [BEND, BEND + 1].contains(&k) {
                    1e-4
                } else {
                    2e-2
                };
                let (mut low, mut high) = (m, m);
                low[k] -= step;
                high[k] += step;
                let difference = (one(&high, x, y).0 - one(&low, x, y).0) / (2.0 * step);
                own[k] += gradient[k] * gradient[k];
                off[k] += (gradient[k] - difference).powi(2);
            }
        }
        // If an edge meets the outline between two chords, differences and derivatives use different chords.
        for k in (0..N).filter(|k| ![UNEVEN_BLUR, OVERSHOOT, HALO].contains(k)) {
            let rough = if [TANGENT, SHEAR, BLUR].contains(&k) {
                0.1
            } else {
                0.01
            };
            let (own, off) = (own[k].sqrt(), off[k].sqrt());
            assert!(
                own > 0.0 && off < rough * own,
                "parameter {k}: off by {off} of {own}"
            );
        }
    }
}
