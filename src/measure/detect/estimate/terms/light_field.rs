//! The fit with the light freed: a field of knots for light and darkness beside the model's parameters.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix2};

use crate::measure::detect::appearance::formula::{Model, Slopes, Tone};
use crate::measure::detect::appearance::parameters::{
    BLUR, COMMON, GAMMA, LIGHT, N, Parameters, Pattern, X, Y,
};
use crate::measure::detect::estimate::bordered::Bordered;
use crate::measure::detect::estimate::gauss_newton::Fit;
use crate::measure::detect::estimate::normal_equations::{Block, Products, biweights, spread};
use crate::measure::detect::estimate::options::ITERATION;
use crate::measure::detect::estimate::options::TERM;
use crate::measure::detect::estimate::residuals::ResidualAnalysis;
use crate::measure::detect::estimate::sandwich::{Blocks, REACH};
use crate::measure::detect::estimate::unknowns::Unknowns;
use crate::measure::detect::sample::pixels::Pixels;
use crate::measure::detect::simd::batch::{Batch, append};
use crate::measure::detect::simd::dispatch::wide;
use crate::measure::detect::simd::lanes::{LANES, Lanes, each, total};

/// Knots of the field of light along and across the marker, and of its darkness along it.
const ALONG: usize = 9;
const ACROSS: usize = 3;
const DARKS: usize = 6;
const FIELD: usize = ALONG * ACROSS + DARKS;
/// Knots about a pixel: four of light, two of darkness.
const ABOUT: usize = 6;

/// A fit with a field of light: the model's parameters, then the field's; of pixels that count from an origin.
struct Field {
    pattern: Pattern,
    origin: [f64; 2],
    m: Parameters,
    extra: [f64; FIELD],
}

/// The answer with the light freed.
pub struct LightFieldFit {
    /// The model's parameters.
    pub parameters: Parameters,
    /// The centre's covariance, at least that which the residuals show, px^2.
    pub covariance: Matrix2<f64>,
    /// The same if no residuals hung together.
    pub white: Matrix2<f64>,
    /// Weighted root mean square of the residuals, grey levels.
    pub rms: f64,
    /// Mean robust weight, 0 to 1.
    pub inliers: f64,
}

/// Pixels between the same knots.
struct Cell {
    knots: [usize; ABOUT],
    batches: Vec<Batch>,
}

/// What the residuals of a linearisation show.
struct Residuals {
    sizes: Vec<f32>,
    weight: f64,
    square: f64,
}

/// One batch's part in the normal equations.
struct Rows {
    r: Lanes,
    /// Roots of the weights, robust ones included.
    root: Lanes,
    /// Derivatives by the parameters.
    gradient: [Lanes; COMMON],
    /// Derivatives by the knots about.
    field: [Lanes; ABOUT],
}

/// The fit with the light freed, without the pixels of things that are not the marker's; `None` where the first step does not
/// promise to take off the residuals' squares the `least` that is asked, in variances of one. Nothing is asked where foreign
/// pixels pull at first.
pub fn fit_light_field(
    pixels: &Pixels,
    fit: &Fit,
    seen: &ResidualAnalysis,
    unknowns: &Unknowns,
    floor: f64,
    least: Option<f64>,
) -> Option<LightFieldFit> {
    let mut list = Vec::with_capacity(N);
    list.extend((0..N).filter(|&k| unknowns.free[k]));
    let own = own(pixels, seen, fit.parameters[BLUR]);
    let cells = cells(pixels, &own);
    if own.len() < 3 * N {
        return None;
    }
    let Pixels { pattern, origin, .. } = *pixels;
    let mut field = Field { pattern, origin, m: fit.parameters, extra: [0.0; FIELD] };
    let mut sizes: Vec<f32> = Vec::with_capacity(pixels.count());
    for (batch, r) in pixels.batches.iter().zip(&seen.residuals) {
        sizes.extend(r.iter().take(batch.len).map(|r| r.abs()));
    }
    let mut scale = floor.max(spread(&mut sizes)) * if least.is_none() { 3.0 } else { 1.0 };
    for iteration in 0..ITERATION.field_most {
        let (mut normal, right, mut seen) = normal(&cells, &field, unknowns, &list, scale);
        for i in 0..normal.nrows() {
            normal[(i, i)] *= 1.0 + if iteration < 2 { 1e-3 } else { 1e-7 };
        }
        let change = Cholesky::new(normal)?.solve(&right);
        // What the step takes off the residuals' squares, if the model is linear.
        if iteration == 0 && least.is_some_and(|least| change.dot(&right) < least * fit.variance) {
            return None;
        }
        let worst = field.go(&change, &list);
        let new = floor.max(spread(&mut seen.sizes));
        if worst < 1e-3 && new > 0.9 * scale {
            break;
        }
        scale = new.max(0.5 * scale);
    }
    let m = field.m;
    let sound = m.iter().all(|v| v.is_finite()) && m[BLUR] > 0.2 && m[BLUR] < 4.0;
    let (normal, _, seen) = normal(&cells, &field, unknowns, &list, scale);
    let factor = Cholesky::new(normal).filter(|_| sound)?;
    let influence = [X, Y].map(|k| {
        let place = list.iter().position(|&l| l == k);
        factor.solve(&DVector::from_fn(list.len() + FIELD, |i, _| if Some(i) == place { 1.0 } else { 0.0 }))
    });
    let (mut blocks, mut white) = (Blocks::new(pixels, &m), Matrix2::zeros());
    moved(&cells, &field, &list, &influence, scale, &mut blocks);
    let variance = seen.square / (seen.weight - list.len() as f64).max(1.0);
    for (i, row) in list.iter().enumerate().filter(|(_, k)| [X, Y].contains(k)) {
        for (j, influence) in influence.iter().enumerate() {
            white[(*row, j)] = influence[i] * variance;
        }
    }
    Some(LightFieldFit {
        parameters: m,
        covariance: blocks.raise(&white, list.len())?.0,
        white,
        rms: (seen.square / seen.weight.max(1e-9)).sqrt(),
        inliers: seen.weight / pixels.weight(),
    })
}

/// Batch and lane of the pixels that are not within the blur of two others that the fit took for foreign:
/// a line that touches the marker also darkens the pixels beside it, too little to be seen in each.
fn own(pixels: &Pixels, seen: &ResidualAnalysis, blur: f64) -> Vec<[usize; 2]> {
    let mut foreign = Vec::new();
    for (batch, tukey) in pixels.batches.iter().zip(&seen.biweights) {
        foreign.extend((0..batch.len).filter(|&i| tukey[i] <= 0.0).map(|i| [batch.x[i], batch.y[i]]));
    }
    let reach2 = (2.5 * blur + 1.0).powi(2) as f32;
    let near = |x: f32, y: f32| {
        foreign.iter().filter(|f| (f[0] - x).powi(2) + (f[1] - y).powi(2) < reach2).take(3).count() >= 3
    };
    let mut out = Vec::with_capacity(pixels.count());
    for (k, batch) in pixels.batches.iter().enumerate() {
        out.extend((0..batch.len).filter(|&i| !near(batch.x[i], batch.y[i])).map(|i| [k, i]));
    }
    out
}

/// The knot before a place on [-REACH, REACH], of `count`, and the share of the one behind it.
#[inline(always)]
fn hat(at: f32, count: usize) -> (f32, f32) {
    let place = (at * (0.5 / REACH as f32) + 0.5) * (count - 1) as f32;
    let place = place.clamp(0.0, (count - 1) as f32);
    let low = place.floor().min((count - 2) as f32);
    (low, place - low)
}

/// The pixels by the knots about them.
fn cells(pixels: &Pixels, own: &[[usize; 2]]) -> Vec<Cell> {
    let knots = |p: f32, q: f32| [hat(p, ALONG), hat(q, ACROSS), hat(p, DARKS)].map(|h| h.0 as usize);
    let mut out: Vec<Cell> = Vec::new();
    let mut place = [usize::MAX; ALONG * ACROSS * DARKS];
    for &[k, i] in own {
        let batch = &pixels.batches[k];
        let [along, across, dark] = knots(batch.p[i], batch.q[i]);
        let key = (along * ACROSS + across) * DARKS + dark;
        if place[key] == usize::MAX {
            place[key] = out.len();
            let first = along * ACROSS + across;
            let dark = ALONG * ACROSS + dark;
            let knots = [first, first + 1, first + ACROSS, first + ACROSS + 1, dark, dark + 1];
            out.push(Cell { knots, batches: Vec::new() });
        }
        let cell = &mut out[place[key]];
        append(&mut cell.batches, batch, i);
    }
    out.iter_mut().flat_map(|cell| &mut cell.batches).for_each(Batch::fill);
    out
}

impl Field {
    /// Goes a step, at most two pixels of the centre; how far that moves.
    fn go(&mut self, change: &DVector<f64>, list: &[usize]) -> f64 {
        let place = |k: usize| list.iter().position(|&l| l == k).map_or(0.0, |i| change[i]);
        let worst = place(X).hypot(place(Y));
        let factor = (2.0 / worst.max(1e-9)).min(1.0);
        for (i, &k) in list.iter().enumerate() {
            self.m[k] += factor * change[i];
        }
        for (i, extra) in self.extra.iter_mut().enumerate() {
            *extra += factor * change[list.len() + i];
        }
        worst
    }

    /// The marker with planes of light and darkness.
    #[inline(always)]
    fn model(&self) -> Model {
        Model::new(self.pattern, &self.m, self.origin)
    }

    /// One batch's rows.
    #[inline(always)]
    fn rows(&self, model: &Model, cell: &Cell, batch: &Batch, scale: f64) -> Rows {
        let (s, t) = model.along_and_across(batch);
        let share = model.share(&s, &t);
        let extra = cell.knots.map(|k| self.extra[k] as f32);
        let mut out = Rows {
            r: Lanes::of(0.0),
            root: Lanes::of(0.0),
            gradient: [Lanes::of(0.0); COMMON],
            field: [Lanes::of(0.0); ABOUT],
        };
        for i in 0..LANES {
            let (p, q, c) = (batch.p[i], batch.q[i], share.c[i]);
            let (u, v, w) = (hat(p, ALONG).1, hat(q, ACROSS).1, hat(p, DARKS).1);
            let hats = [(1.0 - u) * (1.0 - v), (1.0 - u) * v, u * (1.0 - v), u * v, 1.0 - w, w];
            let uneven = hats[0] * extra[0] + hats[1] * extra[1] + hats[2] * extra[2] + hats[3] * extra[3];
            let light = model.light([p, q]) + model.k[LIGHT] * uneven;
            let dark = model.dark([p, q]) + hats[4] * extra[4] + hats[5] * extra[5];
            let Tone { linear, log, through } = model.tone(1.0 - dark * c);
            let value = light * through;
            let open = if value < 255.0 { 1.0 } else { 0.0 };
            out.r[i] = batch.value[i] - if value < 255.0 { value } else { 255.0 };
            let (value, through) = (open * value, open * through);
            let slope = model.k[GAMMA] * value / linear;
            let (by_share, by_dark) = (-slope * dark, -slope * c);
            let slopes = Slopes { share: by_share, dark: by_dark, light: through, gamma: value * log };
            slopes.put(i, model, &share, [&s, &t], [p, q], &mut out.gradient);
            for (k, hat) in hats.into_iter().enumerate() {
                out.field[k][i] = hat * if k < 4 { through * model.k[LIGHT] } else { by_dark };
            }
        }
        let tukey = biweights(&out.r, &out.gradient[X], &out.gradient[Y], scale);
        out.root = each(|i| batch.root[i] * tukey[i]);
        out
    }
}

wide! {
    /// Normal equations over the parameters of a list and the field.
    fn normal(
        cells: &[Cell],
        field: &Field,
        unknowns: &Unknowns,
        list: &[usize],
        scale: f64,
    ) -> (DMatrix<f64>, DVector<f64>, Residuals) = normal_of
}

#[inline(always)]
fn normal_of(
    cells: &[Cell],
    field: &Field,
    unknowns: &Unknowns,
    list: &[usize],
    scale: f64,
) -> (DMatrix<f64>, DVector<f64>, Residuals) {
    let n = list.len();
    let model = field.model();
    let mut sought = Bordered::new(n, FIELD);
    let mut seen = Residuals { sizes: Vec::new(), weight: 0.0, square: 0.0 };
    let (mut weight, mut square) = (Lanes::of(0.0), Lanes::of(0.0));
    let (mut block, mut sums) = (Block::new(), Products::new(ABOUT + n));
    for cell in cells {
        for batch in &cell.batches {
            let rows = field.rows(&model, cell, batch, scale);
            weight = each(|i| weight[i] + rows.root[i] * rows.root[i]);
            square = each(|i| square[i] + (rows.root[i] * rows.r[i]) * (rows.root[i] * rows.r[i]));
            seen.sizes.extend(rows.r.iter().take(batch.len).map(|r| r.abs()));
            let own = list.iter().map(|&k| &rows.gradient[k]);
            if block.push(&rows.root, rows.field.iter().chain(own).chain([&rows.r])) {
                block.flush(&mut sums);
            }
        }
        block.flush(&mut sums);
        sought.take(&mut sums, cell.knots);
    }
    sought.finish(&sums, ABOUT);
    let Bordered { mut normal, mut right, .. } = sought;
    for (i, &k) in list.iter().enumerate() {
        let (prior, deviation) = unknowns.prior[k];
        let weight = (scale / deviation).powi(2);
        normal[(i, i)] += weight + 1e-12;
        right[i] += weight * (prior - field.m[k]);
    }
    for k in 0..FIELD {
        let deviation = if k < ALONG * ACROSS { TERM.field_light } else { TERM.field_dark };
        let weight = (scale / deviation).powi(2);
        normal[(n + k, n + k)] += weight;
        right[n + k] -= weight * field.extra[k];
    }
    normal.fill_upper_triangle_with_lower_triangle();
    (seen.weight, seen.square) = (total(&weight), total(&square));
    (normal, right, seen)
}

wide! {
    /// What the residuals of each batch did to the centre.
    fn moved(
        cells: &[Cell],
        field: &Field,
        list: &[usize],
        influence: &[DVector<f64>; 2],
        scale: f64,
        blocks: &mut Blocks,
    ) = moved_by
}

#[inline(always)]
fn moved_by(
    cells: &[Cell],
    field: &Field,
    list: &[usize],
    influence: &[DVector<f64>; 2],
    scale: f64,
    blocks: &mut Blocks,
) {
    let model = field.model();
    for cell in cells {
        for batch in &cell.batches {
            let rows = field.rows(&model, cell, batch, scale);
            let mut by = [Lanes::of(0.0); 2];
            for (sum, h) in by.iter_mut().zip(influence) {
                let knots = cell.knots.iter().map(|k| h[list.len() + k]);
                for (g, h) in rows.field.iter().zip(knots) {
                    *sum = each(|i| sum[i] + h as f32 * g[i]);
                }
                for (k, h) in list.iter().zip(h.iter()) {
                    *sum = each(|i| sum[i] + *h as f32 * rows.gradient[*k][i]);
                }
                *sum = each(|i| sum[i] * rows.root[i] * rows.root[i] * rows.r[i]);
            }
            blocks.add(batch, by);
        }
    }
}
