//! Normal equations of terms with knots, and the effect of correlated residuals on the centre.
//!
//! A pixel depends only on the few knots around it. Pixels between the same knots form a cell, whose batches are summed
//! like those of the plain formula; the sums of a cell are then added at the rows and columns of its knots.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2};

use crate::detect::appearance::formula::MarkerModel;
use crate::detect::appearance::parameters::{COMMON, MarkerParameters, X, Y};
use crate::detect::estimate::normal_equations::{
    ColumnProducts, MIN_WEIGHT, NormalMatrix, RowBlock,
};
use crate::detect::estimate::{gauss_newton::MarkerFit, sandwich::ResidualBlocks};
use crate::detect::hypothesis::prior::PriorValue;
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::Pixels;
use crate::detect::simd::batch::{Batch, append_pixel};
use crate::detect::simd::lanes::{Lanes, each, sum_lanes};
use crate::dispatch::wide;

/// Pixels between the same knots.
pub struct KnotCell<const ABOUT: usize> {
    pub knots: [usize; ABOUT],
    pub batches: Vec<Batch>,
}

/// Residuals and derivatives of a batch.
pub struct JacobianRows<const ABOUT: usize> {
    /// Residuals, grey levels.
    pub r: Lanes,
    /// Square roots of the weights, including the robust ones.
    pub root: Lanes,
    /// Derivatives with respect to the parameters of the formula.
    pub gradient: [Lanes; COMMON],
    /// Derivative with respect to the unknown of the term that is not a knot.
    pub shared: Lanes,
    /// Derivatives with respect to the knots around the pixels.
    pub knots: [Lanes; ABOUT],
}

impl<const ABOUT: usize> JacobianRows<ABOUT> {
    /// Creates rows of zeros.
    #[inline(always)]
    pub fn new() -> Self {
        let zero = Lanes::splat(0.0);
        Self {
            r: zero,
            root: zero,
            gradient: [zero; COMMON],
            shared: zero,
            knots: [zero; ABOUT],
        }
    }
}

/// Term of the image formula with knots, of which each pixel depends on `ABOUT`.
pub trait KnotTerm<const ABOUT: usize> {
    /// Number of unknowns in addition to the knots: 0 or 1.
    const SHARED: usize;
    /// Returns the number of knots.
    fn knot_count(&self) -> usize;
    /// Returns the formula without the term.
    fn model(&self) -> MarkerModel;
    /// Returns the residuals and derivatives of a batch.
    fn jacobian_rows(
        &self,
        model: &MarkerModel,
        cell: &KnotCell<ABOUT>,
        batch: &Batch,
        scale: f64,
    ) -> JacobianRows<ABOUT>;
    /// Returns true if a pixel of this grey value is used to estimate the scale of the residuals.
    fn is_used_for_scale(value: f32) -> bool;
}

/// Linearisation of a model with a knot term: normal equations over the parameters in a list, the additional unknown and
/// the knots; and the residual statistics.
pub struct KnotLinearisation {
    pub normal: DMatrix<f64>,
    pub right: DVector<f64>,
    /// Sizes of the residuals from which their scale is estimated, grey levels.
    pub sizes: Vec<f32>,
    /// Sum of the weights.
    pub weight: f64,
    pub square: f64,
}

impl KnotLinearisation {
    /// Adds the prior of the `i`-th unknown, whose present value is `now`.
    pub fn add_prior(&mut self, i: usize, now: f64, prior: PriorValue, scale: f64) {
        let weight = (scale / prior.sigma).powi(2);
        self.normal[(i, i)] += weight + MIN_WEIGHT;
        self.right[i] += weight * (prior.value - now);
    }

    /// Variance of a residual of weight 1 in a fit with `count` free parameters of the formula.
    pub fn variance(&self, count: usize) -> f64 {
        self.square / (self.weight - count as f64).max(1.0)
    }
}

/// Covariance and influence of the centre in a linearisation.
pub struct CentreEstimate {
    /// Rows of the inverse normal matrix for the centre.
    pub influence: [DVector<f64>; 2],
    /// Covariance of the centre for uncorrelated residuals, px^2.
    pub white: Matrix2<f64>,
}

impl CentreEstimate {
    /// Computes the estimate from the factor of normal equations over the parameters in a list and a term's unknowns, and
    /// the variance of a residual. Returns `None` if the centre is not in the list.
    pub fn from_factor(factor: &Cholesky<f64, Dyn>, list: &[usize], variance: f64) -> Option<Self> {
        let slot = |k: usize| list.iter().position(|&l| l == k);
        let slots = [slot(X)?, slot(Y)?];
        let unknowns = factor.l_dirty().nrows();
        let influence =
            slots.map(|at| factor.solve(&DVector::from_fn(unknowns, |i, _| f64::from(i == at))));
        let white = Matrix2::from_fn(|i, j| influence[j][slots[i]] * variance);
        Some(Self { influence, white })
    }

    /// Returns the fit at parameters `m`. `blocks` holds the contributions of the residuals to the centre, `weight` is the
    /// sum of the pixels' own weights.
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
            is_systematic: false,
        })
    }
}

/// Lower triangle and right-hand side: the shared parameters, then the knots.
struct BorderedNormal {
    normal: DMatrix<f64>,
    right: DVector<f64>,
    shared: usize,
}

impl BorderedNormal {
    /// Creates zero normal equations.
    fn new(shared: usize, knots: usize) -> Self {
        let all = shared + knots;
        Self {
            normal: DMatrix::zeros(all, all),
            right: DVector::zeros(all),
            shared,
        }
    }

    /// Adds the sums of a cell for the knots around it, the first columns of the products, and clears these columns.
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

    /// Sets the sums of all pixels for the shared parameters: the columns of the products after those of `about` knots.
    #[inline(always)]
    fn set_shared(&mut self, sums: &ColumnProducts, about: usize) {
        let n = self.shared;
        let mut totals = sums
            .totals()
            .skip((0..about).map(|i| about + n + 1 - i).sum());
        for i in 0..n {
            for j in i..n {
                self.normal[(j, i)] = totals.next().unwrap_or(0.0);
            }
            self.right[i] = totals.next().unwrap_or(0.0);
        }
    }
}

/// Groups pixels, given by batch and lane, by the knots around them. `place` returns the number of a pixel's cell, below
/// `count`, and its knots.
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
        let Some((key, knots)) = place(batch, i) else {
            continue;
        };
        let Some(own) = index.get_mut(key) else {
            continue;
        };
        if *own == usize::MAX {
            *own = out.len();
            out.push(KnotCell {
                knots,
                batches: Vec::new(),
            });
        }
        append_pixel(&mut out[*own].batches, batch, i);
    }
    out.iter_mut()
        .flat_map(|cell| &mut cell.batches)
        .for_each(Batch::fill_lanes);
    out
}

/// Input of a linearisation: a term over cells of pixels, the parameters of the formula in a list, and the scale of the
/// residuals.
pub struct KnotProblem<'a, T, const ABOUT: usize> {
    pub cells: &'a [KnotCell<ABOUT>],
    pub term: &'a T,
    pub list: &'a [usize],
    pub scale: f64,
}

wide! {
    /// Returns the normal equations without priors.
    pub fn linearise_term[T: KnotTerm<ABOUT>, const ABOUT: usize](over: KnotProblem<T, ABOUT>) -> KnotLinearisation = linearise_term_generic
}

#[inline(always)]
fn linearise_term_generic<T: KnotTerm<ABOUT>, const ABOUT: usize>(
    over: KnotProblem<T, ABOUT>,
) -> KnotLinearisation {
    let KnotProblem {
        cells,
        term,
        list,
        scale,
    } = over;
    let n = list.len() + T::SHARED;
    let model = term.model();
    let mut bordered = BorderedNormal::new(n, term.knot_count());
    let mut sizes = Vec::new();
    let (mut weight, mut square) = (Lanes::splat(0.0), Lanes::splat(0.0));
    let (mut block, mut sums) = (RowBlock::new(), ColumnProducts::new(ABOUT + n));
    for cell in cells {
        for batch in &cell.batches {
            let rows = term.jacobian_rows(&model, cell, batch, scale);
            weight = each(|i| weight[i] + rows.root[i] * rows.root[i]);
            square = each(|i| square[i] + (rows.root[i] * rows.r[i]) * (rows.root[i] * rows.r[i]));
            let used = (0..batch.len).filter(|&i| T::is_used_for_scale(batch.value[i]));
            sizes.extend(used.map(|i| rows.r[i].abs()));
            let own = list.iter().map(|&k| &rows.gradient[k]);
            let shared = [&rows.shared].into_iter().take(T::SHARED);
            if block.push(
                &rows.root,
                rows.knots.iter().chain(own).chain(shared).chain([&rows.r]),
            ) {
                block.flush(&mut sums);
            }
        }
        block.flush(&mut sums);
        bordered.add_cell(&mut sums, cell.knots);
    }
    bordered.set_shared(&sums, ABOUT);
    let BorderedNormal {
        mut normal, right, ..
    } = bordered;
    normal.fill_upper_triangle_with_lower_triangle();
    KnotLinearisation {
        normal,
        right,
        sizes,
        weight: sum_lanes(&weight),
        square: sum_lanes(&square),
    }
}

wide! {
    /// Adds the contributions of the residuals of each batch to the centre, given its rows of the inverse normal matrix.
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
    let KnotProblem {
        cells,
        term,
        list,
        scale,
    } = over;
    let model = term.model();
    for cell in cells {
        for batch in &cell.batches {
            let rows = term.jacobian_rows(&model, cell, batch, scale);
            let mut by = [Lanes::splat(0.0); 2];
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
