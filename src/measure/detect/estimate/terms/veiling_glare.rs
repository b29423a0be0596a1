//! A disc that glare lies over. What the skin mirrors adds to the light of black and white alike, so that a disc
//! shows through as far as the picture is not saturated: `I = L (1 - k c + g)^gamma`, with `g` the mirrored light over the
//! skin's own. Glare on a wing is a band: `g` is a spline along the disc, slanted as the band is.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix2};

use super::glare_spline::{Glare, places, seen, spline};
use crate::measure::detect::appearance::formula::{Model, Slopes, Tone};
use crate::measure::detect::appearance::parameters::{
    BLUR, COMMON, FIRST, GAMMA, Parameters, Pattern, SECOND, X, Y,
};
use crate::measure::detect::estimate::bordered::Bordered;
use crate::measure::detect::estimate::gauss_newton::Fit;
use crate::measure::detect::estimate::normal_equations::{Block, Products, Square, biweights, spread};
use crate::measure::detect::estimate::options::ITERATION;
use crate::measure::detect::estimate::options::TERM;
use crate::measure::detect::estimate::sandwich::Blocks;
use crate::measure::detect::estimate::unknowns::Unknowns;
use crate::measure::detect::image::ellipse::Ellipse;
use crate::measure::detect::sample::pixels::Pixels;
use crate::measure::detect::simd::batch::{Batch, append};
use crate::measure::detect::simd::dispatch::wide;
use crate::measure::detect::simd::lanes::{LANES, Lanes, each, total};

/// The disc's parameters with the glare over it; of pixels that count from an origin, and along and across an outline.
struct State<'a> {
    origin: [f64; 2],
    ellipse: &'a Ellipse,
    m: Parameters,
    glare: Glare,
}

/// A linearisation: normal equations over the parameters of a list, the slant and the knots; and the residuals' statistics.
struct Step {
    normal: DMatrix<f64>,
    right: DVector<f64>,
    sizes: Vec<f32>,
    weight: f64,
    square: f64,
}

/// Pixels with the same four knots about them, the first of which is given.
struct Cell {
    first: usize,
    batches: Vec<Batch>,
}

/// What a batch says: residuals, roots of their weights, derivatives by the parameters, the slant and the four knots.
struct Rows {
    r: Lanes,
    root: Lanes,
    gradient: [Lanes; COMMON],
    slant: Lanes,
    knots: [Lanes; 4],
}

/// What is known of the glare beforehand: its knots, each with a standard deviation.
struct Known {
    knots: Vec<f64>,
    spreads: Vec<f64>,
}

impl Known {
    fn new(glare: &Glare) -> Self {
        let knots = glare.knots.clone();
        let spread = |k: usize| {
            let about = &knots[k.saturating_sub(1)..(k + 2).min(knots.len())];
            TERM.glare_floor + TERM.glare_share * about.iter().fold(0.0, |a: f64, &b| a.max(b))
        };
        let spreads = (0..knots.len()).map(spread).collect();
        Self { knots, spreads }
    }

    /// Adds that, and what is known of the parameters, to the normal equations.
    fn add(&self, step: &mut Step, state: &State, list: &[usize], unknowns: &Unknowns, scale: f64) {
        let mut add = |i: usize, now: f64, (prior, deviation): (f64, f64)| {
            let weight = (scale / deviation).powi(2);
            step.normal[(i, i)] += weight + 1e-12;
            step.right[i] += weight * (prior - now);
        };
        let n = list.len();
        list.iter().enumerate().for_each(|(i, &k)| add(i, state.m[k], unknowns.prior[k]));
        add(n, state.glare.slant, (state.glare.slant, 1.0));
        for (k, known) in self.knots.iter().copied().zip(self.spreads.iter().copied()).enumerate() {
            add(n + 1 + k, state.glare.knots[k], known);
        }
    }
}

impl State<'_> {
    /// Goes a step, at most a pixel and a half of the centre; how far that moves.
    fn go(&mut self, change: &DVector<f64>, list: &[usize]) -> f64 {
        let of = |k: usize| list.iter().position(|&l| l == k).map_or(0.0, |i| change[i]);
        let moved = of(X).hypot(of(Y));
        let most = (1.5 / moved.max(1e-9)).min(1.0);
        let n = list.len();
        list.iter().enumerate().for_each(|(i, &k)| self.m[k] += most * change[i]);
        self.glare.slant += most * change[n];
        (self.glare.knots.iter_mut().enumerate()).for_each(|(k, knot)| *knot += most * change[n + 1 + k]);
        moved
    }

    fn is_sound(&self) -> bool {
        let m = &self.m;
        m.iter().all(|v| v.is_finite())
            && (0.2..4.0).contains(&m[BLUR])
            && (0.15..3.0).contains(&m[GAMMA])
            && m[FIRST] > 1.0
            && m[SECOND] > 0.2
    }
}

/// The fit with glare over the disc, from a first one to what glare leaves; `None` where it does not settle.
pub fn fit_with_glare(
    pixels: &Pixels,
    ellipse: &Ellipse,
    fit: &Fit,
    unknowns: &Unknowns,
    floor: f64,
) -> Option<Fit> {
    let list: Vec<usize> = (0..COMMON).filter(|&k| unknowns.free[k]).collect();
    let place = |k: usize| list.iter().position(|&l| l == k);
    let (x, y) = (place(X)?, place(Y)?);
    let (m, origin) = (fit.parameters, pixels.origin);
    let mut state = State { origin, ellipse, m, glare: seen(pixels, ellipse, &m) };
    let known = Known::new(&state.glare);
    let mut scale = 4.0 * floor.max(fit.rms);
    for _ in 0..ITERATION.glare_most {
        let cells = cells(pixels, ellipse, &state.glare);
        let mut step = linearised(&cells, &state, &list, scale);
        known.add(&mut step, &state, &list, unknowns, scale);
        let factor = Cholesky::new(step.normal)?;
        let moved = state.go(&factor.solve(&step.right), &list);
        if !state.is_sound() {
            return None;
        }
        let unit = |at: usize| DVector::from_fn(step.right.len(), |i, _| f64::from(i == at));
        let influence = [x, y].map(|at| factor.solve(&unit(at)));
        let variance = step.square / (step.weight - list.len() as f64).max(1.0);
        let white = Matrix2::from_fn(|i, j| influence[j][[x, y][i]] * variance);
        let new = floor.max(spread(&mut step.sizes));
        if moved > ITERATION.glare_still * white.trace().max(0.0).sqrt() || new < 0.9 * scale {
            scale = new.max(0.5 * scale);
            continue;
        }
        let mut blocks = Blocks::new(pixels, &state.m);
        moved_by_blocks(&cells, &state, &list, &influence, new, &mut blocks);
        let (centre, _, correlation) = blocks.raise(&white, list.len())?;
        let mut covariance = Square::zeros();
        covariance.fixed_view_mut::<2, 2>(X, X).copy_from(&centre);
        covariance[(FIRST, FIRST)] = place(FIRST).map_or(0.0, |at| factor.solve(&unit(at))[at] * variance);
        return Some(Fit {
            parameters: state.m,
            covariance,
            variance,
            rms: (step.square / step.weight.max(1e-9)).sqrt(),
            inliers: step.weight / open_weight(pixels).max(1e-9),
            start: state.m,
            images: Vec::new(),
            correlation,
            white,
        });
    }
    None
}

/// Sum of the weights of what is not saturated.
fn open_weight(pixels: &Pixels) -> f64 {
    let own = |b: &Batch| {
        (0..b.len).filter(|&i| b.value[i] < TERM.saturated).map(|i| f64::from(b.root[i]).powi(2)).sum::<f64>()
    };
    pixels.batches.iter().map(own).sum()
}

/// The pixels by the knots about them.
fn cells(pixels: &Pixels, ellipse: &Ellipse, glare: &Glare) -> Vec<Cell> {
    let mut out: Vec<Cell> =
        (0..glare.knots.len()).map(|first| Cell { first, batches: Vec::new() }).collect();
    for batch in &pixels.batches {
        for (i, s, t) in places(batch, ellipse) {
            let Some(cell) = out.get_mut(glare.place(s, t) as usize) else { continue };
            append(&mut cell.batches, batch, i);
        }
    }
    out.retain(|cell| !cell.batches.is_empty());
    out.iter_mut().flat_map(|cell| &mut cell.batches).for_each(Batch::fill);
    out
}

wide! {
    /// The normal equations without what is known beforehand.
    fn linearised(cells: &[Cell], state: &State, list: &[usize], scale: f64) -> Step = linearised_by
}

#[inline(always)]
fn linearised_by(cells: &[Cell], state: &State, list: &[usize], scale: f64) -> Step {
    // The slant comes after the list's parameters, then the knots.
    let n = list.len() + 1;
    let model = state.model();
    let mut sought = Bordered::new(n, state.glare.knots.len());
    let mut sizes = Vec::new();
    let (mut weight, mut square) = (Lanes::of(0.0), Lanes::of(0.0));
    let (mut block, mut sums) = (Block::new(), Products::new(4 + n));
    for Cell { first, batches } in cells {
        for batch in batches {
            let rows = state.rows(&model, *first, batch, scale);
            weight = each(|i| weight[i] + rows.root[i] * rows.root[i]);
            square = each(|i| square[i] + (rows.root[i] * rows.r[i]) * (rows.root[i] * rows.r[i]));
            let open = (0..batch.len).filter(|&i| batch.value[i] < TERM.saturated);
            sizes.extend(open.map(|i| rows.r[i].abs()));
            let own = list.iter().map(|&k| &rows.gradient[k]).chain([&rows.slant]);
            if block.push(&rows.root, rows.knots.iter().chain(own).chain([&rows.r])) {
                block.flush(&mut sums);
            }
        }
        block.flush(&mut sums);
        sought.take(&mut sums, std::array::from_fn::<_, 4, _>(|i| first + i));
    }
    sought.finish(&sums, 4);
    let Bordered { mut normal, right, .. } = sought;
    normal.fill_upper_triangle_with_lower_triangle();
    Step { normal, right, sizes, weight: total(&weight), square: total(&square) }
}

wide! {
    /// What the residuals of each batch did to the centre.
    fn moved_by_blocks(
        cells: &[Cell],
        state: &State,
        list: &[usize],
        influence: &[DVector<f64>; 2],
        scale: f64,
        blocks: &mut Blocks,
    ) = moved_by
}

#[inline(always)]
fn moved_by(
    cells: &[Cell],
    state: &State,
    list: &[usize],
    influence: &[DVector<f64>; 2],
    scale: f64,
    blocks: &mut Blocks,
) {
    let model = state.model();
    for Cell { first, batches } in cells {
        for batch in batches {
            let rows = state.rows(&model, *first, batch, scale);
            let by = influence.each_ref().map(|h| {
                let own = list.iter().map(|&k| &rows.gradient[k]).chain([&rows.slant]);
                let knots = rows.knots.iter().zip(h.iter().skip(list.len() + 1 + first));
                let sum = own
                    .zip(h.iter())
                    .chain(knots)
                    .fold(Lanes::of(0.0), |sum: Lanes, (column, h)| each(|i| sum[i] + *h as f32 * column[i]));
                each(|i| sum[i] * rows.root[i] * rows.root[i] * rows.r[i])
            });
            blocks.add(batch, by);
        }
    }
}

impl State<'_> {
    /// The disc without glare.
    #[inline(always)]
    fn model(&self) -> Model {
        Model::new(Pattern::Disc, &self.m, self.origin)
    }

    /// One batch's rows.
    #[inline(always)]
    fn rows(&self, model: &Model, first: usize, batch: &Batch, scale: f64) -> Rows {
        let glare = &self.glare;
        let (s, t) = model.along_and_across(batch);
        let share = model.share(&s, &t);
        let heights: [f32; 4] =
            std::array::from_fn(|i| glare.knots.get(first + i).map_or(0.0, |knot| *knot as f32));
        let (major, minor) = (self.ellipse.major as f32, self.ellipse.minor as f32);
        let (slant, by_spacing) = (glare.slant as f32, (1.0 / TERM.knot_px) as f32);
        let from = (glare.first / TERM.knot_px + first as f64) as f32;
        let mut out = Rows {
            r: Lanes::of(0.0),
            root: Lanes::of(0.0),
            gradient: [Lanes::of(0.0); COMMON],
            slant: Lanes::of(0.0),
            knots: [Lanes::of(0.0); 4],
        };
        for i in 0..LANES {
            let (p, q, c) = (batch.p[i], batch.q[i], share.c[i]);
            let across = q * minor;
            let (shares, slopes) = spline(((p * major - slant * across) * by_spacing - from).clamp(0.0, 1.0));
            let (mut over, mut rise) = (0.0, 0.0);
            for (height, (share, slope)) in heights.iter().zip(shares.iter().zip(slopes)) {
                over += height * share;
                rise += height * slope * by_spacing;
            }
            let dark = model.dark([p, q]);
            let Tone { linear, log, through } = model.tone(1.0 - dark * c + over);
            let value = model.light([p, q]) * through;
            let slope = model.k[GAMMA] * value / linear;
            let slopes =
                Slopes { share: -slope * dark, dark: -slope * c, light: through, gamma: value * log };
            slopes.put(i, model, &share, [&s, &t], [p, q], &mut out.gradient);
            out.slant[i] = -slope * across * rise;
            for (knot, share) in out.knots.iter_mut().zip(shares) {
                knot[i] = slope * share;
            }
            // What is saturated only says that it is not darker.
            let saturated = batch.value[i] >= TERM.saturated;
            let seen = if saturated { TERM.saturated } else { batch.value[i] };
            let lighter = saturated && value >= TERM.saturated;
            out.r[i] = if lighter { 0.0 } else { seen - value };
            out.root[i] = if lighter { 0.0 } else { batch.root[i] };
        }
        let tukey = biweights(&out.r, &out.gradient[X], &out.gradient[Y], scale);
        out.root = each(|i| out.root[i] * if batch.value[i] >= TERM.saturated { 1.0 } else { tukey[i] });
        out
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::measure::detect::appearance::parameters::{DARK, LIGHT};

    #[test]
    fn derivatives_match_differences() {
        let ellipse = Ellipse { centre: Vector2::new(60.3, 20.2), major: 40.0, minor: 6.0, angle: 0.1 };
        let m: Parameters = std::array::from_fn(|k| {
            [60.3, 20.2, 0.1, 40.0, 6.0, 0.2, 0.9, 120.0, 4.0, 1.0, 0.0, 0.8, 0.0, 0.0, 0.45, 0.02]
                .get(k)
                .copied()
                .unwrap_or(0.0)
        });
        let knots = [0.3, 0.9, 1.4, 0.7];
        let state = |m: Parameters, slant: f64, knots: [f64; 4]| State {
            origin: [60.0, 20.0],
            ellipse: &ellipse,
            m,
            glare: Glare { first: -5.0, slant, knots: knots.to_vec() },
        };
        let mut batch = Batch::new();
        for i in 0..LANES {
            batch.push(i as f32 * 0.4 - 3.0, (i as f32 * 1.7) % 14.0 - 7.0, 120.0);
            let (s, t) =
                ellipse.local(Vector2::new(f64::from(batch.x[i]) + 60.0, f64::from(batch.y[i]) + 20.0));
            (batch.p[i], batch.q[i], batch.root[i]) = ((s / 40.0) as f32, (t / 6.0) as f32, 1.0);
        }
        let rows = |state: &State| state.rows(&state.model(), 0, &batch, 1e3);
        let own = rows(&state(m, 0.2, knots));
        let close = |name: &str, by: &Lanes, low: &Rows, high: &Rows, step: f64| {
            for (by, (low, high)) in by.iter().zip(low.r.iter().zip(high.r.iter())) {
                let difference = f64::from(low - high) / (2.0 * step);
                let off = (f64::from(*by) - difference).abs();
                assert!(off < 0.02 * difference.abs() + 0.6, "{name}: {by} against {difference}");
            }
        };
        for k in [X, Y, FIRST, SECOND, BLUR, LIGHT, DARK, GAMMA] {
            let step = if m[k] < 2.0 { 2e-3 } else { 1e-2 };
            let moved = |by: f64| {
                let mut m = m;
                m[k] += by;
                rows(&state(m, 0.2, knots))
            };
            close("parameter", &own.gradient[k], &moved(-step), &moved(step), step);
        }
        let slanted = |by: f64| rows(&state(m, 0.2 + by, knots));
        close("slant", &own.slant, &slanted(-0.01), &slanted(0.01), 0.01);
        for k in 0..4 {
            let raised = |by: f64| {
                rows(&state(m, 0.2, std::array::from_fn(|j| knots[j] + if j == k { by } else { 0.0 })))
            };
            close("knot", &own.knots[k], &raised(-0.01), &raised(0.01), 0.01);
        }
    }
}
