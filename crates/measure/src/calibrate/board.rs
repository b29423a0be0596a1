//! Boards: the printed pattern and the positions of its points.

use super::BoardView;
use crate::estimation::robust::median;

/// A calibration board (docs/reference/files.md).
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

/// Reason why an image gives no points.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BoardError {
    /// No board in the image.
    #[error(
        "no board found; show the complete board (an AprilGrid with its small squares), in focus, evenly lit and not mirrored"
    )]
    NotFound,
    /// Board found, but cut off or of another size.
    #[error(
        "only {found} of {expected} points found; show the complete board and check its description"
    )]
    Partial { found: usize, expected: usize },
    /// Tags of another board; the text has the difference and the remedy.
    #[error("{0}")]
    OtherTags(String),
}

/// Board points found in an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BoardDetection {
    pub view: BoardView,
    /// Evidence that the board differs from its description.
    pub mismatch: Option<BoardMismatch>,
}

/// Difference between a board and its description, from one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoardMismatch {
    /// More lines of corners than described.
    Larger,
    /// Rows of tags that do not begin with multiples of the columns: the first tag is not 0.
    FirstTag,
    /// Wrong number of tags in a row.
    Columns { seen: usize },
    /// Wrong gap between tags.
    Gap {
        /// Gap over the side of a tag.
        seen: f64,
    },
}

/// Returns the difference between board and description that most images show, as a reason; `None` if there is none.
pub fn description_mismatch(board: &Board, mismatches: &[Option<BoardMismatch>]) -> Option<String> {
    let half = |n: usize| n > 0 && 2 * n > mismatches.len();
    let found = || mismatches.iter().flatten();
    let larger = found()
        .filter(|m| matches!(m, BoardMismatch::Larger))
        .count();
    let first = found()
        .filter(|m| matches!(m, BoardMismatch::FirstTag))
        .count();
    let mut columns: Vec<usize> = found()
        .filter_map(|m| {
            if let BoardMismatch::Columns { seen } = m {
                Some(*seen)
            } else {
                None
            }
        })
        .collect();
    let gaps: Vec<f64> = found()
        .filter_map(|m| {
            if let BoardMismatch::Gap { seen } = m {
                Some(*seen)
            } else {
                None
            }
        })
        .collect();
    columns.sort_unstable();
    match *board {
        Board::Checkerboard { columns, rows, .. } if half(larger) => Some(format!(
            "the board is not as described: images show more than its {columns} x {rows} inner corners; \
             count the corners at which four squares meet"
        )),
        Board::AprilGrid {
            columns: described, ..
        } if half(columns.len()) => {
            let seen = columns[columns.len() / 2];
            Some(format!(
                "the board is not as described: it has {seen} tags in a row, columns = {described}; correct \
                 its description"
            ))
        }
        Board::AprilGrid { columns, rows, .. } if half(first) => Some(format!(
            "the board is not as described: its tags are not numbered from 0 to {}; use a board that is",
            columns * rows - 1
        )),
        Board::AprilGrid { spacing, .. } if half(gaps.len()) => {
            let seen = median(gaps)?;
            Some(format!(
                "the board is not as described: the gap between its tags is {seen:.3} of a tag's side, \
                 spacing = {spacing}; measure both"
            ))
        }
        _ => None,
    }
}

/// Returns the columns or rows of a checkerboard that no image shows, as a reason; `None` if one shows it completely. A
/// description that counts squares has one of each too many.
pub fn missing_corner_lines(board: &Board, views: &[BoardView]) -> Option<String> {
    let Board::Checkerboard {
        columns,
        rows,
        square_m,
    } = *board
    else {
        return None;
    };
    let spanned = |view: &BoardView, axis: usize| {
        let places = view
            .iter()
            .map(|p| (p.board_m[axis] / square_m).round() as i64);
        places
            .clone()
            .max()
            .zip(places.min())
            .map_or(0, |(last, first)| (last - first + 1) as usize)
    };
    let most = |axis: usize| {
        views
            .iter()
            .map(|view| spanned(view, axis))
            .max()
            .unwrap_or(0)
    };
    let seen: Vec<String> = [(most(0), columns, "columns"), (most(1), rows, "rows")]
        .iter()
        .filter(|(seen, described, _)| (1..*described).contains(seen))
        .map(|(seen, described, lines)| format!("{seen} of {described} {lines}"))
        .collect();
    (!seen.is_empty()).then(|| {
        format!(
            "never more than {} of corners seen: count the inner corners, which are one fewer than the \
             squares, or show the complete board in at least one image",
            seen.join(" and ")
        )
    })
}

#[cfg(feature = "boards")]
impl Board {
    /// Returns corner `corner` of tag `id`, board plane, m: counter-clockwise from the bottom left, as Kalibr counts.
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
