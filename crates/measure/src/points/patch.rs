//! Patches of grey values around a point, on the grid of the ground frame.

use nalgebra::{Matrix2, SymmetricEigen, Vector2};

use crate::dispatch::wide;
use crate::identify::{PATCH_REACH_PX, PatchPrediction};
use crate::raster::Raster;
use crate::setup::PointTemplate;

/// Standard deviation of the point spread of a frame with its pixels, px: typical for a lens in focus. The sharper of two
/// patches is smoothed to the other; the adjustment estimates the remaining difference.
const POINT_SPREAD_PX: f64 = 0.8;
/// Largest variance of one pass of the smoothing, px^2: the weights of its 3 x 3 pixels are then positive.
const PASS_VARIANCE_PX2: f64 = 0.25;
/// Grey level from which a pixel is saturated: 255 less the errors of JPEG around edges.
const SATURATED_LEVEL: f32 = 250.0;
/// Pixels on each side of a patch for the cubic interpolation and its derivatives.
pub(super) const MARGIN_PX: usize = 3;
/// Largest side of the area of a frame that a patch is interpolated from, px: a patch of the largest search radius at three
/// times the scale.
const MAX_AREA_PX: f64 = 400.0;

/// Number of positions whose weights are computed together.
const LANES: usize = 8;

/// Sum with which a number is rounded to an integer in the last bits: 1.5 times 2^23.
const ROUNDING: f32 = 12_582_912.0;

/// Grey values of a rectangle of pixels.
#[derive(Clone, Debug)]
pub(super) struct GreyPatch {
    /// Column and row of the first value, px from the origin.
    first: [i32; 2],
    width: usize,
    height: usize,
    values: Vec<f32>,
}

/// Positions along a row at `x`: coefficients of a quadratic polynomial for either coordinate, px.
pub(super) type RowPath = [[f64; 3]; 2];

impl GreyPatch {
    /// Creates a patch from its values at the pixels up to `reach` on both sides of the origin.
    pub(super) fn from_values(reach: [usize; 2], value: impl Fn(i32, i32) -> f32) -> Self {
        Self::from_rows(reach, |y, row| {
            (-(reach[0] as i32)..)
                .zip(row)
                .for_each(|(x, own)| *own = value(x, y));
        })
    }

    /// Creates a patch whose rows are filled at the pixels up to `reach` on both sides of the origin.
    pub(super) fn from_rows(reach: [usize; 2], mut fill: impl FnMut(i32, &mut [f32])) -> Self {
        let ([width, height], first) = (reach.map(|r| 2 * r + 1), reach.map(|r| -(r as i32)));
        let mut patch = Self {
            first,
            width,
            height,
            values: vec![0.0; width * height],
        };
        let rows = patch.values.chunks_exact_mut(patch.width);
        (patch.first[1]..)
            .zip(rows)
            .for_each(|(y, row)| fill(y, row));
        patch
    }

    /// Returns the number of columns and rows.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Returns the rows from top to bottom.
    pub(super) fn rows(&self) -> impl ExactSizeIterator<Item = &[f32]> {
        self.values.chunks_exact(self.width)
    }

    /// Returns the row with an index from the top.
    pub(super) fn row(&self, index: usize) -> &[f32] {
        self.values
            .get(index * self.width..(index + 1) * self.width)
            .unwrap_or(&[])
    }

    /// Returns the 3 x 3 values around a pixel, which must be inside by one.
    #[inline(always)]
    pub(super) fn neighbours(&self, x: i32, y: i32) -> [[f64; 3]; 3] {
        let start =
            (y - 1 - self.first[1]) as usize * self.width + (x - 1 - self.first[0]) as usize;
        [0, 1, 2].map(|k| {
            let row = &self.values[start + k * self.width..][..3];
            [f64::from(row[0]), f64::from(row[1]), f64::from(row[2])]
        })
    }

    /// Returns the patch halved in size by the mean of 2 x 2 pixels; the centre moves by (0.5, 0.5) px.
    pub(super) fn halved(&self) -> Self {
        let reach = [self.width, self.height].map(|side| (side - 3) / 4);
        Self::from_values(reach, |x, y| {
            let [column, row] = [2 * x - self.first[0], 2 * y - self.first[1]].map(|v| v as usize);
            let sum = |row: usize| {
                self.values[row * self.width + column] + self.values[row * self.width + column + 1]
            };
            0.25 * (sum(row) + sum(row + 1))
        })
    }

    /// Smooths the patch by a covariance, px^2, in passes over 3 x 3 pixels whose weights have its second moments.
    fn smooth(&mut self, covariance_px2: &Matrix2<f64>) {
        let count = (covariance_px2.symmetric_eigenvalues().max() / PASS_VARIANCE_PX2).ceil();
        let one = covariance_px2.map(|v| (v / count) as f32);
        for _ in 0..count as usize {
            let before = self.values.clone();
            smooth_rows(
                &before,
                self.width,
                [one[(0, 0)], one[(0, 1)], one[(1, 1)]],
                &mut self.values,
            );
        }
    }

    /// Interpolates the values at the positions of a path for `x = first, first + step, ...`; positions outside have the
    /// value at the edge.
    pub(super) fn sample_row(&self, path: &RowPath, first: f64, step: f64, out: &mut [f32]) {
        let [left, top] = self.first.map(f64::from);
        let [mut u, mut v] = *path;
        u[0] -= left;
        v[0] -= top;
        let path = [u, v].map(|along| along.map(|c| c as f32));
        sample_cubic(
            &self.values,
            [self.width, self.height],
            &path,
            [first, step].map(|x| x as f32),
            out,
        );
    }
}

/// Derivatives of grey values along u and v at the centre of 3 x 3 pixels (Sobel), 1/px: half the noise of a difference.
#[inline(always)]
pub(super) fn sobel_gradient([a, b, c]: &[[f64; 3]; 3]) -> Vector2<f64> {
    let along_u = 2.0 * (b[2] - b[0]) + (c[2] - c[0]) + (a[2] - a[0]);
    let along_v = 2.0 * (c[1] - a[1]) + (c[0] - a[0]) + (c[2] - a[2]);
    Vector2::new(along_u, along_v) / 8.0
}

wide! {
    /// Smooths rows by 3 x 3 weights with the second moments uu, uv, vv; the values at the edge stay.
    fn smooth_rows(before: &[f32], width: usize, moments: [f32; 3], out: &mut [f32]) = smooth_rows_inline
}

#[inline(always)]
fn smooth_rows_inline(before: &[f32], width: usize, [uu, uv, vv]: [f32; 3], out: &mut [f32]) {
    let rows = before.len() / width;
    for y in 1..rows.saturating_sub(1) {
        let [above, own, below] = [y - 1, y, y + 1].map(|y| &before[y * width..(y + 1) * width]);
        let out = &mut out[y * width + 1..(y + 1) * width - 1];
        for (x, out) in out.iter_mut().enumerate() {
            let centre = 2.0 * own[x + 1];
            let across = own[x] + own[x + 2] - centre;
            let down = above[x + 1] + below[x + 1] - centre;
            let mixed = above[x] + below[x + 2] - above[x + 2] - below[x];
            *out = own[x + 1] + 0.5 * (uu * across + vv * down) + 0.25 * uv * mixed;
        }
    }
}

wide! {
    /// Interpolates values of `size` columns and rows by cubic convolution (Keys 1981) at the positions of a path for
    /// `x = first, first + step, ...`
    fn sample_cubic(values: &[f32], size: [usize; 2], path: &[[f32; 3]; 2], steps: [f32; 2], out: &mut [f32])
        = sample_cubic_inline
}

#[inline(always)]
fn sample_cubic_inline(
    values: &[f32],
    size: [usize; 2],
    path: &[[f32; 3]; 2],
    [first, step]: [f32; 2],
    out: &mut [f32],
) {
    let limits = size.map(|side| side as f32 - 2.001);
    for (chunk, out) in out.chunks_mut(LANES).enumerate() {
        let mut whole = [[0_u32; LANES]; 2];
        let mut weights = [[[0.0_f32; LANES]; 4]; 2];
        for k in 0..2 {
            let ([a, b, c], limit) = (path[k], limits[k]);
            for lane in 0..LANES {
                let x = first + step * (chunk * LANES + lane) as f32;
                // At 1 the rounding would be down.
                let at = (a + x * (b + x * c)).max(1.001);
                let at = at.min(limit);
                let rounded = at - 0.5 + ROUNDING;
                whole[k][lane] = rounded.to_bits() - ROUNDING.to_bits();
                let four = cubic_weights(at - (rounded - ROUNDING));
                weights[k]
                    .iter_mut()
                    .zip(four)
                    .for_each(|(lanes, weight)| lanes[lane] = weight);
            }
        }
        let [wx, wy] = weights;
        let mut columns = [[0.0_f32; 4]; LANES];
        for (lane, columns) in columns.iter_mut().enumerate().take(out.len()) {
            let start = (whole[1][lane] as usize - 1) * size[0] + whole[0][lane] as usize - 1;
            for (j, wy) in wy.iter().enumerate() {
                let line = &values[start + j * size[0]..][..4];
                columns
                    .iter_mut()
                    .zip(line)
                    .for_each(|(sum, value)| *sum += wy[lane] * value);
            }
        }
        let along = |lane: usize| {
            let [a, b, c, d] = columns[lane];
            (wx[0][lane] * a + wx[1][lane] * b) + (wx[2][lane] * c + wx[3][lane] * d)
        };
        let all: [f32; LANES] = std::array::from_fn(along);
        out.copy_from_slice(&all[..out.len()]);
    }
}

/// Weights of the cubic convolution of four neighbours at a fraction.
#[inline(always)]
fn cubic_weights(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        -0.5 * t + t2 - 0.5 * t3,
        1.0 - 2.5 * t2 + 1.5 * t3,
        0.5 * t + 2.0 * t2 - 1.5 * t3,
        0.5 * (t3 - t2),
    ]
}

/// Returns the positive part of a symmetric matrix.
fn positive_part(matrix: &Matrix2<f64>) -> Matrix2<f64> {
    let axes = SymmetricEigen::new(*matrix);
    axes.eigenvectors
        * Matrix2::from_diagonal(&axes.eigenvalues.map(|v| v.max(0.0)))
        * axes.eigenvectors.transpose()
}

/// Offset of the patch's centre from the point, px.
pub(super) fn centre_offset(template: &PointTemplate) -> Vector2<f64> {
    template.place_px.map(f64::round) - template.place_px
}

/// Returns the patch of a template, smoothed as the frame shows it.
pub(super) fn template_patch(template: &PointTemplate, prediction: &PatchPrediction) -> GreyPatch {
    let [width, height] = [template.patch.width(), template.patch.height()];
    let centre = template.place_px.map(|v| v.round() as isize);
    let [left, top] = template.origin_px.map(|v| v as isize);
    let reach = [(width - 1) / 2, (height - 1) / 2];
    let value = |x: i32, y: i32| {
        template
            .patch
            .clamped_value(centre.x - left + x as isize, centre.y - top + y as isize)
    };
    let mut patch = GreyPatch::from_values(reach, |x, y| f32::from(value(x, y)));
    if let Some(inverse) = prediction.map_jacobian(&Vector2::zeros()).try_inverse() {
        let excess = inverse * inverse.transpose() - Matrix2::identity();
        patch.smooth(&(positive_part(&excess) * POINT_SPREAD_PX.powi(2)));
    }
    patch
}

/// Copies values of a frame from a column and row on, clamped to the frame's edge.
fn copy_row(frame: &Raster, [left, y]: [i32; 2], out: &mut [f32]) {
    let row = frame.row(y.clamp(0, frame.height() as i32 - 1) as usize);
    let inside = usize::try_from(left)
        .ok()
        .and_then(|left| row.get(left..left + out.len()));
    match inside {
        Some(values) => out
            .iter_mut()
            .zip(values)
            .for_each(|(out, value)| *out = f32::from(*value)),
        None => (left..)
            .zip(out)
            .for_each(|(x, out)| *out = f32::from(row[x.clamp(0, row.len() as i32 - 1) as usize])),
    }
}

/// Returns the patch of a frame on the grid of the ground frame, with a search area of `search` px to both sides, and the
/// fraction of saturated pixels; `None` if the area without the search is not completely in the frame.
///
/// The frame is first smoothed by the blur that the ground frame has beyond it.
pub(super) fn frame_patch(
    frame: &Raster,
    prediction: &PatchPrediction,
    offset: Vector2<f64>,
    search: [usize; 2],
) -> Option<(GreyPatch, f64)> {
    let border = |reach: Vector2<f64>| {
        let around =
            (-1..=1).flat_map(|y| (-1..=1).map(move |x| Vector2::new(f64::from(x), f64::from(y))));
        around.map(move |at| prediction.frame_point(&at.component_mul(&reach)))
    };
    let (right, bottom) = (frame.width() as f64 - 2.0, frame.height() as f64 - 2.0);
    let is_inside =
        |at: Vector2<f64>| at.x >= 1.0 && at.y >= 1.0 && at.x <= right && at.y <= bottom;
    if !border(Vector2::repeat(PATCH_REACH_PX as f64 + 1.0)).all(is_inside) {
        return None;
    }
    let reach = search.map(|s| s + PATCH_REACH_PX + MARGIN_PX);
    let all: Vec<Vector2<f64>> = border(Vector2::from(reach.map(|r| r as f64 + 1.0))).collect();
    let low = all
        .iter()
        .fold(prediction.centre_px, |a, b| a.inf(b))
        .map(|v| v.floor() - MARGIN_PX as f64);
    let high = all
        .iter()
        .fold(prediction.centre_px, |a, b| a.sup(b))
        .map(|v| v.ceil() + MARGIN_PX as f64);
    let [width, height] =
        [high.x - low.x, high.y - low.y].map(|side| side.min(MAX_AREA_PX) as usize + 1);
    let [left, top] = [low.x, low.y].map(|v| v as i32);
    let mut values = vec![0.0; width * height];
    for (y, values) in (top..).zip(values.chunks_exact_mut(width)) {
        copy_row(frame, [left, y], values);
    }
    let mut area = GreyPatch {
        first: [left, top],
        width,
        height,
        values,
    };
    let jacobian = prediction.map_jacobian(&Vector2::zeros());
    let excess = jacobian * jacobian.transpose() - Matrix2::identity();
    area.smooth(&(positive_part(&excess) * POINT_SPREAD_PX.powi(2)));
    let patch = GreyPatch::from_rows(reach, |y, row| {
        let path = prediction.row_path(f64::from(y) + offset.y);
        area.sample_row(&path, offset.x - reach[0] as f64, 1.0, row);
    });
    let saturated = patch
        .values
        .iter()
        .filter(|value| **value >= SATURATED_LEVEL)
        .count();
    let share = saturated as f64 / patch.values.len() as f64;
    Some((patch, share))
}
