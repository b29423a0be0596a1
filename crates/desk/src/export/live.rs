//! Export of live results as a table with one row per result and one column per value.

use std::io::{self, Write};

use serde_json::Value;

use super::columns::{ColumnValues, ExportColumn, NumberType};
use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;
use wingd_evaluation::aircraft::{AircraftState, AircraftTrack};
use wingd_evaluation::quantities::{
    CLOCK_SIGMA, EXPOSURE_SIGMA, FIRST_VERSION, GLOBAL_TEST_PASSED, LiveSource, ResultInputs,
    ResultRow, SOLVED, StoredTimes, Subject, TIP_SIGMAS, TableColumn, finite_value,
    stored_quantities, unit_suffix,
};
use wingd_evaluation::record::{ImageRecord, RecordStatus, Tip, json_text};
use wingd_measure::estimation::quality::GlobalTest;
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
        let once = stored_quantities()
            .into_iter()
            .filter(|(subject, _, quantity)| {
                *subject == Subject::Row && !FIRST_VERSION.contains(&quantity.name)
            });
        let mut stored: Vec<LiveColumnSource> = once
            .map(|(_, form, quantity)| LiveColumnSource {
                name: quantity.column_name(),
                kind: number_type(quantity.stored_unit(), form.kind),
                origin: ValueOrigin::Constant(f64::NAN),
            })
            .collect();
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
            .map(|source| source.to_column(vec![], &[]))
            .collect();
        all_columns(stored, &[])
    }

    /// Returns the rows of a block, with the aircraft data of `track`; `None` if the block cannot be unpacked.
    pub fn block_columns(
        &self,
        head: &LiveHead,
        block: &LiveBlock,
        track: &AircraftTrack,
    ) -> Option<Vec<ExportColumn>> {
        let unpacked: Vec<Vec<f64>> = (0..head.table.columns.len())
            .map(|k| block.column_values(k))
            .collect::<Option<_>>()?;
        let (source, there) = (
            LiveSource::from_table(&head.table),
            column_sources(&head.table),
        );
        let stored = self.stored.iter().map(|wanted| {
            let numbers = match there
                .iter()
                .find(|found| found.name == wanted.name)
                .map(|found| &found.origin)
            {
                Some(ValueOrigin::Value(column, value)) => {
                    let width = head
                        .table
                        .columns
                        .get(*column)
                        .map_or(1, |column| column.width);
                    let all = unpacked.get(*column).into_iter().flatten();
                    all.skip(*value).step_by(width).copied().collect()
                }
                Some(ValueOrigin::Constant(value)) => vec![*value; block.len()],
                None => vec![f64::NAN; block.len()],
            };
            let words = source.words.get(&wanted.name).and_then(Value::as_array);
            wanted.to_column(numbers, words.map_or(&[], Vec::as_slice))
        });
        let results = StoredResult::read_block(head, &source, block, track);
        let inputs = ResultInputs::from_provenance(&source.provenance);
        let row = ResultRow {
            recorder_id: self.recorder.as_deref(),
            flight: Some(&head.flight),
            method: source.method.as_deref(),
            inputs: Some(&inputs),
            ..ResultRow::default()
        };
        let rows: Vec<ResultRow> = results.iter().map(|result| result.row(row)).collect();
        Some(all_columns(stored.collect(), &rows))
    }
}

/// Adds the columns that are not stored to those that are.
fn all_columns(stored: Vec<ExportColumn>, rows: &[ResultRow]) -> Vec<ExportColumn> {
    let others = |identity: bool| {
        TableColumn::of_live(identity)
            .iter()
            .map(|column| ExportColumn::from_rows(column, rows))
            .collect::<Vec<_>>()
    };
    [others(true), stored, others(false)].concat()
}

/// Stored result, as far as the columns that are not stored need it.
struct StoredResult {
    stamp: Option<Stamp>,
    exposure: Option<Exposure>,
    aircraft: AircraftState,
    image: Option<ImageRecord>,
}

impl StoredResult {
    fn read_block(
        head: &LiveHead,
        source: &LiveSource,
        block: &LiveBlock,
        track: &AircraftTrack,
    ) -> Vec<Self> {
        let times = StoredTimes::from_block(block);
        let [exposure_sigma_s, clock_sigma_s, solved, passed] =
            [EXPOSURE_SIGMA, CLOCK_SIGMA, SOLVED, GLOBAL_TEST_PASSED]
                .map(|one| block.named_values(one.name));
        let sigmas_m = TIP_SIGMAS.map(|one| block.named_values(one.name));
        let result = |row: usize| {
            let clock_sigma_s = finite_value(&clock_sigma_s, row);
            let stamp = times
                .as_ref()
                .and_then(|times| times.stamp(&head.began, row))
                .map(|stamp| Stamp {
                    utc_synchronised: stamp.utc_synchronised || clock_sigma_s.is_some(),
                    ..stamp
                });
            let exposure = stamp.as_ref().map(|stamp| Exposure {
                exposure_sigma_s: finite_value(&exposure_sigma_s, row).unwrap_or(0.0),
                ..Exposure::from_camera_clock(stamp, 0.0, clock_sigma_s)
            });
            let joined = stamp.as_ref().filter(|_| !track.is_empty());
            let aircraft = joined
                .map(|stamp| track.state_at(stamp, exposure.as_ref()))
                .unwrap_or_default();
            let image = finite_value(&solved, row).map(|solved| {
                let [survey, ground, root] = [0, 1, 2].map(|k| finite_value(&sigmas_m[k], row));
                let passed = finite_value(&passed, row).map(|passed| passed != 0.0);
                record_of_stored_result(source, solved != 0.0, passed, [survey, ground, root])
            });
            Self {
                stamp,
                exposure,
                aircraft,
                image,
            }
        };
        (0..block.len()).map(result).collect()
    }

    fn row<'a>(&'a self, common: ResultRow<'a>) -> ResultRow<'a> {
        ResultRow {
            stamp: self.stamp.as_ref(),
            exposure: self.exposure.as_ref(),
            aircraft: Some(&self.aircraft),
            image: self.image.as_ref(),
            ..common
        }
    }
}

fn record_of_stored_result(
    source: &LiveSource,
    solved: bool,
    passed: Option<bool>,
    sigmas_m: [Option<f64>; 3],
) -> ImageRecord {
    let [
        sigma_deflection_m,
        sigma_deflection_ground_m,
        sigma_deflection_root_m,
    ] = sigmas_m;
    let tip = |marker: String| Tip {
        marker,
        sigma_deflection_m,
        sigma_deflection_ground_m,
        sigma_deflection_root_m,
        ..Tip::default()
    };
    ImageRecord {
        status: if solved {
            RecordStatus::Ok
        } else {
            RecordStatus::Failed
        },
        global_test: passed.map(|passed| {
            if passed {
                GlobalTest::Passed
            } else {
                GlobalTest::Rejected
            }
        }),
        tip: source.tip.clone().filter(|_| solved).map(tip),
        ..ImageRecord::default()
    }
}

/// Returns the type of a stored column's numbers; `None` for words.
fn number_type(unit: &str, kind: ValueKind) -> Option<NumberType> {
    match (unit, kind) {
        (WORD, _) => None,
        (UTC, _) => Some(NumberType::Time),
        (FLAG, _) => Some(NumberType::Flag),
        (_, ValueKind::F64) => Some(NumberType::Double),
        (_, ValueKind::F32) => Some(NumberType::Single),
        (_, ValueKind::U64 | ValueKind::U32 | ValueKind::U8) => Some(NumberType::Count),
    }
}

impl LiveColumnSource {
    /// Builds the column from its numbers; `words` are the texts of a word column.
    fn to_column(&self, numbers: Vec<f64>, words: &[Value]) -> ExportColumn {
        let word = |number: &f64| {
            words
                .get(Some(*number).filter(|number| !number.is_nan())? as usize)
                .map(json_text)
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
/// `deflection_s01_m` with `arc_length_s01_m`, `sections.bending_moment` becomes `bending_moment_b01_nm`, and `torsion.twist` becomes `torsion_tip_twist_deg`, as for frames. Values
/// without a label are numbered.
fn column_sources(table: &LiveTable) -> Vec<LiveColumnSource> {
    let mut all = vec![];
    for (list, prefix) in PLACES {
        let arcs = table.source.get(list).and_then(Value::as_array);
        for (index, arc) in arcs.into_iter().flatten().enumerate() {
            all.push(LiveColumnSource {
                name: format!("arc_length_{}_m", place_label(prefix, index)),
                kind: Some(NumberType::Double),
                origin: ValueOrigin::Constant(arc.as_f64().unwrap_or(f64::NAN)),
            });
        }
    }
    for (index, column) in table.columns.iter().enumerate() {
        if FIRST_VERSION.contains(&&*column.name) {
            continue;
        }
        let (list, rest) = column
            .name
            .split_once('.')
            .map_or((None, &*column.name), |(l, r)| (Some(l), r));
        let labels = list.and_then(|list| table.source.get(list)?.as_array());
        let labels = labels.filter(|labels| labels.len() == column.width);
        let unit = if [UTC, FLAG, WORD].contains(&&*column.unit) {
            String::new()
        } else {
            unit_suffix(&column.unit)
        };
        let place = PLACES.iter().find(|(place, _)| list == Some(place));
        for value in 0..column.width {
            let label = labels.and_then(|labels| labels.get(value)).map(json_text);
            let name = match (list, label) {
                _ if place.is_some() => {
                    let prefix = place.map_or("", |(_, prefix)| prefix);
                    format!("{rest}_{}{unit}", place_label(prefix, value))
                }
                (Some(TORSION), Some(label)) => format!("{TORSION}_{label}_{rest}{unit}"),
                (_, Some(label)) => format!("{rest}_{label}{unit}"),
                _ if column.width == 1 => format!("{rest}{unit}"),
                _ => format!("{rest}_{}{unit}", value + 1),
            };
            let kind = number_type(&column.unit, column.kind);
            all.push(LiveColumnSource {
                name,
                kind,
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
                _ if text.is_empty() => output.write_all(b"null")?,
                ColumnValues::Texts(_) | ColumnValues::Numbers(NumberType::Time, _) => {
                    serde_json::to_writer(&mut *output, &text)?
                }
                ColumnValues::Numbers(..) if text.ends_with("inf") => output.write_all(b"null")?,
                ColumnValues::Numbers(..) => output.write_all(text.as_bytes())?,
            }
        }
        output.write_all(b"}\n")?;
    }
    Ok(())
}
