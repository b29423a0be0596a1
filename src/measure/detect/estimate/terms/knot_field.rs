//! What terms with knots have in common: their normal equations, and what correlated residuals do to the centre.
//!
//! A pixel knows the few knots about it only. Pixels between the same knots are a cell, whose batches are summed as those of the
//! plain formula are; the cells' sums are then put where their knots stand.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2};

use crate::detect::appearance::formula::MarkerModel;
use crate::detect::appearance::parameters::{COMMON, MarkerParameters, X, Y};
use crate::detect::estimate::normal_equations::{RowBlock, MIN_WEIGHT, ColumnProducts, NormalMatrix};
use crate::detect::estimate::{gauss_newton::MarkerFit, sandwich::ResidualBlocks};
use crate::detect::hypothesis::prior::PriorValue;
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::Pixels;
use crate::detect::simd::batch::{Batch, append};
use crate::detect::simd::dispatch::wide;
use crate::detect::simd::lanes::{Lanes, each, total};

/// Pixels between the same knots.
pub struct KnotCell<const ABOUT: usize> {
    pub knots: [usize; ABOUT],
    pub batches: Vec<Batch>,
}

/// What a batch says.
pub struct JacobianRows<const ABOUT: usize> {
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

impl<const ABOUT: usize> JacobianRows<ABOUT> {
    /// All zero.
    #[inline(always)]
    pub fn new() -> Self {
        let zero = Lanes::of(0.0);
        Self { r: zero, root: zero, gradient: [zero; COMMON], shared: zero, knots: [zero; ABOUT] }
    }
}

/// A term of the image formula with knots, of which a pixel knows `ABOUT`.
pub trait KnotTerm<const ABOUT: usize> {
    /// Unknowns beside the knots: none, or one.
    const SHARED: usize;
    /// Knots.
    fn knot_count(&self) -> usize;
    /// The formula without the term.
    fn model(&self) -> MarkerModel;
    /// One batch's rows.
    fn jacobian_rows(&self, model: &MarkerModel, cell: &KnotCell<ABOUT>, batch: &Batch, scale: f64) -> JacobianRows<ABOUT>;
    /// Whether a pixel of some grey value tells the residuals' scale.
    fn constrains_scale(value: f32) -> bool;
}

/// A linearisation: normal equations over the parameters of a list, what the term has beside its knots, and the knots; and the
/// residuals' statistics.
pub struct KnotLinearisation {
    pub normal: DMatrix<f64>,
    pub right: DVector<f64>,
    /// Sizes of the residuals that tell their scale, grey levels.
    pub sizes: Vec<f32>,
    /// Sum of the weights, and of the weighted squares.
    pub weight: f64,
    pub square: f64,
}

impl KnotLinearisation {
    /// Adds what is known beforehand of the `i`-th unknown, which has some value now.
    pub fn add_prior(&mut self, i: usize, now: f64, prior: PriorValue, scale: f64) {
        let weight = (scale / prior.sigma).powi(2);
        self.normal[(i, i)] += weight + MIN_WEIGHT;
        self.right[i] += weight * (prior.value - now);
    }

    /// Variance of a residual of weight 1, `count` of the formula's parameters being sought.
    pub fn variance(&self, count: usize) -> f64 {
        self.square / (self.weight - count as f64).max(1.0)
    }
}

/// What a linearisation says of the centre.
pub struct CentreEstimate {
    /// Its rows of the inverse normal equations.
    pub influence: [DVector<f64>; 2],
    /// Its covariance if no residuals hung together, px^2.
    pub white: Matrix2<f64>,
}

impl CentreEstimate {
    /// From the factor of normal equations over the parameters of a list and a term's unknowns, and a residual's variance.
    pub fn from_factor(factor: &Cholesky<f64, Dyn>, list: &[usize], variance: f64) -> Option<Self> {
        let slot = |k: usize| list.iter().position(|&l| l == k);
        let slots = [slot(X)?, slot(Y)?];
        let unknowns = factor.l_dirty().nrows();
        let influence = slots.map(|at| factor.solve(&DVector::from_fn(unknowns, |i, _| f64::from(i == at))));
        let white = Matrix2::from_fn(|i, j| influence[j][slots[i]] * variance);
        Some(Self { influence, white })
    }

    /// The fit that ends at some parameters: `blocks` is what the residuals did to the centre, `weight` the sum of the pixels'
    /// own weights.
    pub fn to_marker_fit(
        &self,
        m: &MarkerParameters,
        step: &KnotLinearisation,
        count: usize,
        blocks: &ResidualBlocks,
        weight: f64,
    ) -> Option<MarkerFit> {
        let (centre, _, correlation) = blocks.raise_covariance(&self.white, count)?;
        let mut covariance = NormalMatrix::zeros();
        covariance.fixed_view_mut::<2, 2>(X, X).copy_from(&centre);
        Some(MarkerFit {
            parameters: *m,
            covariance,
            variance: step.variance(count),
            rms: (step.square / step.weight.max(TINY)).sqrt(),
            inliers: step.weight / weight,
            start: *m,
            images: Vec::new(),
            correlation,
            white: self.white,
            foreign_covariance: Matrix2::zeros(),
            is_systematic: false,
        })
    }
}

/// Lower triangle and right side: the shared parameters, then the knots.
struct BorderedNormal {
    normal: DMatrix<f64>,
    right: DVector<f64>,
    shared: usize,
}

impl BorderedNormal {
    /// Zero.
    fn new(shared: usize, knots: usize) -> Self {
        let all = shared + knots;
        Self { normal: DMatrix::zeros(all, all), right: DVector::zeros(all), shared }
    }

    /// Adds what a cell's pixels say of the knots about them, which are the first columns of the products and are then forgotten.
    #[inline(always)]
    fn add_cell<const ABOUT: usize>(&mut self, sums: &mut ColumnProducts, knots: [usize; ABOUT]) {
        let mut totals = sums.totals();
        let knots = knots.map(|k| self.shared + k);
        for (i, &a) in knots.iter().enumerate() {
            for &b in &knots[i..] {
                self.normal[(a.max(b), a.min(b))] += totals.next().unwrap_or(0.0);
            }
            for k in 0..self.shared {
                self.normal[(a, k)] += totals.next().unwrap_or(0.0);
            }
            self.right[a] += totals.next().unwrap_or(0.0);
        }
        drop(totals);
        sums.clear_columns(ABOUT);
    }

    /// Sets what all pixels say of the shared parameters, which are the products' columns after so many of knots.
    #[inline(always)]
    fn set_shared(&mut self, sums: &ColumnProducts, about: usize) {
        let n = self.shared;
        let mut totals = sums.totals().skip((0..about).map(|i| about + n + 1 - i).sum());
        for i in 0..n {
            for j in i..n {
                self.normal[(j, i)] = totals.next().unwrap_or(0.0);
            }
            self.right[i] = totals.next().unwrap_or(0.0);
        }
    }
}

/// The pixels of some batches by the knots about them; `place` tells a cell's number, of so many, and its knots.
pub fn group_by_knots<const ABOUT: usize>(
    pixels: &Pixels,
    own: impl Iterator<Item = [usize; 2]>,
    count: usize,
    place: impl Fn(&Batch, usize) -> Option<(usize, [usize; ABOUT])>,
) -> Vec<KnotCell<ABOUT>> {
    let mut out: Vec<KnotCell<ABOUT>> = Vec::new();
    let mut index = vec![usize::MAX; count];
    for [k, i] in own {
        let batch = &pixels.batches[k];
        let Some((key, knots)) = place(batch, i) else { continue };
        let Some(own) = index.get_mut(key) else { continue };
        if *own == usize::MAX {
            *own = out.len();
            out.push(KnotCell { knots, batches: Vec::new() });
        }
        append(&mut out[*own].batches, batch, i);
    }
    out.iter_mut().flat_map(|cell| &mut cell.batches).for_each(Batch::fill);
    out
}

/// What is linearised: a term over cells of pixels, by the formula's parameters of a list, with residuals of some scale.
pub struct KnotProblem<'a, T, const ABOUT: usize> {
    pub cells: &'a [KnotCell<ABOUT>],
    pub term: &'a T,
    pub list: &'a [usize],
    pub scale: f64,
}

wide! {
    /// The normal equations without what is known beforehand.
    pub fn linearise_term[T: KnotTerm<ABOUT>, const ABOUT: usize](over: KnotProblem<T, ABOUT>) -> KnotLinearisation = linearise_term_generic
}

#[inline(always)]
fn linearise_term_generic<T: KnotTerm<ABOUT>, const ABOUT: usize>(over: KnotProblem<T, ABOUT>) -> KnotLinearisation {
    let KnotProblem { cells, term, list, scale } = over;
    let n = list.len() + T::SHARED;
    let model = term.model();
    let mut sought = BorderedNormal::new(n, term.knot_count());
    let mut sizes = Vec::new();
    let (mut weight, mut square) = (Lanes::of(0.0), Lanes::of(0.0));
    let (mut block, mut sums) = (RowBlock::new(), ColumnProducts::new(ABOUT + n));
    for cell in cells {
        for batch in &cell.batches {
            let rows = term.jacobian_rows(&model, cell, batch, scale);
            weight = each(|i| weight[i] + rows.root[i] * rows.root[i]);
            square = each(|i| square[i] + (rows.root[i] * rows.r[i]) * (rows.root[i] * rows.r[i]));
            let telling = (0..batch.len).filter(|&i| T::constrains_scale(batch.value[i]));
            sizes.extend(telling.map(|i| rows.r[i].abs()));
            let own = list.iter().map(|&k| &rows.gradient[k]);
            let shared = [&rows.shared].into_iter().take(T::SHARED);
            if block.push(&rows.root, rows.knots.iter().chain(own).chain(shared).chain([&rows.r])) {
                block.flush(&mut sums);
            }
        }
        block.flush(&mut sums);
        sought.add_cell(&mut sums, cell.knots);
    }
    sought.set_shared(&sums, ABOUT);
    let BorderedNormal { mut normal, right, .. } = sought;
    normal.fill_upper_triangle_with_lower_triangle();
    KnotLinearisation { normal, right, sizes, weight: total(&weight), square: total(&square) }
}

wide! {
    /// Adds what the residuals of each batch did to the centre, from its rows of the inverse normal equations.
    pub fn add_centre_shifts[T: KnotTerm<ABOUT>, const ABOUT: usize](
        over: KnotProblem<T, ABOUT>, influence: &[DVector<f64>; 2], blocks: &mut ResidualBlocks
    ) = add_centre_shifts_generic
}

#[inline(always)]
fn add_centre_shifts_generic<T: KnotTerm<ABOUT>, const ABOUT: usize>(
    over: KnotProblem<T, ABOUT>,
    influence: &[DVector<f64>; 2],
    blocks: &mut ResidualBlocks,
) {
    let KnotProblem { cells, term, list, scale } = over;
    let model = term.model();
    for cell in cells {
        for batch in &cell.batches {
            let rows = term.jacobian_rows(&model, cell, batch, scale);
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
