//! Dispatch to the finder of each kind of board.

use super::aprilgrid;
use super::board::{Board, BoardDetection, BoardError};
use super::checkerboard;
use crate::raster::Raster;

impl Board {
    /// Finds the board's points in an image.
    ///
    /// # Errors
    /// Returns an error if the image shows no board or too little of it.
    pub fn find(&self, raster: &Raster) -> Result<BoardDetection, BoardError> {
        match *self {
            Self::Checkerboard {
                columns,
                rows,
                square_m,
            } => checkerboard::find_checkerboard(raster, columns, rows, square_m),
            Self::AprilGrid {
                columns,
                rows,
                tag_m,
                spacing,
            } => aprilgrid::find_aprilgrid(raster, columns, rows, tag_m, spacing),
        }
    }
}
