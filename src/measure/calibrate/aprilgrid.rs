//! A Kalibr AprilGrid: tags found by `aprilgrid`, corners measured by our saddle refinement.

use ::aprilgrid::TagFamily;
use ::aprilgrid::detector::TagDetector;
use image::{DynamicImage, GrayImage};
use nalgebra::Vector2;

use super::board::{Board, BoardError};
use super::{BoardPoint, View, saddle};
use crate::measure::raster::Raster;

/// Tags needed for a view.
const LEAST_TAGS: usize = 4;

pub(super) fn find(
    raster: &Raster,
    columns: usize,
    rows: usize,
    tag_m: f64,
    spacing: f64,
) -> Result<View, BoardError> {
    let (width, height) = (raster.width() as u32, raster.height() as u32);
    let gray = GrayImage::from_raw(width, height, raster.luma().to_vec()).ok_or(BoardError::NotFound)?;
    let found = TagDetector::new(&TagFamily::T36H11, None).detect(&DynamicImage::ImageLuma8(gray));
    // The detector's order differs between runs: ours is by id.
    let mut tags: Vec<_> = found.into_iter().filter(|(id, _)| (*id as usize) < columns * rows).collect();
    tags.sort_by_key(|(id, _)| *id);
    if tags.len() < LEAST_TAGS {
        return Err(if tags.is_empty() {
            BoardError::NotFound
        } else {
            BoardError::Partial { found: 4 * tags.len(), expected: 4 * columns * rows }
        });
    }
    let mut view = vec![];
    for (id, corners) in tags {
        let corners = corners.map(|(x, y)| Vector2::new(f64::from(x), f64::from(y)));
        for (k, corner) in corners.iter().enumerate() {
            let side = (corners[(k + 1) % 4] - corner).norm().min((corners[(k + 3) % 4] - corner).norm());
            // Half a gap, so that the window stays inside the small square at the tag's corner.
            let half = saddle::half_window_for(side * spacing.min(1.0) * 1.5);
            let board_m = Board::tag_corner(columns, tag_m, spacing, id as usize, k);
            if let Some(pixel) = saddle::refine(raster, corner, half) {
                view.push(BoardPoint { board_m, pixel });
            }
        }
    }
    Ok(view)
}
