//! What the residuals and two halves of the pictures say of the model.

use nalgebra::Vector2;

use super::adjust::{CameraAdjustment, AdjustmentStart, adjust_bundle};
use super::model::{GlobalCovariance, DISTANCES_M, GLOBAL, INTERIOR};
use super::{MIN_VIEWS, BoardView, quality};

/// Cells over the image's and the board's width and height.
const CELLS: usize = 8;
/// Points of a cell whose mean tells anything.
const MIN_CORNERS_IN_CELL: usize = 4;

/// Two cameras, each from every second picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Halves {
    /// Distance of the points that are compared, m.
    pub distance_m: f64,
    /// Root mean square over the image of the difference between their projections, px.
    pub difference_px: f64,
    /// What their standard deviations let expect, px.
    pub predicted_px: f64,
}

/// What the residuals have in common, root mean square, px: 0 where they are as random as their number allows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ResidualPattern {
    /// By the place in the image: the lens's.
    pub image_px: f64,
    /// By the place on the board: the board's.
    pub board_px: f64,
}

/// `None` where a half has too few pictures or no camera.
pub(super) fn compare_halves(adjusted: &CameraAdjustment, used: &[(usize, BoardView)]) -> Option<Halves> {
    let of = |part: usize| {
        let mine = |k: &usize| k % 2 == part;
        let views: Vec<(usize, BoardView)> =
            used.iter().enumerate().filter(|(k, _)| mine(k)).map(|(_, v)| v.clone()).collect();
        let mut start = AdjustmentStart::from_adjustment(adjusted);
        start.poses = adjusted.poses.iter().enumerate().filter(|(k, _)| mine(k)).map(|(_, p)| *p).collect();
        (views.len() >= MIN_VIEWS).then(|| adjust_bundle(&views, &start, adjusted.model_sigma_px).ok()).flatten()
    };
    let (a, b) = (of(0)?, of(1)?);
    let change = b.solution.global - a.solution.global;
    let scaled = |h: &CameraAdjustment| h.solution.covariance * h.solution.variance_factor();
    // In the middle of the distances at which markers lie.
    let distance_m = DISTANCES_M[1];
    let worth = |m: &GlobalCovariance| quality::uncertainty_at_distance(adjusted, used, m, distance_m).map(|p| p.sigma_px);
    let difference_px = worth(&(change * change.transpose()))?;
    let predicted_px = worth(&(scaled(&a) + scaled(&b)))?;
    Some(Halves { distance_m, difference_px, predicted_px })
}

pub(super) fn residual_pattern(adjusted: &CameraAdjustment, used: &[(usize, BoardView)]) -> ResidualPattern {
    let residuals = adjusted.residuals(used);
    let (low, high) = adjusted.shape.bounds_m();
    let side = high - low;
    let size = Vector2::new(f64::from(adjusted.lens.width), f64::from(adjusted.lens.height));
    let points = || used.iter().flat_map(|(_, v)| v).zip(residuals.iter().flatten());
    let image = points().map(|(p, r)| (p.pixel.component_div(&size), *r));
    let board = points().map(|(p, r)| ((p.board_m - low).component_div(&side.map(|s| s.max(1e-9))), *r));
    ResidualPattern { image_px: systematic_rms(image), board_px: systematic_rms(board) }
}

/// Root mean square of the cells' means, less what chance leaves there; places from 0 to 1.
fn systematic_rms(residuals: impl Iterator<Item = (Vector2<f64>, Vector2<f64>)>) -> f64 {
    let mut cells = vec![(0usize, Vector2::zeros(), 0.0); CELLS * CELLS];
    let (mut all, mut n) = (0.0, 0usize);
    for (place, r) in residuals {
        let index = |v: f64| ((v * CELLS as f64).max(0.0) as usize).min(CELLS - 1);
        let cell = &mut cells[index(place.y) * CELLS + index(place.x)];
        (cell.0, cell.1, cell.2) = (cell.0 + 1, cell.1 + r, cell.2 + r.norm_squared());
        (all, n) = (all + r.norm_squared(), n + 1);
    }
    let mean = all / n.max(1) as f64;
    let (mut sum, mut points) = (0.0, 0usize);
    for (count, total, _) in cells.iter().filter(|c| c.0 >= MIN_CORNERS_IN_CELL) {
        let k = *count as f64;
        sum += k * ((total / k).norm_squared() - mean / k);
        points += count;
    }
    (sum / points.max(1) as f64).max(0.0).sqrt()
}

/// Distortion terms of which a calibration can do without one: of the radial ones only the highest left, of the
/// denominator first.
pub(super) fn droppable_terms(held: &[bool; GLOBAL]) -> Vec<usize> {
    let radial = [11, 6, 10, 5, 9, 4].into_iter().find(|k| !held[*k]);
    radial.into_iter().chain([7, 8].into_iter().filter(|k| !held[*k])).collect()
}

/// Value over standard deviation; infinite where there is none.
pub(super) fn t_value(adjusted: &CameraAdjustment, k: usize) -> f64 {
    let variance = adjusted.solution.covariance[(k, k)] * adjusted.solution.variance_factor();
    debug_assert!(k < INTERIOR);
    adjusted.solution.global[k].abs() / variance.max(0.0).sqrt()
}
