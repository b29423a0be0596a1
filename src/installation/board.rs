//! `BOARD.toml`: a calibration board (docs/interface.md).

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::keyed::{self, Node, Syntax, Trouble};
use super::{Fault, Reader, toml_file};
use crate::measure::calibrate::Board;

/// The one key that says which others there are: read first, so that faults of the others keep their lines.
#[derive(Deserialize)]
struct Named {
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
struct Checkerboard {
    #[serde(rename = "pattern")]
    _pattern: Pattern,
    columns: usize,
    rows: usize,
    square_m: f64,
    scale_sigma: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Aprilgrid {
    #[serde(rename = "pattern")]
    _pattern: Pattern,
    family: Option<String>,
    columns: usize,
    rows: usize,
    tag_m: f64,
    spacing: f64,
    scale_sigma: Option<f64>,
}

enum Table {
    Checkerboard(Checkerboard),
    Aprilgrid(Aprilgrid),
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
const MAX_COUNT: usize = 100;
/// No board is longer, m: millimetres or centimetres stand for metres then.
const MAX_BOARD_LENGTH_M: f64 = 10.0;
/// A board known worse than this, a share, is better measured.
const LOOSEST: f64 = 0.05;

/// Reads a board's description; a `.yaml` as Kalibr's.
pub fn load_board(file: &Path) -> Result<DescribedBoard, Vec<Fault>> {
    let (mut reader, name) = Reader::of_file(file);
    let kalibr = file.extension().is_some_and(|e| e == "yaml" || e == "yml");
    let table = if kalibr { of_kalibr(&mut reader, &name) } else { of_toml(&mut reader, &name) };
    let board = table.map(|(file, table)| checked(&mut reader, &file, table));
    board.filter(|_| reader.faults.is_empty()).ok_or(reader.faults)
}

const MEND: &str = "name a file with pattern = \"checkerboard\" or \"aprilgrid\", or Kalibr's target yaml";

fn of_toml(reader: &mut Reader, name: &Path) -> Option<(PathBuf, Table)> {
    let (file, text) = reader.text(name, MEND)?;
    let Named { pattern } = toml_file::parse_toml(reader, &file, &text)?;
    let table = match pattern {
        Pattern::Checkerboard => Table::Checkerboard(toml_file::parse_toml(reader, &file, &text)?),
        Pattern::Aprilgrid => Table::Aprilgrid(toml_file::parse_toml(reader, &file, &text)?),
    };
    Some((file, table))
}

fn of_kalibr(reader: &mut Reader, name: &Path) -> Option<(PathBuf, Table)> {
    let (file, text) = reader.text(name, MEND)?;
    match keyed::parse(&text, Syntax::Yaml).and_then(|tree| target(&tree)) {
        Ok(table) => Some((file, table)),
        Err(trouble) => {
            reader.trouble(&file, trouble);
            None
        }
    }
}

/// A target of Kalibr (github.com/ethz-asl/kalibr/wiki/calibration-targets), whose checkerboards count inner corners too.
fn target(tree: &Node) -> Result<Table, Trouble> {
    let need = |key: &str| tree.need(key, "write it as Kalibr's wiki describes the target");
    let count = |key: &str| {
        let (node, number) = (need(key)?, need(key)?.number(key)?);
        let whole = number >= 0.0 && number.fract() == 0.0 && number <= MAX_COUNT as f64;
        let mend = "give a whole number of tags, or of inner corners";
        if whole {
            Ok(number as usize)
        } else {
            Err(Trouble::new(node.line, key, format!("is {number}"), mend))
        }
    };
    let kind = need("target_type")?;
    let table = match kind.text().unwrap_or("a list") {
        "aprilgrid" => Ok(Table::Aprilgrid(Aprilgrid {
            _pattern: Pattern::Aprilgrid,
            family: None,
            columns: count("tagCols")?,
            rows: count("tagRows")?,
            tag_m: need("tagSize")?.number("tagSize")?,
            spacing: need("tagSpacing")?.number("tagSpacing")?,
            scale_sigma: None,
        })),
        "checkerboard" => {
            let side = |key: &str| need(key)?.number(key);
            let (along, across) = (side("colSpacingMeters")?, side("rowSpacingMeters")?);
            if along != across {
                let problem = format!("is {across} m, colSpacingMeters {along} m");
                let mend = "squares alone are read: measure both, and describe other boards by scale_sigma";
                return Err(Trouble::new(need("rowSpacingMeters")?.line, "rowSpacingMeters", problem, mend));
            }
            let (columns, rows) = (count("targetCols")?, count("targetRows")?);
            let _pattern = Pattern::Checkerboard;
            Ok(Table::Checkerboard(Checkerboard {
                _pattern,
                columns,
                rows,
                square_m: along,
                scale_sigma: None,
            }))
        }
        other => {
            let problem = format!("\"{other}\" is another target");
            Err(Trouble::new(kind.line, "target_type", problem, "show an aprilgrid or a checkerboard"))
        }
    }?;
    known(tree)?;
    Ok(table)
}

/// Keys of Kalibr's targets; `codeOffset` moves the tags' numbers, and those from 0 on are read.
const KALIBR: [&str; 9] = [
    "target_type",
    "tagCols",
    "tagRows",
    "tagSize",
    "tagSpacing",
    "targetCols",
    "targetRows",
    "rowSpacingMeters",
    "colSpacingMeters",
];
const OFFSET: &str = "codeOffset";

/// A key that nobody knows may say what the board is.
fn known(tree: &Node) -> Result<(), Trouble> {
    for entry in tree.entries() {
        let (line, key) = (entry.node.line, entry.key.as_str());
        if KALIBR.contains(&key) || (key == OFFSET && entry.node.number(key)? == 0.0) {
            continue;
        }
        let (problem, mend) = match key {
            OFFSET => ("is not 0", "print the grid with tags from 0 on, which alone are read"),
            _ => (
                "is no key of a target that is read",
                "leave it out if it says nothing of the board's geometry",
            ),
        };
        return Err(Trouble::new(line, key, problem, mend));
    }
    Ok(())
}

fn checked(reader: &mut Reader, file: &Path, table: Table) -> DescribedBoard {
    let (columns, rows, least, scale_sigma) = match &table {
        Table::Checkerboard(t) => (t.columns, t.rows, 3, t.scale_sigma),
        Table::Aprilgrid(t) => (t.columns, t.rows, 1, t.scale_sigma),
    };
    if let Some(sigma) = scale_sigma.filter(|s| !(*s > 0.0 && *s <= LOOSEST)) {
        let mend = format!(
            "give the share to which the board's lengths are known, above 0 and at most {LOOSEST}, or leave it out \
             where they are exact"
        );
        reader.fault(file, "scale_sigma", format!("is {sigma}"), mend);
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
        Table::Checkerboard(t) => ("square_m", "squares", t.square_m),
        Table::Aprilgrid(t) => ("tag_m", "tags", t.tag_m),
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
            reader.fault(file, key, problem.trim_end(), "give a number from 0.0001 to 100");
        }
    };
    let board = match table {
        Table::Checkerboard(Checkerboard { columns, rows, square_m, .. }) => {
            length("square_m", square_m, "m");
            Board::Checkerboard { columns, rows, square_m }
        }
        Table::Aprilgrid(Aprilgrid { family, columns, rows, tag_m, spacing, .. }) => {
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
            Board::AprilGrid { columns, rows, tag_m, spacing }
        }
    };
    DescribedBoard { board, scale_sigma }
}
