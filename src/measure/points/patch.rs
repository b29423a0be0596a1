//! Patches of grey values on the grid of the ground frame, around a point.

use nalgebra::{Matrix2, SymmetricEigen, Vector2};

use crate::identify::{PATCH_REACH_PX, PatchPrediction};
use crate::raster::Raster;
use crate::setup::PointTemplate;

/// Standard deviation of the point spread of a frame with its pixels, px: typical for a lens in focus. The sharper of two
/// patches is smoothed to the other; the adjustment estimates the remaining difference.
const POINT_SPREAD_PX: f64 = 0.8;
/// Variance of the smoothing below which it is left to the adjustment, px^2.
const MIN_SMOOTHING_PX2: f64 = 0.04;
/// Grey level from which a pixel is saturated.
const SATURATED_LEVEL: u8 = 250;
/// Pixels on each side of a patch for the cubic interpolation and its derivatives.
pub(super) const MARGIN_PX: usize = 3;

/// Grey values around a centre, which is the ground frame's pixel nearest to a point.
#[derive(Clone, Debug)]
pub(super) struct GreyPatch {
    /// Largest offsets from the centre, px.
    pub(super) reach: [usize; 2],
    width: usize,
    values: Vec<f32>,
}

impl GreyPatch {
    /// Creates a patch from its values at offsets from the centre.
    pub(super) fn from_values(reach: [usize; 2], mut value: impl FnMut(f64, f64) -> f32) -> Self {
        let [a, b] = reach.map(|r| r as i32);
        let values = (-b..=b).flat_map(|y| (-a..=a).map(move |x| (x, y))).map(|(x, y)| value(x.into(), y.into()));
        Self { reach, width: 2 * reach[0] + 1, values: values.collect() }
    }

    /// Returns the values of a row at an offset from the centre.
    pub(super) fn row(&self, y: isize) -> &[f32] {
        let start = (y + self.reach[1] as isize).max(0) as usize * self.width;
        self.values.get(start..start + self.width).unwrap_or(&[])
    }

    /// Returns the value at an offset from the centre, which is clamped to the patch.
    pub(super) fn value(&self, x: isize, y: isize) -> f32 {
        let clamp = |v: isize, reach: usize| (v + reach as isize).clamp(0, 2 * reach as isize) as usize;
        self.values[clamp(y, self.reach[1]) * self.width + clamp(x, self.reach[0])]
    }

    /// Returns the gradient at an offset from the centre, 1/px, from 3 x 3 pixels (Sobel), which halves the noise of a
    /// difference.
    pub(super) fn gradient(&self, x: isize, y: isize) -> Vector2<f64> {
        let across = |dx: isize, dy: isize| self.value(x + dx, y + dy) - self.value(x - dx, y - dy);
        let diagonals = [across(1, 1), across(1, -1)];
        let along_u = 2.0 * across(1, 0) + diagonals[0] + diagonals[1];
        let along_v = 2.0 * across(0, 1) + diagonals[0] - diagonals[1];
        Vector2::new(f64::from(along_u), f64::from(along_v)) / 8.0
    }

    /// Interpolates cubically at an offset from the centre.
    pub(super) fn sample(&self, x: f64, y: f64) -> f32 {
        let (left, top) = (x.floor(), y.floor());
        let (wx, wy) = (cubic_weights((x - left) as f32), cubic_weights((y - top) as f32));
        let (left, top) = (left as isize - 1, top as isize - 1);
        let (i, j) = (left + self.reach[0] as isize, top + self.reach[1] as isize);
        let inside = i >= 0 && j >= 0 && i as usize + 4 <= self.width && j as usize + 4 <= 2 * self.reach[1] + 1;
        let mut sum = 0.0;
        for (k, wy) in wy.iter().enumerate() {
            let row: f32 = if inside {
                let start = (j as usize + k) * self.width + i as usize;
                wx.iter().zip(&self.values[start..start + 4]).map(|(wx, value)| wx * value).sum()
            } else {
                wx.iter().zip(0..).map(|(wx, i)| wx * self.value(left + i, top + k as isize)).sum()
            };
            sum += wy * row;
        }
        sum
    }

    /// Returns the patch halved in size by the mean of 2 x 2 pixels; the centre moves by (0.5, 0.5) px.
    pub(super) fn halved(&self) -> Self {
        let reach = self.reach.map(|r| (r - 1) / 2);
        Self::from_values(reach, |x, y| {
            let (x, y) = (2 * x as isize, 2 * y as isize);
            0.25 * (self.value(x, y) + self.value(x + 1, y) + self.value(x, y + 1) + self.value(x + 1, y + 1))
        })
    }
}

/// Weights of the cubic convolution (Keys 1981) of four neighbours at a fraction.
fn cubic_weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [-0.5 * t + t2 - 0.5 * t3, 1.0 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2.0 * t2 - 1.5 * t3, 0.5 * (t3 - t2)]
}

/// Taps of a smoothing along one axis: offsets, px, and weights.
fn smoothing_taps(sigma: f64, step: f64) -> Vec<(f64, f32)> {
    if sigma <= 0.0 {
        return vec![(0.0, 1.0)];
    }
    let count = (2.0 * sigma / step).ceil();
    let step = 2.0 * sigma / count;
    let taps = (0..=2 * count as usize).map(|k| (k as f64 - count) * step);
    let all: Vec<(f64, f32)> = taps.map(|at| (at, (-0.5 * (at / sigma).powi(2)).exp() as f32)).collect();
    let sum: f32 = all.iter().map(|(_, weight)| weight).sum();
    all.into_iter().map(|(at, weight)| (at, weight / sum)).collect()
}

/// Taps of a Gaussian smoothing with the positive part of a covariance, px^2; `step`: their distance along a unit vector,
/// px. A single tap if there is none.
fn gaussian_taps(covariance_px2: &Matrix2<f64>, step: impl Fn(&Vector2<f64>) -> f64) -> Vec<(Vector2<f64>, f32)> {
    let axes = SymmetricEigen::new(*covariance_px2);
    let along = |k: usize| {
        let axis: Vector2<f64> = axes.eigenvectors.column(k).into_owned();
        let variance = axes.eigenvalues[k];
        let sigma = if variance > MIN_SMOOTHING_PX2 { variance.sqrt() } else { 0.0 };
        (axis, smoothing_taps(sigma, step(&axis)))
    };
    let ((first, a), (second, b)) = (along(0), along(1));
    let pairs = a.iter().flat_map(|a| b.iter().map(move |b| (a, b)));
    pairs.map(|((x, p), (y, q))| (first * *x + second * *y, p * q)).collect()
}

/// Blur that the ground frame has beyond a frame, on the grid of the ground frame, px^2; negative where the frame is more
/// blurred.
fn excess_blur(patch: &PatchPrediction) -> Matrix2<f64> {
    let inverse = patch.map_jacobian(&Vector2::zeros()).try_inverse().unwrap_or_else(Matrix2::identity);
    (Matrix2::identity() - inverse * inverse.transpose()) * POINT_SPREAD_PX.powi(2)
}

/// Offset of the patch's centre from the point, px.
pub(super) fn centre_offset(template: &PointTemplate) -> Vector2<f64> {
    template.place_px.map(f64::round) - template.place_px
}

/// Returns the patch of a template, smoothed as the frame shows it.
pub(super) fn template_patch(template: &PointTemplate, prediction: &PatchPrediction) -> GreyPatch {
    let [width, height] = [template.patch.width(), template.patch.height()];
    let centre = template.place_px.map(f64::round) - Vector2::new(template.origin_px[0], template.origin_px[1]).cast();
    let reach = [(width - 1) / 2, (height - 1) / 2];
    let grey =
        GreyPatch::from_values(reach, |x, y| f32::from(template.patch.nearest_value(centre.x + x, centre.y + y)));
    let taps = gaussian_taps(&-excess_blur(prediction), |_| 0.5);
    match taps.len() {
        1 => grey,
        _ => GreyPatch::from_values(reach, |x, y| {
            taps.iter().map(|(at, weight)| weight * grey.sample(x + at.x, y + at.y)).sum()
        }),
    }
}

/// Returns the patch of a frame on the grid of the ground frame, with a search area of `search` px to both sides, and the
/// fraction of saturated pixels; `None` if the area without the search is not completely in the frame.
pub(super) fn frame_patch(
    frame: &Raster,
    prediction: &PatchPrediction,
    offset: Vector2<f64>,
    search: [usize; 2],
) -> Option<(GreyPatch, f64)> {
    let reach = PATCH_REACH_PX as f64 + 1.0;
    let (right, bottom) = (frame.width() as f64 - 2.0, frame.height() as f64 - 2.0);
    let corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];
    let is_inside = |(x, y): (f64, f64)| {
        let at = prediction.frame_point(&Vector2::new(x * reach, y * reach));
        at.x >= 1.0 && at.y >= 1.0 && at.x <= right && at.y <= bottom
    };
    if !corners.into_iter().all(is_inside) {
        return None;
    }
    let jacobian = prediction.map_jacobian(&Vector2::zeros());
    let step = |axis: &Vector2<f64>| (1.0 / (jacobian * axis).norm()).min(1.0);
    let taps: Vec<(Vector2<f64>, f32)> =
        gaussian_taps(&excess_blur(prediction), step).into_iter().map(|(at, w)| (jacobian * at, w)).collect();
    let (mut saturated, mut count) = (0_usize, 0_usize);
    let patch = GreyPatch::from_values(search.map(|s| s + PATCH_REACH_PX + MARGIN_PX), |x, y| {
        let at = prediction.frame_point(&(Vector2::new(x, y) + offset));
        count += 1;
        saturated += usize::from(frame.nearest_value(at.x, at.y) >= SATURATED_LEVEL);
        match taps.len() {
            1 => sample_cubic(frame, &at),
            _ => taps.iter().map(|(by, weight)| weight * sample_linear(frame, &(at + by))).sum(),
        }
    });
    Some((patch, saturated as f64 / count as f64))
}

/// Interpolates a frame cubically, clamped to its edge.
fn sample_cubic(frame: &Raster, at: &Vector2<f64>) -> f32 {
    let (left, top) = (at.x.floor(), at.y.floor());
    let (wx, wy) = (cubic_weights((at.x - left) as f32), cubic_weights((at.y - top) as f32));
    sum_around(frame, left as isize - 1, top as isize - 1, wx, wy)
}

/// Interpolates a frame linearly, clamped to its edge.
fn sample_linear(frame: &Raster, at: &Vector2<f64>) -> f32 {
    let (left, top) = (at.x.floor(), at.y.floor());
    let (fx, fy) = ((at.x - left) as f32, (at.y - top) as f32);
    sum_around(frame, left as isize, top as isize, [1.0 - fx, fx], [1.0 - fy, fy])
}

/// Sums weighted values of a frame from a column and row.
fn sum_around<const N: usize>(frame: &Raster, left: isize, top: isize, wx: [f32; N], wy: [f32; N]) -> f32 {
    let end = left + N as isize;
    let mut sum = 0.0;
    for (y, wy) in (top..).zip(wy) {
        let inside = (left >= 0 && y >= 0).then(|| frame.row(y as usize).get(left as usize..end as usize)).flatten();
        let row: f32 = match inside {
            Some(values) => values.iter().zip(wx).map(|(value, wx)| wx * f32::from(*value)).sum(),
            None => (left..end).zip(wx).map(|(x, wx)| wx * f32::from(frame.clamped_value(x, y))).sum(),
        };
        sum += wy * row;
    }
    sum
}
