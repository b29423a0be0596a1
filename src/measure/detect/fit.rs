//! Stage 4: the image model fitted to grey values, robustly, with covariance.

use nalgebra::{Cholesky, SMatrix, SVector};

use super::model::{
    ANGLE, BLUR, DARK, FIRST, GAMMA, LIGHT, N, Parameters, Pattern, Pixel, X, Y, grey_rotated,
};

type Square = SMatrix<f64, N, N>;
type Column = SVector<f64, N>;

/// A converged fit.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Parameters.
    pub parameters: Parameters,
    /// Their covariance; zero for those held fixed.
    pub covariance: Square,
    /// Weighted root mean square of the residuals, grey levels.
    pub rms: f64,
    /// Mean robust weight, 0 to 1.
    pub inliers: f64,
}

impl Fit {
    /// The same fit under the condition that the parameters `zero` are 0: exact for a linear model,
    /// and the parameters in question are small.
    pub fn without(&self, zero: &[usize]) -> Self {
        let mut out = self.clone();
        for &k in zero {
            let (column, variance) = (out.covariance.column(k).into_owned(), out.covariance[(k, k)]);
            if variance > 0.0 {
                let value = out.parameters[k];
                for i in 0..N {
                    out.parameters[i] -= column[i] * value / variance;
                }
                out.covariance -= column * column.transpose() / variance;
            }
            out.parameters[k] = 0.0;
        }
        out
    }
}

/// What is sought, and what is known of it beforehand.
#[derive(Clone, Debug)]
pub struct Unknowns {
    /// Parameters that are sought.
    pub free: [bool; N],
    /// Usual value and its standard deviation, infinite where nothing is known.
    pub usual: [(f64, f64); N],
}

/// One linearisation: normal equations and residual statistics.
struct Step {
    normal: Square,
    right: Column,
    scale: f64,
    weight: f64,
    square: f64,
}

const MAX_ITERATIONS: usize = 20;
/// Residuals beyond this many scales have no weight (Tukey's biweight; 95 % efficient at 4.7).
const CUT: f64 = 6.0;

/// Unevenness of a real outline and of its sampling, px, that is no reason to distrust a pixel.
const EDGE_JITTER: f64 = 0.08;
/// Pixels that the iteration starts with; all of them only refine its result.
const FIRST_PIXELS: usize = 320;

/// Fits the `free` parameters from `start` to every so-manieth pixel, to a hundredth of a pixel.
pub fn rough(
    pattern: Pattern,
    pixels: &[Pixel],
    start: &Parameters,
    unknowns: &Unknowns,
    floor: f64,
) -> Option<Parameters> {
    let stride = (pixels.len() / FIRST_PIXELS).max(1);
    let some: Vec<Pixel> = pixels.iter().step_by(stride).copied().collect();
    let contrast = contrast(start);
    let mut residuals = Vec::with_capacity(some.len());
    // Most pixels are flat and say nothing of an edge that is still off: the scale comes down slowly.
    let scale = 0.25 * contrast;
    Some(
        iterate(pattern, &some, *start, scale, unknowns, floor.max(0.02 * contrast), &mut residuals, 1e-2)?.0,
    )
}

/// Fits the `free` parameters from near the solution; `None` where it does not settle.
pub fn fit(
    pattern: Pattern,
    pixels: &[Pixel],
    start: &Parameters,
    unknowns: &Unknowns,
    floor: f64,
) -> Option<Fit> {
    let count = unknowns.free.iter().filter(|&&f| f).count();
    if pixels.len() < 2 * count {
        return None;
    }
    let contrast = contrast(start);
    let floor = floor.max(0.02 * contrast);
    let mut residuals = Vec::with_capacity(pixels.len());
    let (m, scale) = iterate(pattern, pixels, *start, 2.0 * floor, unknowns, floor, &mut residuals, 1e-3)?;
    finish(pattern, pixels, m, unknowns, scale, floor, &mut residuals, count)
}

/// Grey levels between white or skin and black.
pub fn contrast(m: &Parameters) -> f64 {
    m[LIGHT] * (1.0 - (1.0 - m[DARK]).max(0.0).powf(m[GAMMA]))
}

/// Repeats the linear solution until the centre stands still; the parameters and the scale.
#[allow(clippy::too_many_arguments)]
fn iterate(
    pattern: Pattern,
    pixels: &[Pixel],
    mut m: Parameters,
    mut scale: f64,
    unknowns: &Unknowns,
    floor: f64,
    residuals: &mut Vec<f64>,
    tolerance: f64,
) -> Option<(Parameters, f64)> {
    for iteration in 0..MAX_ITERATIONS {
        let step = linearise(pattern, pixels, &m, unknowns, scale, floor, residuals);
        let damping = if iteration < 2 { 1e-3 } else { 1e-7 };
        let mut damped = step.normal;
        for i in 0..N {
            damped[(i, i)] *= 1.0 + damping;
            damped[(i, i)] += 1e-12;
        }
        let change = limit(Cholesky::new(damped)?.solve(&step.right), &m, pattern);
        for i in 0..N {
            m[i] += change[i];
        }
        if !plausible(pattern, &m) {
            return None;
        }
        let moved = change[X].hypot(change[Y]);
        let settled = moved < tolerance
            && (pattern != Pattern::Disc || change[FIRST].abs() < 0.02)
            && (step.scale / scale - 1.0).abs() < 20.0 * tolerance;
        scale = step.scale.max(0.5 * scale);
        if settled || (iteration + 1 == MAX_ITERATIONS && moved < 0.02) {
            return Some((m, scale));
        }
    }
    None
}

#[allow(clippy::too_many_arguments)]
fn finish(
    pattern: Pattern,
    pixels: &[Pixel],
    mut m: Parameters,
    unknowns: &Unknowns,
    scale: f64,
    floor: f64,
    residuals: &mut Vec<f64>,
    count: usize,
) -> Option<Fit> {
    let step = linearise(pattern, pixels, &m, unknowns, scale, floor, residuals);
    let mut regular = step.normal;
    for i in 0..N {
        regular[(i, i)] *= 1.0 + 1e-10;
        regular[(i, i)] += 1e-12;
    }
    let factor = Cholesky::new(regular)?;
    let change = limit(factor.solve(&step.right), &m, pattern);
    for i in 0..N {
        m[i] += change[i];
    }
    let variance = step.square / (step.weight - count as f64).max(1.0);
    let mut covariance = factor.inverse() * variance;
    for i in (0..N).filter(|&i| !unknowns.free[i]) {
        covariance.row_mut(i).fill(0.0);
        covariance.column_mut(i).fill(0.0);
    }
    let rms = (step.square / step.weight.max(1e-9)).sqrt();
    let inliers = step.weight / pixels.len() as f64;
    Some(Fit { parameters: m, covariance, rms, inliers })
}

/// Rows of the weighted Jacobian that wait for their products, column by column.
struct Block {
    columns: [[f64; BLOCK]; N + 1],
    rows: usize,
}

/// Rows per block: enough for the products to run in vector registers.
const BLOCK: usize = 32;

impl Block {
    /// Adds the products of all pairs of the first `n` columns and the residuals, and empties it.
    fn flush(&mut self, n: usize, normal: &mut [[f64; N]; N], right: &mut [f64; N]) {
        for column in &mut self.columns[..=n] {
            column[self.rows..].fill(0.0);
        }
        for i in 0..n {
            #[allow(clippy::needless_range_loop)]
            for j in i..n {
                normal[i][j] += dot(&self.columns[i], &self.columns[j]);
            }
            right[i] += dot(&self.columns[i], &self.columns[n]);
        }
        self.rows = 0;
    }
}

fn dot(a: &[f64; BLOCK], b: &[f64; BLOCK]) -> f64 {
    let mut lanes = [0.0; 4];
    for (x, y) in a.chunks_exact(4).zip(b.chunks_exact(4)) {
        for (lane, (p, q)) in lanes.iter_mut().zip(x.iter().zip(y)) {
            *lane += p * q;
        }
    }
    (lanes[0] + lanes[1]) + (lanes[2] + lanes[3])
}

/// Normal equations at `m`, with biweights for residuals against `scale`.
fn linearise(
    pattern: Pattern,
    pixels: &[Pixel],
    m: &Parameters,
    unknowns: &Unknowns,
    scale: f64,
    floor: f64,
    residuals: &mut Vec<f64>,
) -> Step {
    let trig = m[ANGLE].sin_cos();
    let list: Vec<usize> = (0..N).filter(|&i| unknowns.free[i]).collect();
    let n = list.len();
    let mut packed = [[0.0f64; N]; N];
    let mut packed_right = [0.0f64; N];
    let mut block = Block { columns: [[0.0; BLOCK]; N + 1], rows: 0 };
    let (mut weight, mut square) = (0.0, 0.0);
    residuals.clear();
    for pixel in pixels {
        let (value, gradient) = grey_rotated(pattern, m, trig, pixel);
        let r = pixel.value - value;
        residuals.push(r.abs());
        let jitter2 = EDGE_JITTER * EDGE_JITTER * (gradient[X] * gradient[X] + gradient[Y] * gradient[Y]);
        let z2 = r * r / (CUT * CUT * (scale * scale + jitter2));
        if z2 >= 1.0 {
            continue;
        }
        let root = 1.0 - z2;
        weight += root * root;
        square += root * root * r * r;
        for (column, &k) in block.columns.iter_mut().zip(&list) {
            column[block.rows] = root * gradient[k];
        }
        block.columns[n][block.rows] = root * r;
        block.rows += 1;
        if block.rows == BLOCK {
            block.flush(n, &mut packed, &mut packed_right);
        }
    }
    block.flush(n, &mut packed, &mut packed_right);
    let mut normal = Square::identity();
    let mut right = Column::zeros();
    for (i, &k) in list.iter().enumerate() {
        right[k] = packed_right[i];
        for (j, &l) in list.iter().enumerate() {
            normal[(k, l)] = packed[i.min(j)][i.max(j)];
        }
    }
    for &k in &list {
        let (usual, deviation) = unknowns.usual[k];
        let weight = (scale / deviation).powi(2);
        normal[(k, k)] += weight;
        right[k] += weight * (usual - m[k]);
    }
    Step { normal, right, scale: spread(residuals).max(floor), weight, square }
}

/// Robust standard deviation from absolute residuals.
fn spread(residuals: &mut [f64]) -> f64 {
    let middle = residuals.len() / 2;
    let (_, median, _) = residuals.select_nth_unstable_by(middle, f64::total_cmp);
    1.4826 * *median
}

/// Keeps a step within what the linearisation can bear.
fn limit(mut change: Column, m: &Parameters, pattern: Pattern) -> Column {
    let mut factor: f64 = 1.0;
    let mut bound = |step: f64, most: f64| factor = factor.min(most / step.abs().max(1e-12));
    bound(change[X], 3.0);
    bound(change[Y], 3.0);
    bound(change[ANGLE], 0.2);
    bound(change[BLUR], 0.5);
    bound(change[GAMMA], 0.2);
    bound(change[DARK], 0.1);
    if pattern == Pattern::Disc {
        bound(change[FIRST], 0.2 * m[FIRST]);
        bound(change[FIRST + 1], 0.3 * m[FIRST + 1]);
    } else {
        bound(change[FIRST], 0.2);
    }
    change *= factor.min(1.0);
    change
}

fn plausible(pattern: Pattern, m: &Parameters) -> bool {
    let common = m.iter().all(|v| v.is_finite()) && m[BLUR] > 0.2 && m[BLUR] < 4.0;
    let lit = m[LIGHT] > 1.0 && m[LIGHT] < 1500.0 && m[DARK] > 0.02 && m[DARK] < 1.5;
    let lit = lit && m[GAMMA] > 0.15 && m[GAMMA] < 3.0;
    let shape = match pattern {
        Pattern::Disc => m[FIRST] > 1.0 && m[FIRST + 1] > 0.2,
        _ => m[FIRST] > 0.005 && m[FIRST] < 2.5,
    };
    common && lit && shape
}
