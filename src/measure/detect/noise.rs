//! The frame's noise, from second differences along sampled rows.

use super::super::raster::Raster;

/// Standard deviation of the grey values' noise, grey levels; at least that of rounding.
pub fn estimate(image: &Raster) -> f64 {
    let mut histogram = [0u32; 511];
    let step = (image.height() / 48).max(1);
    for y in (step / 2..image.height()).step_by(step) {
        let row = image.row(y);
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
            return (median / (0.6745 * 6f64.sqrt())).max(0.29);
        }
        below += n;
    }
    0.29
}
