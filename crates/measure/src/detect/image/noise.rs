//! Noise of the frame, from second differences along sampled rows; and smoothing.

use super::ellipse::Ellipse;
use crate::dispatch::wide;
use crate::raster::Raster;
use crate::tiles::Tiles;

/// Noise from which on outlines fray, grey levels: blobs are then segmented in the smoothed image.
pub const FRAYING_NOISE: f64 = 3.0;

/// Smooths the image with the binomial filter of 3 x 3 px, which leaves 3/8 of the noise, in each row from the first to the
/// last of some tiles; borders stay unchanged, the rest is 0.
pub fn smooth_image(image: &Raster, tiles: &Tiles) -> Option<Raster> {
    let (width, height) = (image.width(), image.height());
    let mut luma = vec![0; width * height];
    let mut sums = vec![0u16; width];
    for (y, out) in luma.chunks_exact_mut(width).enumerate() {
        let columns = tiles.columns(y);
        if columns.is_empty() {
            continue;
        }
        // The first and the last column are not filtered.
        let wider = columns.start.saturating_sub(1)..(columns.end + 1).min(width);
        let row = |y: usize| &image.row(y)[wider.clone()];
        let out = &mut out[wider.clone()];
        out.copy_from_slice(row(y));
        if y > 0 && y + 1 < height {
            smooth_row(
                [row(y - 1), row(y), row(y + 1)],
                &mut sums[..wider.len()],
                out,
            );
        }
    }
    Raster::new(width, height, luma)
}

wide! {
    /// Filters the middle one of three rows, except for its ends.
    fn smooth_row(rows: [&[u8]; 3], sums: &mut [u16], out: &mut [u8]) = smooth_row_generic
}

#[inline(always)]
fn smooth_row_generic([above, row, below]: [&[u8]; 3], sums: &mut [u16], out: &mut [u8]) {
    for (sum, ((&a, &b), &c)) in sums.iter_mut().zip(above.iter().zip(row).zip(below)) {
        *sum = u16::from(a) + 2 * u16::from(b) + u16::from(c);
    }
    let last = out.len().saturating_sub(1);
    for (out, w) in out[..last].iter_mut().skip(1).zip(sums.windows(3)) {
        *out = ((w[0] + 2 * w[1] + w[2] + 8) >> 4) as u8;
    }
}

/// Returns the rows of a frame that are sampled for its noise.
pub fn sampled_rows(height: usize) -> impl Iterator<Item = usize> {
    /// Number of rows. In a camera's frame they have about 10,000 differences, which determine the noise to 1 %; each
    /// requires a row of tiles to be decoded.
    const ROWS: usize = 16;
    let step = (height / ROWS).max(1);
    (step / 2..height).step_by(step)
}

/// Estimates the standard deviation of the noise, grey levels; at least that of rounding.
pub fn estimate_noise(image: &Raster) -> f64 {
    noise_from_rows(sampled_rows(image.height()).map(|y| image.row(y)))
}

/// Estimates the noise in a box around an outline, grey levels. Noise may differ over a frame, for example if vignetting
/// has been corrected.
pub fn noise_around(image: &Raster, ellipse: &Ellipse) -> f64 {
    /// Skin around the outline, px: more than the printed area.
    const SKIN_PX: f64 = 16.0;
    let reach = ellipse.half_extent().add_scalar(SKIN_PX);
    let rows = image.rows_in_box(ellipse.centre - reach, ellipse.centre + reach);
    noise_from_rows(rows.map(|(_, _, row)| row))
}

/// Median absolute value of the normal distribution over its standard deviation.
const MEDIAN_OVER_SIGMA: f64 = 0.6745;
/// Standard deviation of rounding to whole grey levels: 1/sqrt(12).
const ROUNDING: f64 = 0.29;

/// Estimates the noise of some rows of pixels, grey levels.
fn noise_from_rows<'a>(rows: impl Iterator<Item = &'a [u8]>) -> f64 {
    let mut histogram = [0u32; 511];
    for row in rows {
        for w in row.windows(3).step_by(3) {
            let saturated = w.iter().any(|&v| v == 0 || v >= 254);
            if !saturated {
                let d = i32::from(w[0]) + i32::from(w[2]) - 2 * i32::from(w[1]);
                histogram[(d.unsigned_abs() as usize).min(510)] += 1;
            }
        }
    }
    // A difference of integers: the median is interpolated within its bin [d - 1/2, d + 1/2).
    let total: u32 = histogram.iter().sum();
    let mut below = 0.0;
    for (d, &n) in histogram.iter().enumerate() {
        let (n, half) = (f64::from(n), 0.5 * f64::from(total));
        if n > 0.0 && below + n >= half {
            let from = (d as f64 - 0.5).max(0.0);
            let width = if d == 0 { 0.5 } else { 1.0 };
            let median = from + width * (half - below) / n;
            // A second difference of independent values has six of their variances.
            return (median / (MEDIAN_OVER_SIGMA * 6f64.sqrt())).max(ROUNDING);
        }
        below += n;
    }
    ROUNDING
}
