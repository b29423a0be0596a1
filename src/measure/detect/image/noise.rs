//! The frame's noise, from second differences along sampled rows; and a picture without most of it.

use super::ellipse::Ellipse;
use crate::detect::simd::dispatch::wide;
use crate::raster::Raster;
use crate::tiles::Tiles;

/// Noise from which on outlines fray, grey levels: blobs are then sought in the smoothed picture.
pub const FRAYING: f64 = 3.0;
/// The same at the levels of faint frames, whose contrast is a third of that.
pub const FRAYING_FAINT: f64 = 1.0;

/// The picture under the binomial filter of 3 x 3 px, which leaves three eighths of the noise, of each row from the first of
/// some tiles to the last; rims as they are, 0 elsewhere.
pub fn smoothed(image: &Raster, tiles: &Tiles) -> Option<Raster> {
    let (width, height) = (image.width(), image.height());
    let mut luma = vec![0; width * height];
    let mut sums = vec![0u16; width];
    for (y, out) in luma.chunks_exact_mut(width).enumerate() {
        let columns = tiles.columns(y);
        if columns.is_empty() {
            continue;
        }
        // The first and the last of them are not filtered.
        let wider = columns.start.saturating_sub(1)..(columns.end + 1).min(width);
        let row = |y: usize| &image.row(y)[wider.clone()];
        let out = &mut out[wider.clone()];
        out.copy_from_slice(row(y));
        if y > 0 && y + 1 < height {
            smooth([row(y - 1), row(y), row(y + 1)], &mut sums[..wider.len()], out);
        }
    }
    Raster::new(width, height, luma)
}

wide! {
    /// The filtered middle one of three rows, but for its ends.
    fn smooth(rows: [&[u8]; 3], sums: &mut [u16], out: &mut [u8]) = smoothed_row
}

#[inline(always)]
fn smoothed_row([above, row, below]: [&[u8]; 3], sums: &mut [u16], out: &mut [u8]) {
    for (sum, ((&a, &b), &c)) in sums.iter_mut().zip(above.iter().zip(row).zip(below)) {
        *sum = u16::from(a) + 2 * u16::from(b) + u16::from(c);
    }
    let last = out.len().saturating_sub(1);
    for (out, w) in out[..last].iter_mut().skip(1).zip(sums.windows(3)) {
        *out = ((w[0] + 2 * w[1] + w[2] + 8) >> 4) as u8;
    }
}

/// The rows of a frame that tell its noise.
pub fn sampled(height: usize) -> impl Iterator<Item = usize> {
    /// Of a camera's frame they hold some ten thousand differences, which tell it to a hundredth; each has a row of tiles decoded.
    const ROWS: usize = 16;
    let step = (height / ROWS).max(1);
    (step / 2..height).step_by(step)
}

/// Standard deviation of the grey values' noise, grey levels; at least that of rounding.
pub fn estimate(image: &Raster) -> f64 {
    from_rows(sampled(image.height()).map(|y| image.row(y)))
}

/// The same in a box about an outline: noise may differ over a frame, as where a lens's fall of light has been made good.
pub fn about(image: &Raster, ellipse: &Ellipse) -> f64 {
    /// Skin about the outline, px: it must be more than what is printed.
    const BESIDE: f64 = 16.0;
    let reach = ellipse.extent().add_scalar(BESIDE);
    let rows = image.rows_of(ellipse.centre - reach, ellipse.centre + reach);
    from_rows(rows.map(|(_, _, row)| row))
}

/// Median size of the normal law over its standard deviation.
const MEDIAN_OVER_SIGMA: f64 = 0.6745;
/// What rounding to whole grey levels leaves, grey levels: 1/sqrt(12).
const ROUNDING: f64 = 0.29;

/// The noise of some rows of pixels.
fn from_rows<'a>(rows: impl Iterator<Item = &'a [u8]>) -> f64 {
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
