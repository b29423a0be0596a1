//! Checks of the model by residual patterns and by two halves of the images.

use nalgebra::Vector2;

use super::adjust::CameraAdjustment;
use super::model::{DISTANCES_M, GLOBAL, GlobalCovariance, INTERIOR};
use super::{BoardView, MIN_VIEWS, quality};

/// Number of cells over the width and over the height of image and board.
const CELLS: usize = 8;
/// Points that a cell needs for its mean to be used.
const MIN_CORNERS_IN_CELL: usize = 4;

/// Comparison of two cameras, each calibrated from every second image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Halves {
    pub distance_m: f64,
    /// Root mean square over the image of the difference between their projections, px.
    pub difference_px: f64,
    /// Difference expected from the two standard deviations, px.
    pub predicted_px: f64,
}

/// Systematic part of the residuals, root mean square, px: 0 if they are as random as their number allows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ResidualPattern {
    /// Pattern over the image, caused by the lens.
    pub image_px: f64,
    /// Pattern over the board, caused by the board.
    pub board_px: f64,
}

/// Calibrates from each half of the images; `None` if a half has too few images or does not converge.
pub(super) fn compare_halves(
    adjusted: &CameraAdjustment,
    used: &[(usize, BoardView)],
) -> Option<Halves> {
    let calibrate_half = |part: usize| {
        let in_half = |k: &usize| k % 2 == part;
        let views: Vec<(usize, BoardView)> = used
            .iter()
            .enumerate()
            .filter(|(k, _)| in_half(k))
            .map(|(_, v)| v.clone())
            .collect();
        let mut start = adjusted.camera.clone();
        start.poses = adjusted
            .camera
            .poses
            .iter()
            .enumerate()
            .filter(|(k, _)| in_half(k))
            .map(|(_, p)| *p)
            .collect();
        (views.len() >= MIN_VIEWS)
            .then(|| start.adjust(&views, adjusted.model_sigma_px).ok())
            .flatten()
    };
    let (a, b) = (calibrate_half(0)?, calibrate_half(1)?);
    let change = b.solution.global - a.solution.global;
    // The middle of the distances of markers.
    let distance_m = DISTANCES_M[1];
    let effect_px = |m: &GlobalCovariance| {
        quality::uncertainty_at_distance(adjusted, used, m, distance_m).map(|p| p.sigma_px)
    };
    let difference_px = effect_px(&(change * change.transpose()))?;
    let predicted_px =
        effect_px(&(a.solution.scaled_covariance() + b.solution.scaled_covariance()))?;
    Some(Halves {
        distance_m,
        difference_px,
        predicted_px,
    })
}

/// Estimates the systematic part of the residuals over the image and over the board.
pub(super) fn residual_pattern(
    adjusted: &CameraAdjustment,
    used: &[(usize, BoardView)],
) -> ResidualPattern {
    let residuals = adjusted.residuals(used);
    let (low, high) = adjusted.shape.bounds_m();
    let side = high - low;
    let size = Vector2::new(
        f64::from(adjusted.camera.lens.width),
        f64::from(adjusted.camera.lens.height),
    );
    let points = || {
        used.iter()
            .flat_map(|(_, v)| v)
            .zip(residuals.iter().flatten())
    };
    let image = points().map(|(p, r)| (p.pixel.component_div(&size), *r));
    let board = points().map(|(p, r)| {
        (
            (p.board_m - low).component_div(&side.map(|s| s.max(1e-9))),
            *r,
        )
    });
    ResidualPattern {
        image_px: systematic_rms(image),
        board_px: systematic_rms(board),
    }
}

/// Returns the root mean square of the cells' means less the part expected of random residuals; positions from 0 to 1.
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

/// Returns the distortion terms of which one may be dropped next: of the free radial ones the first of k6, k3, k5, k2, k4,
/// k1, and each free tangential one.
pub(super) fn droppable_terms(fixed: &[bool; GLOBAL]) -> Vec<usize> {
    let radial = [11, 6, 10, 5, 9, 4].into_iter().find(|k| !fixed[*k]);
    radial
        .into_iter()
        .chain([7, 8].into_iter().filter(|k| !fixed[*k]))
        .collect()
}

/// Returns parameter `k` over its standard deviation; infinite if that is 0.
pub(super) fn t_value(adjusted: &CameraAdjustment, k: usize) -> f64 {
    let variance = adjusted.solution.scaled_covariance()[(k, k)];
    debug_assert!(k < INTERIOR);
    adjusted.solution.global[k].abs() / variance.max(0.0).sqrt()
}
