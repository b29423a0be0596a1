//! Linearisation of the image model on the pixels of a fit: normal equations with robust weights.

use nalgebra::{SMatrix, SVector};

use super::prior::FitUnknowns;
use super::scale::ResidualSizes;
use crate::detect::appearance::formula::{MarkerModel, grey_values};
use crate::detect::appearance::overshoot::{self, SharpenedModel, is_sharpened};
use crate::detect::appearance::parameters::{GreyBatch, MarkerParameters, N, X, Y};
use crate::detect::appearance::quadrants;
use crate::detect::estimate::options::{ITERATION, WEIGHT};
use crate::detect::hypothesis::prior::PriorValue;
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::Pixels;
use crate::detect::simd::lanes::{LANES, Lanes, each, sum_lanes};
use crate::dispatch::wide;

/// Matrix of the normal equations of all marker parameters.
pub type NormalMatrix = SMatrix<f64, N, N>;

/// Vector over all marker parameters.
pub type ParameterVector = SVector<f64, N>;

/// Minimum weight of an unknown, so that an undetermined one keeps its value: 10^-12 of the weight of one grey level.
pub const MIN_WEIGHT: f64 = 1e-12;

/// Normal equations and residual statistics of one linearisation.
pub struct Linearisation {
    pub normal: NormalMatrix,
    pub right: ParameterVector,
    pub scale: f64,
    pub weight: f64,
    /// Sum of the derivatives of the influence function, corresponding to the sum of the weights.
    curvature: f64,
    pub square: f64,
}

impl Linearisation {
    /// Variance of a residual of weight 1 in a fit with `count` free parameters.
    pub fn variance(&self, count: usize) -> f64 {
        self.square / (self.weight - count as f64).max(1.0)
    }

    /// Fraction of the sum of squared residuals that a step removes if the model is linear.
    pub fn predicted_reduction(&self, change: &ParameterVector) -> f64 {
        change.dot(&self.right) / self.square.max(TINY)
    }

    /// Factor by which a step is too short because the weights depend on the residuals.
    pub fn step_gain(&self) -> f64 {
        (self.weight / self.curvature.max(TINY)).clamp(1.0, ITERATION.max_gain)
    }

    /// Weighted root mean square of the residuals, grey levels.
    pub fn rms(&self) -> f64 {
        (self.square / self.weight.max(TINY)).sqrt()
    }
}

/// Rows of the weighted Jacobian, stored by column with the residuals last, whose products have not been summed yet.
pub struct RowBlock {
    columns: [[Lanes; BLOCK_BATCHES]; MAX_COLUMNS],
    batches: usize,
}

/// Maximum number of columns: the parameters, or the common ones with those of a field's knots around a pixel, and the
/// residuals.
const MAX_COLUMNS: usize = N + 1;
/// Batches per block.
const BLOCK_BATCHES: usize = 8;

/// Sums of products of columns, by lane: of each column with itself and all later ones. The residuals are the last column.
#[derive(Debug, PartialEq)]
pub struct ColumnProducts {
    columns: usize,
    sums: Vec<Lanes>,
}

impl ColumnProducts {
    /// Creates zero sums for a number of columns and the residuals.
    pub fn new(columns: usize) -> Self {
        Self {
            columns,
            sums: vec![Lanes::splat(0.0); (columns + 1) * columns / 2 + columns],
        }
    }

    /// Totals over the lanes, column by column.
    pub fn totals(&self) -> impl Iterator<Item = f64> {
        self.sums.iter().map(sum_lanes)
    }

    /// Sets the sums of the first columns to zero.
    pub fn clear_columns(&mut self, columns: usize) {
        let first = (0..columns).map(|i| self.columns + 1 - i).sum();
        self.sums
            .iter_mut()
            .take(first)
            .for_each(|sum| *sum = Lanes::splat(0.0));
    }
}

impl RowBlock {
    /// Creates a block without rows.
    pub fn new() -> Self {
        Self {
            columns: [[Lanes::splat(0.0); BLOCK_BATCHES]; MAX_COLUMNS],
            batches: 0,
        }
    }

    /// Appends the weighted columns of a batch, residuals last. Returns true if the block is full.
    #[inline(always)]
    pub fn push<'a>(&mut self, root: &Lanes, columns: impl Iterator<Item = &'a Lanes>) -> bool {
        let k = self.batches % BLOCK_BATCHES;
        for (out, column) in self.columns.iter_mut().zip(columns) {
            out[k] = each(|i| root[i] * column[i]);
        }
        self.batches = k + 1;
        self.batches == BLOCK_BATCHES
    }

    /// Adds the products of the columns with one another and with the residuals to `sums`; empties the block.
    #[inline(always)]
    pub fn flush(&mut self, sums: &mut ColumnProducts) {
        let n = sums.columns;
        let mut rest = &mut sums.sums[..];
        for column in &mut self.columns[..=n] {
            column[self.batches..].fill(Lanes::splat(0.0));
        }
        // Two columns at a time: the later ones are read half as often.
        for i in (0..n).step_by(2) {
            let (own, later) = rest.split_at_mut(n + 1 - i);
            let (next, later) = later.split_at_mut(if i + 1 < n { n - i } else { 0 });
            let (one, others) = (&self.columns[i], &self.columns[i..=n]);
            if let [square, own @ ..] = own {
                add_batch_products(square, one, one);
                if next.is_empty() {
                    for (sum, column) in own.iter_mut().zip(&others[1..]) {
                        add_batch_products(sum, one, column);
                    }
                }
                for ((sum, next), column) in own.iter_mut().zip(next).zip(&others[1..]) {
                    add_two_products(sum, next, [one, &others[1]], column);
                }
            }
            rest = later;
        }
        self.batches = 0;
    }
}

#[inline(always)]
fn add_batch_products(
    sum: &mut Lanes,
    one: &[Lanes; BLOCK_BATCHES],
    other: &[Lanes; BLOCK_BATCHES],
) {
    let mut lanes = *sum;
    for (x, y) in one.iter().zip(other) {
        for (lane, (p, q)) in lanes.iter_mut().zip(x.iter().zip(y.iter())) {
            *lane = p.mul_add(*q, *lane);
        }
    }
    *sum = lanes;
}

/// Adds the products of two columns with a third.
#[inline(always)]
fn add_two_products(
    sum: &mut Lanes,
    next: &mut Lanes,
    [one, two]: [&[Lanes; BLOCK_BATCHES]; 2],
    other: &[Lanes; BLOCK_BATCHES],
) {
    let (mut lanes, mut lanes_next) = (*sum, *next);
    for ((x, y), z) in one.iter().zip(two).zip(other) {
        for i in 0..LANES {
            lanes[i] = x[i].mul_add(z[i], lanes[i]);
            lanes_next[i] = y[i].mul_add(z[i], lanes_next[i]);
        }
    }
    (*sum, *next) = (lanes, lanes_next);
}

/// Grey values and derivatives of the image model for the batches of a fit.
pub type BatchImages = Vec<GreyBatch>;

/// Sums of a linearisation: products of the columns with one another and with the residuals, and the residual statistics.
#[derive(Debug, PartialEq)]
struct LinearisationSums {
    products: ColumnProducts,
    scale: f64,
    weight: f64,
    curvature: f64,
    square: f64,
}

/// Returns the normal equations at `m`, with biweights for residuals relative to `scale`, and stores the grey values in
/// `images` if given.
pub fn linearise_model(
    pixels: &Pixels,
    m: &MarkerParameters,
    unknowns: &FitUnknowns,
    scale: f64,
    floor: f64,
    images: Option<&mut BatchImages>,
) -> Linearisation {
    // Collecting into an array here takes the compiler minutes.
    let list: &[usize] = &(0..N).filter(|&k| unknowns.free[k]).collect::<Vec<_>>();
    let sums = sum_batches(pixels, m, list, scale, images);
    let mut normal = NormalMatrix::zeros();
    let mut right = ParameterVector::zeros();
    let mut totals = sums.products.totals();
    for (i, &k) in list.iter().enumerate() {
        for (&l, sum) in list[i..].iter().zip(&mut totals) {
            normal[(k, l)] = sum;
            normal[(l, k)] = sum;
        }
        right[k] = totals.next().unwrap_or(0.0);
    }
    for &k in list {
        let PriorValue { value, sigma } = unknowns.prior[k];
        let weight = (scale / sigma).powi(2);
        normal[(k, k)] += weight;
        right[k] += weight * (value - m[k]);
    }
    Linearisation {
        normal,
        right,
        scale: sums.scale.max(floor),
        weight: sums.weight,
        curvature: sums.curvature,
        square: sums.square,
    }
}

wide! {
    /// Sums over all batches for the parameters in a list.
    fn sum_batches(
        pixels: &Pixels, m: &MarkerParameters, list: &[usize], scale: f64, images: Option<&mut BatchImages>
    ) -> LinearisationSums
        = Pixels::sum_linearised_batches
}

impl Pixels {
    #[inline(always)]
    fn sum_linearised_batches(
        &self,
        m: &MarkerParameters,
        list: &[usize],
        scale: f64,
        images: Option<&mut BatchImages>,
    ) -> LinearisationSums {
        // One loop for each model: a loop for both is slower for both, and a model passed as a function
        // is compiled without the processor's wide registers.
        match (self.outlined, is_sharpened(m)) {
            (false, false) => self.sum_batches_of_model::<false, false>(m, list, scale, images),
            (true, false) => self.sum_batches_of_model::<true, false>(m, list, scale, images),
            (false, true) => self.sum_batches_of_model::<false, true>(m, list, scale, images),
            (true, true) => self.sum_batches_of_model::<true, true>(m, list, scale, images),
        }
    }

    #[inline(always)]
    fn sum_batches_of_model<const OUTLINED: bool, const SHARPENED: bool>(
        &self,
        m: &MarkerParameters,
        list: &[usize],
        scale: f64,
        mut images: Option<&mut BatchImages>,
    ) -> LinearisationSums {
        if let Some(images) = &mut images {
            images.resize_with(self.batches.len(), GreyBatch::new);
        }
        let mut discarded = GreyBatch::new();
        let model = MarkerModel::new(self.pattern, m, self.origin);
        let sharpened = SHARPENED.then(|| {
            SharpenedModel::new(
                MarkerModel::new(self.pattern, m, self.origin),
                m,
                self.origin,
            )
        });
        let mut copy = SHARPENED.then(GreyBatch::new);
        let mut sums = ColumnProducts::new(list.len());
        let mut block = RowBlock::new();
        let (mut weight, mut curvature, mut square) =
            (Lanes::splat(0.0), Lanes::splat(0.0), Lanes::splat(0.0));
        let mut sizes = ResidualSizes::new(self.batches.len());
        for (k, batch) in self.batches.iter().enumerate() {
            let image = images
                .as_mut()
                .and_then(|images| images.get_mut(k))
                .unwrap_or(&mut discarded);
            match (&sharpened, &mut copy) {
                (Some(model), Some(copy)) if OUTLINED => {
                    overshoot::sharpened_outlined_grey_values(model, batch, image, copy)
                }
                (Some(model), Some(copy)) => {
                    overshoot::sharpened_grey_values(model, batch, image, copy)
                }
                _ if OUTLINED => quadrants::outlined_grey_values(&model, batch, image),
                _ => grey_values(&model, batch, image),
            }
            let r = each(|i| batch.value[i] - image.value[i]);
            let tukey = biweight_roots(&r, &image.gradient[X], &image.gradient[Y], scale);
            let root = each(|i| batch.root[i] * tukey[i]);
            sizes.add(&r, &batch.root);
            for i in 0..LANES {
                weight[i] += root[i] * root[i];
                // The biweight's influence is (1 - u^2)^2 r, and `tukey` 1 - u^2.
                curvature[i] += batch.root[i] * root[i] * (5.0 * tukey[i] - 4.0);
                square[i] += (root[i] * r[i]) * (root[i] * r[i]);
            }
            let columns = list.iter().map(|&k| image.derivative(k)).chain([&r]);
            if block.push(&root, columns) {
                block.flush(&mut sums);
            }
        }
        block.flush(&mut sums);
        LinearisationSums {
            products: sums,
            scale: sizes.sigma(scale),
            weight: sum_lanes(&weight),
            curvature: sum_lanes(&curvature),
            square: sum_lanes(&square),
        }
    }
}

/// Square roots of Tukey's biweights.
#[inline(always)]
pub fn biweight_roots(r: &Lanes, by_x: &Lanes, by_y: &Lanes, scale: f64) -> Lanes {
    let (scale2, jitter2) = (
        (scale * scale) as f32,
        (WEIGHT.edge_jitter_px * WEIGHT.edge_jitter_px) as f32,
    );
    let cut2 = (WEIGHT.cut_scales * WEIGHT.cut_scales) as f32;
    each(|i| {
        let edge2 = jitter2 * (by_x[i] * by_x[i] + by_y[i] * by_y[i]);
        let root = 1.0 - r[i] * r[i] / (cut2 * (scale2 + edge2));
        if root > 0.0 { root } else { 0.0 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::appearance::parameters::MarkerPattern;
    use crate::detect::sample::pixels::{PixelKind, Sorter};
    use crate::detect::simd::batch::Batch;

    #[test]
    fn every_processor_gives_the_same_bits() {
        let shapes = [
            (
                MarkerPattern::Disc,
                false,
                [20.3, 19.8, -0.4, 30.0, 4.0, 0.4, 0.8],
            ),
            (
                MarkerPattern::Disc,
                false,
                [20.3, 19.8, 0.3, 20.0, 15.0, 0.0, 0.8],
            ),
            (
                MarkerPattern::WhiteAlong,
                false,
                [20.3, 19.8, -0.4, 0.1, 4e-4, 2e-4, 0.8],
            ),
            (
                MarkerPattern::BlackAlong,
                true,
                [20.3, 19.8, -0.4, 0.3, 4e-4, 2e-4, 1.8],
            ),
        ];
        let plain_and_sharpened = [[0.0, 0.0], [0.7, 1.3]].into_iter();
        for ((pattern, rim, shape), halo) in
            plain_and_sharpened.flat_map(|halo| shapes.map(|shape| (shape, halo)))
        {
            let light = [180.0, 6.0, -3.0, 2.0, 0.7, 0.05, -0.02, 0.5, 0.02];
            let narrow = [30.0, 8.0, 0.1, 0.3, -0.2, 0.5, 0.05, -0.04];
            let m: Vec<f64> = shape
                .into_iter()
                .chain(light)
                .chain(halo)
                .chain(narrow)
                .collect();
            let m: MarkerParameters = std::array::from_fn(|k| m[k]);
            let mut sorter = Sorter::new(pattern, [20.0, 20.0]);
            let mut batch = Batch::new();
            for i in 0..1500u32 {
                let (x, y) = ((i % 60) as f32 - 28.3, (i / 60) as f32 - 13.3);
                let k = batch.len;
                batch.push(x, y, (i * 7919 % 190) as f32);
                (batch.p[k], batch.q[k], batch.root[k]) =
                    (x / 30.0, y / 10.0, (i % 5) as f32 / 4.0);
                sorter.push(PixelKind::ClosedForm, &batch, k);
                batch.len %= LANES;
            }
            let mut pixels = sorter.finish();
            pixels.outlined = rim;
            let list: [usize; N] = std::array::from_fn(|k| k);
            let wide = sum_batches(&pixels, &m, &list, 30.0, None);
            assert_eq!(
                wide,
                pixels.sum_linearised_batches(&m, &list, 30.0, None),
                "{pattern:?}"
            );
            assert!(
                wide.weight > 100.0 && wide.products.totals().next().is_some_and(|sum| sum > 1.0),
                "{pattern:?}: nothing was summed"
            );
        }
    }
}
