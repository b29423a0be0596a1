//! Export of live results as a table with one row per result and one column per value.

use std::io::{self, Write};

use serde_json::Value;

use super::columns::{ColumnValues, ExportColumn, constant_text};
use super::live_facts::result_ids;
use crate::store::columns::{FLAG, LiveBlock, LiveHead, LiveTable, UTC, ValueKind, WORD};
use crate::store::live::{SCALAR_COLUMNS, names};

/// List of the station columns: the part of a column name before the dot, as in `stations.deflection`.
const STATIONS: &str = "stations";
const TORSION: &str = "torsion";

/// Columns of several files whose tables may differ. A value that a file does not have is missing in its rows. The scalar
/// columns are always present.
pub struct LiveColumns {
    recorder: Option<String>,
    all: Vec<LiveColumnSource>,
}

/// Exported column and the origin of its values.
struct LiveColumnSource {
    /// Name, with the unit.
    name: String,
    value_type: LiveValueType,
    origin: ValueOrigin,
}

#[derive(Clone, Copy)]
enum LiveValueType {
    Time,
    Flag,
    Text,
    Integer,
    Single,
    Double,
}

enum ValueOrigin {
    /// Index of the file's column, and of the value within its row.
    Value(usize, usize),
    /// Constant value for all rows of the table.
    Constant(f64),
}

impl LiveColumns {
    /// Collects the columns of all tables; `recorder` is the id of the store.
    pub fn from_tables<'a>(tables: impl IntoIterator<Item = &'a LiveTable>, recorder: Option<String>) -> Self {
        let once = SCALAR_COLUMNS.iter().map(|(name, unit, kind)| LiveColumnSource {
            name: format!("{name}{}", unit_suffix(unit)),
            value_type: LiveValueType::from_unit(unit, *kind),
            origin: ValueOrigin::Constant(f64::NAN),
        });
        let mut all: Vec<LiveColumnSource> = once.collect();
        for place in tables.into_iter().flat_map(column_sources) {
            if !all.iter().any(|known| known.name == place.name) {
                all.push(place);
            }
        }
        Self { recorder, all }
    }

    /// Returns all columns without rows.
    pub fn empty_columns(&self) -> Vec<ExportColumn> {
        let mut columns: Vec<ExportColumn> =
            ["recorder_id", "flight", "result_id", "boot_id"].map(|name| constant_text(name, None, 0)).into();
        columns.extend(self.all.iter().map(|place| place.to_column(&[], &[])));
        columns
    }

    /// Returns the rows of a block; `None` if it cannot be unpacked.
    pub fn block_columns(&self, head: &LiveHead, block: &LiveBlock) -> Option<Vec<ExportColumn>> {
        let rows = block.len();
        let unpacked: Vec<Vec<f64>> =
            (0..head.table.columns.len()).map(|k| block.column_values(k)).collect::<Option<_>>()?;
        let there = column_sources(&head.table);
        let mut columns = vec![
            constant_text("recorder_id", self.recorder.as_deref(), rows),
            constant_text("flight", Some(head.flight.as_str()), rows),
            ExportColumn { name: "result_id".to_owned(), values: ColumnValues::Text(result_ids(head, block)) },
            constant_text("boot_id", Some(head.began.boot_id.as_str()), rows),
        ];
        columns.extend(self.all.iter().map(|place| {
            let numbers = match there.iter().find(|found| found.name == place.name).map(|found| &found.origin) {
                Some(ValueOrigin::Value(column, value)) => {
                    let width = head.table.columns.get(*column).map_or(1, |column| column.width);
                    let all = unpacked.get(*column).into_iter().flatten();
                    all.skip(*value).step_by(width).copied().collect()
                }
                Some(ValueOrigin::Constant(value)) => vec![*value; rows],
                None => vec![f64::NAN; rows],
            };
            place.to_column(&numbers, &word_labels(&head.table, &place.name))
        }));
        Some(columns)
    }
}

/// Returns the texts of the numbers of a word column.
fn word_labels(table: &LiveTable, name: &str) -> Vec<String> {
    let list = table.source.get(names::WORDS).and_then(|words| words.get(name)?.as_array());
    list.into_iter().flatten().map(label_text).collect()
}

impl LiveValueType {
    fn from_unit(unit: &str, kind: ValueKind) -> Self {
        match (unit, kind) {
            (UTC, _) => Self::Time,
            (FLAG, _) => Self::Flag,
            (WORD, _) => Self::Text,
            (_, ValueKind::F64) => Self::Double,
            (_, ValueKind::F32) => Self::Single,
            (_, ValueKind::U64 | ValueKind::U32 | ValueKind::U8) => Self::Integer,
        }
    }
}

impl LiveColumnSource {
    /// Builds the column from its numbers; `words` are the texts of a word column.
    fn to_column(&self, numbers: &[f64], words: &[String]) -> ExportColumn {
        let all = || numbers.iter().map(|number| Some(*number).filter(|number| !number.is_nan()));
        let values = match self.value_type {
            LiveValueType::Time => ColumnValues::Time(all().map(|v| v.map(|v| v as i64)).collect()),
            LiveValueType::Flag => ColumnValues::Flag(all().map(|v| v.map(|v| v != 0.0)).collect()),
            LiveValueType::Text => ColumnValues::Text(all().map(|v| words.get(v? as usize).cloned()).collect()),
            LiveValueType::Double => ColumnValues::Number(all().collect()),
            LiveValueType::Single => ColumnValues::Single(all().map(|v| v.map(|v| v as f32)).collect()),
            LiveValueType::Integer => ColumnValues::Count(all().map(|v| v.map(|v| v as i64)).collect()),
        };
        ExportColumn { name: self.name.clone(), values }
    }
}

/// Lists the columns of a table. `markers.deflection` in m becomes `deflection_M01_m`, `stations.deflection` becomes
/// `deflection_s01_m` with `arc_length_s01_m`, and `torsion.twist` becomes `torsion_tip_twist_deg`, as for frames. Values
/// without a label are numbered.
fn column_sources(table: &LiveTable) -> Vec<LiveColumnSource> {
    let mut all = arc_length_sources(table);
    for (index, column) in table.columns.iter().enumerate() {
        let (list, rest) = column.name.split_once('.').map_or((None, &*column.name), |(l, r)| (Some(l), r));
        let labels = list.and_then(|list| table.source.get(list)?.as_array());
        let labels = labels.filter(|labels| labels.len() == column.width);
        let unit = unit_suffix(&column.unit);
        for value in 0..column.width {
            let label = labels.and_then(|labels| labels.get(value)).map(label_text);
            let name = match (list, label) {
                (Some(STATIONS), _) => format!("{rest}_{}{unit}", station_label(value)),
                (Some(TORSION), Some(label)) => format!("{TORSION}_{label}_{rest}{unit}"),
                (_, Some(label)) => format!("{rest}_{label}{unit}"),
                _ if column.width == 1 => format!("{rest}{unit}"),
                _ => format!("{rest}_{}{unit}", value + 1),
            };
            let value_type = LiveValueType::from_unit(&column.unit, column.kind);
            all.push(LiveColumnSource { name, value_type, origin: ValueOrigin::Value(index, value) });
        }
    }
    all
}

/// Lists the arc lengths of the stations from the bending root. They depend on the installation, unlike the station names.
fn arc_length_sources(table: &LiveTable) -> Vec<LiveColumnSource> {
    let arcs = table.source.get(STATIONS).and_then(Value::as_array);
    let place = |(index, arc): (usize, &Value)| LiveColumnSource {
        name: format!("arc_length_{}_m", station_label(index)),
        value_type: LiveValueType::Double,
        origin: ValueOrigin::Constant(arc.as_f64().unwrap_or(f64::NAN)),
    };
    arcs.into_iter().flatten().enumerate().map(place).collect()
}

/// Returns the name of a station, numbered from 1 at the root.
fn station_label(index: usize) -> String {
    format!("s{:02}", index + 1)
}

fn label_text(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// Returns the suffix of a column name for a unit.
fn unit_suffix(unit: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    match unit {
        "" | UTC | FLAG | WORD => String::new(),
        _ => match unit.strip_prefix("1/") {
            Some(below) => format!("_per_{}", below.chars().map(plain).collect::<String>()),
            None => format!("_{}", unit.chars().map(plain).collect::<String>()),
        },
    }
}

/// Writes rows as one JSON object each; missing and infinite values are `null`.
pub fn write_json_rows(output: &mut dyn Write, columns: &[ExportColumn]) -> io::Result<()> {
    let rows = columns.first().map_or(0, |column| column.values.len());
    for row in 0..rows {
        for (index, column) in columns.iter().enumerate() {
            output.write_all(if index == 0 { b"{" } else { b"," })?;
            serde_json::to_writer(&mut *output, &column.name)?;
            output.write_all(b":")?;
            let text = column.values.value_text(row);
            match &column.values {
                ColumnValues::Number(_) | ColumnValues::Single(_) if text.ends_with("inf") => {
                    output.write_all(b"null")?
                }
                _ if text.is_empty() => output.write_all(b"null")?,
                ColumnValues::Text(_) | ColumnValues::Time(_) => serde_json::to_writer(&mut *output, &text)?,
                _ => output.write_all(text.as_bytes())?,
            }
        }
        output.write_all(b"}\n")?;
    }
    Ok(())
}
