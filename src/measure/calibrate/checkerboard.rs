//! A checkerboard: found and indexed by `calib-targets`, measured by our saddle refinement.

use std::collections::HashMap;

use calib_targets::chessboard::ChessboardParams;
use calib_targets::detect;
use calib_targets::image::GrayImage;
use nalgebra::Vector2;

use super::board::BoardError;
use super::{BoardPoint, View, saddle};
use crate::measure::raster::Raster;

pub(super) fn find(raster: &Raster, columns: usize, rows: usize, square_m: f64) -> Result<View, BoardError> {
    let (width, height) = (raster.width() as u32, raster.height() as u32);
    let gray = GrayImage::from_raw(width, height, raster.luma().to_vec()).ok_or(BoardError::NotFound)?;
    let config = detect::default_chess_config();
    let found = detect::detect_chessboard_best(&gray, &config, &ChessboardParams::sweep_default())
        .map_err(|_| BoardError::NotFound)?;
    let corners: HashMap<(i32, i32), Vector2<f64>> = found
        .corners
        .iter()
        .map(|c| ((c.grid.u, c.grid.v), Vector2::new(f64::from(c.position.x), f64::from(c.position.y))))
        .collect();
    let expected = columns * rows;
    let (origin, turned) =
        placement(&corners, columns, rows).ok_or(BoardError::Partial { found: corners.len(), expected })?;
    // Columns count to the right of rows in every picture: a bow towards the camera stays one.
    let mirrored = turned == (handedness(&corners) > 0.0);
    let mut view = vec![];
    for r in 0..rows as i32 {
        for c in 0..columns as i32 {
            let k = if mirrored { columns as i32 - 1 - c } else { c };
            let cell = if turned { (origin.0 + r, origin.1 + k) } else { (origin.0 + k, origin.1 + r) };
            let Some(pixel) = corners.get(&cell) else { continue };
            let half = saddle::half_window(&corners, cell);
            if let Some(pixel) = saddle::refine(raster, pixel, half) {
                view.push(BoardPoint { board_m: Vector2::new(f64::from(c), f64::from(r)) * square_m, pixel });
            }
        }
    }
    // Where on the grid a part of the board lies does not matter to a calibration, but half a board
    // may be another pattern.
    if view.len() * 2 < expected {
        return Err(BoardError::Partial { found: view.len(), expected });
    }
    Ok(view)
}

/// Whether the labels' second axis lies clockwise of the first in the picture (positive) or not.
fn handedness(corners: &HashMap<(i32, i32), Vector2<f64>>) -> f64 {
    let turn = |(cell, here): (&(i32, i32), &Vector2<f64>)| {
        let along = corners.get(&(cell.0 + 1, cell.1))? - here;
        let across = corners.get(&(cell.0, cell.1 + 1))? - here;
        Some((along.x * across.y - along.y * across.x).signum())
    };
    corners.iter().filter_map(turn).sum()
}

/// Where on the labelled grid the board lies with most corners, and whether its rows run along v.
/// Which of the two ends is the origin does not matter to a calibration.
fn placement(
    corners: &HashMap<(i32, i32), Vector2<f64>>,
    columns: usize,
    rows: usize,
) -> Option<((i32, i32), bool)> {
    let mut best: Option<(usize, (i32, i32), bool)> = None;
    let mut cells: Vec<(i32, i32)> = corners.keys().copied().collect();
    cells.sort_unstable();
    let us: std::collections::BTreeSet<i32> = cells.iter().map(|c| c.0).collect();
    let vs: std::collections::BTreeSet<i32> = cells.iter().map(|c| c.1).collect();
    for turned in [false, true] {
        let (nu, nv) = if turned { (rows, columns) } else { (columns, rows) };
        for &u in &us {
            for &v in &vs {
                let inside =
                    |c: &&(i32, i32)| (u..u + nu as i32).contains(&c.0) && (v..v + nv as i32).contains(&c.1);
                let count = cells.iter().filter(inside).count();
                if best.is_none_or(|b| count > b.0) {
                    best = Some((count, (u, v), turned));
                }
            }
        }
    }
    best.map(|(_, origin, turned)| (origin, turned))
}
