//! Export of live results as a table with one row per result and one column per value.

use std::io::{self, Write};

use jiff::Timestamp;
use serde_json::Value;

use super::RowWriter;
use super::columns::{ColumnValues, ExportColumn, NumberType};
use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;
use wingd_evaluation::aircraft::{AircraftState, AircraftTrack};
use wingd_evaluation::quantities::{
    CLOCK_SIGMA, EXPOSURE_SIGMA, LiveSource, ResultInputs, ResultQuantity, ResultRow, SINCE_BOOT,
    STATUS, Subject, TableColumn, UTC as UTC_COLUMN, stored_quantities, unit_suffix,
};
use wingd_evaluation::record::{ImageRecord, Tip, json_text};
use wingd_store::columns::{FLAG, LiveBlock, LiveHead, LiveTable, UTC, ValueKind, WORD};

/// Columns of several files whose tables may differ. A value that a file does not have is missing in its rows. The columns
/// with one value per row are always present, and so are those that are derived from stored ones.
pub struct LiveColumns {
    recorder: Option<String>,
    stored: Vec<LiveColumnSource>,
}

/// Exported column and the origin of its values.
struct LiveColumnSource {
    /// Name, with the unit.
    name: String,
    /// Type of its numbers; `None` for words.
    kind: Option<NumberType>,
    /// Words that its numbers stand for.
    words: Vec<String>,
    origin: ValueOrigin,
}

enum ValueOrigin {
    /// Index of the file's column, and of the value within its row.
    Value(usize, usize),
    /// Constant value for all rows of the table.
    Constant(f64),
}

impl LiveColumns {
    /// Collects the columns of all tables; `recorder` is the id of the store.
    pub fn from_tables<'a>(
        tables: impl IntoIterator<Item = &'a LiveTable>,
        recorder: Option<String>,
    ) -> Self {
        let quantities = stored_quantities().into_iter();
        let once = quantities.filter(|(subject, ..)| *subject == Subject::Row);
        let once = once.map(|(_, form, quantity)| LiveColumnSource {
            name: quantity.column_name(),
            kind: number_type(quantity.stored_unit(), form.kind, form.name),
            words: vec![],
            origin: ValueOrigin::Constant(f64::NAN),
        });
        let mut stored = Vec::from_iter(once);
        for source in tables.into_iter().flat_map(column_sources) {
            if !stored.iter().any(|known| known.name == source.name) {
                stored.push(source);
            }
        }
        Self { recorder, stored }
    }

    /// Returns all columns without rows.
    pub fn empty_columns(&self) -> Vec<ExportColumn> {
        let stored = self
            .stored
            .iter()
            .map(|source| source.to_column(vec![], &[]));
        all_columns(stored.collect(), &[])
    }

    /// Returns the rows of a block, with the aircraft data of `track`; `None` if the block cannot be unpacked.
    pub fn block_columns(
        &self,
        head: &LiveHead,
        block: &LiveBlock,
        track: &AircraftTrack,
    ) -> Option<Vec<ExportColumn>> {
        let columns = &head.table.columns;
        let unpacked = (0..columns.len()).map(|k| block.column_values(k));
        let unpacked: Vec<Vec<f64>> = unpacked.collect::<Option<_>>()?;
        let there = column_sources(&head.table);
        let stored = self.stored.iter().map(|wanted| {
            let found = there.iter().find(|found| found.name == wanted.name);
            let numbers = match found.map(|found| &found.origin) {
                Some(ValueOrigin::Value(column, value)) => {
                    let all = unpacked[*column].iter().skip(*value);
                    all.step_by(columns[*column].width).copied().collect()
                }
                Some(ValueOrigin::Constant(value)) => vec![*value; block.len()],
                None => vec![f64::NAN; block.len()],
            };
            wanted.to_column(numbers, found.map_or(&[], |found| &found.words))
        });
        let source = LiveSource::from_table(&head.table);
        let results = StoredResult::read_block(head, block, track);
        let inputs = ResultInputs::from_provenance(&source.provenance);
        let tip = source.tip.map(|marker| Tip {
            marker,
            ..Tip::default()
        });
        let solved = ImageRecord {
            tip,
            ..ImageRecord::default()
        };
        let unsolved = ImageRecord::default();
        let rows = results.iter().map(|result| ResultRow {
            recorder_id: self.recorder.as_deref(),
            flight: Some(&head.flight),
            method: source.method.as_deref(),
            inputs: Some(&inputs),
            stamp: result.stamp.as_ref(),
            exposure: result.exposure.as_ref(),
            aircraft: Some(&result.aircraft),
            image: result
                .is_solved
                .map(|is_solved| if is_solved { &solved } else { &unsolved }),
            ..ResultRow::default()
        });
        Some(all_columns(stored.collect(), &Vec::from_iter(rows)))
    }
}

/// Adds the columns that are not stored to those that are.
fn all_columns(stored: Vec<ExportColumn>, rows: &[ResultRow]) -> Vec<ExportColumn> {
    let others = |identity: bool| {
        let columns = TableColumn::of_live(identity);
        let columns = columns.iter().map(|c| ExportColumn::from_rows(c, rows));
        Vec::from_iter(columns)
    };
    [others(true), stored, others(false)].concat()
}

/// Stored result, as far as the columns that are not stored need it.
struct StoredResult {
    stamp: Option<Stamp>,
    exposure: Option<Exposure>,
    aircraft: AircraftState,
    is_solved: Option<bool>,
}

impl StoredResult {
    fn read_block(head: &LiveHead, block: &LiveBlock, track: &AircraftTrack) -> Vec<Self> {
        let column = |one: &ResultQuantity| {
            let name = one.stored_name(Subject::Row);
            block.named_values(&name).unwrap_or_default()
        };
        let [
            utc_us,
            since_boot_s,
            exposure_sigma_s,
            clock_sigma_s,
            status,
        ] = [UTC_COLUMN, SINCE_BOOT, EXPOSURE_SIGMA, CLOCK_SIGMA, STATUS].map(|one| column(&one));
        let began = &head.began;
        let result = |row: usize| {
            let value = |column: &[f64]| column.get(row).copied().filter(|v| v.is_finite());
            let clock_sigma_s = value(&clock_sigma_s);
            let utc = value(&utc_us).and_then(|us| Timestamp::from_microsecond(us as i64).ok());
            let stamp = utc.map(|utc| {
                let by_utc_s = || began.since_boot_s + utc.duration_since(began.utc).as_secs_f64();
                Stamp {
                    utc,
                    utc_synchronised: began.utc_synchronised || clock_sigma_s.is_some(),
                    since_boot_s: value(&since_boot_s).unwrap_or_else(by_utc_s),
                    ..began.clone()
                }
            });
            let exposure = stamp.as_ref().map(|stamp| Exposure {
                exposure_sigma_s: value(&exposure_sigma_s).unwrap_or(0.0),
                ..Exposure::from_camera_clock(stamp, 0.0, clock_sigma_s)
            });
            let joined = stamp.as_ref().filter(|_| !track.is_empty());
            let aircraft = joined.map(|stamp| track.state_at(stamp, exposure.as_ref()));
            Self {
                stamp,
                exposure,
                aircraft: aircraft.unwrap_or_default(),
                is_solved: value(&status).map(|word| word == 1.0),
            }
        };
        (0..block.len()).map(result).collect()
    }
}

/// Returns the type of a stored column's numbers; `None` for words. Columns that the first version stored under another name
/// are double.
fn number_type(unit: &str, kind: ValueKind, renamed: Option<&str>) -> Option<NumberType> {
    match (unit, kind) {
        (WORD, _) => None,
        (UTC, _) => Some(NumberType::Time),
        (FLAG, _) => Some(NumberType::Flag),
        (_, ValueKind::F32) if renamed.is_none() => Some(NumberType::Single),
        (_, ValueKind::F32 | ValueKind::F64) => Some(NumberType::Double),
        (_, ValueKind::U64 | ValueKind::U32 | ValueKind::U8) => Some(NumberType::Count),
    }
}

impl LiveColumnSource {
    /// Builds the column from its numbers, which stand for words in a column of words.
    fn to_column(&self, numbers: Vec<f64>, words: &[String]) -> ExportColumn {
        let word = |number: &f64| {
            let index = Some(*number).filter(|number| !number.is_nan())?;
            words.get(index as usize).cloned()
        };
        let values = match self.kind {
            Some(kind) => ColumnValues::from_numbers(kind, numbers),
            None => ColumnValues::Texts(numbers.iter().map(word).collect()),
        };
        ExportColumn {
            name: self.name.clone(),
            values,
        }
    }
}

/// Lists the columns of a table. `markers.deflection` in m becomes `deflection_M01_m`, `stations.deflection` becomes
/// `deflection_s01_m` with `arc_length_s01_m`, `sections.bending_moment` becomes `bending_moment_b01_nm`, and `torsion.twist`
/// becomes `torsion_tip_twist_deg`, as for frames. Values without a label are numbered.
fn column_sources(table: &LiveTable) -> Vec<LiveColumnSource> {
    let list_of = |list: &str| table.source.get(list).and_then(Value::as_array);
    let mut all = vec![];
    for (list, prefix) in PLACES {
        for (index, arc) in list_of(list).into_iter().flatten().enumerate() {
            all.push(LiveColumnSource {
                name: format!("arc_length_{}_m", place_label(prefix, index)),
                kind: Some(NumberType::Double),
                words: vec![],
                origin: ValueOrigin::Constant(arc.as_f64().unwrap_or(f64::NAN)),
            });
        }
    }
    let quantities = stored_quantities();
    for (index, column) in table.columns.iter().enumerate() {
        let split = column.name.split_once('.');
        let (list, stored_name) = split.map_or((None, &*column.name), |(l, r)| (Some(l), r));
        let mut known = quantities.iter();
        let known = known.find(|(subject, _, one)| one.stored_name(*subject) == column.name);
        let form = known.map(|(_, form, _)| form);
        let rest = known.map_or(stored_name, |(_, _, quantity)| quantity.name);
        let unit = known.map_or(&*column.unit, |(_, _, quantity)| quantity.stored_unit());
        let labels = list.and_then(list_of);
        let labels = labels.filter(|labels| labels.len() == column.width);
        let suffix = match [UTC, FLAG, WORD].contains(&unit) {
            true => String::new(),
            false => unit_suffix(unit),
        };
        let words = table
            .source
            .get("words")
            .and_then(|w| w.get(&column.name)?.as_array());
        let words = match words {
            Some(words) => words.iter().map(json_text).collect(),
            None => form.map_or(vec![], |form| (form.words)()),
        };
        let place = PLACES.iter().find(|(place, _)| list == Some(place));
        for value in 0..column.width {
            let label = match (place, labels.and_then(|labels| labels.get(value))) {
                (Some((_, prefix)), _) => format!("_{}", place_label(prefix, value)),
                (None, Some(label)) => format!("_{}", json_text(label)),
                (None, None) if column.width == 1 => String::new(),
                (None, None) => format!("_{}", value + 1),
            };
            let name = match list {
                Some(TORSION) => format!("{TORSION}{label}_{rest}{suffix}"),
                _ => format!("{rest}{label}{suffix}"),
            };
            all.push(LiveColumnSource {
                name,
                kind: number_type(unit, column.kind, form.and_then(|form| form.name)),
                words: words.clone(),
                origin: ValueOrigin::Value(index, value),
            });
        }
    }
    all
}

/// Lists of places along the span, with the letter before their number: the part of a stored name before the dot.
const PLACES: [(&str, &str); 2] = [("stations", "s"), ("sections", "b")];
/// List whose labels are not a suffix of the column's name.
const TORSION: &str = "torsion";

/// Returns the name of a place, numbered from 1 at the root.
fn place_label(prefix: &str, index: usize) -> String {
    format!("{prefix}{:02}", index + 1)
}

/// Rows as one JSON object each; missing and infinite values are `null`.
pub struct JsonRows<W: Write>(pub W);

impl<W: Write> RowWriter for JsonRows<W> {
    fn add(&mut self, columns: Vec<ExportColumn>) -> io::Result<()> {
        let output = &mut self.0;
        let rows = columns.first().map_or(0, |column| column.values.len());
        for row in 0..rows {
            for (index, column) in columns.iter().enumerate() {
                output.write_all(if index == 0 { b"{" } else { b"," })?;
                serde_json::to_writer(&mut *output, &column.name)?;
                output.write_all(b":")?;
                let text = column.values.value_text(row);
                match &column.values {
                    _ if text.is_empty() => output.write_all(b"null")?,
                    ColumnValues::Texts(_) | ColumnValues::Numbers(NumberType::Time, _) => {
                        serde_json::to_writer(&mut *output, &text)?
                    }
                    ColumnValues::Numbers(..) if text.ends_with("inf") => {
                        output.write_all(b"null")?
                    }
                    ColumnValues::Numbers(..) => output.write_all(text.as_bytes())?,
                }
            }
            output.write_all(b"}\n")?;
        }
        Ok(())
    }

    fn end(self: Box<Self>) -> io::Result<()> {
        Ok(())
    }
}
