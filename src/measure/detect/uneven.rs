//! Stage 5: what the image model leaves unexplained. Residuals that hang together along the outline
//! say that the light is more uneven than a plane, or that something else lies across the marker:
//! then the light is freed, the foreign pixels are left out, and the covariance grows by what stays.

use nalgebra::{Matrix2, Vector2};

use super::batch::Pixels;
use super::blocks::{Blocks, SECTORS, sectors};
use super::field::freed;
use super::fit::{Fit, Unknowns};
use super::lanes::{Lanes, each};
use super::linear::biweights;
use super::model::{N, X, Y};
use super::wide::wide;

/// Times its own variance beyond which a centre's variance from blocks of residuals is not chance.
const CORRELATED: f64 = 4.0;
/// Mean square of residuals by sectors, over that of white ones, beyond which the light is uneven.
const UNEVEN: f64 = 1.5;
/// Share of pixels that the fit has left out, beyond which they are looked into.
const FOREIGN: f64 = 0.01;
/// What a field of light must take off the residuals' squares, in variances of one: its 33 unknowns take off as many by
/// chance, and several times as many where residuals hang together, as JPEG leaves them: to be heard, and to be believed.
const DOUBTFUL: f64 = 120.0;
/// What a first step must promise of that to be followed.
const HOPELESS: f64 = 60.0;
const CERTAIN: f64 = 280.0;

/// What a fit's residuals show.
pub struct Deserved {
    /// The centre's covariance, at least that which they show, px^2.
    covariance: Matrix2<f64>,
    /// The greatest ratio of the two.
    ratio: f64,
    /// Their mean ratio in squares.
    mean: f64,
    /// Mean square of residuals by sectors, over that of white ones.
    uneven: f64,
    /// Residuals of each batch, grey levels.
    pub residuals: Vec<Lanes>,
    /// Roots of their robust weights.
    pub biweights: Vec<Lanes>,
}

/// The fit as it is, with the covariance that its residuals deserve; or a better one. What is left of
/// a marker that is not `whole` could not bear more unknowns.
pub fn improve(pixels: &Pixels, fit: Fit, unknowns: &Unknowns, floor: f64, whole: bool) -> Fit {
    let scale = floor.max(fit.rms);
    let Some(seen) = deserved(pixels, &fit, scale) else { return fit };
    let left_out = seen.biweights.iter().zip(&pixels.batches);
    let left_out: usize = left_out.map(|(t, b)| t.iter().take(b.len).filter(|&&t| t <= 0.0).count()).sum();
    let foreign = left_out as f64 / pixels.count() as f64;
    let suspect = whole && (seen.uneven > UNEVEN || seen.ratio > CORRELATED || foreign > FOREIGN);
    // With few foreign pixels the first step tells.
    let least = (foreign <= FOREIGN).then_some(HOPELESS);
    let freed = if suspect { freed(pixels, &fit, &seen, unknowns, floor, least) } else { None };
    let mut out = Fit { clumped: seen.mean, ..fit };
    let mut centre = seen.covariance;
    if let Some(freed) = freed {
        let gain = (1.0 - (freed.rms / out.rms).powi(2)) * pixels.weight();
        // Between the two limits both stand, so that a small difference of a pixel or two decides nothing.
        let share = ((gain - DOUBTFUL) / (CERTAIN - DOUBTFUL)).clamp(0.0, 1.0);
        let between = |one: f64, other: f64| one + share * (other - one);
        let apart = [X, Y].map(|k| freed.parameters[k] - out.parameters[k]);
        let apart = Vector2::from(apart) * (share * (1.0 - share)).sqrt();
        centre = centre.zip_map(&freed.covariance, between) + apart * apart.transpose();
        out.white = out.white.zip_map(&freed.white, between);
        for (own, other) in out.parameters.iter_mut().zip(freed.parameters) {
            *own = between(*own, other);
        }
        out.rms = between(out.rms, freed.rms);
        out.inliers = between(out.inliers, freed.inliers);
    }
    out.covariance.fixed_view_mut::<2, 2>(X, X).copy_from(&centre);
    out
}

wide! {
    /// What a fit's residuals show, from where it was linearised.
    fn deserved(pixels: &Pixels, fit: &Fit, scale: f64) -> Option<Deserved> = deserved_by
}

#[inline(always)]
fn deserved_by(pixels: &Pixels, fit: &Fit, scale: f64) -> Option<Deserved> {
    let m = &fit.parameters;
    let [by_x, by_y] = [X, Y].map(|k| fit.covariance.column(k).map(|v| (v / fit.variance) as f32));
    let mut list = [(0, [0.0f32; 3]); N];
    let mut count = 0;
    for k in (0..N).filter(|&k| fit.covariance[(k, k)] > 0.0 || m[k] != fit.start[k]) {
        list[count] = (k, [(m[k] - fit.start[k]) as f32, by_x[k], by_y[k]]);
        count += 1;
    }
    let mut blocks = Blocks::new(pixels, m);
    // Of each sector the sum of its weighted residuals, and of the weights' squares.
    let mut common = [[0.0f64; 2]; SECTORS];
    let mut residuals = Vec::with_capacity(pixels.batches.len());
    let mut roots = Vec::with_capacity(pixels.batches.len());
    for (batch, image) in pixels.batches.iter().zip(&fit.images) {
        let mut sums = [Lanes::of(0.0); 3];
        for (k, by) in &list[..count] {
            let gradient = image.by(*k);
            for (sum, by) in sums.iter_mut().zip(by) {
                *sum = each(|i| sum[i] + by * gradient[i]);
            }
        }
        let r = each(|i| batch.value[i] - image.value[i] - sums[0][i]);
        let tukey = biweights(&r, &image.gradient[X], &image.gradient[Y], scale);
        let pull = each(|i| (batch.root[i] * tukey[i]) * (batch.root[i] * tukey[i]) * r[i]);
        blocks.add(batch, [each(|i| sums[1][i] * pull[i]), each(|i| sums[2][i] * pull[i])]);
        let sector = sectors(batch);
        for i in 0..batch.len {
            if let Some(sum) = common.get_mut(sector[i] as usize) {
                let weight = f64::from((batch.root[i] * tukey[i]).powi(4));
                *sum = [sum[0] + f64::from(pull[i]), sum[1] + weight];
            }
        }
        residuals.push(r);
        roots.push(tukey);
    }
    let free = (0..N).filter(|&k| fit.covariance[(k, k)] > 0.0).count();
    let (covariance, ratio, mean) = blocks.raise(&fit.white, free)?;
    let seen = common.iter().filter(|sum| sum[1] > 2.0);
    let (sum, count) = seen.fold((0.0, 0.0), |(s, n), [r, w]| (s + r * r / w, n + 1.0));
    let uneven = sum / (fit.variance * f64::max(count, 1.0));
    Some(Deserved { covariance, ratio, mean, uneven, residuals, biweights: roots })
}
