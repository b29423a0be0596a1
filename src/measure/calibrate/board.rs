//! Boards: what is printed, and where its points are.

use super::{View, checkerboard};
use crate::measure::raster::Raster;

/// A calibration board (docs/interface.md).
#[derive(Clone, Debug, PartialEq)]
pub enum Board {
    /// Black and white squares.
    Checkerboard {
        /// Inner corners along a row.
        columns: usize,
        /// Inner corners along a column.
        rows: usize,
        /// Side of a square, m.
        square_m: f64,
    },
    /// A grid of tags of the family 36h11 with small squares at their corners (Kalibr).
    AprilGrid {
        /// Tags along a row.
        columns: usize,
        /// Tags along a column.
        rows: usize,
        /// Side of a tag, m.
        tag_m: f64,
        /// Gap over side.
        spacing: f64,
    },
}

/// Why a picture gives no points.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BoardError {
    /// Not seen.
    #[error("no board found; show it whole, sharp and evenly lit")]
    NotFound,
    /// Seen, but cut or of another size.
    #[error("only {found} of {expected} points found; show the board whole and check its description")]
    Partial {
        /// Points found.
        found: usize,
        /// Points of the board.
        expected: usize,
    },
    /// This program was built without it.
    #[error("this build cannot read AprilGrids; build with the feature aprilgrid")]
    NotBuilt,
}

impl Board {
    /// The board's points in a picture.
    pub fn find(&self, raster: &Raster) -> Result<View, BoardError> {
        match *self {
            Self::Checkerboard { columns, rows, square_m } => {
                checkerboard::find(raster, columns, rows, square_m)
            }
            #[cfg(feature = "aprilgrid")]
            Self::AprilGrid { columns, rows, tag_m, spacing } => {
                super::aprilgrid::find(raster, columns, rows, tag_m, spacing)
            }
            #[cfg(not(feature = "aprilgrid"))]
            Self::AprilGrid { .. } => Err(BoardError::NotBuilt),
        }
    }

    /// Corner `corner` of tag `id`: counter-clockwise from the bottom left, as Kalibr counts, m.
    #[cfg(feature = "aprilgrid")]
    pub(super) fn tag_corner(
        columns: usize,
        tag_m: f64,
        spacing: f64,
        id: usize,
        corner: usize,
    ) -> nalgebra::Vector2<f64> {
        use nalgebra::Vector2;
        let pitch = tag_m * (1.0 + spacing);
        let origin = Vector2::new((id % columns) as f64, (id / columns) as f64) * pitch;
        let offset = [(0.0, 0.0), (tag_m, 0.0), (tag_m, tag_m), (0.0, tag_m)][corner % 4];
        origin + Vector2::new(offset.0, offset.1)
    }
}
