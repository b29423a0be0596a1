//! Tables of aircraft data: the canonical CSV (`utc` and columns named as quantities), and lines of IWG1.

use std::path::Path;

use super::layout::{IWG1_KEYWORD, Layout, QuantityColumn};
use super::{QUANTITY_COUNT, Quantity};
use crate::installation::{Reader, parse_records};
use wingd_base::fault::Fault;
use wingd_base::regular_file::MAX_DATA_BYTES;

/// Table that can be imported into a flight.
#[derive(Clone, Debug, PartialEq)]
pub struct AircraftTable {
    /// Positions of the fields of its lines.
    pub layout: Layout,
    /// Records as in the file, with the line on which each begins.
    pub lines: Vec<(u64, String)>,
}

/// Contents of the cells of a quantity's column.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnTally {
    pub quantity: Quantity,
    /// Number of values.
    pub values: usize,
    /// Number of cells without a possible number, and the first of them.
    pub invalid: usize,
    pub first_invalid: Option<String>,
}

/// Contents of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct TableContents {
    /// Contents of each mapped quantity.
    pub tallies: Vec<ColumnTally>,
    /// Number of records with a time.
    pub timed: usize,
    /// First and last time of the records with a value, seconds since 1970; `None` if there is none.
    pub valued_s: Option<(f64, f64)>,
    /// Lines and time tags of records without a readable time.
    pub unread: Vec<(u64, String)>,
}

/// Columns of the canonical table: the time, and the quantities by their names.
const COLUMNS: [&str; 1 + QUANTITY_COUNT] = {
    let mut columns = ["utc"; 1 + QUANTITY_COUNT];
    columns.split_at_mut(1).1.copy_from_slice(super::NAMES);
    columns
};

/// Returns whether the first field of a line is the keyword of IWG1, or of its header that some recorders write.
fn is_iwg1(line: &str) -> bool {
    let first = line.split(',').next().unwrap_or_default();
    [IWG1_KEYWORD, "HEADER"].contains(&first.trim_matches(['"', ' ', '\t']))
}

impl AircraftTable {
    /// Reads a table: IWG1 if its first line is one, else the canonical CSV.
    ///
    /// # Errors
    /// Returns the errors of the table with line, column and remedy.
    pub fn read(file: &Path) -> Result<Self, Vec<Fault>> {
        Reader::read_file(file, |reader, name| {
            reader.max_bytes = MAX_DATA_BYTES;
            let remedy = "name a table: CSV with a column utc, or lines of IWG1";
            let (file, text) = reader.read_text(name, remedy)?;
            match text.lines().find(|line| !line.trim().is_empty()) {
                Some(first) if is_iwg1(first) => Self::read_iwg1(reader, &file, &text),
                _ => Self::read_canonical(reader, &file, &text),
            }
        })
    }

    /// Reads lines of IWG1. A field that is missing or added would shift those after it.
    fn read_iwg1(reader: &mut Reader, file: &Path, text: &str) -> Option<Self> {
        let lines = (1..).zip(text.lines().map(str::to_owned));
        let lines = Vec::from_iter(lines.filter(|(_, line)| !line.trim().is_empty()));
        let field_count = |line: &str| line.split(',').count();
        let width = lines.first().map_or(0, |(_, line)| field_count(line));
        let is_damaged = |(_, line): &&(u64, String)| {
            let is_single = line.matches(IWG1_KEYWORD).count() == 1;
            is_iwg1(line) && !(is_single && field_count(line) == width)
        };
        if let Some((number, _)) = lines.iter().find(is_damaged) {
            let problem = format!("is not one record of {width} fields");
            let remedy = "convert the table with `wingd-table` and format = \"iwg1\", which reads headers, splits joined lines and omits damaged ones";
            reader.fault(file, &format!("line {number}"), problem, remedy);
            return None;
        }
        Some(Self {
            layout: Layout::iwg1(&[]),
            lines,
        })
    }

    fn read_canonical(reader: &mut Reader, file: &Path, text: &str) -> Option<Self> {
        let table = parse_records(reader, file, text, COLUMNS, &COLUMNS[1..])?;
        let [time, quantities @ ..] = table.index;
        let columns = Quantity::ALL.into_iter().zip(quantities);
        let column = |(quantity, field): (Quantity, Option<usize>)| {
            Some(QuantityColumn {
                field: 1 + field?,
                quantity,
                scale: 1.0,
                offset: 0.0,
            })
        };
        let columns: Vec<QuantityColumn> = columns.filter_map(column).collect();
        if columns.is_empty() {
            let remedy = format!(
                "name a column as one of {}; `wingd-table` makes such a table from others",
                COLUMNS[1..].join(",")
            );
            reader.fault(file, "line 1", "has no quantity", remedy);
        }
        let lines = table.rows.into_iter().map(|row| (row.line, row.text));
        Some(Self {
            layout: Layout::separated(',', 1 + time?, columns),
            lines: lines.collect(),
        })
    }

    /// Counts the contents of the cells.
    pub fn contents(&self) -> TableContents {
        let quantities = &self.layout.column;
        let none = |c: &QuantityColumn| ColumnTally {
            quantity: c.quantity,
            values: 0,
            invalid: 0,
            first_invalid: None,
        };
        let mut tallies: Vec<ColumnTally> = quantities.iter().map(none).collect();
        let (mut timed, mut valued_s, mut unread) = (0, None, vec![]);
        for (line, text) in &self.lines {
            let fields = self.layout.fields(text);
            let Some(sample) = self.layout.sample(&fields) else {
                let tag = fields.get(self.layout.time_field - 1);
                unread.push((*line, tag.map(ToString::to_string).unwrap_or_default()));
                continue;
            };
            timed += 1;
            if sample.values.iter().any(Option::is_some) {
                let (first, last) = valued_s.unwrap_or((sample.time_s, sample.time_s));
                valued_s = Some((first.min(sample.time_s), last.max(sample.time_s)));
            }
            for (tally, column) in tallies.iter_mut().zip(quantities) {
                tally.count_cell(column.read(&fields));
            }
        }
        TableContents {
            tallies,
            timed,
            valued_s,
            unread,
        }
    }
}

impl ColumnTally {
    fn count_cell(&mut self, cell: Option<Result<f64, &str>>) {
        match cell {
            Some(Ok(_)) => self.values += 1,
            None => {}
            Some(Err(text)) => {
                self.invalid += 1;
                self.first_invalid.get_or_insert_with(|| text.to_owned());
            }
        }
    }

    /// Returns the reason if the column has no values.
    pub fn no_values_reason(&self) -> Option<String> {
        let name = self.quantity.name();
        let reason = match &self.first_invalid {
            Some(text) => format!(
                "{name} cannot be {text}; give plain numbers with decimal points, in the unit of its name"
            ),
            None => format!("the column of {name} is empty"),
        };
        (self.values == 0).then_some(reason)
    }
}
