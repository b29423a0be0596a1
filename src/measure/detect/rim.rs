//! Narrow quadrants: edges and outline in one model, for blur mixes what lies at the one with what lies at the other.
//!
//! `I = s + m (w - (w - k) c - s)`: white `w`, black `k` and skin `s` in grey levels, `c` the blurred share of black of
//! quadrants without an end, `m` the blurred share of an ellipse. Near enough for a first geometry: where edge and outline meet
//! the blurred product is not the product of the blurred.

use nalgebra::{Cholesky, SMatrix, SVector, Vector2};

use super::super::raster::Raster;
use super::batch::Batch;
use super::candidate::{Candidate, Outline, half_turn};
use super::linear::{Block, Products, biweights, spread};
use super::model::{
    ANGLE, BLUR, FIRST, LANES, Lanes, N, Parameters, Pattern, SECOND, Share, X, Y, along_and_across, each,
    share,
};
use super::oval::{Oval, columns, row_of};
use super::wide::wide;

/// Unknowns: where the edges cross, their bisector's direction, the tangent of half their angle, the blur; the
/// outline's centre, direction and semi-axes; white, black, skin.
const COUNT: usize = 15;
const HALF: usize = 3;
const SOFT: usize = 4;
const OUTLINE: usize = 5;
const TURN: usize = 7;
const MAJOR: usize = 8;
const MINOR: usize = 9;
const WHITE: usize = 10;
const BLACK: usize = 11;
const SKIN: usize = 12;

type Column = SVector<f64, COUNT>;
type Square = SMatrix<f64, COUNT, COUNT>;

/// Part of a period by which the pixels of a row lie aside of those of the last.
const GOLDEN: f64 = 0.618;

/// How far the outline's centre is from the crossing, px.
const ASIDE: f64 = 1.0;
/// Least semi-major axis, px, and least contrast, grey levels, of what may be such quadrants.
const SHORTEST: f64 = 10.0;
const LEAST_CONTRAST: f64 = 10.0;
/// Most steps.
const MOST: usize = 20;
/// Pixels that are used, about.
const WANTED: f64 = 400.0;
/// Scale of the residuals for the weights, as a share of the contrast: at first and at least. An end that the first outline has
/// missed is no outlier.
const FIRST_SCALE: f64 = 0.3;
const LEAST_SCALE: f64 = 0.1;
/// Greatest residuals in the end, as a share of the contrast.
const LEFT: f64 = 0.12;
/// How much larger than an outline its pixels reach, and how much it may grow until others are chosen.
const ROOM: f64 = 1.2;
const GROWN: f64 = 1.1;
/// How much longer than the first outline the marker may be: black is seen of its middle only.
const LONGEST: f64 = 8.0;
/// Change of an outline, px, that is none.
const CALM: f64 = 0.1;

/// Grey levels of white, black and skin.
#[derive(Clone, Copy, Debug)]
pub struct Greys {
    pub white: f64,
    pub black: f64,
    pub skin: f64,
}

/// Quadrants with outline and edges from both together, from those of a candidate; `None` where that does not settle near
/// them. The blur, px, is known with some deviation.
pub fn refined(image: &Raster, candidate: &Candidate, greys: Greys, blur: (f64, f64)) -> Option<Candidate> {
    let (start, (angle, half)) = (candidate.outline, candidate.edges?);
    let centre = start.centre;
    #[rustfmt::skip]
    let mut m = Column::from([
        centre.x, centre.y, angle, half, blur.0,
        centre.x, centre.y, start.angle, start.major, start.minor,
        greys.white, greys.black, greys.skin, 0.0, 0.0,
    ]);
    let contrast = greys.white - greys.black;
    if start.major < SHORTEST || contrast < LEAST_CONTRAST {
        return None;
    }
    let mut scale = FIRST_SCALE * contrast;
    let mut chosen = Chosen::about(image, &start, blur.0)?;
    for _ in 0..MOST {
        let mut equations = linearise(candidate.pattern, &chosen, &m, scale);
        equations.foretell(&m, scale, blur);
        let change = equations.step(&m)?;
        m += change;
        if !is_plausible(&m, &start) {
            return None;
        }
        scale = equations.spread.max(0.4 * scale).max(LEAST_SCALE * contrast);
        let outline = outline_of(&m);
        let calm = [X, Y, OUTLINE, OUTLINE + 1, MAJOR, MINOR].iter().all(|&k| change[k].abs() < CALM);
        if outline.major > GROWN * chosen.outline.major || outline.minor > GROWN * chosen.outline.minor {
            chosen = Chosen::about(image, &outline, m[SOFT])?;
        } else if calm {
            let good = equations.spread < LEFT * (m[WHITE] - m[BLACK]);
            return good.then(|| Candidate {
                outline,
                edges: Some((m[ANGLE], m[HALF])),
                ..candidate.clone()
            });
        }
    }
    None
}

fn outline_of(m: &Column) -> Outline {
    let centre = Vector2::new(m[OUTLINE], m[OUTLINE + 1]);
    Outline { centre, major: m[MAJOR], minor: m[MINOR], angle: half_turn(m[TURN]) }
}

fn is_plausible(m: &Column, start: &Outline) -> bool {
    m.iter().all(|v| v.is_finite())
        && (0.3..4.0).contains(&m[SOFT])
        && (0.005..2.5).contains(&m[HALF])
        && m[MINOR] > 1.0
        && (m[MINOR]..LONGEST * start.major).contains(&m[MAJOR])
}

/// Some of the pixels about an outline.
struct Chosen {
    outline: Outline,
    origin: [f64; 2],
    batches: Vec<Batch>,
}

impl Chosen {
    fn about(image: &Raster, outline: &Outline, blur: f64) -> Option<Self> {
        let (centre, margin) = (outline.centre, 2.5 * blur + 2.0);
        let origin = [centre.x.round(), centre.y.round()];
        let about = Outline { major: ROOM * outline.major, minor: ROOM * outline.minor, ..*outline };
        let rows = Some(Oval::new(&about).grown(margin)?);
        let reach = about.extent().y + margin;
        let (width, height) = (image.width(), image.height());
        let area = [0, 0, width - 1, height - 1];
        let count = std::f64::consts::PI * (about.major + margin) * (about.minor + margin);
        let step = (count / WANTED).round().clamp(1.0, 1024.0) as usize;
        // Those of a row lie in the gaps of the rows beside it.
        let shift = (GOLDEN * step as f64).round() as usize;
        let mut batches = Vec::new();
        let mut batch = Batch::new();
        let lines =
            (centre.y - reach).max(0.0) as usize..((centre.y + reach).max(0.0) as usize + 1).min(height);
        for y in lines {
            let Some((from, to)) = row_of(&rows, y as f64) else { continue };
            let columns = columns(from, to, area);
            let first = columns.start + (step - (columns.start + y * shift) % step) % step;
            for x in (first..columns.end).step_by(step) {
                let Some(&value) = image.row(y).get(x) else { continue };
                batch.push((x as f64 - origin[0]) as f32, (y as f64 - origin[1]) as f32, f32::from(value));
                // What is clipped tells nothing.
                batch.root[batch.len - 1] = if value == 255 { 0.0 } else { 1.0 };
                if batch.is_full() {
                    batches.push(std::mem::replace(&mut batch, Batch::new()));
                }
            }
        }
        if batch.len > 0 {
            batch.fill();
            batches.push(batch);
        }
        (batches.len() * LANES > 4 * COUNT).then_some(Self { outline: *outline, origin, batches })
    }
}

/// Normal equations, and the residuals' robust standard deviation.
struct Equations {
    normal: Square,
    right: Column,
    spread: f64,
}

impl Equations {
    /// Adds what is known beforehand: the blur, and that the outline's centre is hardly aside of the crossing.
    fn foretell(&mut self, m: &Column, scale: f64, blur: (f64, f64)) {
        let weight = (scale / blur.1).powi(2);
        self.normal[(SOFT, SOFT)] += weight;
        self.right[SOFT] += weight * (blur.0 - m[SOFT]);
        let weight = (scale / ASIDE).powi(2);
        for (edge, rim) in [(X, OUTLINE), (Y, OUTLINE + 1)] {
            for (i, k, sign) in [(edge, edge, 1.0), (rim, rim, 1.0), (edge, rim, -1.0), (rim, edge, -1.0)] {
                self.normal[(i, k)] += sign * weight;
            }
            let apart = weight * (m[rim] - m[edge]);
            self.right[edge] += apart;
            self.right[rim] -= apart;
        }
    }

    /// Their solution, within what the linearisation can bear; `None` where they tell too little.
    fn step(&self, m: &Column) -> Option<Column> {
        let mut damped = self.normal;
        for i in 0..COUNT {
            damped[(i, i)] = damped[(i, i)] * 1.001 + 1e-9;
        }
        let mut change = Cholesky::new(damped)?.solve(&self.right);
        let (major, minor) = (0.15 * m[MAJOR], 0.2 * m[MINOR]);
        let most = [3.0, 3.0, 0.2, 0.2, 0.4, 3.0, 3.0, 0.1, major, minor, 40.0, 40.0, 40.0, 40.0, 40.0];
        let share =
            change.iter().zip(most).map(|(step, most)| most / step.abs().max(1e-12)).fold(1.0, f64::min);
        change *= share;
        Some(change)
    }
}

wide! {
    /// Normal equations at `m`, with biweights for residuals against `scale`.
    fn linearise(pattern: Pattern, chosen: &Chosen, m: &Column, scale: f64) -> Equations = linearised
}

#[inline(always)]
fn linearised(pattern: Pattern, chosen: &Chosen, m: &Column, scale: f64) -> Equations {
    let (mut edges, mut rim): (Parameters, Parameters) = ([0.0; N], [0.0; N]);
    (edges[X], edges[Y], edges[ANGLE], edges[FIRST], edges[BLUR]) = (m[X], m[Y], m[ANGLE], m[HALF], m[SOFT]);
    (rim[X], rim[Y], rim[ANGLE], rim[BLUR]) = (m[OUTLINE], m[OUTLINE + 1], m[TURN], m[SOFT]);
    (rim[FIRST], rim[SECOND]) = (m[MAJOR], m[MINOR]);
    let trigs = [edges[ANGLE].sin_cos(), rim[ANGLE].sin_cos()];
    let [white, black, level, along, across] =
        [m[WHITE], m[BLACK], m[SKIN], m[SKIN + 1] / m[MAJOR], m[SKIN + 2] / m[MINOR]].map(|v| v as f32);
    let (by_a, by_b) = ((1.0 / m[MAJOR]) as f32, (1.0 / m[MINOR]) as f32);
    let mut sums = Products::new(COUNT);
    let mut block = Block::new();
    let mut sizes = Vec::with_capacity(chosen.batches.len() * LANES);
    for batch in &chosen.batches {
        let (s, t) = along_and_across(&edges, chosen.origin, trigs[0], batch);
        let dark = share(pattern, &edges, &s, &t);
        let (p, q) = along_and_across(&rim, chosen.origin, trigs[1], batch);
        let inside = share(Pattern::Disc, &rim, &p, &q);
        let skin = each(|i| level + along * p[i] + across * q[i]);
        let marker = each(|i| white - (white - black) * dark.c[i]);
        let r = each(|i| batch.value[i] - skin[i] - inside.c[i] * (marker[i] - skin[i]));
        let by_dark = each(|i| inside.c[i] * (black - white));
        let by_inside = each(|i| marker[i] - skin[i]);
        let outside = each(|i| 1.0 - inside.c[i]);
        let [x, y, angle] = moved(&dark, &by_dark, trigs[0], [&s, &t]);
        let [u, v, turn] = moved(&inside, &by_inside, trigs[1], [&p, &q]);
        let gradient: [Lanes; COUNT] = [
            x,
            y,
            angle,
            each(|i| by_dark[i] * dark.first[i]),
            each(|i| by_dark[i] * dark.blur[i] + by_inside[i] * inside.blur[i]),
            u,
            v,
            turn,
            each(|i| by_inside[i] * inside.first[i]),
            each(|i| by_inside[i] * inside.second[i]),
            each(|i| inside.c[i] * (1.0 - dark.c[i])),
            each(|i| inside.c[i] * dark.c[i]),
            outside,
            each(|i| outside[i] * p[i] * by_a),
            each(|i| outside[i] * q[i] * by_b),
        ];
        let tukey = biweights(&r, &gradient[X], &gradient[Y], scale);
        let root = each(|i| batch.root[i] * tukey[i]);
        sizes.extend((0..LANES).filter(|&i| batch.root[i] > 0.0).map(|i| r[i].abs()));
        if block.push(&root, gradient.iter().chain([&r])) {
            block.flush(&mut sums);
        }
    }
    block.flush(&mut sums);
    let (mut normal, mut right) = (Square::zeros(), Column::zeros());
    let mut totals = sums.totals();
    for i in 0..COUNT {
        for (k, sum) in (i..COUNT).zip(&mut totals) {
            (normal[(i, k)], normal[(k, i)]) = (sum, sum);
        }
        right[i] = totals.next().unwrap_or(0.0);
    }
    Equations { normal, right, spread: spread(&mut sizes) }
}

/// Derivatives by centre and direction of what a share's derivatives are multiplied by.
#[inline(always)]
fn moved(share: &Share, by_share: &Lanes, trig: (f64, f64), [s, t]: [&Lanes; 2]) -> [Lanes; 3] {
    let (sin, cos) = (trig.0 as f32, trig.1 as f32);
    [
        each(|i| by_share[i] * (share.t[i] * sin - share.s[i] * cos)),
        each(|i| -by_share[i] * (share.s[i] * sin + share.t[i] * cos)),
        each(|i| by_share[i] * (share.s[i] * t[i] - share.t[i] * s[i])),
    ]
}
