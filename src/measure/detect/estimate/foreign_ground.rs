//! Pixels next to foreign objects: dirt, paint, a streak of fluid, the torn corner of a decal. The only evidence used is that
//! pixels of the object do not fit, so it is the same for any kind of object.

use super::residuals::ResidualAnalysis;
use crate::detect::estimate::options::TERM;
use crate::detect::sample::pixels::Pixels;

/// Minimum number of foreign pixels around a position for the foreign object to reach it; one or two are noise.
const MIN_FOREIGN_PIXELS: usize = 3;

/// Returns batch and lane of the pixels that are farther than the blur from foreign pixels, to which the fit gave no
/// weight. A line that touches the marker also darkens the pixels next to it, by too little to be noticed in each.
pub fn clean_pixels(pixels: &Pixels, seen: &ResidualAnalysis, blur: f64) -> Vec<[usize; 2]> {
    let mut foreign = Vec::new();
    for (batch, tukey) in pixels.batches.iter().zip(&seen.biweights) {
        foreign.extend((0..batch.len).filter(|&i| tukey[i] <= 0.0).map(|i| [batch.x[i], batch.y[i]]));
    }
    let reach2 = (TERM.foreign.0 * blur + TERM.foreign.1).powi(2) as f32;
    let near = |x: f32, y: f32| {
        let near = foreign.iter().filter(|f| (f[0] - x).powi(2) + (f[1] - y).powi(2) < reach2);
        near.take(MIN_FOREIGN_PIXELS).count() >= MIN_FOREIGN_PIXELS
    };
    let mut out = Vec::with_capacity(pixels.count());
    for (k, batch) in pixels.batches.iter().enumerate() {
        out.extend((0..batch.len).filter(|&i| !near(batch.x[i], batch.y[i])).map(|i| [k, i]));
    }
    out
}
