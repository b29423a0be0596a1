//! Saddle point of four alternating quadrants, to a few hundredths of a pixel: start value of the fit in `corner.rs`.

use nalgebra::{Matrix2, Vector2};

use crate::raster::Raster;

const ITERATIONS: usize = 30;
const SETTLED_PX: f64 = 1e-4;

/// Half the side of the largest window, px: limits the time, as the result only starts the fit.
const MAX_HALF_WINDOW: usize = 8;

/// Returns half the side of the window, px: a third of the distance to the nearest other corner.
pub(super) fn half_window_for(distance_px: f64) -> usize {
    ((distance_px / 3.0) as usize).clamp(2, MAX_HALF_WINDOW)
}

/// Finds the point to which the gradient of every edge in the window is orthogonal (Förstner and Gülch 1987), iterated;
/// `None` if it does not settle inside the window.
pub(super) fn refine_saddle(
    raster: &Raster,
    start: &Vector2<f64>,
    half: usize,
) -> Option<Vector2<f64>> {
    let half = half as isize;
    let inside = |p: &Vector2<f64>| {
        p.x > half as f64 + 1.0
            && p.y > half as f64 + 1.0
            && p.x < raster.width() as f64 - half as f64 - 2.0
            && p.y < raster.height() as f64 - half as f64 - 2.0
    };
    let mut centre = *start;
    for _ in 0..ITERATIONS {
        if !inside(&centre) {
            return None;
        }
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for dy in -half..=half {
            for dx in -half..=half {
                let at = centre + Vector2::new(dx as f64, dy as f64);
                let g = Vector2::new(
                    sample_bilinear(raster, at.x + 1.0, at.y)
                        - sample_bilinear(raster, at.x - 1.0, at.y),
                    sample_bilinear(raster, at.x, at.y + 1.0)
                        - sample_bilinear(raster, at.x, at.y - 1.0),
                );
                let weight = (-2.0 * ((dx * dx + dy * dy) as f64) / (half * half) as f64).exp();
                let outer = g * g.transpose() * weight;
                normal += outer;
                right += outer * at;
            }
        }
        let next = normal.try_inverse()? * right;
        let moved = (next - centre).norm();
        centre = next;
        if moved < SETTLED_PX {
            return ((centre - start).norm() <= half as f64).then_some(centre);
        }
    }
    None
}

/// Interpolates a grey value bilinearly.
fn sample_bilinear(raster: &Raster, x: f64, y: f64) -> f64 {
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let g =
        |dx: isize, dy: isize| f64::from(raster.clamped_value(x0 as isize + dx, y0 as isize + dy));
    (g(0, 0) * (1.0 - fx) + g(1, 0) * fx) * (1.0 - fy) + (g(0, 1) * (1.0 - fx) + g(1, 1) * fx) * fy
}
