//! `BOARD.toml`: a calibration board (docs/interface.md).

use std::path::Path;

use serde::Deserialize;

use super::{Fault, Reader, toml_file};
use crate::measure::calibrate::Board;

#[derive(Deserialize)]
#[serde(tag = "pattern", rename_all = "lowercase", deny_unknown_fields)]
enum Table {
    Checkerboard {
        columns: usize,
        rows: usize,
        square_m: f64,
        scale_sigma: Option<f64>,
    },
    Aprilgrid {
        family: Option<String>,
        columns: usize,
        rows: usize,
        tag_m: f64,
        spacing: f64,
        scale_sigma: Option<f64>,
    },
}

/// A board and how well it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct DescribedBoard {
    /// What is printed.
    pub board: Board,
    /// Standard deviation of its lengths along and of those across, each as a share; `None`: they are exact.
    pub scale_sigma: Option<f64>,
}

/// The one family that can be read.
const FAMILY: &str = "t36h11";
/// Beyond it a slip of the pen is likelier than a board.
const MOST: usize = 100;

/// A board known worse than this, a share, is better measured.
const LOOSEST: f64 = 0.05;

/// Reads a board's description.
pub fn load_board(file: &Path) -> Result<DescribedBoard, Vec<Fault>> {
    let directory = file.parent().unwrap_or(Path::new("")).to_owned();
    let name = file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let mut reader = Reader { directory, faults: vec![], digests: vec![] };
    let board = read(&mut reader, &name);
    board.filter(|_| reader.faults.is_empty()).ok_or(reader.faults)
}

fn read(reader: &mut Reader, name: &str) -> Option<DescribedBoard> {
    let (file, text) = reader.text(name, "name a file with pattern = \"checkerboard\" or \"aprilgrid\"")?;
    let table: Table = toml_file::parse_toml(reader, &file, &text)?;
    let (columns, rows, least, scale_sigma) = match &table {
        Table::Checkerboard { columns, rows, scale_sigma, .. } => (*columns, *rows, 3, *scale_sigma),
        Table::Aprilgrid { columns, rows, scale_sigma, .. } => (*columns, *rows, 1, *scale_sigma),
    };
    if let Some(sigma) = scale_sigma.filter(|s| !(*s > 0.0 && *s <= LOOSEST)) {
        let mend = format!(
            "give the share to which the board's lengths are known, above 0 and at most {LOOSEST}, or leave it out \
             where they are exact"
        );
        reader.fault(&file, "scale_sigma", format!("is {sigma}"), mend);
    }
    for (key, count) in [("columns", columns), ("rows", rows)] {
        if !(least..=MOST).contains(&count) {
            reader.fault(&file, key, format!("is {count}"), format!("give a number from {least} to {MOST}"));
        }
    }
    let mut length = |key: &str, value: f64, unit: &str| {
        if !(1e-4..=100.0).contains(&value) {
            let problem = format!("is {value} {unit}");
            reader.fault(&file, key, problem.trim_end(), "give a number from 0.0001 to 100");
        }
    };
    let board = match table {
        Table::Checkerboard { columns, rows, square_m, .. } => {
            length("square_m", square_m, "m");
            Board::Checkerboard { columns, rows, square_m }
        }
        Table::Aprilgrid { family, columns, rows, tag_m, spacing, .. } => {
            length("tag_m", tag_m, "m");
            length("spacing", spacing, "");
            if let Some(family) = family.filter(|f| f != FAMILY) {
                reader.fault(
                    &file,
                    "family",
                    format!("\"{family}\" is not known"),
                    format!("write \"{FAMILY}\""),
                );
            }
            Board::AprilGrid { columns, rows, tag_m, spacing }
        }
    };
    Some(DescribedBoard { board, scale_sigma })
}
