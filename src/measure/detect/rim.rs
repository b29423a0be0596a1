//! Narrow quadrants: edges and outline in one model, for blur mixes what lies at the one with what lies at the other.
//!
//! `I = L (e (1 - k c) + (1 - e) u)^g`: as of wide quadrants ([`super::model`]), but only the share `e` of the light, that of
//! a blurred ellipse, is the marker's; the rest is skin, whose light is `u` (a plane) times that of the white. Where edges and
//! outline meet, the blurred product is not the product of the blurred; the error is alike on opposite sides.

use nalgebra::Vector2;

use super::super::raster::Raster;
use super::batch::{Batch, Kind, Pixels, Sorter};
use super::candidate::{Candidate, Outline, half_turn};
use super::fit::{Unknowns, contrast, rough};
use super::model::{
    ANGLE, BLUR, DARK, EGG, FIRST, GAMMA, Grey, LANES, LIGHT, N, Parameters, Pattern, SECOND, THIRD, X, Y,
    along_and_across, share,
};
use super::normal::{exp, ln};
use super::oval::{Oval, columns, row_of};
use super::sought::USUAL_GAMMA;

/// The outline's semi-axes, px; its direction, rad; its centre from the crossing, px, in u and v. These parameters are those
/// of a wide marker's bends, light and darkness.
pub const MAJOR: usize = SECOND;
pub const MINOR: usize = THIRD;
pub const TURN: usize = EGG;
const ASIDE: usize = LIGHT + 1;
/// The skin's light over that of the white: constant; along the marker; across it.
const SKIN: usize = LIGHT + 3;
const SKIN_ALONG: usize = DARK + 1;
const SKIN_ACROSS: usize = DARK + 2;

/// How far the outline's centre is from the crossing, px.
const ASIDE_SPREAD: f64 = 1.0;
/// Pixels that are used, about.
const WANTED: f64 = 400.0;
/// Of pixels outside an outline, which only tell the skin, how many are used.
const OUTSIDE: usize = 3;
/// Part of a period by which the pixels of a row lie aside of those of the last.
const GOLDEN: f64 = 0.618;
/// Least scale of the residuals for the weights, as a share of the contrast: an end that the first outline has missed is no
/// outlier; and the greatest in the end.
const LEAST: f64 = 0.1;
const MOST: f64 = 0.12;
/// Least semi-major axis, px, and least contrast, grey levels, of what may be such quadrants.
const SHORTEST: f64 = 10.0;
const LEAST_CONTRAST: f64 = 10.0;
/// How much larger than an outline its pixels reach, and how much it may grow until others are chosen; how often that is done.
const ROOM: f64 = 1.2;
const GROWN: f64 = 1.1;
const ROUNDS: usize = 5;

/// A candidate's first parameters: its geometry, with grey levels and blur of `m`, and the skin's grey level.
pub fn start(candidate: &Candidate, m: &Parameters, skin: f64) -> Option<Parameters> {
    let (outline, (angle, half)) = (candidate.outline, candidate.edges?);
    let mut out = [0.0; N];
    (out[X], out[Y], out[ANGLE], out[FIRST]) = (outline.centre.x, outline.centre.y, angle, half);
    (out[MAJOR], out[MINOR], out[TURN]) = (outline.major, outline.minor, outline.angle);
    (out[BLUR], out[LIGHT], out[DARK], out[GAMMA]) = (m[BLUR], m[LIGHT], m[DARK], USUAL_GAMMA.0);
    out[SKIN] = (skin / m[LIGHT]).max(0.0).powf(1.0 / USUAL_GAMMA.0);
    Some(out)
}

/// What is sought of narrow quadrants, with a blur, px, that is known with some deviation.
fn unknowns(blur: (f64, f64)) -> Unknowns {
    let mut usual = [(0.0, f64::INFINITY); N];
    usual[GAMMA] = USUAL_GAMMA;
    usual[BLUR] = blur;
    usual[ASIDE] = (0.0, ASIDE_SPREAD);
    usual[ASIDE + 1] = (0.0, ASIDE_SPREAD);
    let mut free = [true; N];
    free[GAMMA] = false;
    Unknowns { free, usual }
}

/// Quadrants with outline and edges from both together, and their blur, px, from first parameters; `None` where that does
/// not settle near them.
pub fn refined(
    image: &Raster,
    candidate: &Candidate,
    start: Parameters,
    blur: (f64, f64),
) -> Option<(Candidate, f64)> {
    if start[MAJOR] < SHORTEST || contrast(&start) < LEAST_CONTRAST {
        return None;
    }
    let unknowns = unknowns(blur);
    let mut m = start;
    for _ in 0..ROUNDS {
        let outline = outline_of(&m);
        let pixels = pixels(image, candidate.pattern, &outline, m[BLUR])?;
        let scale;
        (m, scale) = rough(&pixels, &m, &unknowns, LEAST * contrast(&m))?;
        if m[MAJOR] < GROWN * outline.major && m[MINOR] < GROWN * outline.minor {
            let edges = Some((m[ANGLE], m[FIRST]));
            let found = Candidate { outline: outline_of(&m), edges, ..candidate.clone() };
            return (scale < MOST * contrast(&m)).then_some((found, m[BLUR]));
        }
    }
    None
}

/// The outline of parameters.
fn outline_of(m: &Parameters) -> Outline {
    let centre = Vector2::new(m[X] + m[ASIDE], m[Y] + m[ASIDE + 1]);
    Outline { centre, major: m[MAJOR], minor: m[MINOR], angle: half_turn(m[TURN]) }
}

/// Some of the pixels in and about an outline.
fn pixels(image: &Raster, pattern: Pattern, outline: &Outline, blur: f64) -> Option<Pixels> {
    let (centre, margin) = (outline.centre, 2.5 * blur + 2.0);
    let origin = [centre.x.round(), centre.y.round()];
    let about = Outline { major: ROOM * outline.major, minor: ROOM * outline.minor, ..*outline };
    let (oval, own) = (Oval::new(&about), Oval::new(outline));
    let (rows, inner) = (Some(oval.grown(margin)?), Some(own.grown(blur)?));
    let count = std::f64::consts::PI * (about.major + margin) * (about.minor + margin);
    let step = (count / WANTED).round().clamp(1.0, 1024.0) as usize;
    // Those of a row lie in the gaps of the rows beside it.
    let shift = (GOLDEN * (step * OUTSIDE) as f64).round() as usize;
    let (width, height) = (image.width(), image.height());
    let area = [0, 0, width - 1, height - 1];
    let reach = about.extent().y + margin;
    let lines = (centre.y - reach).max(0.0) as usize..((centre.y + reach).max(0.0) as usize + 1).min(height);
    let mut sorter = Sorter::new(pattern, origin);
    let mut batch = Batch::new();
    for y in lines {
        let Some((from, to)) = row_of(&rows, y as f64) else { continue };
        let inside = row_of(&inner, y as f64).map_or(0..0, |(from, to)| columns(from, to, area));
        for x in columns(from, to, area) {
            let turn = x + y * shift;
            let step = if inside.contains(&x) { step } else { step * OUTSIDE };
            let Some(&value) = image.row(y).get(x).filter(|_| turn.is_multiple_of(step)) else { continue };
            batch.len = 0;
            batch.push((x as f64 - origin[0]) as f32, (y as f64 - origin[1]) as f32, f32::from(value));
            let (s, t) = outline.local(Vector2::new(x as f64, y as f64));
            (batch.p[0], batch.q[0]) = ((s / outline.major) as f32, (t / outline.minor) as f32);
            batch.root[0] = 1.0;
            sorter.push(Kind::Dear, &batch, 0);
        }
    }
    let mut out = sorter.finish();
    out.rim = true;
    Some(out)
}

/// The grey values of a batch and their derivatives; clipped, with zero derivatives, at 255. The sine and cosine of the
/// edges' angle come from the caller, once for all batches.
#[inline(always)]
pub fn grey(pattern: Pattern, m: &Parameters, origin: [f64; 2], trig: (f64, f64), batch: &Batch) -> Grey {
    let (mut edges, mut rim): (Parameters, Parameters) = ([0.0; N], [0.0; N]);
    (edges[X], edges[Y], edges[FIRST], edges[BLUR]) = (m[X], m[Y], m[FIRST], m[BLUR]);
    (rim[X], rim[Y], rim[BLUR]) = (m[X] + m[ASIDE], m[Y] + m[ASIDE + 1], m[BLUR]);
    (rim[FIRST], rim[SECOND]) = (m[MAJOR], m[MINOR]);
    let rim_trig = m[TURN].sin_cos();
    let (s, t) = along_and_across(&edges, origin, trig, batch);
    let black = share(pattern, &edges, &s, &t);
    let (p, q) = along_and_across(&rim, origin, rim_trig, batch);
    let own = share(Pattern::Disc, &rim, &p, &q);
    let k = m.map(|v| v as f32);
    let mut out = Grey { value: [0.0; LANES], gradient: [[0.0; LANES]; N] };
    for i in 0..LANES {
        let gradient = &mut out.gradient;
        let skin = k[SKIN] + k[SKIN_ALONG] * batch.p[i] + k[SKIN_ACROSS] * batch.q[i];
        let marker = 1.0 - k[DARK] * black.c[i];
        let mixed = skin + own.c[i] * (marker - skin);
        let mixed = if mixed > 1e-3 { mixed } else { 1e-3 };
        let log = ln(mixed);
        let through = exp(k[GAMMA] * log);
        let value = k[LIGHT] * through;
        let clipped = value >= 255.0;
        let open = if clipped { 0.0 } else { 1.0 };
        out.value[i] = if clipped { 255.0 } else { value };
        let slope = open * k[GAMMA] * value / mixed;
        let by_black = -slope * own.c[i] * k[DARK];
        let by_own = slope * (marker - skin);
        gradient[LIGHT][i] = open * through;
        gradient[DARK][i] = -slope * own.c[i] * black.c[i];
        gradient[GAMMA][i] = open * value * log;
        gradient[SKIN][i] = slope * (1.0 - own.c[i]);
        gradient[SKIN_ALONG][i] = gradient[SKIN][i] * batch.p[i];
        gradient[SKIN_ACROSS][i] = gradient[SKIN][i] * batch.q[i];
        gradient[FIRST][i] = by_black * black.first[i];
        gradient[BLUR][i] = by_black * black.blur[i] + by_own * own.blur[i];
        gradient[MAJOR][i] = by_own * own.first[i];
        gradient[MINOR][i] = by_own * own.second[i];
        let [x, y, angle] = black.moved(i, trig, [&s, &t]).map(|v| by_black * v);
        let [u, v, turn] = own.moved(i, rim_trig, [&p, &q]).map(|v| by_own * v);
        (gradient[X][i], gradient[Y][i], gradient[ANGLE][i]) = (x + u, y + v, angle);
        (gradient[ASIDE][i], gradient[ASIDE + 1][i], gradient[TURN][i]) = (u, v, turn);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::model;
    use super::*;

    fn narrow() -> Parameters {
        let mut m = [0.0; N];
        (m[X], m[Y], m[ANGLE], m[FIRST], m[BLUR]) = (20.3, 19.8, -0.3, 0.3, 1.8);
        (m[MAJOR], m[MINOR], m[TURN], m[ASIDE], m[ASIDE + 1]) = (30.0, 7.0, -0.15, 0.4, -0.3);
        (m[LIGHT], m[DARK], m[GAMMA]) = (210.0, 0.9, 0.45);
        (m[SKIN], m[SKIN_ALONG], m[SKIN_ACROSS]) = (0.5, 0.05, -0.04);
        m
    }

    /// Value and derivatives at a place.
    fn one(m: &Parameters, x: f64, y: f64) -> (f64, Parameters) {
        let mut batch = Batch::new();
        batch.push((x - 20.0) as f32, (y - 20.0) as f32, 0.0);
        (batch.p[0], batch.q[0]) = (((x - 20.0) / 30.0) as f32, ((y - 20.0) / 7.0) as f32);
        batch.fill();
        let out = grey(Pattern::WhiteAlong, m, [20.0, 20.0], m[ANGLE].sin_cos(), &batch);
        (f64::from(out.value[0]), out.gradient.map(|lanes| f64::from(lanes[0])))
    }

    #[test]
    fn derivatives_match_differences() {
        let m = narrow();
        for i in 0..80 {
            let (x, y) = (f64::from(i * 7 % 80) - 19.7, f64::from(i * 3 % 29) + 6.3);
            let gradient = one(&m, x, y).1;
            for k in 0..N {
                let step = 4e-3;
                let (mut low, mut high) = (m, m);
                low[k] -= step;
                high[k] += step;
                let difference = (one(&high, x, y).0 - one(&low, x, y).0) / (2.0 * step);
                let most = 0.05 * difference.abs().max(10.0);
                let off = (gradient[k] - difference).abs();
                assert!(off < most, "({x}, {y}) parameter {k}: {} against {difference}", gradient[k]);
            }
        }
    }

    #[test]
    fn far_from_its_outline_there_is_skin_and_within_the_quadrants() {
        let m = narrow();
        let light = |share: f64| 210.0 * share.powf(0.45);
        let skin = |x: f64, y: f64| 0.5 + 0.05 * (x - 20.0) / 30.0 - 0.04 * (y - 20.0) / 7.0;
        assert!((one(&m, 20.0, 50.0).0 - light(skin(20.0, 50.0))).abs() < 0.1);
        let (x, y) = (20.3 + 9.0 * 0.3f64.cos(), 19.8 - 9.0 * 0.3f64.sin());
        let mut wide = m;
        for k in [SECOND, THIRD, EGG, LIGHT + 1, LIGHT + 2, LIGHT + 3, DARK + 1, DARK + 2] {
            wide[k] = 0.0;
        }
        let mut batch = Batch::new();
        batch.push((x - 20.0) as f32, (y - 20.0) as f32, 0.0);
        batch.fill();
        let trig = m[ANGLE].sin_cos();
        let alone = model::grey(Pattern::WhiteAlong, &wide, [20.0, 20.0], trig, &batch).value[0];
        assert!((one(&m, x, y).0 - f64::from(alone)).abs() < 0.5, "{} of {alone}", one(&m, x, y).0);
    }
}
