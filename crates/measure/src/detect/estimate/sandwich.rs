//! Sandwich estimate of the covariance of a fit's centre from correlated residuals.

use nalgebra::{Cholesky, Matrix2};

use crate::detect::appearance::parameters::{MarkerParameters, X, Y};
use crate::detect::detection::covariance::raise_covariance;
use crate::detect::estimate::options::WEIGHT;
use crate::detect::sample::pixels::Pixels;
use crate::detect::simd::batch::Batch;
use crate::detect::simd::lanes::{Lanes, each};

/// Extent of a marker for sectors and light fields, in semi-axes.
pub const REACH: f64 = 1.1;
/// Number of sectors along the marker, on both sides of its axis, within which residuals may be correlated.
pub const SECTORS: usize = 48;

/// Contributions of the residuals to the centre, px, summed in blocks of neighbouring pixels: in squares, and in sectors
/// along the marker on each side of its axis.
pub struct ResidualBlocks {
    origin: [f32; 2],
    per_px: f32,
    width: usize,
    squares: Vec<[f64; 2]>,
    sectors: Vec<[f64; 2]>,
}

impl ResidualBlocks {
    /// Creates empty blocks. Squares are aligned with the origin of the image, as those of JPEG are.
    pub fn new(pixels: &Pixels, m: &MarkerParameters) -> Self {
        // The extent of the pixels, because quadrants have no axes.
        let (cx, cy) = (
            (m[X] - pixels.origin[0]) as f32,
            (m[Y] - pixels.origin[1]) as f32,
        );
        let mut far = Lanes::splat(1.0);
        for batch in &pixels.batches {
            far = each(|i| {
                far[i]
                    .max((batch.x[i] - cx).abs())
                    .max((batch.y[i] - cy).abs())
            });
        }
        let reach = f64::from(far.iter().fold(1.0, |a: f32, &b| a.max(b)));
        let side = WEIGHT.square_px * (reach / (WEIGHT.square_px * WEIGHT.squares)).ceil();
        let origin =
            [X, Y].map(|k| (((m[k] - reach) / side).floor() * side - pixels.origin[k]) as f32);
        let width = (2.0 * reach / side) as usize + 2;
        let none = |count: usize| vec![[0.0; 2]; count];
        let per_px = 1.0 / side as f32;
        Self {
            origin,
            per_px,
            width,
            squares: none(width * width),
            sectors: none(SECTORS),
        }
    }

    /// Adds the contributions of the residuals of a batch.
    #[inline(always)]
    pub fn add(&mut self, batch: &Batch, moved: [Lanes; 2]) {
        let last = (self.width - 1) as f32;
        let place = |v: f32, from: f32| ((v - from) * self.per_px).clamp(0.0, last).floor();
        let square = each(|i| {
            place(batch.y[i], self.origin[1]) * self.width as f32
                + place(batch.x[i], self.origin[0])
        });
        let sector = pixel_sectors(batch);
        for i in 0..batch.len {
            let moved = [f64::from(moved[0][i]), f64::from(moved[1][i])];
            let blocks = [
                (&mut self.squares, square[i]),
                (&mut self.sectors, sector[i]),
            ];
            for block in blocks
                .into_iter()
                .filter_map(|(blocks, k)| blocks.get_mut(k as usize))
            {
                block[0] += moved[0];
                block[1] += moved[1];
            }
        }
    }

    /// Returns `white` raised to the covariance from the blocks, the largest ratio of the two, and their mean ratio in
    /// squares.
    pub fn raise_covariance(
        &self,
        white: &Matrix2<f64>,
        count: usize,
    ) -> Option<(Matrix2<f64>, f64, f64)> {
        let squares = block_covariance(&self.squares, count);
        let (raised, one) = raise_covariance(white, &squares, WEIGHT.max_random_ratio)?;
        let (raised, other) = raise_covariance(
            &raised,
            &block_covariance(&self.sectors, count),
            WEIGHT.max_random_ratio,
        )?;
        let mean = 0.5 * (Cholesky::new(*white)?.inverse() * squares).trace();
        Some((raised, one.max(other), mean))
    }
}

/// Returns the sector of each pixel of a batch.
#[inline(always)]
pub fn pixel_sectors(batch: &Batch) -> Lanes {
    /// Sectors on each side of the axis.
    const ALONG: f32 = (SECTORS / 2) as f32;
    each(|i| {
        let along = (batch.p[i] / REACH as f32 + 1.0) * 0.5 * ALONG;
        2.0 * along.clamp(0.0, ALONG - 1.0).floor() + if batch.q[i] > 0.0 { 1.0 } else { 0.0 }
    })
}

/// Returns the covariance of the centre from blocks that are independent of each other.
fn block_covariance(blocks: &[[f64; 2]], count: usize) -> Matrix2<f64> {
    let seen: Matrix2<f64> = blocks
        .iter()
        .map(|&[x, y]| Matrix2::new(x * x, x * y, x * y, y * y))
        .sum();
    // The parameters absorb a part of the common residual of a block.
    let number = blocks.iter().filter(|b| **b != [0.0; 2]).count() as f64;
    seen * (number / (number - count as f64).max(1.0)).min(WEIGHT.max_correction)
}
