//! What terms with knots have in common: their normal equations, and what correlated residuals do to the centre.
//!
//! A pixel knows the few knots about it only. Pixels between the same knots are a cell, whose batches are summed as those of the
//! plain formula are; the cells' sums are then put where their knots stand.

use nalgebra::{DMatrix, DVector};

use crate::measure::detect::appearance::formula::Model;
use crate::measure::detect::appearance::parameters::COMMON;
use crate::measure::detect::estimate::bordered::Bordered;
use crate::measure::detect::estimate::normal_equations::{Block, Products};
use crate::measure::detect::estimate::sandwich::Blocks;
use crate::measure::detect::sample::pixels::Pixels;
use crate::measure::detect::simd::batch::{Batch, append};
use crate::measure::detect::simd::lanes::{Lanes, each, total};

/// Pixels between the same knots.
pub struct Cell<const ABOUT: usize> {
    pub knots: [usize; ABOUT],
    pub batches: Vec<Batch>,
}

/// What a batch says.
pub struct Rows<const ABOUT: usize> {
    /// Residuals, grey levels.
    pub r: Lanes,
    /// Roots of the weights, robust ones included.
    pub root: Lanes,
    /// Derivatives by the formula's parameters.
    pub gradient: [Lanes; COMMON],
    /// Derivative by what the term has beside its knots.
    pub shared: Lanes,
    /// Derivatives by the knots about.
    pub knots: [Lanes; ABOUT],
}

impl<const ABOUT: usize> Rows<ABOUT> {
    /// All zero.
    #[inline(always)]
    pub fn new() -> Self {
        let zero = Lanes::of(0.0);
        Self { r: zero, root: zero, gradient: [zero; COMMON], shared: zero, knots: [zero; ABOUT] }
    }
}

/// A term of the image formula with knots, of which a pixel knows `ABOUT`.
pub trait Term<const ABOUT: usize> {
    /// Unknowns beside the knots: none, or one.
    const SHARED: usize;
    /// Knots.
    fn count(&self) -> usize;
    /// The formula without the term.
    fn model(&self) -> Model;
    /// One batch's rows.
    fn rows(&self, model: &Model, cell: &Cell<ABOUT>, batch: &Batch, scale: f64) -> Rows<ABOUT>;
    /// Whether a pixel of some grey value tells the residuals' scale.
    fn tells(value: f32) -> bool;
}

/// A linearisation: normal equations over the parameters of a list, what the term has beside its knots, and the knots; and the
/// residuals' statistics.
pub struct Step {
    pub normal: DMatrix<f64>,
    pub right: DVector<f64>,
    /// Sizes of the residuals that tell their scale, grey levels.
    pub sizes: Vec<f32>,
    /// Sum of the weights, and of the weighted squares.
    pub weight: f64,
    pub square: f64,
}

impl Step {
    /// Adds what is known beforehand of the `i`-th unknown, which has some value now: its prior, with a standard deviation.
    pub fn hold(&mut self, i: usize, now: f64, (prior, deviation): (f64, f64), scale: f64) {
        let weight = (scale / deviation).powi(2);
        self.normal[(i, i)] += weight + LEAST;
        self.right[i] += weight * (prior - now);
    }
}

/// Least weight of an unknown, so that what nothing tells stays where it is: a part in 10^12 of one grey level's.
const LEAST: f64 = 1e-12;

/// The pixels of some batches by the knots about them; `place` tells a cell's number, of so many, and its knots.
pub fn cells<const ABOUT: usize>(
    pixels: &Pixels,
    own: impl Iterator<Item = [usize; 2]>,
    count: usize,
    place: impl Fn(&Batch, usize) -> Option<(usize, [usize; ABOUT])>,
) -> Vec<Cell<ABOUT>> {
    let mut out: Vec<Cell<ABOUT>> = Vec::new();
    let mut index = vec![usize::MAX; count];
    for [k, i] in own {
        let batch = &pixels.batches[k];
        let Some((key, knots)) = place(batch, i) else { continue };
        let Some(own) = index.get_mut(key) else { continue };
        if *own == usize::MAX {
            *own = out.len();
            out.push(Cell { knots, batches: Vec::new() });
        }
        append(&mut out[*own].batches, batch, i);
    }
    out.iter_mut().flat_map(|cell| &mut cell.batches).for_each(Batch::fill);
    out
}

/// The normal equations without what is known beforehand.
#[inline(always)]
pub fn linearise<T: Term<ABOUT>, const ABOUT: usize>(
    cells: &[Cell<ABOUT>],
    term: &T,
    list: &[usize],
    scale: f64,
) -> Step {
    let n = list.len() + T::SHARED;
    let model = term.model();
    let mut sought = Bordered::new(n, term.count());
    let mut sizes = Vec::new();
    let (mut weight, mut square) = (Lanes::of(0.0), Lanes::of(0.0));
    let (mut block, mut sums) = (Block::new(), Products::new(ABOUT + n));
    for cell in cells {
        for batch in &cell.batches {
            let rows = term.rows(&model, cell, batch, scale);
            weight = each(|i| weight[i] + rows.root[i] * rows.root[i]);
            square = each(|i| square[i] + (rows.root[i] * rows.r[i]) * (rows.root[i] * rows.r[i]));
            let telling = (0..batch.len).filter(|&i| T::tells(batch.value[i]));
            sizes.extend(telling.map(|i| rows.r[i].abs()));
            let own = list.iter().map(|&k| &rows.gradient[k]);
            let shared = [&rows.shared].into_iter().take(T::SHARED);
            if block.push(&rows.root, rows.knots.iter().chain(own).chain(shared).chain([&rows.r])) {
                block.flush(&mut sums);
            }
        }
        block.flush(&mut sums);
        sought.take(&mut sums, cell.knots);
    }
    sought.finish(&sums, ABOUT);
    let Bordered { mut normal, right, .. } = sought;
    normal.fill_upper_triangle_with_lower_triangle();
    Step { normal, right, sizes, weight: total(&weight), square: total(&square) }
}

/// What the residuals of each batch did to the centre, from the centre's rows of the inverse normal equations.
#[inline(always)]
pub fn add_up_blocks<T: Term<ABOUT>, const ABOUT: usize>(
    cells: &[Cell<ABOUT>],
    term: &T,
    list: &[usize],
    influence: &[DVector<f64>; 2],
    scale: f64,
    blocks: &mut Blocks,
) {
    let model = term.model();
    for cell in cells {
        for batch in &cell.batches {
            let rows = term.rows(&model, cell, batch, scale);
            let mut by = [Lanes::of(0.0); 2];
            for (sum, h) in by.iter_mut().zip(influence) {
                let knots = cell.knots.iter().map(|k| h[list.len() + T::SHARED + k]);
                for (g, h) in rows.knots.iter().zip(knots) {
                    *sum = each(|i| sum[i] + h as f32 * g[i]);
                }
                let own = list.iter().map(|&k| &rows.gradient[k]);
                let own = own.chain([&rows.shared].into_iter().take(T::SHARED));
                for (g, h) in own.zip(h.iter()) {
                    *sum = each(|i| sum[i] + *h as f32 * g[i]);
                }
                *sum = each(|i| sum[i] * rows.root[i] * rows.root[i] * rows.r[i]);
            }
            blocks.add(batch, by);
        }
    }
}
