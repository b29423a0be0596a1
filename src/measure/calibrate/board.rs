//! Boards: what is printed, and where its points are.

use super::BoardView;
use crate::estimation::robust::median;

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

/// A board in a picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BoardDetection {
    /// Its points.
    pub view: BoardView,
    /// What shows that it is not as described.
    pub misfit: Option<BoardMismatch>,
}

/// How a board differs from its description, as one picture shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoardMismatch {
    /// A checkerboard has more lines of corners.
    Larger,
    /// Tags above one another count this much on.
    Columns {
        /// Tags along a row.
        seen: usize,
    },
    /// The gap between tags.
    Gap {
        /// Over a tag's side.
        seen: f64,
    },
}

/// What most pictures say of the description, as a reason; `None` where the board is as described.
pub fn description_mismatch(board: &Board, misfits: &[Option<BoardMismatch>]) -> Option<String> {
    let half = |n: usize| n > 0 && 2 * n > misfits.len();
    let found = || misfits.iter().flatten();
    let larger = found().filter(|m| matches!(m, BoardMismatch::Larger)).count();
    let mut columns: Vec<usize> =
        found().filter_map(|m| if let BoardMismatch::Columns { seen } = m { Some(*seen) } else { None }).collect();
    let gaps: Vec<f64> =
        found().filter_map(|m| if let BoardMismatch::Gap { seen } = m { Some(*seen) } else { None }).collect();
    columns.sort_unstable();
    match *board {
        Board::Checkerboard { columns, rows, .. } if half(larger) => Some(format!(
            "the board is not as described: pictures show more than its {columns} x {rows} inner corners; count \
             the corners at which four squares meet"
        )),
        Board::AprilGrid { columns: described, .. } if half(columns.len()) => {
            let seen = columns[columns.len() / 2];
            Some(format!(
                "the board is not as described: it has {seen} tags in a row, columns = {described}; mend its description"
            ))
        }
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

/// Columns or rows of a checkerboard that no picture shows, as a reason; `None` where one shows it whole. A description that
/// counts squares has one of each too many.
pub fn missing_corner_lines(board: &Board, views: &[BoardView]) -> Option<String> {
    let Board::Checkerboard { columns, rows, square_m } = *board else { return None };
    let spanned = |view: &BoardView, axis: usize| {
        let places = view.iter().map(|p| (p.board_m[axis] / square_m).round() as i64);
        places.clone().max().zip(places.min()).map_or(0, |(last, first)| (last - first + 1) as usize)
    };
    let most = |axis: usize| views.iter().map(|view| spanned(view, axis)).max().unwrap_or(0);
    let seen: Vec<String> = [(most(0), columns, "columns"), (most(1), rows, "rows")]
        .iter()
        .filter(|(seen, described, _)| (1..*described).contains(seen))
        .map(|(seen, described, what)| format!("{seen} of {described} {what}"))
        .collect();
    (!seen.is_empty()).then(|| {
        format!(
            "never more than {} of corners seen: count the inner corners, one fewer than the squares, or show the whole \
             board once",
            seen.join(" and ")
        )
    })
}

#[cfg(feature = "aprilgrid")]
impl Board {
    /// Corner `corner` of tag `id`: counter-clockwise from the bottom left, as Kalibr counts, m.
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
