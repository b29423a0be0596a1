//! Tables of aircraft data written by other programs: separator, header, units and time are detected or given. Pure.

use std::borrow::Cow;

use jiff::civil::Date;

use super::icartt::{self, IcarttHead};
use super::layout::{Cell, Layout, QuantityColumn};
use super::mapping::{MappedColumn, Mapping, StatedOnce, TableFormat};
use super::statements::{check_date, check_date_and_zone, check_unit, check_units};
use super::{Quantity, iwg1};
use crate::installation::{Row, RowsError, parse_rows, separator_line};
use wingd_base::fault::KeyFault;

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
    /// Times of the records with a value, in ascending order.
    pub valued_s: Vec<f64>,
    /// Lines and time tags of records without a readable time.
    pub unread: Vec<(u64, String)>,
}

/// Number of rows in which the header is searched for.
const MAX_HEADER_ROW: usize = 500;
/// Number of rows below the header that may be units.
const MAX_UNIT_ROWS: usize = 3;
/// Separators that are tried if the mapping has none.
const SEPARATORS: [char; 4] = [',', ';', '\t', '|'];

impl AircraftTable {
    /// Finds header and records of a table.
    ///
    /// # Errors
    /// Returns the first error of the table; a key without a line belongs to the mapping.
    pub fn parse(mapping: &Mapping, text: &str) -> Result<Self, KeyFault> {
        if mapping.format == TableFormat::Iwg1 {
            let (lines, remarks) = iwg1::split_records(text)?;
            let own = mapping
                .column
                .iter()
                .filter_map(|c| Some(column_from_mapping(c, c.field?)));
            let layout = Layout::iwg1(&own.collect::<Vec<_>>());
            let layout = Layout {
                time_format: mapping.time_format,
                date: stated_date(mapping),
                ..layout
            };
            return Ok(Self {
                layout,
                lines,
                remarks,
            });
        }
        let head = IcarttHead::read(text);
        if head.is_none() && mapping.format == TableFormat::Icartt {
            return Err(icartt::missing_head_fault());
        }
        let completed = head.as_ref().map(|head| head.complete_mapping(mapping));
        read_table_with_header(completed.as_ref().unwrap_or(mapping), head.as_ref(), text)
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
        let (mut times_s, mut valued_s, mut unread) = (vec![], vec![], vec![]);
        for (line, text) in &self.lines {
            let fields = self.layout.fields(text);
            let Some(sample) = self.layout.sample(&fields) else {
                let Layout {
                    date_field,
                    time_field,
                    zone_field,
                    ..
                } = self.layout;
                let places = [date_field, Some(time_field), zone_field]
                    .into_iter()
                    .flatten();
                let tag: Vec<&str> = places
                    .filter_map(|k| fields.get(k.checked_sub(1)?))
                    .map(AsRef::as_ref)
                    .collect();
                unread.push((*line, tag.join(" ")));
                continue;
            };
            times_s.push(sample.time_s);
            if sample.values.iter().any(Option::is_some) {
                valued_s.push(sample.time_s);
            }
            for (tally, column) in tallies.iter_mut().zip(quantities) {
                tally.count_cell(&self.layout, &fields, column);
            }
        }
        valued_s.sort_by(f64::total_cmp);
        TableContents {
            tallies,
            times_s,
            valued_s,
            unread,
        }
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
        let (points, commas) = (
            |text: &String| text.contains('.'),
            |text: &String| text.contains(','),
        );
        let number = |text: &String| text.replace(',', "").parse::<f64>().is_ok();
        match (self.values, &self.text.1, self.out_of_range.1) {
            (1.., ..) => None,
            (0, Some(text), _) if number(text) && has_thousands_separators(text) => Some(format!(
                "{name} has commas that separate thousands, or decimals ({text}); save its numbers without thousands, or write \
                 decimal = \",\" in the mapping"
            )),
            (0, Some(text), _) if number(text) && commas(text) && !points(text) => Some(format!(
                "{name} has decimal commas ({text}); write decimal = \",\" in the mapping"
            )),
            (0, Some(text), _) if number(text) => Some(format!(
                "{name} has points and decimal commas ({text}); save its numbers without thousands, with one decimal sign"
            )),
            (0, Some(text), _) => Some(format!(
                "{name} has texts instead of numbers ({text}); save plain numbers, or name another column"
            )),
            (0, None, Some(value)) => Some(format!(
                "{name} cannot be {value:.6}; correct the mapping's scale, or name another column"
            )),
            (0, None, None) => Some(format!("the column of {name} is empty; name another")),
        }
    }
}

/// Returns whether a number's commas may separate thousands: `35,000`.
fn has_thousands_separators(text: &str) -> bool {
    let mut groups = text.trim_start_matches(['+', '-']).split(',');
    let first = groups
        .next()
        .is_some_and(|g| (1..=3).contains(&g.len()) && !g.starts_with('0'));
    let mut others = groups
        .map(|g| g.split_once('.').map_or(g, |(whole, _)| whole))
        .peekable();
    first && others.peek().is_some() && others.all(|g| g.len() == 3)
}

fn column_from_mapping(named: &MappedColumn, field: usize) -> QuantityColumn {
    let (scale, offset) = named.conversion();
    QuantityColumn {
        field,
        quantity: named.quantity,
        scale,
        offset,
    }
}

/// Returns the date of all lines: that of the seconds of a day, or the first of the year.
fn stated_date(mapping: &Mapping) -> Option<Date> {
    match (&mapping.date, mapping.year) {
        (Some(StatedOnce::Value(date)), _) => Some(*date),
        (_, Some(year)) => Date::new(year, 1, 1).ok(),
        _ => None,
    }
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

/// Splits a text by a separator; the header is the first row with most of the mapping's columns and the time. `None` if no
/// row has the time.
fn split_by(
    mapping: &Mapping,
    text: &str,
    separator: char,
) -> Result<Option<SplitTable>, RowsError> {
    let rows = parse_rows(text, separator)?;
    let has =
        |row: &Row, name: &Option<String>| row.cells.iter().any(|cell| Some(cell) == name.as_ref());
    let columns = |row: &Row| mapping.column.iter().filter(|c| has(row, &c.name)).count();
    let with_time = rows
        .iter()
        .take(MAX_HEADER_ROW)
        .enumerate()
        .filter(|(_, row)| has(row, &mapping.time));
    let best = with_time
        .map(|(k, row)| (columns(row), k))
        .max_by_key(|(count, k)| (*count, std::cmp::Reverse(*k)));
    Ok(best.map(|(columns, header)| SplitTable {
        separator,
        rows,
        header,
        columns,
    }))
}

/// Splits a text by the separator of the mapping or of a first line `sep=;`, or else by the one that yields most of the
/// columns.
fn detect_separator(mapping: &Mapping, text: &str) -> Result<(SplitTable, bool), KeyFault> {
    let given = mapping
        .separator
        .or_else(|| text.lines().next().and_then(separator_line));
    let (mut best, mut error): (Option<SplitTable>, _) = (None, None);
    for separator in given.map_or(SEPARATORS.to_vec(), |s| vec![s]) {
        match split_by(mapping, text, separator) {
            Ok(Some(split)) if best.as_ref().is_none_or(|b| split.columns > b.columns) => {
                best = Some(split)
            }
            Ok(_) => {}
            Err(other) => error = error.or(Some(other)),
        }
    }
    match (best, error) {
        (Some(best), _) => Ok((best, given.is_some())),
        (None, Some(error)) => Err(KeyFault::on_line(
            error.line(),
            "",
            error.to_string(),
            "correct the line",
        )),
        (None, None) => Err(missing_header_fault(
            text,
            mapping.time.as_deref().unwrap_or_default(),
            given,
        )),
    }
}

fn read_table_with_header(
    mapping: &Mapping,
    head: Option<&IcarttHead>,
    text: &str,
) -> Result<AircraftTable, KeyFault> {
    let (
        SplitTable {
            separator,
            rows,
            header: at,
            ..
        },
        given,
    ) = detect_separator(mapping, text)?;
    let mut remarks: Vec<String> = vec![];
    if !given && separator != ',' {
        remarks.push(format!("its columns are separated by {separator:?}"));
    }
    if at > 0 {
        remarks.push(format!(
            "omitted before the header: {}",
            count_text(at, "line")
        ));
    }
    let (above, rest) = rows.split_at(at);
    let (header, data) = rest
        .split_first()
        .ok_or_else(|| missing_header_fault(text, "", None))?;
    let mut layout = locate_columns(mapping, header, separator)?;
    if let Some(head) = head {
        layout.missing = head.missing_values();
        for (named, column) in mapping.column.iter().zip(&mut layout.column) {
            column.scale *= head.column_factor(named.name.as_deref().unwrap_or_default());
        }
        check_date(mapping, (icartt::DATE_LINE as u64 + 1, ""), head.date)?;
    }
    check_units(mapping, &layout, (above, header), &mut remarks)?;
    let data = select_records(&layout, mapping, header, data, &mut remarks)?;
    for row in data.first().into_iter().chain(data.last()) {
        check_date_and_zone(mapping, &layout, header, row)?;
    }
    let lines = data
        .into_iter()
        .map(|row| (row.line, row.text.clone()))
        .collect();
    Ok(AircraftTable {
        layout,
        lines,
        remarks,
    })
}

/// Formats a count with its noun: `1 line`, `2 lines`.
fn count_text(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// Returns why no line is the header.
fn missing_header_fault(text: &str, time: &str, given: Option<char>) -> KeyFault {
    let first = text
        .lines()
        .find(|l| !l.trim().is_empty())
        .unwrap_or_default();
    let shown: String = first.chars().take(80).collect();
    if first.trim_start_matches('"').starts_with(iwg1::KEYWORD) {
        return KeyFault::on_line(
            1,
            "",
            "is a line of IWG1, not a header",
            "write format = \"iwg1\" in the mapping",
        );
    }
    let has = |separator: &char| {
        let found = parse_rows(text, *separator).unwrap_or_default();
        found
            .iter()
            .take(MAX_HEADER_ROW)
            .any(|r| r.cells.iter().any(|c| c == time))
    };
    let words = |line: &str| line.split_whitespace().any(|word| word == time);
    if !time.is_empty()
        && text.lines().take(MAX_HEADER_ROW).any(words)
        && !SEPARATORS.iter().any(has)
    {
        let remedy = "save it with commas, semicolons or tabs between its columns";
        return KeyFault::on_line(1, "", "has columns that are separated by blanks", remedy);
    }
    match SEPARATORS.iter().find(|s| Some(**s) != given && has(s)) {
        Some(other) => {
            let problem = format!(
                "the table is separated by {other:?}, not by {:?}",
                given.unwrap_or(',')
            );
            KeyFault::on_line(
                0,
                "separator",
                problem,
                format!("write separator = {other:?}, or delete it"),
            )
        }
        None => {
            let problem = format!("no line has the column {time}");
            KeyFault::on_line(0, "time", problem, format!("the first line is: {shown}"))
        }
    }
}

/// Locates the mapping's columns.
fn locate_columns(mapping: &Mapping, header: &Row, separator: char) -> Result<Layout, KeyFault> {
    let place = |name: &str| {
        let mut found = header
            .cells
            .iter()
            .enumerate()
            .filter(|(_, cell)| *cell == name)
            .map(|(k, _)| k + 1);
        match (found.next(), found.next()) {
            (Some(field), None) => Ok(field),
            (Some(_), Some(_)) => Err(KeyFault::on_line(
                header.line,
                name,
                "occurs twice in the header",
                "keep the valid column",
            )),
            (None, _) => {
                let remedy = format!("its header has {}", header.cells.join(", "));
                Err(KeyFault::on_line(
                    0,
                    name,
                    "is not a column of the table",
                    remedy,
                ))
            }
        }
    };
    let mut columns = vec![];
    for named in &mapping.column {
        columns.push(column_from_mapping(
            named,
            place(named.name.as_deref().unwrap_or_default())?,
        ));
    }
    let stated = |key: &str, name: &str, other: &str| {
        let remedy = format!(
            "write {other}, or the name of a column: {}",
            header.cells.join(", ")
        );
        let problem = format!("\"{name}\" is not a {key} and not a column of the table");
        place(name)
            .map(Some)
            .map_err(|_| KeyFault::on_line(0, key, problem, remedy))
    };
    let date_field = match &mapping.date {
        Some(StatedOnce::Column(name)) => stated("date", name, "2026-06-01")?,
        _ => None,
    };
    let (zone_s, zone_field) = match &mapping.zone {
        Some(StatedOnce::Column(name)) => (None, stated("zone", name, "+02:00")?),
        Some(StatedOnce::Value(zone)) => (Some(zone.seconds()), None),
        None => (None, None),
    };
    Ok(Layout {
        time_format: mapping.time_format,
        date: stated_date(mapping),
        date_field,
        zone_s,
        zone_field,
        decimal: mapping.decimal,
        ..Layout::separated(
            separator,
            place(mapping.time.as_deref().unwrap_or_default())?,
            columns,
        )
    })
}

/// Returns the records below the header, without rows of units.
fn select_records<'a>(
    layout: &Layout,
    mapping: &Mapping,
    header: &Row,
    data: &'a [Row],
    remarks: &mut Vec<String>,
) -> Result<Vec<&'a Row>, KeyFault> {
    let width = header.cells.len();
    if let Some(row) = data.iter().find(|row| row.exceeds(width)) {
        let problem = format!("has {} cells under a header of {width}", row.cells.len());
        let remedy =
            "put quotes around a text with a separator, and a line end between two records";
        return Err(KeyFault::on_line(row.line, "", problem, remedy));
    }
    let (mut data, short): (Vec<&Row>, Vec<&Row>) =
        data.iter().partition(|row| row.cells.len() >= width);
    if let Some(first) = short.first() {
        let lines = count_text(short.len(), "line");
        remarks.push(format!(
            "omitted because they have fewer cells than the header: {lines}, line {} first",
            first.line
        ));
    }
    let units = data
        .iter()
        .take(MAX_UNIT_ROWS)
        .take_while(|row| is_unit_row(layout, row))
        .count();
    for row in data.drain(..units) {
        for (named, column) in mapping.column.iter().zip(&layout.column) {
            let unit = row
                .cells
                .get(column.field - 1)
                .map(String::as_str)
                .unwrap_or_default();
            check_unit(named, unit, row.line, remarks)?;
        }
        remarks.push(format!("line {} is a row of units", row.line));
    }
    Ok(data)
}

/// Returns whether a row has no time and no number in any mapped column, but a text in one.
fn is_unit_row(layout: &Layout, row: &Row) -> bool {
    let cells = || {
        layout
            .column
            .iter()
            .map(|column| layout.cell(&row.cells, column))
    };
    layout.sample(&row.cells).is_none()
        && cells().all(|cell| matches!(cell, Cell::Text | Cell::Blank))
        && cells().any(|cell| cell == Cell::Text)
}
