//! Statistics of a sample, and how many are drawn.

use std::ops::Range;

/// Returns `all` with `WINGD_DRAWS=all`, as `make test-long` sets it, and `few` in `make test`.
pub fn draws<T>(few: T, all: T) -> T {
    if std::env::var("WINGD_DRAWS").is_ok_and(|draws| draws == "all") {
        all
    } else {
        few
    }
}

/// Returns the range of the rms of `count` normalised errors whose sigma is within 5 % of right: three standard deviations of
/// 1 / sqrt(2 count) each besides.
pub fn honest_range(count: usize) -> Range<f64> {
    let scatter = 3.0 / (2.0 * count as f64).sqrt();
    0.95 * (1.0 - scatter)..1.05 * (1.0 + scatter)
}

pub fn rms(v: &[f64]) -> f64 {
    (v.iter().map(|x| x * x).sum::<f64>() / v.len().max(1) as f64).sqrt()
}

pub fn median(v: &[f64]) -> f64 {
    let mut v = v.to_vec();
    v.sort_by(f64::total_cmp);
    v[v.len() / 2]
}
