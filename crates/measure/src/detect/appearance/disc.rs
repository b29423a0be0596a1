//! Blurred fraction of black of a disc seen as an ellipse, for a batch of pixels.

use super::parameters::{BLUR, BlackFraction, MAJOR, MINOR, MarkerParameters, SAG, TAPER};
use crate::detect::simd::functions::{
    GAUSS_12, PEAK, asin, gauss_kernel, normal_distribution, normal_distributions, sin_quarter,
};
use crate::detect::simd::lanes::{LANES, Lanes, all_lanes, each};

/// Distance from the end of a flat ellipse, standard deviations of blur, within which the sum along it is needed.
pub const END_SIGMAS: f64 = 4.2;

/// Reach of the sum to both sides, standard deviations of blur: beyond, 0.001 % is left.
const REACH_SIGMAS: f32 = 4.4;
/// Limit of a blunt outline: smallest radius of curvature, blurs, and also largest axis ratio.
const BLUNT: f64 = 3.0;
/// Smallest divisors: the precision of single numbers near 1, and less than any position in semi-axes.
const ROUNDING: f32 = 1e-6;
const TINY: f32 = 1e-9;
/// Longest step towards the nearest point of the outline, rad: beyond, Newton's method may diverge.
const MAX_TURN: f32 = 0.3;
/// Smallest square of a chord, relative, at a flat ellipse's ends, at which its edges are not straight.
const MIN_CHORD_SQUARE: f32 = 1e-3;

/// Parameters of the ellipse in single precision.
#[derive(Clone, Copy)]
struct DiscParameters {
    a: f32,
    by_a: f32,
    b: f32,
    sag: f32,
    taper: f32,
    sigma: f32,
}

/// Returns 1 for positions so far beyond the end of a flat ellipse that they are white, 0 for others.
#[inline(always)]
pub fn mask_beyond_end(s: &Lanes, t: &Lanes, [a, b]: [f32; 2], sag: f32, reach: f32) -> Lanes {
    let by_a = 1.0 / a;
    each(|i| {
        // Position along at which the ellipse is thickest within reach.
        let along = (s[i].abs() - reach) * by_a;
        let along = if along > 0.0 { along } else { 0.0 };
        let off = t[i].abs() - (reach + sag.abs());
        let out = if off > 0.0 && off * off > b * b * (1.0 - along * along) {
            1.0
        } else {
            0.0
        };
        if along >= 1.0 { 1.0 } else { out }
    })
}

/// Computes the fraction of a blurred ellipse whose long axis is bent by a parabola and whose thickness changes along it. A
/// curved skin has this effect on a flat ellipse if the line of sight is along or across the curvature.
#[inline(always)]
pub fn disc_fraction(s: &Lanes, t: &Lanes, m: &MarkerParameters) -> BlackFraction {
    let d = DiscParameters {
        a: m[MAJOR] as f32,
        by_a: 1.0 / m[MAJOR] as f32,
        b: m[MINOR] as f32,
        sag: m[SAG] as f32,
        taper: m[TAPER] as f32,
        sigma: m[BLUR] as f32,
    };
    // Divisions and roots have the longest latency: as few as possible.
    let along = each(|i| s[i] * d.by_a);
    let thin = each(|i| 1.0 - d.taper * along[i]);
    let level = each(|i| t[i] - d.sag * along[i] * along[i]);
    let straight = each(|i| level[i] * thin[i]);
    let mut fraction = BlackFraction::default();
    let nothing = mask_beyond_end(s, t, [d.a, d.b], d.sag, END_SIGMAS as f32 * d.sigma);
    if all_lanes(|i| nothing[i] > 0.0) {
        return fraction;
    }
    if m[MINOR] * m[MINOR] > BLUNT * m[BLUR] * m[MAJOR] && m[MAJOR] < BLUNT * m[MINOR] {
        fraction_by_distance(s, &straight, d, &mut fraction);
    } else if all_lanes(|i| s[i].abs() < d.a - END_SIGMAS as f32 * d.sigma) {
        fraction_by_chord(s, &straight, d, &mut fraction);
    } else {
        fraction_by_sum(s, &straight, d, &mut fraction);
    }
    for i in 0..LANES {
        let (along, across) = (along[i], fraction.t[i]);
        let by_along = -across * (thin[i] * 2.0 * d.sag * along + level[i] * d.taper) * d.by_a;
        fraction.taper[i] = -across * level[i] * along;
        fraction.t[i] = across * thin[i];
        fraction.third[i] = -across * thin[i] * along * along;
        fraction.s[i] += by_along;
        fraction.first[i] -= by_along * along;
    }
    fraction
}

/// Returns the distance from an ellipse, px, to within a factor of two; positive.
#[inline(always)]
pub fn distance_to_ellipse(a: f32, b: f32, s: &Lanes, t: &Lanes) -> Lanes {
    let (by_a, by_b) = (1.0 / a, 1.0 / b);
    each(|i| {
        let (p, q) = (s[i] * by_a, t[i] * by_b);
        let r = (p * p + q * q).sqrt() + ROUNDING;
        let slope = ((p * by_a) * (p * by_a) + (q * by_b) * (q * by_b)).sqrt() + TINY;
        let outwards = (r - 1.0).abs() * r / slope;
        // In a flat ellipse the outline across is nearer than the radial one.
        let u = 1.0 - p * p;
        let u = if u > TINY { u } else { TINY };
        let across =
            (b * u.sqrt() - t[i].abs()) * (u / (u + (b * by_a * p) * (b * by_a * p))).sqrt();
        let across = if across > 0.0 { across } else { 0.0 };
        if r >= 1.0 || outwards < across {
            outwards
        } else {
            across
        }
    })
}

/// Computes the fraction from the distance to the outline, with the first-order effect of curvature (the blurred edge moves
/// inwards). Valid if the radius of curvature is well above the blur everywhere.
#[inline(always)]
fn fraction_by_distance(
    s: &Lanes,
    t: &Lanes,
    DiscParameters {
        a, by_a, b, sigma, ..
    }: DiscParameters,
    fraction: &mut BlackFraction,
) {
    let unlike = b * b - a * a;
    let (by_b, by_sigma) = (1.0 / b, 1.0 / sigma);
    for i in 0..LANES {
        let (s, t) = (s[i], t[i]);
        // Eccentric angle of the nearest point of the outline, by Newton's method, as a unit vector.
        let (mut cos, mut sin) = (s * by_a + TINY, t * by_b);
        let norm = 1.0 / (cos * cos + sin * sin).sqrt();
        (cos, sin) = (cos * norm, sin * norm);
        for _ in 0..3 {
            let slope = unlike * (cos * cos - sin * sin) + s * a * cos + t * b * sin;
            let value = unlike * sin * cos + s * a * sin - t * b * cos;
            let slope = if slope.abs() > ROUNDING {
                slope
            } else {
                ROUNDING
            };
            let turn = -value / slope;
            let turn = if turn < MAX_TURN { turn } else { MAX_TURN };
            let turn = if turn > -MAX_TURN { turn } else { -MAX_TURN };
            let (one, other) = (cos - turn * sin, sin + turn * cos);
            let norm = 1.0 / (1.0 + turn * turn).sqrt();
            (cos, sin) = (one * norm, other * norm);
        }
        let norm = 1.0 / (b * b * cos * cos + a * a * sin * sin).sqrt();
        let (ns, nt) = (b * cos * norm, a * sin * norm);
        let distance = (s - a * cos) * ns + (t - b * sin) * nt;
        let curvature = a * b * norm * norm * norm;
        let (density, inside) = normal_distribution(distance * by_sigma + 0.5 * sigma * curvature);
        let edge = density * by_sigma;
        fraction.c[i] = 1.0 - inside;
        fraction.s[i] = -edge * ns;
        fraction.t[i] = -edge * nt;
        fraction.first[i] = edge * ns * cos;
        fraction.second[i] = edge * nt * sin;
        fraction.blur[i] = density * (distance * by_sigma * by_sigma - 0.5 * curvature);
    }
}

/// Computes the fraction away from the ends of a flat ellipse: both edges are straight within the blur, up to their
/// curvature. Exact also if they lie within one another's blur.
#[inline(always)]
fn fraction_by_chord(
    s: &Lanes,
    t: &Lanes,
    DiscParameters { by_a, b, sigma, .. }: DiscParameters,
    fraction: &mut BlackFraction,
) {
    let by_sigma = 1.0 / sigma;
    let flat = b * by_a;
    for i in 0..LANES {
        let (along, t) = (s[i] * by_a, t[i]);
        let u = 1.0 - along * along;
        let u = if u > MIN_CHORD_SQUARE {
            u
        } else {
            MIN_CHORD_SQUARE
        };
        let rise = flat * along;
        // The edge's slope is -rise / root: one division for both.
        let (root, steep) = (u.sqrt(), (u + rise * rise).sqrt());
        let by_both = 1.0 / (root * steep);
        let by_root = steep * by_both;
        let slope = -rise * by_root;
        let bend = -flat * by_a * by_root * by_root * by_root;
        let by_width = by_sigma * u * by_both;
        let edge = b * root + 0.5 * bend * sigma * sigma;
        let (upper, lower) = ((t - edge) * by_width, (t + edge) * by_width);
        let [(du, cu), (dl, cl)] = normal_distributions([upper, lower]);
        let by_height = (du + dl) * by_width;
        fraction.c[i] = cl - cu;
        fraction.s[i] = by_height * slope;
        fraction.t[i] = (dl - du) * by_width;
        fraction.first[i] = by_height * flat * along * along * by_root;
        fraction.second[i] = by_height * root;
        fraction.blur[i] = (upper * du - lower * dl) * by_sigma + by_height * bend * sigma;
    }
}

/// Computes the fraction near the ends of a flat ellipse: chords across it, blurred across in closed form, summed along it.
/// The eccentric angle as the variable removes the chord's infinite slope at the end.
#[inline(always)]
fn fraction_by_sum(
    s: &Lanes,
    t: &Lanes,
    DiscParameters {
        a, by_a, b, sigma, ..
    }: DiscParameters,
    fraction: &mut BlackFraction,
) {
    let reach = REACH_SIGMAS * sigma;
    let by_sigma = 1.0 / sigma;
    let from = each(|i| asin((s[i] - reach) * by_a));
    let to = each(|i| asin((s[i] + reach) * by_a));
    let (middle, half) = (
        each(|i| 0.5 * (from[i] + to[i])),
        each(|i| 0.5 * (to[i] - from[i])),
    );
    let [
        mut black,
        mut by_s,
        mut by_t,
        mut by_a,
        mut by_b,
        mut by_blur,
    ] = [Lanes::splat(0.0); 6];
    for (node, weight) in GAUSS_12 {
        for i in 0..LANES {
            let theta = half[i].mul_add(node, middle[i]);
            let sin = sin_quarter(theta);
            let cos = sin_quarter(std::f32::consts::FRAC_PI_2 - theta.abs());
            let along = a.mul_add(-sin, s[i]) * by_sigma;
            let square = along * along;
            let density = half[i] * weight * gauss_kernel(along);
            let measure = cos * density;
            let upper = b.mul_add(-cos, t[i]) * by_sigma;
            let lower = b.mul_add(cos, t[i]) * by_sigma;
            let [(du, cu), (dl, cl)] = normal_distributions([upper, lower]);
            let both = du + dl;
            let inside = measure * (cl - cu);
            black[i] += inside;
            by_s[i] = along.mul_add(inside, by_s[i]);
            by_t[i] = measure.mul_add(dl - du, by_t[i]);
            by_b[i] = (measure * cos).mul_add(both, by_b[i]);
            by_a[i] = (density * both).mul_add(sin * sin, by_a[i]);
            let blurred = measure.mul_add(upper.mul_add(du, -lower * dl), by_blur[i]);
            by_blur[i] = inside.mul_add(square - 1.0, blurred);
        }
    }
    // Common factors of all terms.
    let by_width = PEAK * by_sigma;
    let (common, slope) = (a * by_width, a * by_width * by_sigma);
    fraction.c = each(|i| common * black[i]);
    fraction.s = each(|i| -slope * by_s[i]);
    fraction.t = each(|i| slope * by_t[i]);
    fraction.second = each(|i| slope * by_b[i]);
    fraction.first = each(|i| b * by_width * by_sigma * by_a[i]);
    fraction.blur = each(|i| slope * by_blur[i]);
}
