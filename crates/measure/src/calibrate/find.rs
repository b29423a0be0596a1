//! Dispatch to the finder of each kind of board.

#[cfg(feature = "aprilgrid")]
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
            #[cfg(feature = "aprilgrid")]
            Self::AprilGrid {
                columns,
                rows,
                tag_m,
                spacing,
            } => aprilgrid::find_aprilgrid(raster, columns, rows, tag_m, spacing),
            #[cfg(not(feature = "aprilgrid"))]
            Self::AprilGrid { .. } => Err(BoardError::NotBuilt),
        }
    }
}
