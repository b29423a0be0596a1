//! Stage 5: what the image model leaves unexplained. Residuals that hang together along the outline
//! say that the light is more uneven than a plane, or that something else lies across the marker:
//! then the light is freed, the foreign pixels are left out, and the covariance grows by what stays.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix2};

use super::blocks::Blocks;
use super::fit::{Fit, Unknowns};
use super::linear::{Block, CUT, EDGE_JITTER, Products, biweights, spread, total};
use super::model::{
    ANGLE, BLUR, Batch, DARK, EGG, FIRST, GAMMA, LANES, LIGHT, N, Parameters, Pattern, Pixel, SECOND, THIRD,
    X, Y, each, grey,
};
use super::wide::wide;

/// Knots of the field of light along and across the marker, and of its darkness along it.
const ALONG: usize = 9;
const ACROSS: usize = 3;
const DARKS: usize = 6;
const FIELD: usize = ALONG * ACROSS + DARKS;
/// How far light, as a share, and darkness are thought to depart from planes.
const UNEVEN_LIGHT: f64 = 0.15;
const UNEVEN_DARK: f64 = 0.15;
/// The fields reach this far, in semi-axes.
pub const REACH: f64 = 1.1;
/// Times its own variance beyond which a centre's variance from blocks of residuals is not chance.
const CORRELATED: f64 = 4.0;
/// Share of pixels that the fit has left out, beyond which they are looked into.
const FOREIGN: f64 = 0.01;
/// What a field of light must leave of the residuals: forty more unknowns always leave less.
const BETTER: f64 = 0.95;
const MAX_ITERATIONS: usize = 4;
/// Pixels of a fit with a field.
const MOST: usize = 1000;

/// A fit with a field of light: the model's parameters, then the field's.
struct Field {
    m: Parameters,
    extra: [f64; FIELD],
}

/// One pixel's part in the normal equations.
struct Row {
    /// Residual, grey levels.
    r: f64,
    /// Root of its robust weight.
    root: f64,
    /// Whether it has no robust weight at all.
    foreign: bool,
    /// Derivatives by the parameters.
    gradient: Parameters,
    /// Columns of the field, and the derivatives by them.
    field: [(usize, f64); 6],
}

/// The fit as it is, with the covariance that its residuals deserve; or a better one. What is left of
/// a marker that is not `whole` could not bear more unknowns.
pub fn improve(
    pattern: Pattern,
    pixels: &[Pixel],
    fit: Fit,
    unknowns: &Unknowns,
    floor: f64,
    whole: bool,
) -> Fit {
    let scale = floor.max(fit.rms);
    let Some((plain, ratio, foreign)) = deserved(pattern, pixels, &fit, scale) else { return fit };
    let suspect = whole && (ratio > CORRELATED || foreign > FOREIGN);
    let freed = if suspect { freed(pattern, pixels, &fit, unknowns, floor) } else { None };
    let mut out = fit;
    let centre = match freed {
        Some((m, covariance, rms, inliers)) if rms < BETTER * out.rms => {
            out = Fit { parameters: m, rms, inliers, ..out };
            covariance
        }
        _ => plain,
    };
    out.covariance.fixed_view_mut::<2, 2>(X, X).copy_from(&centre);
    out
}

wide! {
    /// The covariance of a fit's centre, at least that which its residuals show, the greatest ratio of
    /// the two, and the share of pixels that the fit has left out.
    fn deserved(pattern: Pattern, pixels: &[Pixel], fit: &Fit, scale: f64) -> Option<(Matrix2<f64>, f64, f64)>
        = deserved_by
}

wide! {
    /// Residuals and derivatives of all pixels.
    fn rows_under(field: &Field, pattern: Pattern, pixels: &[Pixel], scale: f64) -> Vec<Row> = Field::rows_of
}

wide! {
    /// Normal equations over the parameters and the field.
    fn normal(rows: &[Row], unknowns: &Unknowns, field: &Field, scale: f64) -> (DMatrix<f64>, DVector<f64>)
        = normal_of
}

#[inline(always)]
fn deserved_by(
    pattern: Pattern,
    pixels: &[Pixel],
    fit: &Fit,
    scale: f64,
) -> Option<(Matrix2<f64>, f64, f64)> {
    let m = &fit.parameters;
    let influence = [X, Y].map(|k| fit.covariance.column(k).map(|v| v / fit.variance));
    let list: Vec<usize> = (0..N).filter(|&k| fit.covariance[(k, k)] > 0.0).collect();
    let (origin, trig) = ([m[X].round(), m[Y].round()], m[ANGLE].sin_cos());
    let mut blocks = Blocks::new(pixels, m);
    let mut foreign = 0;
    for some in pixels.chunks(LANES) {
        let batch = Batch::new(some, origin);
        let image = grey(pattern, m, origin, trig, &batch);
        let r = each(|i| batch.value[i] - image.value[i]);
        let tukey = biweights(&r, &image.gradient[X], &image.gradient[Y], scale);
        let root = each(|i| batch.root[i] * tukey[i]);
        let moved = influence.map(|h| {
            let mut sum = [0.0f32; LANES];
            for &k in &list {
                let h = h[k] as f32;
                sum.iter_mut().zip(&image.gradient[k]).for_each(|(s, g)| *s += h * g);
            }
            each(|i| sum[i] * root[i] * root[i] * r[i])
        });
        foreign += (0..some.len()).filter(|&i| tukey[i] <= 0.0).count();
        for (i, pixel) in some.iter().enumerate() {
            blocks.add(pixel, [f64::from(moved[0][i]), f64::from(moved[1][i])]);
        }
    }
    let white = fit.covariance.fixed_view::<2, 2>(X, X).into_owned();
    let (raised, ratio) = blocks.raise(&white, list.len())?;
    Some((raised, ratio, foreign as f64 / pixels.len() as f64))
}

/// The fit with the light freed, without the pixels of things that are not the marker's.
#[allow(clippy::type_complexity)]
fn freed(
    pattern: Pattern,
    pixels: &[Pixel],
    fit: &Fit,
    unknowns: &Unknowns,
    floor: f64,
) -> Option<(Parameters, Matrix2<f64>, f64, f64)> {
    let stride = pixels.len().div_ceil(MOST) as u64;
    // By place and not by number, so that one pixel more or less changes no other.
    let chosen = |p: &&Pixel| (p.x as u64 * 5 + p.y as u64 * 3).is_multiple_of(stride);
    let some: Vec<Pixel> = pixels.iter().filter(chosen).copied().collect();
    let mut field = Field { m: fit.parameters, extra: [0.0; FIELD] };
    let rows = rows_under(&field, pattern, &some, floor.max(fit.rms));
    let own = own(&some, &rows, field.m[BLUR]);
    if own.len() < 3 * N {
        return None;
    }
    let mut residuals: Vec<f32> = Vec::with_capacity(own.len());
    let mut scale = 3.0 * floor.max(spread_of(&rows, &mut residuals));
    for iteration in 0..MAX_ITERATIONS {
        let rows = rows_under(&field, pattern, &own, scale);
        let (normal, right) = normal(&rows, unknowns, &field, scale);
        let mut damped = normal;
        for i in 0..damped.nrows() {
            damped[(i, i)] *= 1.0 + if iteration < 2 { 1e-3 } else { 1e-7 };
        }
        let change = Cholesky::new(damped)?.solve(&right);
        let worst = change[X].hypot(change[Y]);
        let factor = (2.0 / worst.max(1e-9)).min(1.0);
        for i in 0..N {
            field.m[i] += factor * change[i];
        }
        for i in 0..FIELD {
            field.extra[i] += factor * change[N + i];
        }
        let new = floor.max(spread_of(&rows, &mut residuals));
        if worst < 1e-3 && new > 0.9 * scale {
            break;
        }
        scale = new.max(0.5 * scale);
    }
    let rows = rows_under(&field, pattern, &own, scale);
    let sound = field.m.iter().all(|v| v.is_finite()) && field.m[BLUR] > 0.2 && field.m[BLUR] < 4.0;
    let cov = covariance(&rows, &own, unknowns, &field, scale).filter(|_| sound)?;
    let weight: f64 = rows.iter().map(|r| r.root * r.root).sum();
    let square: f64 = rows.iter().map(|r| (r.root * r.r).powi(2)).sum();
    Some((
        field.m,
        cov,
        (square / weight.max(1e-9)).sqrt(),
        weight / some.iter().map(|p| p.weight).sum::<f64>(),
    ))
}

fn spread_of(rows: &[Row], residuals: &mut Vec<f32>) -> f64 {
    residuals.clear();
    residuals.extend(rows.iter().map(|r| r.r.abs() as f32));
    spread(residuals)
}

/// Pixels that are not within the blur of two others that the fit took for foreign: a line that
/// touches the marker also darkens the pixels beside it, too little to be seen in each.
fn own(pixels: &[Pixel], rows: &[Row], blur: f64) -> Vec<Pixel> {
    let foreign: Vec<&Pixel> = pixels.iter().zip(rows).filter(|(_, r)| r.foreign).map(|(p, _)| p).collect();
    let reach2 = (2.5 * blur + 1.0).powi(2);
    let near = |p: &Pixel| {
        foreign.iter().filter(|f| (f.x - p.x).powi(2) + (f.y - p.y).powi(2) < reach2).take(3).count() >= 3
    };
    pixels.iter().filter(|p| !near(p)).copied().collect()
}

/// Two neighbouring knots of `count` over [-REACH, REACH], and their shares.
fn hats(at: f64, count: usize) -> [(usize, f64); 2] {
    let place = ((at / REACH + 1.0) * 0.5).clamp(0.0, 1.0) * (count - 1) as f64;
    let low = (place as usize).min(count - 2);
    let share = place - low as f64;
    [(low, 1.0 - share), (low + 1, share)]
}

impl Field {
    #[inline(always)]
    fn rows_of(&self, pattern: Pattern, pixels: &[Pixel], scale: f64) -> Vec<Row> {
        let m = &self.m;
        // Under light and darkness that are known and the same everywhere, the share of black shows.
        let mut bare = *m;
        bare[LIGHT..DARK + 3].copy_from_slice(&[100.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0]);
        bare[GAMMA] = 1.0;
        let (origin, trig) = ([m[X].round(), m[Y].round()], m[ANGLE].sin_cos());
        let mut out = Vec::with_capacity(pixels.len());
        for some in pixels.chunks(LANES) {
            let batch = Batch::new(some, origin);
            let image = grey(pattern, &bare, origin, trig, &batch);
            for (i, pixel) in some.iter().enumerate() {
                let share = (1.0 - f64::from(image.value[i]) / 100.0) / 0.5;
                let by = |k: usize| -f64::from(image.gradient[k][i]) / 50.0;
                out.push(self.row(pixel, share, by, scale));
            }
        }
        out
    }

    #[inline(always)]
    /// One pixel's row from its share of black and that share's derivatives.
    fn row(&self, pixel: &Pixel, share: f64, by: impl Fn(usize) -> f64, scale: f64) -> Row {
        let (m, p, q) = (&self.m, pixel.p, pixel.q);
        let (along, across, dark_along) = (hats(p, ALONG), hats(q, ACROSS), hats(p, DARKS));
        let mut field = [(0, 0.0); 6];
        for (slot, (i, j)) in field.iter_mut().zip([(0, 0), (0, 1), (1, 0), (1, 1)]) {
            *slot = (along[i].0 * ACROSS + across[j].0, along[i].1 * across[j].1);
        }
        for (slot, d) in field[4..].iter_mut().zip(dark_along) {
            *slot = (ALONG * ACROSS + d.0, d.1);
        }
        let sum = |f: &[(usize, f64)]| -> f64 { f.iter().map(|&(k, w)| w * self.extra[k]).sum() };
        let plane = m[LIGHT] + m[LIGHT + 1] * p + m[LIGHT + 2] * q + m[LIGHT + 3] * p * p;
        let light = plane + m[LIGHT] * sum(&field[..4]);
        let dark = m[DARK] + m[DARK + 1] * p + m[DARK + 2] * q + sum(&field[4..]);
        let linear = (1.0 - dark * share).max(1e-3);
        let log = linear.ln();
        let through = (m[GAMMA] * log).exp();
        let value = light * through;
        let mut gradient = [0.0; N];
        let r = pixel.value - value.min(255.0);
        if value < 255.0 {
            let slope = m[GAMMA] * value / linear;
            for k in [X, Y, ANGLE, FIRST, SECOND, THIRD, BLUR, EGG] {
                gradient[k] = -slope * dark * by(k);
            }
            for (k, v) in [1.0, p, q, p * p].into_iter().enumerate() {
                gradient[LIGHT + k] = through * v;
            }
            for (k, v) in [1.0, p, q].into_iter().enumerate() {
                gradient[DARK + k] = -slope * share * v;
            }
            gradient[GAMMA] = value * log;
            field[..4].iter_mut().for_each(|f| f.1 *= through * m[LIGHT]);
            field[4..].iter_mut().for_each(|f| f.1 *= -slope * share);
        } else {
            field.iter_mut().for_each(|f| f.1 = 0.0);
        }
        let edge2 = EDGE_JITTER * EDGE_JITTER * (gradient[X].powi(2) + gradient[Y].powi(2));
        let tukey = (1.0 - r * r / (CUT * CUT * (scale * scale + edge2))).max(0.0);
        Row { r, root: tukey * pixel.weight.sqrt(), foreign: tukey <= 0.0, gradient, field }
    }
}

#[inline(always)]
fn normal_of(rows: &[Row], unknowns: &Unknowns, field: &Field, scale: f64) -> (DMatrix<f64>, DVector<f64>) {
    const SIZE: usize = N + FIELD;
    let list: Vec<usize> = (0..N).filter(|&k| unknowns.free[k]).collect();
    let (mut lower, mut right) = (vec![[0.0; SIZE]; SIZE], [0.0; SIZE]);
    let (mut block, mut sums): (Block, Products) = (Block::new(), [[[0.0; LANES]; N + 1]; N]);
    for row in rows.iter().filter(|r| r.root > 0.0) {
        let w = row.root * row.root;
        let own = row.gradient.iter().chain([&row.r]).map(|v| (row.root * v) as f32);
        if block.push(own) {
            block.flush(N, &mut sums);
        }
        for (i, &(a, u)) in row.field.iter().enumerate() {
            let (g, line) = (w * u, &mut lower[N + a]);
            line.iter_mut().zip(&row.gradient).for_each(|(sum, v)| *sum += g * v);
            right[N + a] += g * row.r;
            // The field's columns come in rising order.
            for &(b, v) in &row.field[..=i] {
                line[N + b] += g * v;
            }
        }
    }
    block.flush(N, &mut sums);
    for k in 0..N {
        (0..=k).for_each(|j| lower[k][j] = total(&sums[j][k]));
        right[k] = total(&sums[k][N]);
    }
    let mut normal = DMatrix::from_fn(SIZE, SIZE, |i, j| lower[i.max(j)][i.min(j)]);
    let mut right = DVector::from_row_slice(&right);
    for k in (0..N).filter(|&k| !unknowns.free[k]) {
        normal.row_mut(k).fill(0.0);
        normal.column_mut(k).fill(0.0);
        normal[(k, k)] = 1.0;
        right[k] = 0.0;
    }
    for &k in &list {
        let (usual, deviation) = unknowns.usual[k];
        let weight = (scale / deviation).powi(2);
        normal[(k, k)] += weight + 1e-12;
        right[k] += weight * (usual - field.m[k]);
    }
    for k in 0..FIELD {
        let deviation = if k < ALONG * ACROSS { UNEVEN_LIGHT } else { UNEVEN_DARK };
        let weight = (scale / deviation).powi(2);
        normal[(N + k, N + k)] += weight;
        right[N + k] -= weight * field.extra[k];
    }
    (normal, right)
}

/// The centre's covariance, at least that which blocks of residuals show (a sandwich estimate).
fn covariance(
    rows: &[Row],
    pixels: &[Pixel],
    unknowns: &Unknowns,
    field: &Field,
    scale: f64,
) -> Option<Matrix2<f64>> {
    let (normal, _) = normal(rows, unknowns, field, scale);
    let size = normal.nrows();
    let factor = Cholesky::new(normal)?;
    let list: Vec<usize> = (0..N).filter(|&k| unknowns.free[k]).collect();
    let unit = |k: usize| DVector::from_fn(size, |i, _| if i == k { 1.0 } else { 0.0 });
    let influence = [X, Y].map(|k| factor.solve(&unit(k)));
    let (mut weight, mut square) = (0.0, 0.0);
    let mut blocks = Blocks::new(pixels, &field.m);
    for (row, pixel) in rows.iter().zip(pixels) {
        let w = row.root * row.root;
        weight += w;
        square += w * row.r * row.r;
        let moved = [0, 1].map(|k| {
            let h = &influence[k];
            let own: f64 = list.iter().map(|&k| h[k] * row.gradient[k]).sum();
            w * row.r * (own + row.field.iter().map(|&(k, v)| h[N + k] * v).sum::<f64>())
        });
        blocks.add(pixel, moved);
    }
    let variance = square / (weight - list.len() as f64).max(1.0);
    let white = Matrix2::new(influence[0][X], influence[0][Y], influence[1][X], influence[1][Y]) * variance;
    Some(blocks.raise(&white, list.len())?.0)
}
