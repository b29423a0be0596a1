//! `BOARD.toml`: description of a calibration board (docs/reference/files.md).

use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::installation::Reader;
use wingd_base::fault::Fault;
use wingd_measure::calibrate::Board;

/// Key that determines the other keys; it is read first, so that errors of the others keep their lines.
#[derive(Deserialize)]
struct PatternKey {
    pattern: Pattern,
}

#[derive(Clone, Copy, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Pattern {
    Checkerboard,
    Aprilgrid,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CheckerboardTable {
    #[serde(rename = "pattern")]
    _pattern: Pattern,
    columns: usize,
    rows: usize,
    square_m: f64,
    scale_sigma: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AprilgridTable {
    #[serde(rename = "pattern")]
    _pattern: Pattern,
    family: Option<String>,
    columns: usize,
    rows: usize,
    tag_m: f64,
    spacing: f64,
    scale_sigma: Option<f64>,
}

enum BoardTable {
    Checkerboard(CheckerboardTable),
    Aprilgrid(AprilgridTable),
}

/// Calibration board and the standard deviation of its lengths.
#[derive(Clone, Debug, PartialEq)]
pub struct DescribedBoard {
    /// Printed pattern.
    pub board: Board,
    /// Relative standard deviation of its lengths along and across; `None`: they are exact.
    pub scale_sigma: Option<f64>,
}

/// Tag family that can be read.
const FAMILY: &str = "t36h11";
/// Largest number of rows or columns; a larger one is more likely a typing mistake than a board.
const MAX_COUNT: usize = 100;
/// Largest length of a board, m; a longer one is probably given in millimetres or centimetres.
const MAX_BOARD_LENGTH_M: f64 = 10.0;
/// Largest relative standard deviation of a board's lengths; a board with a larger one should be measured.
const MAX_SCALE_SIGMA: f64 = 0.05;

/// Reads the description of a board.
pub fn load_board(file: &Path) -> Result<DescribedBoard, Vec<Fault>> {
    Reader::read_file(file, |reader, name| {
        let (file, table) = read_table(reader, name)?;
        Some(check_board(reader, &file, table))
    })
}

const BOARD_REMEDY: &str = "name a file with pattern = \"checkerboard\" or \"aprilgrid\"; \
    `wingd convert` makes it from Kalibr's target";

fn read_table(reader: &mut Reader, name: &Path) -> Option<(PathBuf, BoardTable)> {
    let (file, text) = reader.read_text(name, BOARD_REMEDY)?;
    let PatternKey { pattern } = reader.parse_toml(&file, &text)?;
    let table = match pattern {
        Pattern::Checkerboard => BoardTable::Checkerboard(reader.parse_toml(&file, &text)?),
        Pattern::Aprilgrid => BoardTable::Aprilgrid(reader.parse_toml(&file, &text)?),
    };
    Some((file, table))
}

fn check_board(reader: &mut Reader, file: &Path, table: BoardTable) -> DescribedBoard {
    let (columns, rows, least, scale_sigma) = match &table {
        BoardTable::Checkerboard(t) => (t.columns, t.rows, 3, t.scale_sigma),
        BoardTable::Aprilgrid(t) => (t.columns, t.rows, 1, t.scale_sigma),
    };
    if let Some(sigma) = scale_sigma.filter(|s| !(*s > 0.0 && *s <= MAX_SCALE_SIGMA)) {
        let remedy = format!(
            "give the relative standard deviation of the board's lengths, above 0 and at most {MAX_SCALE_SIGMA}, or \
             omit it if they are exact"
        );
        reader.fault(file, "scale_sigma", format!("is {sigma}"), remedy);
    }
    for (key, count) in [("columns", columns), ("rows", rows)] {
        if !(least..=MAX_COUNT).contains(&count) {
            reader.fault(
                file,
                key,
                format!("is {count}"),
                format!("give a number from {least} to {MAX_COUNT}"),
            );
        }
    }
    let (key, largest, side_m) = match &table {
        BoardTable::Checkerboard(t) => ("square_m", "squares", t.square_m),
        BoardTable::Aprilgrid(t) => ("tag_m", "tags", t.tag_m),
    };
    let board_m = side_m * columns.max(rows) as f64;
    if board_m > MAX_BOARD_LENGTH_M && (1e-4..=100.0).contains(&side_m) {
        let problem = format!("is {side_m}: {largest} of {side_m} m, a board of {board_m:.0} m");
        let (of_mm, of_cm) = (side_m / 1000.0, side_m / 100.0);
        reader.fault(
            file,
            key,
            problem,
            format!("give metres: {of_mm} for {side_m} mm, {of_cm} for {side_m} cm"),
        );
    }
    let mut length = |key: &str, value: f64, unit: &str| {
        if !(1e-4..=100.0).contains(&value) {
            let problem = format!("is {value} {unit}");
            reader.fault(
                file,
                key,
                problem.trim_end(),
                "give a number from 0.0001 to 100",
            );
        }
    };
    let board = match table {
        BoardTable::Checkerboard(CheckerboardTable {
            columns,
            rows,
            square_m,
            ..
        }) => {
            length("square_m", square_m, "m");
            Board::Checkerboard {
                columns,
                rows,
                square_m,
            }
        }
        BoardTable::Aprilgrid(AprilgridTable {
            family,
            columns,
            rows,
            tag_m,
            spacing,
            ..
        }) => {
            length("tag_m", tag_m, "m");
            length("spacing", spacing, "");
            if let Some(family) = family.filter(|f| f != FAMILY) {
                reader.fault(
                    file,
                    "family",
                    format!("\"{family}\" is not known"),
                    format!("write \"{FAMILY}\""),
                );
            }
            Board::AprilGrid {
                columns,
                rows,
                tag_m,
                spacing,
            }
        }
    };
    DescribedBoard { board, scale_sigma }
}
