//! Checkerboards: `calib-targets` finds and indexes the corners, our own fit measures them.

use std::collections::HashMap;

use calib_targets_chessboard::{
    ChessboardDetector, ChessboardParams, GrayImageView, default_chess_config, detect_corners,
};
use nalgebra::Vector2;

use super::board::{BoardDetection, BoardError, BoardMismatch};
use super::corner::{self, CornerHint};
use super::{BoardPoint, BoardView, reduced, saddle};
use crate::raster::Raster;

type GridCell = (i32, i32);
type GridCorners = HashMap<GridCell, Vector2<f64>>;

/// Window radius over the distance to the nearest other corner: half, so that no two windows share pixels. If they
/// overlapped, neighbours would share noise, and the standard deviations of the camera, for which all corners count as
/// independent, would be too small.
pub(super) const WINDOW_FRACTION: f64 = 0.5;
/// Fraction of a line next to the described board that must be corners for the line to belong to the board.
const MIN_LINE_FRACTION: f64 = 0.8;

/// Finds the inner corners of a checkerboard.
///
/// # Errors
/// Returns an error if less than half of the board is found.
pub(super) fn find_checkerboard(
    raster: &Raster,
    columns: usize,
    rows: usize,
    square_m: f64,
) -> Result<BoardDetection, BoardError> {
    let corners = refine_corners(raster, &locate_corners(raster).ok_or(BoardError::NotFound)?);
    let expected = columns * rows;
    let (origin, turned) = best_placement(&corners, columns, rows).ok_or(BoardError::Partial {
        found: corners.len(),
        expected,
    })?;
    // Columns are to the right of rows in every image, so that the sign of the bow is the same in all.
    let mirrored = turned == (handedness(&corners) > 0.0);
    let mut view = BoardView::new();
    for r in 0..rows as i32 {
        for c in 0..columns as i32 {
            let k = if mirrored { columns as i32 - 1 - c } else { c };
            let cell = if turned {
                (origin.0 + r, origin.1 + k)
            } else {
                (origin.0 + k, origin.1 + r)
            };
            let fitted = corner_hint(&corners, cell).and_then(|h| corner::fit_corner(raster, &h));
            let board_m = Vector2::new(f64::from(c), f64::from(r)) * square_m;
            view.extend(fitted.map(|f| BoardPoint {
                board_m,
                pixel: f.pixel,
                covariance_px2: f.covariance_px2,
            }));
        }
    }
    // The calibration does not depend on the part of the board that is seen, but less than half a board
    // may be another pattern.
    if view.len() * 2 < expected {
        return Err(BoardError::Partial {
            found: view.len(),
            expected,
        });
    }
    let size = if turned {
        (rows, columns)
    } else {
        (columns, rows)
    };
    Ok(BoardDetection {
        view,
        mismatch: find_extra_line(&corners, origin, size),
    })
}

/// Finds corners with their grid labels; large images are searched in a smaller copy first, then at full size.
fn locate_corners(raster: &Raster) -> Option<GridCorners> {
    let (small, scale) = reduced::reduce_image(raster);
    let found = small
        .as_ref()
        .and_then(detect_chessboard_grid)
        .map(|found| {
            found
                .into_iter()
                .map(|(cell, p)| (cell, p * scale + Vector2::repeat(0.5 * (scale - 1.0))))
                .collect()
        });
    found.or_else(|| detect_chessboard_grid(raster))
}

fn detect_chessboard_grid(raster: &Raster) -> Option<GridCorners> {
    let gray = GrayImageView {
        width: raster.width(),
        height: raster.height(),
        data: raster.luma(),
    };
    let corners = detect_corners(&gray, &default_chess_config());
    let ways = ChessboardParams::sweep_default().into_iter();
    let found = ways.filter_map(|way| ChessboardDetector::new(way).ok()?.detect(&corners));
    let best = found.max_by_key(|board| board.corners.len())?;
    let corners = best.corners.iter();
    Some(
        corners
            .map(|c| {
                (
                    (c.grid.u, c.grid.v),
                    Vector2::new(f64::from(c.position.x), f64::from(c.position.y)),
                )
            })
            .collect(),
    )
}

/// Moves corners to their saddle points; drops those without one nearby.
fn refine_corners(raster: &Raster, corners: &GridCorners) -> GridCorners {
    let one = |(cell, here): (&GridCell, &Vector2<f64>)| {
        let near = STEPS
            .iter()
            .filter_map(|d| corners.get(&(cell.0 + d.0, cell.1 + d.1)));
        let nearest = near.map(|p| (p - here).norm()).fold(f64::MAX, f64::min);
        Some((
            *cell,
            saddle::refine_saddle(raster, here, saddle::half_window_for(nearest))?,
        ))
    };
    corners.iter().filter_map(one).collect()
}

const STEPS: [GridCell; 4] = [(1, 0), (-1, 0), (0, 1), (0, -1)];

/// Returns start values for a corner from its neighbours.
fn corner_hint(corners: &GridCorners, cell: GridCell) -> Option<CornerHint> {
    let centre = *corners.get(&cell)?;
    let along = grid_line(corners, cell, (1, 0))?;
    let across = grid_line(corners, cell, (0, 1))?;
    let sine = along.0.normalize().perp(&across.0.normalize()).abs();
    let radius_px = (WINDOW_FRACTION * along.2.min(across.2) * sine).min(corner::MAX_REFINEMENT_PX);
    let curvature_per_px = [along.1, across.1];
    Some(CornerHint {
        centre,
        edges: [along.0, across.0],
        curvature_per_px,
        radius_px,
    })
}

/// Returns direction, curvature and distance of the nearest neighbour of the grid line through a corner. At its ends the
/// line has the curvature of the next corner.
fn grid_line(
    corners: &GridCorners,
    cell: GridCell,
    step: GridCell,
) -> Option<(Vector2<f64>, f64, f64)> {
    let at = |k: i32| corners.get(&(cell.0 + k * step.0, cell.1 + k * step.1));
    let here = at(0)?;
    let bend = |a: &Vector2<f64>, b: &Vector2<f64>, c: &Vector2<f64>| {
        let chord = c - a;
        let left = Vector2::new(-chord.y, chord.x).normalize();
        2.0 * left.dot(&(a + c - 2.0 * b)) / ((c - b).norm_squared() + (a - b).norm_squared())
    };
    match (at(-1), at(1)) {
        (Some(a), Some(c)) => Some((
            c - a,
            bend(a, here, c),
            (a - here).norm().min((c - here).norm()),
        )),
        (None, Some(c)) => Some((
            c - here,
            at(2).map_or(0.0, |d| bend(here, c, d)),
            (c - here).norm(),
        )),
        (Some(a), None) => Some((
            here - a,
            at(-2).map_or(0.0, |z| bend(z, a, here)),
            (a - here).norm(),
        )),
        (None, None) => None,
    }
}

/// Returns a positive value if the labels' second axis lies clockwise of the first in the image, else a negative one.
fn handedness(corners: &GridCorners) -> f64 {
    let turn = |(cell, here): (&GridCell, &Vector2<f64>)| {
        let along = corners.get(&(cell.0 + 1, cell.1))? - here;
        let across = corners.get(&(cell.0, cell.1 + 1))? - here;
        Some((along.x * across.y - along.y * across.x).signum())
    };
    corners.iter().filter_map(turn).sum()
}

/// Returns the origin on the labelled grid that covers most corners, and true if the board's rows run along v. Either end
/// may be the origin; the calibration does not depend on it.
fn best_placement(corners: &GridCorners, columns: usize, rows: usize) -> Option<(GridCell, bool)> {
    let mut best: Option<(usize, GridCell, bool)> = None;
    let mut cells: Vec<GridCell> = corners.keys().copied().collect();
    cells.sort_unstable();
    let us: std::collections::BTreeSet<i32> = cells.iter().map(|c| c.0).collect();
    let vs: std::collections::BTreeSet<i32> = cells.iter().map(|c| c.1).collect();
    for turned in [false, true] {
        let size = if turned {
            (rows, columns)
        } else {
            (columns, rows)
        };
        for &u in &us {
            for &v in &vs {
                let count = cells
                    .iter()
                    .filter(|c| is_cell_inside_board(c, (u, v), size))
                    .count();
                if best.is_none_or(|b| count > b.0) {
                    best = Some((count, (u, v), turned));
                }
            }
        }
    }
    best.map(|(_, origin, turned)| (origin, turned))
}

fn is_cell_inside_board(cell: &GridCell, origin: GridCell, size: (usize, usize)) -> bool {
    (origin.0..origin.0 + size.0 as i32).contains(&cell.0)
        && (origin.1..origin.1 + size.1 as i32).contains(&cell.1)
}

/// Looks for a complete line of corners next to the described board.
fn find_extra_line(
    corners: &GridCorners,
    origin: GridCell,
    size: (usize, usize),
) -> Option<BoardMismatch> {
    let (end_u, end_v) = (origin.0 + size.0 as i32, origin.1 + size.1 as i32);
    let count = |cells: &mut dyn Iterator<Item = GridCell>, length: usize| {
        let found = cells.filter(|c| corners.contains_key(c)).count();
        found as f64 >= MIN_LINE_FRACTION * length as f64
    };
    let upright = [origin.0 - 1, end_u]
        .into_iter()
        .any(|u| count(&mut (origin.1..end_v).map(|v| (u, v)), size.1));
    let level = [origin.1 - 1, end_v]
        .into_iter()
        .any(|v| count(&mut (origin.0..end_u).map(|u| (u, v)), size.0));
    (upright || level).then_some(BoardMismatch::Larger)
}
