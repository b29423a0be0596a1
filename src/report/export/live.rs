//! Live results become a table here, with one row per result and one column per value.

use std::io::{self, Write};

use serde_json::Value;

use super::columns::{Column, Values, text};
use super::live_facts::result_ids;
use crate::store::columns::{RowBlock, FLAG, LiveHead, ValueKind, LiveTable, UTC, WORD};
use crate::store::live::{SCALAR_COLUMNS, names};

/// Lists of a table by the names of its columns: `markers.deflection` is of `markers`.
const STATIONS: &str = "stations";
const TORSION: &str = "torsion";

/// The columns of several files, whose tables may differ: what a file has not is missing in its rows. What a result has once
/// is always there, whatever the files have.
pub struct LiveColumns {
    recorder: Option<String>,
    all: Vec<Place>,
}

/// Where a column's values come from.
struct Place {
    /// With the unit.
    name: String,
    what: What,
    from: Origin,
}

#[derive(Clone, Copy)]
enum What {
    Time,
    Flag,
    Word,
    Whole,
    Single,
    Double,
}

enum Origin {
    /// Column of the file, and which of its values in a row.
    Value(usize, usize),
    /// The same for all of the table's rows.
    Constant(f64),
}

impl LiveColumns {
    /// Of all tables; `recorder` is the store's id.
    pub fn of<'a>(tables: impl IntoIterator<Item = &'a LiveTable>, recorder: Option<String>) -> Self {
        let once = SCALAR_COLUMNS.iter().map(|(name, unit, kind)| Place {
            name: format!("{name}{}", ending(unit)),
            what: What::of(unit, *kind),
            from: Origin::Constant(f64::NAN),
        });
        let mut all: Vec<Place> = once.collect();
        for place in tables.into_iter().flat_map(places) {
            if !all.iter().any(|known| known.name == place.name) {
                all.push(place);
            }
        }
        Self { recorder, all }
    }

    /// Without rows.
    pub fn empty(&self) -> Vec<Column> {
        let mut columns: Vec<Column> =
            ["recorder_id", "flight", "result_id", "boot_id"].map(|name| text(name, None, 0)).into();
        columns.extend(self.all.iter().map(|place| place.column(&[], &[])));
        columns
    }

    /// A block's rows; `None` where it cannot be unpacked.
    pub fn rows(&self, head: &LiveHead, block: &RowBlock) -> Option<Vec<Column>> {
        let rows = block.len();
        let unpacked: Vec<Vec<f64>> =
            (0..head.table.columns.len()).map(|k| block.column_values(k)).collect::<Option<_>>()?;
        let there = places(&head.table);
        let mut columns = vec![
            text("recorder_id", self.recorder.as_deref(), rows),
            text("flight", Some(head.flight.as_str()), rows),
            Column { name: "result_id".to_owned(), values: Values::Text(result_ids(head, block)) },
            text("boot_id", Some(head.began.boot_id.as_str()), rows),
        ];
        columns.extend(self.all.iter().map(|place| {
            let numbers = match there.iter().find(|found| found.name == place.name).map(|found| &found.from) {
                Some(Origin::Value(column, value)) => {
                    let width = head.table.columns.get(*column).map_or(1, |column| column.width);
                    let all = unpacked.get(*column).into_iter().flatten();
                    all.skip(*value).step_by(width).copied().collect()
                }
                Some(Origin::Constant(value)) => vec![*value; rows],
                None => vec![f64::NAN; rows],
            };
            place.column(&numbers, &words(&head.table, &place.name))
        }));
        Some(columns)
    }
}

/// What the numbers of a word column mean.
fn words(table: &LiveTable, name: &str) -> Vec<String> {
    let list = table.source.get(names::WORDS).and_then(|words| words.get(name)?.as_array());
    list.into_iter().flatten().map(label).collect()
}

impl What {
    fn of(unit: &str, kind: ValueKind) -> Self {
        match (unit, kind) {
            (UTC, _) => Self::Time,
            (FLAG, _) => Self::Flag,
            (WORD, _) => Self::Word,
            (_, ValueKind::F64) => Self::Double,
            (_, ValueKind::F32) => Self::Single,
            (_, ValueKind::U64 | ValueKind::U32 | ValueKind::U8) => Self::Whole,
        }
    }
}

impl Place {
    /// With these rows; `words` are what a word column's numbers mean.
    fn column(&self, numbers: &[f64], words: &[String]) -> Column {
        let all = || numbers.iter().map(|number| Some(*number).filter(|number| !number.is_nan()));
        let values = match self.what {
            What::Time => Values::Time(all().map(|v| v.map(|v| v as i64)).collect()),
            What::Flag => Values::Flag(all().map(|v| v.map(|v| v != 0.0)).collect()),
            What::Word => Values::Text(all().map(|v| words.get(v? as usize).cloned()).collect()),
            What::Double => Values::Number(all().collect()),
            What::Single => Values::Single(all().map(|v| v.map(|v| v as f32)).collect()),
            What::Whole => Values::Count(all().map(|v| v.map(|v| v as i64)).collect()),
        };
        Column { name: self.name.clone(), values }
    }
}

/// `markers.deflection` in m is `deflection_M01_m`, `stations.deflection` `deflection_s01_m` with `arc_length_s01_m` beside it, `torsion.twist`
/// `torsion_tip_twist_deg` as of frames; what is not named is counted.
fn places(table: &LiveTable) -> Vec<Place> {
    let mut all = arc_lengths(table);
    for (index, column) in table.columns.iter().enumerate() {
        let (list, rest) = column.name.split_once('.').map_or((None, &*column.name), |(l, r)| (Some(l), r));
        let labels = list.and_then(|list| table.source.get(list)?.as_array());
        let labels = labels.filter(|labels| labels.len() == column.width);
        let unit = ending(&column.unit);
        for value in 0..column.width {
            let label = labels.and_then(|labels| labels.get(value)).map(label);
            let name = match (list, label) {
                (Some(STATIONS), _) => format!("{rest}_{}{unit}", station(value)),
                (Some(TORSION), Some(label)) => format!("{TORSION}_{label}_{rest}{unit}"),
                (_, Some(label)) => format!("{rest}_{label}{unit}"),
                _ if column.width == 1 => format!("{rest}{unit}"),
                _ => format!("{rest}_{}{unit}", value + 1),
            };
            let what = What::of(&column.unit, column.kind);
            all.push(Place { name, what, from: Origin::Value(index, value) });
        }
    }
    all
}

/// Where the stations are, from the bending root: they follow the installation, their names do not.
fn arc_lengths(table: &LiveTable) -> Vec<Place> {
    let arcs = table.source.get(STATIONS).and_then(Value::as_array);
    let place = |(index, arc): (usize, &Value)| Place {
        name: format!("arc_length_{}_m", station(index)),
        what: What::Double,
        from: Origin::Constant(arc.as_f64().unwrap_or(f64::NAN)),
    };
    arcs.into_iter().flatten().enumerate().map(place).collect()
}

/// From the root on, counted from 1.
fn station(index: usize) -> String {
    format!("s{:02}", index + 1)
}

fn label(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// As the end of a column's name.
fn ending(unit: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    match unit {
        "" | UTC | FLAG | WORD => String::new(),
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
