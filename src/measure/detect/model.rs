//! The image model: what a blurred marker looks like in grey values, with derivatives.
//!
//! `I = L (1 - k c)^g`: `L` is the grey value of the white or the skin (a plane, with a square term
//! along the marker), `k` the marker's darkness (a plane), `c` in 0..1 the blurred share of black;
//! `g` is the tone curve's exponent, for blur acts on light and not on grey values. Both shapes
//! give `c` in their own frame: `s` along the main direction, `t` across it.

use super::normal::{gauss, gauss_8, normal};

/// Parameters of either shape.
pub const N: usize = 16;
/// Centre u.
pub const X: usize = 0;
/// Centre v.
pub const Y: usize = 1;
/// Direction of s, rad.
pub const ANGLE: usize = 2;
/// Ellipse: semi-major axis, px. Quadrants: tangent of half the angle between the edges.
pub const FIRST: usize = 3;
/// Ellipse: semi-minor axis, px. Quadrants: curvature term of the first edge, 1/px.
pub const SECOND: usize = 4;
/// Ellipse: sag of the bent axis at its ends, px. Quadrants: curvature of the second edge, 1/px.
pub const THIRD: usize = 5;
/// Blur, pixel included, px.
pub const BLUR: usize = 6;
/// Light: constant, along s, along t, along s squared.
pub const LIGHT: usize = 7;
/// Darkness: constant, along s, along t.
pub const DARK: usize = 11;

/// Exponent of the tone curve.
pub const GAMMA: usize = 14;

/// Ellipse: relative change of its thickness from the centre to its end.
pub const EGG: usize = 15;

/// Parameters of a marker's image.
pub type Parameters = [f64; N];

/// Which pattern `c` describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pattern {
    /// A black disc.
    Disc,
    /// Black between the edges along s, white along t.
    BlackAlong,
    /// White between the edges along s, black along t.
    WhiteAlong,
}

/// A grey value with its place in the marker's fixed frame for light and darkness.
#[derive(Clone, Copy, Debug)]
pub struct Pixel {
    /// Column.
    pub x: f64,
    /// Row.
    pub y: f64,
    /// Grey value.
    pub value: f64,
    /// Along the marker over its semi-major axis.
    pub p: f64,
    /// Across the marker over its semi-minor axis.
    pub q: f64,
}

/// Share of black and its derivatives by s, t, FIRST, SECOND, THIRD and BLUR.
#[derive(Clone, Copy, Debug, Default)]
struct Share {
    c: f64,
    s: f64,
    t: f64,
    first: f64,
    second: f64,
    third: f64,
    blur: f64,
    egg: f64,
}

/// As [`grey_rotated`], from the parameters alone.
#[cfg(test)]
fn grey(pattern: Pattern, m: &Parameters, pixel: &Pixel) -> (f64, Parameters) {
    let (sin, cos) = m[ANGLE].sin_cos();
    grey_rotated(pattern, m, (sin, cos), pixel)
}

/// The grey value at a pixel and its derivatives; clipped, with zero derivatives, at 255. The sine
/// and cosine of the angle come from the caller, once for all pixels.
pub fn grey_rotated(
    pattern: Pattern,
    m: &Parameters,
    (sin, cos): (f64, f64),
    pixel: &Pixel,
) -> (f64, Parameters) {
    let (dx, dy) = (pixel.x - m[X], pixel.y - m[Y]);
    let (s, t) = (dx * cos + dy * sin, dy * cos - dx * sin);
    let share = match pattern {
        Pattern::Disc => disc(s, t, m),
        Pattern::BlackAlong => wedge(s, t, m),
        Pattern::WhiteAlong => wedge(s, t, m).complement(),
    };
    let (p, q) = (pixel.p, pixel.q);
    let light = m[LIGHT] + m[LIGHT + 1] * p + m[LIGHT + 2] * q + m[LIGHT + 3] * p * p;
    let dark = m[DARK] + m[DARK + 1] * p + m[DARK + 2] * q;
    let linear = (1.0 - dark * share.c).max(1e-3);
    let (log, through) = if share.c < 1e-7 {
        (0.0, 1.0)
    } else {
        let log = linear.ln();
        (log, (m[GAMMA] * log).exp())
    };
    let value = light * through;
    if value >= 255.0 {
        return (255.0, [0.0; N]);
    }
    let slope = m[GAMMA] * value / linear;
    let by_share = -slope * dark;
    let by_dark = -slope * share.c;
    let gradient = [
        by_share * (share.t * sin - share.s * cos),
        -by_share * (share.s * sin + share.t * cos),
        by_share * (share.s * t - share.t * s),
        by_share * share.first,
        by_share * share.second,
        by_share * share.third,
        by_share * share.blur,
        through,
        through * p,
        through * q,
        through * p * p,
        by_dark,
        by_dark * p,
        by_dark * q,
        value * log,
        by_share * share.egg,
    ];
    (value, gradient)
}

impl Share {
    fn complement(self) -> Self {
        Self {
            c: 1.0 - self.c,
            s: -self.s,
            t: -self.t,
            first: -self.first,
            second: -self.second,
            third: -self.third,
            blur: -self.blur,
            egg: -self.egg,
        }
    }
}

/// A blurred ellipse, its long axis bent by a parabola and its thickness changing along it: what a
/// curved skin makes of a flat ellipse, where the line of sight is along or across the curvature.
fn disc(s: f64, t: f64, m: &Parameters) -> Share {
    let (a, b, sag, sigma) = (m[FIRST], m[SECOND], m[THIRD], m[BLUR]);
    let along = s / a;
    let thin = 1.0 - m[EGG] * along;
    let level = t - sag * along * along;
    let straight = level * thin;
    let reach = 5.5 * sigma;
    if s.abs() > a + reach || straight.abs() > b + reach {
        return Share::default();
    }
    let mut share = if b * b > 3.0 * sigma * a && a < 3.0 * b {
        disc_by_distance(s, straight, a, b, sigma)
    } else if s.abs() < a - 4.2 * sigma {
        disc_by_chord(s, straight, a, b, sigma)
    } else {
        disc_by_quadrature(s, straight, a, b, sigma)
    };
    share.egg = -share.t * level * along;
    let by_along = -share.t * (thin * 2.0 * sag * along + level * m[EGG]);
    share.t *= thin;
    share.third = -share.t * along * along;
    share.s += by_along / a;
    share.first -= by_along * along / a;
    share
}

/// Where the outline's radius of curvature is well above the blur everywhere: the distance to the
/// outline decides, with the first-order effect of curvature (the blurred edge moves inwards).
fn disc_by_distance(s: f64, t: f64, a: f64, b: f64, sigma: f64) -> Share {
    let mut theta = (t / b).atan2(s / a);
    let mut trig = theta.sin_cos();
    for _ in 0..3 {
        let (sin, cos) = trig;
        let slope = (b * b - a * a) * (cos * cos - sin * sin) + s * a * cos + t * b * sin;
        let value = (b * b - a * a) * sin * cos + s * a * sin - t * b * cos;
        if slope.abs() < 1e-9 {
            break;
        }
        theta -= (value / slope).clamp(-0.3, 0.3);
        trig = theta.sin_cos();
    }
    let (sin, cos) = trig;
    let norm = (b * b * cos * cos + a * a * sin * sin).sqrt();
    let (ns, nt) = (b * cos / norm, a * sin / norm);
    let distance = (s - a * cos) * ns + (t - b * sin) * nt;
    let curvature = a * b / (norm * norm * norm);
    let (density, inside) = normal(distance / sigma + 0.5 * sigma * curvature);
    let edge = density / sigma;
    Share {
        c: 1.0 - inside,
        s: -edge * ns,
        t: -edge * nt,
        first: edge * ns * cos,
        second: edge * nt * sin,
        third: 0.0,
        egg: 0.0,
        blur: density * (distance / (sigma * sigma) - 0.5 * curvature),
    }
}

/// Away from the ends of a flat ellipse: both edges are straight within the blur, up to their
/// curvature; exact also where they lie within one another's blur.
fn disc_by_chord(s: f64, t: f64, a: f64, b: f64, sigma: f64) -> Share {
    let u = 1.0 - s * s / (a * a);
    let root = u.sqrt();
    let height = b * root;
    let slope = -b * s / (a * a * root);
    let bend = -b / (a * a * u * root);
    let spread = sigma * (1.0 + slope * slope).sqrt();
    let edge = height + 0.5 * bend * sigma * sigma;
    let (upper, lower) = ((t - edge) / spread, (t + edge) / spread);
    let ((du, cu), (dl, cl)) = (normal(upper), normal(lower));
    let by_height = (du + dl) / spread;
    Share {
        c: cl - cu,
        s: by_height * slope,
        t: (dl - du) / spread,
        first: by_height * b * s * s / (a * a * a * root),
        second: by_height * root,
        third: 0.0,
        egg: 0.0,
        blur: (upper * du - lower * dl) / sigma + by_height * bend * sigma,
    }
}

/// Near the ends of a flat ellipse: chords across it, blurred across in closed form, summed along
/// it. The eccentric angle as the variable takes away the chord's infinite slope at the end.
fn disc_by_quadrature(s: f64, t: f64, a: f64, b: f64, sigma: f64) -> Share {
    let reach = 4.6 * sigma;
    let from = ((s - reach) / a).clamp(-1.0, 1.0).asin();
    let to = ((s + reach) / a).clamp(-1.0, 1.0).asin();
    let mut share = Share::default();
    for (theta, weight) in gauss(from, to) {
        let (sin, cos) = theta.sin_cos();
        let along = (s - a * sin) / sigma;
        let density = 0.398_942_280_401_432_7 * (-0.5 * along * along).exp() / sigma;
        let measure = weight * a * cos * density;
        let (upper, lower) = ((t - b * cos) / sigma, (t + b * cos) / sigma);
        let ((du, cu), (dl, cl)) = (normal(upper), normal(lower));
        let (inside, by_height) = (cl - cu, (du + dl) / sigma);
        share.c += measure * inside;
        share.s -= measure * inside * along / sigma;
        share.t += measure * (dl - du) / sigma;
        share.second += measure * by_height * cos;
        share.first += weight * density * by_height * b * sin * sin;
        share.blur += measure * (inside * (along * along - 1.0) / sigma + (upper * du - lower * dl) / sigma);
    }
    share
}

/// The blurred share between two crossing edges `t = +-f s + k s^2`, `f <= 1`, around the s axis.
fn wedge(s: f64, t: f64, m: &Parameters) -> Share {
    let sigma = m[BLUR];
    if s.abs() > 3.6 * sigma {
        return wedge_side(s, t, m, true);
    }
    let mut share = Share::default();
    let reach = 4.2 * sigma;
    for (from, to) in [(s - reach, 0.0), (0.0, s + reach)] {
        for (at, weight) in gauss_8(from, to) {
            let along = (s - at) / sigma;
            let density = 0.398_942_280_401_432_7 * (-0.5 * along * along).exp() / sigma;
            let here = wedge_side(at, t, m, false);
            let w = weight * density;
            share.c += w * here.c;
            share.s -= w * here.c * along / sigma;
            share.t += w * here.t;
            share.first += w * here.first;
            share.second += w * here.second;
            share.third += w * here.third;
            share.blur += w * (here.c * (along * along - 1.0) / sigma + here.blur);
        }
    }
    share
}

/// Between the edges at `s`, blurred along both directions (`tilted`) or across only.
fn wedge_side(s: f64, t: f64, m: &Parameters, tilted: bool) -> Share {
    let (f, k1, k2, sigma) = (m[FIRST], m[SECOND], m[THIRD], m[BLUR]);
    let (slope1, slope2) = (f + 2.0 * k1 * s, -f + 2.0 * k2 * s);
    let tilt = |slope: f64| if tilted { (1.0 + slope * slope).sqrt() } else { 1.0 };
    let (spread1, spread2) = (sigma * tilt(slope1), sigma * tilt(slope2));
    let z1 = (t - f * s - k1 * s * s) / spread1;
    let z2 = (t + f * s - k2 * s * s) / spread2;
    let ((d1, c1), (d2, c2)) = (normal(z1), normal(z2));
    let side = if s >= 0.0 { 1.0 } else { -1.0 };
    let (e1, e2) = (side * d1 / spread1, side * d2 / spread2);
    // The blur across a tilted edge changes with its slope.
    let turn = |d: f64, z: f64, slope: f64| {
        if tilted { side * d * z * slope / (1.0 + slope * slope) } else { 0.0 }
    };
    let (turn1, turn2) = (turn(d1, z1, slope1), turn(d2, z2, slope2));
    Share {
        c: side * (c2 - c1),
        s: e1 * slope1 - e2 * slope2,
        t: e2 - e1,
        first: (e1 + e2) * s + turn1 + turn2,
        second: e1 * s * s + 2.0 * turn1 * s,
        third: -e2 * s * s - 2.0 * turn2 * s,
        egg: 0.0,
        blur: side * (z1 * d1 - z2 * d2) / sigma,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixel(x: f64, y: f64) -> Pixel {
        Pixel { x, y, value: 0.0, p: (x - 20.0) / 30.0, q: (y - 20.0) / 10.0 }
    }

    fn discs() -> Vec<Parameters> {
        let light = [180.0, 6.0, -3.0, 2.0, 0.7, 0.05, -0.02, 0.5, 0.02];
        let shapes: [[f64; 7]; 4] = [
            [20.3, 19.8, 0.3, 30.0, 15.0, 0.0, 0.8],
            [20.3, 19.8, -0.4, 30.0, 4.0, 0.4, 0.8],
            [20.3, 19.8, 1.2, 20.0, 1.2, 0.0, 0.9],
            [20.3, 19.8, 0.1, 6.0, 5.0, 0.0, 1.6],
        ];
        shapes.iter().map(|s| std::array::from_fn(|i| if i < 7 { s[i] } else { light[i - 7] })).collect()
    }

    fn quadrants() -> Vec<Parameters> {
        let light = [180.0, 6.0, -3.0, 2.0, 0.7, 0.05, -0.02, 0.5, 0.02];
        let shapes: [[f64; 7]; 3] = [
            [20.3, 19.8, 0.3, 0.9, 0.0, 0.0, 0.8],
            [20.3, 19.8, -0.4, 0.1, 4e-4, 2e-4, 0.8],
            [20.3, 19.8, 1.2, 0.4, -1e-3, 0.0, 1.5],
        ];
        shapes.iter().map(|s| std::array::from_fn(|i| if i < 7 { s[i] } else { light[i - 7] })).collect()
    }

    /// The share of black by brute force: the sharp pattern, sampled finely, blurred.
    fn sampled(pattern: Pattern, m: &Parameters, pixel: &Pixel) -> f64 {
        let (sin, cos) = m[ANGLE].sin_cos();
        let (mut sum, mut weights) = (0.0, 0.0);
        let n = 160;
        for i in -n..=n {
            for j in -n..=n {
                let (gx, gy) = (f64::from(i) * 5.0 / f64::from(n), f64::from(j) * 5.0 / f64::from(n));
                let w = (-0.5 * (gx * gx + gy * gy)).exp();
                let (dx, dy) = (pixel.x + gx * m[BLUR] - m[X], pixel.y + gy * m[BLUR] - m[Y]);
                let (s, t) = (dx * cos + dy * sin, dy * cos - dx * sin);
                let inside = match pattern {
                    Pattern::Disc => {
                        let t = t - m[THIRD] * (s / m[FIRST]).powi(2);
                        (s / m[FIRST]).powi(2) + (t / m[SECOND]).powi(2) < 1.0
                    }
                    _ => {
                        let one = t - m[FIRST] * s - m[SECOND] * s * s;
                        let other = t + m[FIRST] * s - m[THIRD] * s * s;
                        (one * other < 0.0) == (pattern == Pattern::BlackAlong)
                    }
                };
                sum += if inside { w } else { 0.0 };
                weights += w;
            }
        }
        sum / weights
    }

    fn share(pattern: Pattern, m: &Parameters, pixel: &Pixel) -> f64 {
        let mut flat = *m;
        flat[LIGHT..].copy_from_slice(&[100.0, 0.0, 0.0, 0.0, 0.9, 0.0, 0.0, 1.0, 0.0]);
        (1.0 - grey(pattern, &flat, pixel).0 / 100.0) / 0.9
    }

    #[test]
    fn the_closed_forms_match_a_sampled_blur() {
        for (pattern, sets) in
            [(Pattern::Disc, discs()), (Pattern::BlackAlong, quadrants()), (Pattern::WhiteAlong, quadrants())]
        {
            for m in sets {
                for i in 0..60 {
                    let at = pixel(f64::from(i * 7 % 60) - 8.0, f64::from(i * 3 % 29) + 6.3);
                    let (got, want) = (share(pattern, &m, &at), sampled(pattern, &m, &at));
                    assert!((got - want).abs() < 6e-3, "{pattern:?} {m:?} {at:?}: {got} against {want}");
                }
            }
        }
    }

    #[test]
    fn derivatives_match_differences() {
        for (pattern, sets) in [(Pattern::Disc, discs()), (Pattern::BlackAlong, quadrants())] {
            for m in sets {
                for i in 0..60 {
                    let at = pixel(f64::from(i * 7 % 60) - 8.3, f64::from(i * 3 % 29) + 6.7);
                    let (_, gradient) = grey(pattern, &m, &at);
                    for k in 0..N {
                        let step = if (SECOND..=THIRD).contains(&k) && m[k] < 0.1 { 1e-6 } else { 1e-4 };
                        let (mut low, mut high) = (m, m);
                        low[k] -= step;
                        high[k] += step;
                        let difference =
                            (grey(pattern, &high, &at).0 - grey(pattern, &low, &at).0) / (2.0 * step);
                        let scale = difference.abs().max(if step < 1e-5 { 2000.0 } else { 10.0 });
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
