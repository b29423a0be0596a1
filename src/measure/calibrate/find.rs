//! The finder for each kind of board.

#[cfg(feature = "aprilgrid")]
use super::aprilgrid;
use super::board::{Board, BoardError, Sighting};
use super::checkerboard;
use crate::raster::Raster;

impl Board {
    /// The board's points in a picture.
    pub fn find(&self, raster: &Raster) -> Result<Sighting, BoardError> {
        match *self {
            Self::Checkerboard { columns, rows, square_m } => {
                checkerboard::find(raster, columns, rows, square_m)
            }
            #[cfg(feature = "aprilgrid")]
            Self::AprilGrid { columns, rows, tag_m, spacing } => {
                aprilgrid::find(raster, columns, rows, tag_m, spacing)
            }
            #[cfg(not(feature = "aprilgrid"))]
            Self::AprilGrid { .. } => Err(BoardError::NotBuilt),
        }
    }
}
