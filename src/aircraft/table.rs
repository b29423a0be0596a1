//! Tables of aircraft data written by other programs: separator, header, units and time are detected or given. Pure.

use std::borrow::Cow;

use super::layout::{Cell, Layout, LineFormat, QuantityColumn};
use super::mapping::{MappedColumn, Mapping};
use super::units::{self, UnitAgreement};
use super::{Quantity, iwg1};
use crate::installation::{KeyFault, Row, RowsError, parse_rows, separator_line};

/// Table that can be imported into a flight.
#[derive(Clone, Debug, PartialEq)]
pub struct AircraftTable {
    /// Positions of the fields of its lines.
    pub layout: Layout,
    /// Records as in the file, with the line on which each begins.
    pub lines: Vec<(u64, String)>,
    /// Remarks on detected, omitted or repaired contents.
    pub remarks: Vec<String>,
}

/// Contents of the cells of a quantity's column.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnTally {
    pub quantity: Quantity,
    /// Number of values.
    pub values: usize,
    /// Number of empty cells.
    pub blank: usize,
    /// Number of texts that are not numbers, and the first of them.
    pub text: (usize, Option<String>),
    /// Number of impossible values, and the first of them in the quantity's unit.
    pub out_of_range: (usize, Option<f64>),
}

/// Contents of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct TableContents {
    /// Contents of each mapped quantity.
    pub tallies: Vec<ColumnTally>,
    /// Times of its records, seconds since 1970, in their order.
    pub times_s: Vec<f64>,
    /// Lines and time tags of records without a readable time.
    pub unread: Vec<(u64, String)>,
}

/// Number of rows in which the header is searched for.
const MAX_HEADER_ROW: usize = 50;
/// Separators that are tried if the mapping has none.
const SEPARATORS: [char; 4] = [',', ';', '\t', '|'];

impl AircraftTable {
    /// Finds header and records of a table.
    ///
    /// # Errors
    /// Returns the first error of the table; a key without a line belongs to the mapping.
    pub fn parse(mapping: &Mapping, text: &str) -> Result<Self, KeyFault> {
        match mapping.format {
            LineFormat::Iwg1 => {
                let (lines, remarks) = iwg1::split_records(text)?;
                let own = mapping.column.iter().filter_map(|c| Some(column_from_mapping(c, c.field?)));
                let layout = Layout::iwg1(&own.collect::<Vec<_>>());
                let layout = Layout { time_format: mapping.time_format, date: mapping.date, ..layout };
                Ok(Self { layout, lines, remarks })
            }
            LineFormat::Text => read_table_with_header(mapping, text),
        }
    }

    /// Counts the contents of the cells.
    pub fn contents(&self) -> TableContents {
        let quantities = &self.layout.column;
        let none = |c: &QuantityColumn| ColumnTally {
            quantity: c.quantity,
            values: 0,
            blank: 0,
            text: (0, None),
            out_of_range: (0, None),
        };
        let mut tallies: Vec<ColumnTally> = quantities.iter().map(none).collect();
        let (mut times_s, mut unread) = (vec![], vec![]);
        for (line, text) in &self.lines {
            let fields = self.layout.fields(text);
            let Some(sample) = self.layout.sample(&fields) else {
                let tag = self.layout.time_field.checked_sub(1).and_then(|k| fields.get(k));
                unread.push((*line, tag.map(ToString::to_string).unwrap_or_default()));
                continue;
            };
            times_s.push(sample.time_s);
            for (tally, column) in tallies.iter_mut().zip(quantities) {
                tally.count_cell(&self.layout, &fields, column);
            }
        }
        TableContents { tallies, times_s, unread }
    }
}

impl ColumnTally {
    fn count_cell(&mut self, layout: &Layout, fields: &[Cow<str>], column: &QuantityColumn) {
        match layout.cell(fields, column) {
            Cell::Value(_) => self.values += 1,
            Cell::Blank => self.blank += 1,
            Cell::Text => {
                self.text.0 += 1;
                let cell = column.field.checked_sub(1).and_then(|k| fields.get(k));
                self.text.1 = self.text.1.take().or_else(|| cell.map(ToString::to_string));
            }
            Cell::OutOfRange(value) => {
                self.out_of_range.0 += 1;
                self.out_of_range.1 = self.out_of_range.1.or(Some(value));
            }
        }
    }

    /// Returns the reason if the column has no values.
    pub fn no_values_reason(&self) -> Option<String> {
        let name = self.quantity.name();
        let (points, commas) = (|text: &String| text.contains('.'), |text: &String| text.contains(','));
        let number = |text: &String| text.replace(',', "").parse::<f64>().is_ok();
        match (self.values, &self.text.1, self.out_of_range.1) {
            (1.., ..) => None,
            (0, Some(text), _) if number(text) && has_thousands_separators(text) => Some(format!(
                "{name} has commas that separate thousands, or decimals ({text}); save its numbers without thousands, or write \
                 decimal = \",\" in the mapping"
            )),
            (0, Some(text), _) if number(text) && commas(text) && !points(text) => {
                Some(format!("{name} has decimal commas ({text}); write decimal = \",\" in the mapping"))
            }
            (0, Some(text), _) if number(text) => Some(format!(
                "{name} has points and decimal commas ({text}); save its numbers without thousands, with one decimal sign"
            )),
            (0, Some(text), _) => Some(format!(
                "{name} has texts instead of numbers ({text}); save plain numbers, or name another column"
            )),
            (0, None, Some(value)) => {
                Some(format!("{name} cannot be {value:.6}; correct the mapping's scale, or name another column"))
            }
            (0, None, None) => Some(format!("the column of {name} is empty; name another")),
        }
    }
}

/// Returns whether a number's commas may separate thousands: `35,000`.
fn has_thousands_separators(text: &str) -> bool {
    let mut groups = text.trim_start_matches(['+', '-']).split(',');
    let first = groups.next().is_some_and(|g| (1..=3).contains(&g.len()) && !g.starts_with('0'));
    let mut others = groups.map(|g| g.split_once('.').map_or(g, |(whole, _)| whole)).peekable();
    first && others.peek().is_some() && others.all(|g| g.len() == 3)
}

fn column_from_mapping(named: &MappedColumn, field: usize) -> QuantityColumn {
    QuantityColumn { field, quantity: named.quantity, scale: named.scale, offset: named.offset }
}

/// Text split by a separator.
struct SplitTable {
    separator: char,
    rows: Vec<Row>,
    /// Index of the header among the rows.
    header: usize,
    /// Number of mapped columns in the header.
    columns: usize,
}

/// Splits a text by a separator; `None` if no row is the header.
fn split_by(mapping: &Mapping, text: &str, separator: char) -> Result<Option<SplitTable>, RowsError> {
    let rows = parse_rows(text, separator)?;
    let has = |row: &Row, name: &Option<String>| row.cells.iter().any(|cell| Some(cell) == name.as_ref());
    let header = rows.iter().take(MAX_HEADER_ROW).position(|row| has(row, &mapping.time));
    Ok(header.map(|header| {
        let columns = mapping.column.iter().filter(|c| has(&rows[header], &c.name)).count();
        SplitTable { separator, rows, header, columns }
    }))
}

/// Splits a text by the separator of the mapping or of a first line `sep=;`, or else by the one that yields most of the
/// columns.
fn detect_separator(mapping: &Mapping, text: &str) -> Result<(SplitTable, bool), KeyFault> {
    let given = mapping.separator.or_else(|| text.lines().next().and_then(separator_line));
    let (mut best, mut error): (Option<SplitTable>, _) = (None, None);
    for separator in given.map_or(SEPARATORS.to_vec(), |s| vec![s]) {
        match split_by(mapping, text, separator) {
            Ok(Some(split)) if best.as_ref().is_none_or(|b| split.columns > b.columns) => best = Some(split),
            Ok(_) => {}
            Err(other) => error = error.or(Some(other)),
        }
    }
    match (best, error) {
        (Some(best), _) => Ok((best, given.is_some())),
        (None, Some(error)) => Err(KeyFault::on_line(error.line(), "", error.to_string(), "correct the line")),
        (None, None) => Err(missing_header_fault(text, mapping.time.as_deref().unwrap_or_default(), given)),
    }
}

fn read_table_with_header(mapping: &Mapping, text: &str) -> Result<AircraftTable, KeyFault> {
    let (SplitTable { separator, rows, header: at, .. }, given) = detect_separator(mapping, text)?;
    let mut remarks: Vec<String> = vec![];
    if !given && separator != ',' {
        remarks.push(format!("its columns are separated by {separator:?}"));
    }
    if at > 0 {
        remarks.push(format!("omitted before the header: {}", count_text(at, "line")));
    }
    let mut rows = rows.into_iter().skip(at);
    let header = rows.next().ok_or_else(|| missing_header_fault(text, "", None))?;
    let layout = locate_columns(mapping, &header, separator)?;
    let lines = select_records(&layout, mapping, &header, rows.collect(), &mut remarks)?;
    Ok(AircraftTable { layout, lines, remarks })
}

/// Formats a count with its noun: `1 line`, `2 lines`.
fn count_text(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// Returns why no line is the header.
fn missing_header_fault(text: &str, time: &str, given: Option<char>) -> KeyFault {
    let first = text.lines().find(|l| !l.trim().is_empty()).unwrap_or_default();
    let shown: String = first.chars().take(80).collect();
    if first.trim_start_matches('"').starts_with(iwg1::KEYWORD) {
        return KeyFault::on_line(1, "", "is a line of IWG1, not a header", "write format = \"iwg1\" in the mapping");
    }
    let has = |separator: &char| {
        let found = parse_rows(text, *separator).unwrap_or_default();
        found.iter().take(MAX_HEADER_ROW).any(|r| r.cells.iter().any(|c| c == time))
    };
    let words = |line: &str| line.split_whitespace().any(|word| word == time);
    if !time.is_empty() && text.lines().take(MAX_HEADER_ROW).any(words) && !SEPARATORS.iter().any(has) {
        let remedy = "save it with commas, semicolons or tabs between its columns";
        return KeyFault::on_line(1, "", "has columns that are separated by blanks", remedy);
    }
    match SEPARATORS.iter().find(|s| Some(**s) != given && has(s)) {
        Some(other) => {
            let problem = format!("the table is separated by {other:?}, not by {:?}", given.unwrap_or(','));
            KeyFault::on_line(0, "separator", problem, format!("write separator = {other:?}, or delete it"))
        }
        None => {
            let problem = format!("no line has the column {time}");
            KeyFault::on_line(0, "time", problem, format!("the first line is: {shown}"))
        }
    }
}

/// Locates the mapping's columns; units in their names must be those of the mapping.
fn locate_columns(mapping: &Mapping, header: &Row, separator: char) -> Result<Layout, KeyFault> {
    let place = |name: &str| {
        let mut found = header.cells.iter().enumerate().filter(|(_, cell)| *cell == name).map(|(k, _)| k + 1);
        match (found.next(), found.next()) {
            (Some(field), None) => Ok(field),
            (Some(_), Some(_)) => {
                Err(KeyFault::on_line(header.line, name, "occurs twice in the header", "keep the valid column"))
            }
            (None, _) => {
                let remedy = format!("its header has {}", header.cells.join(", "));
                Err(KeyFault::on_line(0, name, "is not a column of the table", remedy))
            }
        }
    };
    let mut columns = vec![];
    for named in &mapping.column {
        let name = named.name.as_deref().unwrap_or_default();
        columns.push(column_from_mapping(named, place(name)?));
        if let Some(unit) = units::unit_in_name(name) {
            // Brackets in a name may contain anything: an unknown unit is ignored.
            check_unit(named, unit, header.line)?;
        }
    }
    let time_field = place(mapping.time.as_deref().unwrap_or_default())?;
    let text = Layout::separated(separator, time_field, columns);
    Ok(Layout { time_format: mapping.time_format, date: mapping.date, decimal: mapping.decimal, ..text })
}

/// Checks the unit that a table names against the mapping; `false` if the unit is unknown.
fn check_unit(named: &MappedColumn, unit: &str, line: u64) -> Result<bool, KeyFault> {
    let name = named.name.as_deref().unwrap_or_default();
    let quantity = named.quantity.name();
    match units::compare_unit(named.quantity, unit, named.scale, named.offset) {
        UnitAgreement::Same => Ok(true),
        UnitAgreement::Unknown => Ok(false),
        UnitAgreement::Different(scale, offset) => {
            let problem = format!(
                "is in {unit}, but the mapping converts it to {quantity} by scale = {}, offset = {}",
                named.scale, named.offset
            );
            Err(KeyFault::on_line(line, name, problem, format!("write scale = {scale}, offset = {offset}")))
        }
        UnitAgreement::WrongDimension => {
            let problem = format!("is in {unit}, which is not a unit of {quantity}");
            Err(KeyFault::on_line(line, name, problem, "name the column of that quantity"))
        }
    }
}

/// Returns the records below the header, without a row of units.
fn select_records(
    layout: &Layout,
    mapping: &Mapping,
    header: &Row,
    data: Vec<Row>,
    remarks: &mut Vec<String>,
) -> Result<Vec<(u64, String)>, KeyFault> {
    let width = header.cells.len();
    if let Some(row) = data.iter().find(|row| row.exceeds(width)) {
        let problem = format!("has {} cells under a header of {width}", row.cells.len());
        let remedy = "put quotes around a text with a separator, and a line end between two records";
        return Err(KeyFault::on_line(row.line, "", problem, remedy));
    }
    let (data, short): (Vec<Row>, Vec<Row>) = data.into_iter().partition(|row| row.cells.len() >= width);
    if let Some(first) = short.first() {
        let lines = count_text(short.len(), "line");
        remarks
            .push(format!("omitted because they have fewer cells than the header: {lines}, line {} first", first.line));
    }
    let mut data = data.into_iter().peekable();
    if let Some(row) = data.peek().filter(|row| is_unit_row(layout, row)) {
        for (named, column) in mapping.column.iter().zip(&layout.column) {
            let unit = row.cells.get(column.field - 1).map(|u| u.trim_matches(['[', ']', '(', ')']));
            let unit = unit.unwrap_or_default();
            if !check_unit(named, unit, row.line)? {
                remarks.push(format!(
                    "the unit {unit} of {} is unknown: the mapping's scale is used",
                    named.quantity.name()
                ));
            }
        }
        remarks.push(format!("line {} is a row of units", row.line));
        data.next();
    }
    Ok(data.map(|row| (row.line, row.text)).collect())
}

/// Returns whether a row has no time and no number in any mapped column, but a text in one.
fn is_unit_row(layout: &Layout, row: &Row) -> bool {
    let cells = || layout.column.iter().map(|column| layout.cell(&row.cells, column));
    layout.sample(&row.cells).is_none()
        && cells().all(|cell| matches!(cell, Cell::Text | Cell::Blank))
        && cells().any(|cell| cell == Cell::Text)
}
