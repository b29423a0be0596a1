//! A table of the aircraft's data as other programs write it: separator, header, units and time found or named. Pure.

use std::borrow::Cow;

use super::layout::{Cell, Column, Kind, Layout};
use super::mapping::{Mapping, Named};
use super::units::{self, Agreement};
use super::{Quantity, iwg1};
use crate::installation::{Row, RowsError, Trouble, rows, separator_line};

/// A table that can be taken into a flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Where the fields of its lines stand.
    pub layout: Layout,
    /// Its records as they stand in the file, with the line that each begins on.
    pub lines: Vec<(u64, String)>,
    /// What was found, left out or mended.
    pub remarks: Vec<String>,
}

/// What the cells of a quantity's column hold.
#[derive(Clone, Debug, PartialEq)]
pub struct Tally {
    /// The quantity.
    pub quantity: Quantity,
    /// Values.
    pub values: usize,
    /// Cells with nothing in them.
    pub blank: usize,
    /// Texts that are no number, and the first of them.
    pub text: (usize, Option<String>),
    /// Numbers that cannot be true, and the first of them in the quantity's unit.
    pub out_of_reason: (usize, Option<f64>),
}

/// What a table says by itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Contents {
    /// Per quantity that the mapping takes.
    pub tallies: Vec<Tally>,
    /// Moments of its records, seconds since 1970, in their order.
    pub times_s: Vec<f64>,
    /// Lines and time tags of records that have no moment.
    pub unread: Vec<(u64, String)>,
}

/// Rows before the header that are looked at.
const BEFORE_HEADER: usize = 50;
/// Separators that are tried where the mapping names none.
const SEPARATORS: [char; 4] = [',', ';', '\t', '|'];

impl Table {
    /// Finds header and records of a table's text.
    ///
    /// # Errors
    /// What is wrong with the table at its first place; a key without a line is one of the mapping.
    pub fn find(mapping: &Mapping, text: &str) -> Result<Self, Trouble> {
        match mapping.format {
            Kind::Iwg1 => {
                let (lines, remarks) = iwg1::lines(text)?;
                let own = mapping.column.iter().filter_map(|c| Some(column(c, c.field?)));
                let layout = Layout::iwg1(&own.collect::<Vec<_>>());
                let layout = Layout { time_format: mapping.time_format, date: mapping.date, ..layout };
                Ok(Self { layout, lines, remarks })
            }
            Kind::Text => with_header(mapping, text),
        }
    }

    /// What its cells hold.
    pub fn contents(&self) -> Contents {
        let quantities = &self.layout.column;
        let none = |c: &Column| Tally {
            quantity: c.quantity,
            values: 0,
            blank: 0,
            text: (0, None),
            out_of_reason: (0, None),
        };
        let mut tallies: Vec<Tally> = quantities.iter().map(none).collect();
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
                tally.count(&self.layout, &fields, column);
            }
        }
        Contents { tallies, times_s, unread }
    }
}

impl Tally {
    fn count(&mut self, layout: &Layout, fields: &[Cow<str>], column: &Column) {
        match layout.cell(fields, column) {
            Cell::Value(_) => self.values += 1,
            Cell::Blank => self.blank += 1,
            Cell::Text => {
                self.text.0 += 1;
                let cell = column.field.checked_sub(1).and_then(|k| fields.get(k));
                self.text.1 = self.text.1.take().or_else(|| cell.map(ToString::to_string));
            }
            Cell::OutOfReason(value) => {
                self.out_of_reason.0 += 1;
                self.out_of_reason.1 = self.out_of_reason.1.or(Some(value));
            }
        }
    }

    /// Why it has no values, where it has none.
    pub fn why_none(&self) -> Option<String> {
        let name = self.quantity.name();
        let (points, commas) = (|text: &String| text.contains('.'), |text: &String| text.contains(','));
        let number = |text: &String| text.replace(',', "").parse::<f64>().is_ok();
        match (self.values, &self.text.1, self.out_of_reason.1) {
            (1.., ..) => None,
            (0, Some(text), _) if number(text) && thousands(text) => Some(format!(
                "{name} has commas that part thousands, or decimals ({text}); save its numbers without thousands, or write \
                 decimal = \",\" in the mapping"
            )),
            (0, Some(text), _) if number(text) && commas(text) && !points(text) => {
                Some(format!("{name} has decimal commas ({text}); write decimal = \",\" in the mapping"))
            }
            (0, Some(text), _) if number(text) => Some(format!(
                "{name} has points beside decimal commas ({text}); save its numbers without thousands, with one decimal sign"
            )),
            (0, Some(text), _) => Some(format!(
                "{name} has texts for numbers ({text}); save plain numbers, or name another column"
            )),
            (0, None, Some(value)) => Some(format!(
                "{name} cannot be {value:.6}; correct the mapping's scale, or name another column"
            )),
            (0, None, None) => Some(format!("the column of {name} is empty; name another")),
        }
    }
}

/// Whether commas of a number may part thousands: `35,000`.
fn thousands(text: &str) -> bool {
    let mut groups = text.trim_start_matches(['+', '-']).split(',');
    let first = groups.next().is_some_and(|g| (1..=3).contains(&g.len()) && !g.starts_with('0'));
    let mut others = groups.map(|g| g.split_once('.').map_or(g, |(whole, _)| whole)).peekable();
    first && others.peek().is_some() && others.all(|g| g.len() == 3)
}

fn column(named: &Named, field: usize) -> Column {
    Column { field, quantity: named.quantity, scale: named.scale, offset: named.offset }
}

/// A text parted by a separator.
struct Parted {
    separator: char,
    rows: Vec<Row>,
    /// Place of the header among the rows.
    header: usize,
    /// Columns of the mapping that it has.
    columns: usize,
}

/// `None` where no row is the header then.
fn parted(mapping: &Mapping, text: &str, separator: char) -> Result<Option<Parted>, RowsError> {
    let rows = rows(text, separator)?;
    let has = |row: &Row, name: &Option<String>| row.cells.iter().any(|cell| Some(cell) == name.as_ref());
    let header = rows.iter().take(BEFORE_HEADER).position(|row| has(row, &mapping.time));
    Ok(header.map(|header| {
        let columns = mapping.column.iter().filter(|c| has(&rows[header], &c.name)).count();
        Parted { separator, rows, header, columns }
    }))
}

/// By the separator that the mapping or a first line `sep=;` states, else by the one that shows most of the columns.
fn found(mapping: &Mapping, text: &str) -> Result<(Parted, bool), Trouble> {
    let stated = mapping.separator.or_else(|| text.lines().next().and_then(separator_line));
    let (mut best, mut error): (Option<Parted>, _) = (None, None);
    for separator in stated.map_or(SEPARATORS.to_vec(), |s| vec![s]) {
        match parted(mapping, text, separator) {
            Ok(Some(parted)) if best.as_ref().is_none_or(|b| parted.columns > b.columns) => {
                best = Some(parted)
            }
            Ok(_) => {}
            Err(other) => error = error.or(Some(other)),
        }
    }
    match (best, error) {
        (Some(best), _) => Ok((best, stated.is_some())),
        (None, Some(error)) => Err(Trouble::new(error.line(), "", error.to_string(), "correct the line")),
        (None, None) => Err(no_header(text, mapping.time.as_deref().unwrap_or_default(), stated)),
    }
}

fn with_header(mapping: &Mapping, text: &str) -> Result<Table, Trouble> {
    let (Parted { separator, rows, header: at, .. }, stated) = found(mapping, text)?;
    let mut remarks: Vec<String> = vec![];
    if !stated && separator != ',' {
        remarks.push(format!("its columns are separated by {separator:?}"));
    }
    if at > 0 {
        remarks.push(format!("left out before the header: {}", counted(at, "line")));
    }
    let mut rows = rows.into_iter().skip(at);
    let header = rows.next().ok_or_else(|| no_header(text, "", None))?;
    let layout = layout(mapping, &header, separator)?;
    let lines = records(&layout, mapping, &header, rows.collect(), &mut remarks)?;
    Ok(Table { layout, lines, remarks })
}

/// `1 line`, `2 lines`.
fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// Why no line is the header.
fn no_header(text: &str, time: &str, stated: Option<char>) -> Trouble {
    let first = text.lines().find(|l| !l.trim().is_empty()).unwrap_or_default();
    let shown: String = first.chars().take(80).collect();
    if first.trim_start_matches('"').starts_with(iwg1::KEYWORD) {
        return Trouble::new(
            1,
            "",
            "is a line of IWG1, and no header",
            "write format = \"iwg1\" in the mapping",
        );
    }
    let has = |separator: &char| {
        let found = rows(text, *separator).unwrap_or_default();
        found.iter().take(BEFORE_HEADER).any(|r| r.cells.iter().any(|c| c == time))
    };
    let words = |line: &str| line.split_whitespace().any(|word| word == time);
    if !time.is_empty() && text.lines().take(BEFORE_HEADER).any(words) && !SEPARATORS.iter().any(has) {
        let mend = "save it with commas, semicolons or tabs between its columns";
        return Trouble::new(1, "", "has columns that are separated by blanks", mend);
    }
    match SEPARATORS.iter().find(|s| Some(**s) != stated && has(s)) {
        Some(other) => {
            let problem = format!("the table is separated by {other:?}, not by {:?}", stated.unwrap_or(','));
            Trouble::new(0, "separator", problem, format!("write separator = {other:?}, or leave it out"))
        }
        None => {
            let problem = format!("no line holds the column {time}");
            Trouble::new(0, "time", problem, format!("the first line is: {shown}"))
        }
    }
}

/// Where the mapping's columns stand; units in their names must be those of the mapping.
fn layout(mapping: &Mapping, header: &Row, separator: char) -> Result<Layout, Trouble> {
    let place = |name: &str| {
        let mut found = header.cells.iter().enumerate().filter(|(_, cell)| *cell == name).map(|(k, _)| k + 1);
        match (found.next(), found.next()) {
            (Some(field), None) => Ok(field),
            (Some(_), Some(_)) => Err(Trouble::new(
                header.line,
                name,
                "stands twice in the header",
                "keep the column that holds",
            )),
            (None, _) => {
                let mend = format!("its header has {}", header.cells.join(", "));
                Err(Trouble::new(0, name, "is no column of the table", mend))
            }
        }
    };
    let mut columns = vec![];
    for named in &mapping.column {
        let name = named.name.as_deref().unwrap_or_default();
        columns.push(column(named, place(name)?));
        if let Some(unit) = units::in_name(name) {
            // A bracket in a name may hold anything: a unit that nobody knows is none.
            agree(named, unit, header.line)?;
        }
    }
    let time_field = place(mapping.time.as_deref().unwrap_or_default())?;
    let text = Layout::text(separator, time_field, columns);
    Ok(Layout { time_format: mapping.time_format, date: mapping.date, decimal: mapping.decimal, ..text })
}

/// Whether a unit that the table names is the mapping's; `false` where nobody knows it.
fn agree(named: &Named, unit: &str, line: u64) -> Result<bool, Trouble> {
    let name = named.name.as_deref().unwrap_or_default();
    let quantity = named.quantity.name();
    match units::agreement(named.quantity, unit, named.scale, named.offset) {
        Agreement::Same => Ok(true),
        Agreement::Unknown => Ok(false),
        Agreement::Other(scale, offset) => {
            let problem = format!(
                "is in {unit}, but the mapping makes {quantity} of it by scale = {}, offset = {}",
                named.scale, named.offset
            );
            Err(Trouble::new(line, name, problem, format!("write scale = {scale}, offset = {offset}")))
        }
        Agreement::NoneOfIt => {
            let problem = format!("is in {unit}, which is no unit of {quantity}");
            Err(Trouble::new(line, name, problem, "name the column of that quantity"))
        }
    }
}

/// The records below the header, without a row of units.
fn records(
    layout: &Layout,
    mapping: &Mapping,
    header: &Row,
    data: Vec<Row>,
    remarks: &mut Vec<String>,
) -> Result<Vec<(u64, String)>, Trouble> {
    let width = header.cells.len();
    if let Some(row) = data.iter().find(|row| row.exceeds(width)) {
        let problem = format!("has {} cells under a header of {width}", row.cells.len());
        let mend = "put quotes about a text with a separator, and a line end between two records";
        return Err(Trouble::new(row.line, "", problem, mend));
    }
    let (data, short): (Vec<Row>, Vec<Row>) = data.into_iter().partition(|row| row.cells.len() >= width);
    if let Some(first) = short.first() {
        let lines = counted(short.len(), "line");
        remarks.push(format!(
            "left out for fewer cells than the header has: {lines}, line {} first",
            first.line
        ));
    }
    let mut data = data.into_iter().peekable();
    if let Some(row) = data.peek().filter(|row| is_units(layout, row)) {
        for (named, column) in mapping.column.iter().zip(&layout.column) {
            let unit = row.cells.get(column.field - 1).map(|u| u.trim_matches(['[', ']', '(', ')']));
            let unit = unit.unwrap_or_default();
            if !agree(named, unit, row.line)? {
                remarks.push(format!(
                    "nobody knows the unit {unit} of {}: the mapping's counts",
                    named.quantity.name()
                ));
            }
        }
        remarks.push(format!("line {} is a row of units", row.line));
        data.next();
    }
    Ok(data.map(|row| (row.line, row.text)).collect())
}

/// A row without a moment and without a number in any column that is taken, but with something in one.
fn is_units(layout: &Layout, row: &Row) -> bool {
    let cells = || layout.column.iter().map(|column| layout.cell(&row.cells, column));
    layout.sample(&row.cells).is_none()
        && cells().all(|cell| matches!(cell, Cell::Text | Cell::Blank))
        && cells().any(|cell| cell == Cell::Text)
}
