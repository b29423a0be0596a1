//! Aircraft data and provenance of live results, in the same columns as for frames.

use serde_json::{Map, Value};

use super::columns::{ColumnValues, ExportColumn, constant_text, schema_version};
use crate::aircraft::{AircraftState, AircraftTrack, Quantity};
use crate::clock::Stamp;
use crate::clock::exposure::{Exposure, ExposureSource};
use crate::clock::quality::ClockQuality;
use crate::store::columns::{LiveBlock, LiveHead};
use crate::store::live::names;
use crate::store::{Inputs, installations};

/// Columns of a flight's live results that do not come from the live file.
#[derive(Default)]
pub struct LiveFacts {
    /// Samples of the aircraft data.
    pub track: AircraftTrack,
}

/// Times of a block's results, row by row.
struct RowInstants {
    utc: Option<Vec<f64>>,
    since_boot_s: Option<Vec<f64>>,
    exposure_sigma_s: Option<Vec<f64>>,
    clock_sigma_s: Option<Vec<f64>>,
}

impl LiveFacts {
    /// Returns the columns without rows.
    pub fn empty_columns() -> Vec<ExportColumn> {
        let mut columns = shared_columns(&BlockResults::default());
        columns.extend(aircraft_columns(&[]));
        columns.extend(provenance_columns(&Map::new(), 0));
        columns
    }

    /// Returns the columns of a block.
    pub fn block_columns(&self, head: &LiveHead, block: &LiveBlock) -> Vec<ExportColumn> {
        let column = |name: &str| block.column_values(head.table.find_column(name)?.0);
        let instants = RowInstants {
            utc: column(names::UTC),
            since_boot_s: column(names::SINCE_BOOT),
            exposure_sigma_s: column(names::EXPOSURE_SIGMA),
            clock_sigma_s: column(names::CLOCK_SIGMA),
        };
        let state = |row: usize| match self.track.is_empty() {
            true => AircraftState::new(),
            false => instants.aircraft_state(&self.track, &head.began, row).unwrap_or_default(),
        };
        let mut columns = shared_columns(&BlockResults::from_block(head, block));
        columns.extend(aircraft_columns(&(0..block.len()).map(state).collect::<Vec<_>>()));
        let inputs = head.table.source.get(names::PROVENANCE).and_then(Value::as_object);
        columns.extend(provenance_columns(&inputs.cloned().unwrap_or_default(), block.len()));
        columns
    }
}

fn finite_value(column: &Option<Vec<f64>>, row: usize) -> Option<f64> {
    column.as_ref()?.get(row).copied().filter(|value| value.is_finite())
}

impl RowInstants {
    /// Returns UTC and time since boot, s, of a live result (a row of the table); `None` if its time is unknown.
    fn result_instant(&self, began: &Stamp, row: usize) -> Option<(jiff::Timestamp, f64)> {
        let utc = jiff::Timestamp::from_microsecond(finite_value(&self.utc, row)? as i64).ok()?;
        let by_utc_s = began.since_boot_s + utc.duration_since(began.utc).as_secs_f64();
        Some((utc, finite_value(&self.since_boot_s, row).unwrap_or(by_utc_s)))
    }

    /// Returns the aircraft data at a row; `None` if its time is unknown.
    fn aircraft_state(&self, track: &AircraftTrack, began: &Stamp, row: usize) -> Option<AircraftState> {
        let value_at_row = |column: &Option<Vec<f64>>| finite_value(column, row);
        let (utc, since_boot_s) = self.result_instant(began, row)?;
        let clock_sigma_s = value_at_row(&self.clock_sigma_s);
        let utc_synchronised = began.utc_synchronised || clock_sigma_s.is_some();
        let stamp = Stamp { utc, utc_synchronised, since_boot_s, boot_id: began.boot_id.clone() };
        let exposure = Exposure {
            exposure_time: utc,
            exposure_since_boot_s: since_boot_s,
            exposure_sigma_s: value_at_row(&self.exposure_sigma_s).unwrap_or(0.0),
            exposure_source: ExposureSource::AskedAndDelivered,
            exposure_delay_s: None,
            clock_sigma_s,
            clock: ClockQuality::default(),
            camera_clock_offset_s: None,
        };
        Some(track.state_at(&stamp, Some(&exposure)))
    }
}

/// Returns a key for each row, unique within a recorder, like `series/shot` of a frame: the first 8 digits of the boot id,
/// and the microseconds from boot to exposure.
pub(super) fn result_ids(head: &LiveHead, block: &LiveBlock) -> Vec<Option<String>> {
    let column = |name: &str| block.column_values(head.table.find_column(name)?.0);
    let instants = RowInstants {
        utc: column(names::UTC),
        since_boot_s: column(names::SINCE_BOOT),
        exposure_sigma_s: None,
        clock_sigma_s: None,
    };
    let boot: String = head.began.boot_id.chars().filter(char::is_ascii_alphanumeric).take(8).collect();
    let id = |row: usize| {
        let (_, since_boot_s) = instants.result_instant(&head.began, row)?;
        Some(format!("{boot}/{:.0}", 1e6 * since_boot_s))
    };
    (0..block.len()).map(id).collect()
}

/// Values of a block for the columns shared with frames, as stored in the file.
#[derive(Default)]
struct BlockResults {
    rows: usize,
    utc: Option<Vec<f64>>,
    solved: Option<Vec<f64>>,
    passed: Option<Vec<f64>>,
    sigmas_m: [Option<Vec<f64>>; 3],
    method: Option<String>,
    tip: Option<String>,
}

impl BlockResults {
    fn from_block(head: &LiveHead, block: &LiveBlock) -> Self {
        let column = |name: &str| block.column_values(head.table.find_column(name)?.0);
        let word = |name: &str| head.table.source.get(name).and_then(Value::as_str).map(str::to_owned);
        Self {
            rows: block.len(),
            utc: column(names::UTC),
            solved: column(names::SOLVED),
            passed: column(names::GLOBAL_TEST_PASSED),
            sigmas_m: ["", "_ground", "_root"].map(|which| column(&format!("sigma_tip_deflection{which}"))),
            method: word("method"),
            tip: word("tip"),
        }
    }
}

/// Builds the columns shared with frames, by the same names.
fn shared_columns(results: &BlockResults) -> Vec<ExportColumn> {
    let number = finite_value;
    let rows = 0..results.rows;
    let words = |name: &str, value: &dyn Fn(usize) -> Option<String>| ExportColumn {
        name: name.to_owned(),
        values: ColumnValues::Text(rows.clone().map(value).collect()),
    };
    let choose_text = |column, row, yes: &str, no: &str| {
        number(column, row).map(|value| if value == 0.0 { no } else { yes }.to_owned())
    };
    let moments = rows.clone().map(|row| number(&results.utc, row).map(|utc| utc as i64)).collect();
    let mut columns = vec![
        ExportColumn { name: "exposure_time".to_owned(), values: ColumnValues::Time(moments) },
        words("status", &|row| choose_text(&results.solved, row, "ok", "failed")),
        constant_text("method", results.method.as_deref(), results.rows),
        ExportColumn {
            name: "flight_adjustment".to_owned(),
            values: ColumnValues::Flag(vec![Some(false); results.rows]),
        },
        words("global_test", &|row| choose_text(&results.passed, row, "passed", "rejected")),
        words("tip_marker", &|row| results.tip.clone().filter(|_| number(&results.solved, row) == Some(1.0))),
    ];
    for (which, sigma) in ["", "_ground", "_root"].into_iter().zip(&results.sigmas_m) {
        let sigmas = rows.clone().map(|row| number(sigma, row)).collect();
        columns.push(ExportColumn {
            name: format!("tip_sigma_deflection{which}_m"),
            values: ColumnValues::Number(sigmas),
        });
    }
    columns
}

/// Builds two columns per quantity: value and standard deviation.
fn aircraft_columns(states: &[AircraftState]) -> Vec<ExportColumn> {
    let both = |quantity: Quantity| {
        let values = |value: fn(&crate::aircraft::JoinedValue) -> f64| {
            let one = |state: &AircraftState| state.get(&quantity).map(value).filter(|v| v.is_finite());
            ColumnValues::Number(states.iter().map(one).collect())
        };
        [
            ExportColumn { name: quantity.name().to_owned(), values: values(|joined| joined.value) },
            ExportColumn { name: format!("sigma_{}", quantity.name()), values: values(|joined| joined.sigma) },
        ]
    };
    Quantity::ALL.into_iter().flat_map(both).collect()
}

/// Builds the columns of the inputs common to all results of a file.
fn provenance_columns(inputs: &Map<String, Value>, rows: usize) -> Vec<ExportColumn> {
    let word = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let input_text = |name: &str| inputs.get(name).map(word);
    let key = (!inputs.is_empty()).then(|| Inputs::new(inputs.clone()).key(""));
    let columns = [
        ("program", input_text("program")),
        ("installation_sha256", installations::digest_from_provenance(inputs)),
        ("parameters", input_text("parameters")),
        ("inputs", key),
    ];
    let columns = columns.into_iter().map(|(name, value)| constant_text(name, value.as_deref(), rows));
    columns.chain([schema_version(rows)]).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn every_row_has_provenance() {
        let inputs = serde_json::json!({"program": "wingd 1", "camera.toml.sha256": "ab", "parameters": {"a": 1}});
        let columns = provenance_columns(inputs.as_object().unwrap(), 2);
        let texts: Vec<String> = columns.iter().map(|column| column.values.value_text(1)).collect();
        assert_eq!((texts[0].as_str(), texts[2].as_str()), ("wingd 1", "{\"a\":1}"));
        assert_eq!((texts[1].len(), texts[3].len()), (64, 64));
        // The schema version is in every row.
        assert!(provenance_columns(&Map::new(), 1).iter().take(4).all(|column| column.values.value_text(0).is_empty()));
        assert_eq!(LiveFacts::empty_columns().len(), 9 + 2 * Quantity::ALL.len() + 5);
    }
}
