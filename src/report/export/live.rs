//! Live results become a table here, with one row per result and one column per value.

use std::io::{self, Write};

use serde_json::Value;

use super::columns::{Column, Values};
use crate::store::columns::{Block, Head, Kind, LiveTable, UTC};

/// The columns of several files, whose tables may differ: what a file has not is missing in its rows.
pub struct LiveColumns {
    recorder: Option<String>,
    all: Vec<Place>,
}

/// Where a column's values come from.
struct Place {
    /// With the unit.
    name: String,
    kind: Kind,
    is_time: bool,
    /// Column of the file, and which of its values in a row.
    column: usize,
    value: usize,
}

impl LiveColumns {
    /// Of all tables; `recorder` is the store's id.
    pub fn of<'a>(tables: impl IntoIterator<Item = &'a LiveTable>, recorder: Option<String>) -> Self {
        let mut all: Vec<Place> = Vec::new();
        for place in tables.into_iter().flat_map(places) {
            if !all.iter().any(|known| known.name == place.name) {
                all.push(place);
            }
        }
        Self { recorder, all }
    }

    /// Without rows.
    pub fn empty(&self) -> Vec<Column> {
        let text = |name: &str| Column { name: name.to_owned(), values: Values::Text(Vec::new()) };
        let mut columns: Vec<Column> = ["recorder_id", "flight", "boot_id"].map(text).into();
        let empty = |place: &Place| Column { name: place.name.clone(), values: values(place, &[], 0) };
        columns.extend(self.all.iter().map(empty));
        columns
    }

    /// A block's rows; `None` where it cannot be unpacked.
    pub fn rows(&self, head: &Head, block: &Block) -> Option<Vec<Column>> {
        let rows = block.len();
        let text = |value: Option<&str>| Values::Text(vec![value.map(str::to_owned); rows]);
        let fixed = [self.recorder.as_deref(), Some(head.flight.as_str()), Some(head.began.boot_id.as_str())];
        let there = places(&head.table);
        let unpacked: Vec<Vec<f64>> =
            (0..head.table.columns.len()).map(|k| block.column(k)).collect::<Option<_>>()?;
        let mut columns = self.empty();
        for (column, value) in columns.iter_mut().zip(fixed) {
            column.values = text(value);
        }
        for (column, place) in columns.iter_mut().skip(fixed.len()).zip(&self.all) {
            let found = there.iter().find(|found| found.name == place.name);
            let from = found.and_then(|found| Some((found, unpacked.get(found.column)?)));
            column.values = match from {
                Some((found, from)) => {
                    let width = head.table.columns.get(found.column).map_or(1, |column| column.width);
                    let of_row: Vec<f64> = from.iter().skip(found.value).step_by(width).copied().collect();
                    values(place, &of_row, 0)
                }
                None => values(place, &[], rows),
            };
        }
        Some(columns)
    }
}

/// Numbers as a column of the place's kind, `missing` before them.
fn values(place: &Place, numbers: &[f64], missing: usize) -> Values {
    let present = |number: &f64| Some(*number).filter(|number| !number.is_nan());
    let all = || std::iter::repeat_n(None, missing).chain(numbers.iter().map(present));
    match place.kind {
        _ if place.is_time => Values::Time(all().map(|v| v.map(|v| v as i64)).collect()),
        Kind::F64 => Values::Number(all().collect()),
        Kind::F32 => Values::Single(all().map(|v| v.map(|v| v as f32)).collect()),
        Kind::U64 | Kind::U32 | Kind::U8 => Values::Count(all().map(|v| v.map(|v| v as i64)).collect()),
    }
}

/// `markers.lift` in m is `lift_M01_m` and so on; what is not named is counted.
fn places(table: &LiveTable) -> Vec<Place> {
    let mut all = Vec::new();
    for (index, column) in table.columns.iter().enumerate() {
        let (list, rest) = column.name.split_once('.').map_or((None, &*column.name), |(l, r)| (Some(l), r));
        let labels = list.and_then(|list| table.source.get(list)?.as_array());
        let labels = labels.filter(|labels| labels.len() == column.width);
        let unit = unit(&column.unit);
        for value in 0..column.width {
            let label = labels.and_then(|labels| labels.get(value)).map(label);
            let name = match label {
                Some(label) => format!("{rest}_{label}{unit}"),
                None if column.width == 1 => format!("{rest}{unit}"),
                None => format!("{rest}_{}{unit}", value + 1),
            };
            let is_time = column.unit == UTC;
            all.push(Place { name, kind: column.kind, is_time, column: index, value });
        }
    }
    all
}

fn label(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// As the end of a column's name.
fn unit(unit: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    match unit {
        "" | UTC => String::new(),
        _ => match unit.strip_prefix("1/") {
            Some(below) => format!("_per_{}", below.chars().map(plain).collect::<String>()),
            None => format!("_{}", unit.chars().map(plain).collect::<String>()),
        },
    }
}

/// Writes rows as one JSON object each; what is missing, and what JSON has no number for, is `null`.
pub fn json_rows(output: &mut dyn Write, columns: &[Column]) -> io::Result<()> {
    let rows = columns.first().map_or(0, |column| column.values.len());
    for row in 0..rows {
        for (index, column) in columns.iter().enumerate() {
            output.write_all(if index == 0 { b"{" } else { b"," })?;
            serde_json::to_writer(&mut *output, &column.name)?;
            output.write_all(b":")?;
            let text = column.values.text(row);
            match &column.values {
                Values::Number(_) | Values::Single(_) if text.ends_with("inf") => {
                    output.write_all(b"null")?
                }
                _ if text.is_empty() => output.write_all(b"null")?,
                Values::Text(_) | Values::Time(_) => serde_json::to_writer(&mut *output, &text)?,
                _ => output.write_all(text.as_bytes())?,
            }
        }
        output.write_all(b"}\n")?;
    }
    Ok(())
}
