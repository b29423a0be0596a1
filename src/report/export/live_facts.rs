//! Beside a live result stands what the aircraft's data say at its instant, and what it follows from: the same columns as of
//! frames.

use serde_json::{Map, Value};

use super::columns::{Column, Values, schema_version, text};
use crate::aircraft::{Quantity, State, Track};
use crate::clock::Stamp;
use crate::clock::exposure::{Exposure, ExposureSource};
use crate::clock::quality::ClockQuality;
use crate::store::columns::{RowBlock, LiveHead};
use crate::store::live::names;
use crate::store::{Inputs, installations};

/// Of a flight, by its aircraft's data.
#[derive(Default)]
pub struct LiveFacts {
    /// Lines of the aircraft's data.
    pub track: Track,
}

/// A block's instants, row by row.
struct Instants {
    utc: Option<Vec<f64>>,
    since_boot_s: Option<Vec<f64>>,
    exposure_sigma_s: Option<Vec<f64>>,
    clock_sigma_s: Option<Vec<f64>>,
}

impl LiveFacts {
    /// Without rows.
    pub fn empty() -> Vec<Column> {
        let mut columns = as_of_frames(&Once::default());
        columns.extend(aircraft(&[]));
        columns.extend(provenance(&Map::new(), 0));
        columns
    }

    /// A block's rows.
    pub fn rows(&self, head: &LiveHead, block: &RowBlock) -> Vec<Column> {
        let column = |name: &str| block.column_values(head.table.find_column(name)?.0);
        let instants = Instants {
            utc: column(names::UTC),
            since_boot_s: column(names::SINCE_BOOT),
            exposure_sigma_s: column(names::EXPOSURE_SIGMA),
            clock_sigma_s: column(names::CLOCK_SIGMA),
        };
        let state = |row: usize| match self.track.is_empty() {
            true => State::new(),
            false => instants.state(&self.track, &head.began, row).unwrap_or_default(),
        };
        let mut columns = as_of_frames(&Once::of(head, block));
        columns.extend(aircraft(&(0..block.len()).map(state).collect::<Vec<_>>()));
        let inputs = head.table.source.get(names::PROVENANCE).and_then(Value::as_object);
        columns.extend(provenance(&inputs.cloned().unwrap_or_default(), block.len()));
        columns
    }
}

fn finite(column: &Option<Vec<f64>>, row: usize) -> Option<f64> {
    column.as_ref()?.get(row).copied().filter(|value| value.is_finite())
}

impl Instants {
    /// UTC and time since boot of a row, s; `None` where its instant is not known.
    fn moment(&self, began: &Stamp, row: usize) -> Option<(jiff::Timestamp, f64)> {
        let utc = jiff::Timestamp::from_microsecond(finite(&self.utc, row)? as i64).ok()?;
        let by_utc_s = began.since_boot_s + utc.duration_since(began.utc).as_secs_f64();
        Some((utc, finite(&self.since_boot_s, row).unwrap_or(by_utc_s)))
    }

    /// What the aircraft's data say of a row; `None` where its instant is not known.
    fn state(&self, track: &Track, began: &Stamp, row: usize) -> Option<State> {
        let of = |column: &Option<Vec<f64>>| finite(column, row);
        let (utc, since_boot_s) = self.moment(began, row)?;
        let clock_sigma_s = of(&self.clock_sigma_s);
        let utc_synchronised = began.utc_synchronised || clock_sigma_s.is_some();
        let stamp = Stamp { utc, utc_synchronised, since_boot_s, boot_id: began.boot_id.clone() };
        let exposure = Exposure {
            exposure_time: utc,
            exposure_since_boot_s: since_boot_s,
            exposure_sigma_s: of(&self.exposure_sigma_s).unwrap_or(0.0),
            exposure_source: ExposureSource::AskedAndDelivered,
            exposure_delay_s: None,
            clock_sigma_s,
            clock: ClockQuality::default(),
            camera_clock_offset_s: None,
        };
        Some(track.at(&stamp, Some(&exposure)))
    }
}

/// A key for each row that no start of the recorder gives again, as `series/shot` is of a frame: of the boot its first eight
/// digits, and the microseconds from there to the exposure.
pub(super) fn result_ids(head: &LiveHead, block: &RowBlock) -> Vec<Option<String>> {
    let column = |name: &str| block.column_values(head.table.find_column(name)?.0);
    let instants = Instants {
        utc: column(names::UTC),
        since_boot_s: column(names::SINCE_BOOT),
        exposure_sigma_s: None,
        clock_sigma_s: None,
    };
    let boot: String = head.began.boot_id.chars().filter(char::is_ascii_alphanumeric).take(8).collect();
    let id = |row: usize| {
        let (_, since_boot_s) = instants.moment(&head.began, row)?;
        Some(format!("{boot}/{:.0}", 1e6 * since_boot_s))
    };
    (0..block.len()).map(id).collect()
}

/// What a row has under the names of frames, in the numbers of the file.
#[derive(Default)]
struct Once {
    rows: usize,
    utc: Option<Vec<f64>>,
    solved: Option<Vec<f64>>,
    passed: Option<Vec<f64>>,
    sigmas_m: [Option<Vec<f64>>; 3],
    method: Option<String>,
    tip: Option<String>,
}

impl Once {
    fn of(head: &LiveHead, block: &RowBlock) -> Self {
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

/// The columns that frames have too, by the same names.
fn as_of_frames(once: &Once) -> Vec<Column> {
    let number = finite;
    let rows = 0..once.rows;
    let words = |name: &str, of: &dyn Fn(usize) -> Option<String>| Column {
        name: name.to_owned(),
        values: Values::Text(rows.clone().map(of).collect()),
    };
    let is = |column, row, yes: &str, no: &str| {
        number(column, row).map(|value| if value == 0.0 { no } else { yes }.to_owned())
    };
    let moments = rows.clone().map(|row| number(&once.utc, row).map(|utc| utc as i64)).collect();
    let mut columns = vec![
        Column { name: "exposure_time".to_owned(), values: Values::Time(moments) },
        words("status", &|row| is(&once.solved, row, "ok", "failed")),
        text("method", once.method.as_deref(), once.rows),
        Column { name: "flight_adjustment".to_owned(), values: Values::Flag(vec![Some(false); once.rows]) },
        words("global_test", &|row| is(&once.passed, row, "passed", "rejected")),
        words("tip_marker", &|row| once.tip.clone().filter(|_| number(&once.solved, row) == Some(1.0))),
    ];
    for (which, sigma) in ["", "_ground", "_root"].into_iter().zip(&once.sigmas_m) {
        let of = rows.clone().map(|row| number(sigma, row)).collect();
        columns.push(Column { name: format!("tip_sigma_deflection{which}_m"), values: Values::Number(of) });
    }
    columns
}

/// Each quantity with its standard deviation.
fn aircraft(states: &[State]) -> Vec<Column> {
    let both = |quantity: Quantity| {
        let of = |value: fn(&crate::aircraft::Joined) -> f64| {
            let one = |state: &State| state.get(&quantity).map(value).filter(|v| v.is_finite());
            Values::Number(states.iter().map(one).collect())
        };
        [
            Column { name: quantity.name().to_owned(), values: of(|joined| joined.value) },
            Column { name: format!("sigma_{}", quantity.name()), values: of(|joined| joined.sigma) },
        ]
    };
    Quantity::ALL.into_iter().flat_map(both).collect()
}

/// What all results of a file follow from.
fn provenance(inputs: &Map<String, Value>, rows: usize) -> Vec<Column> {
    let word = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let of = |name: &str| inputs.get(name).map(word);
    let key = (!inputs.is_empty()).then(|| Inputs::new(inputs.clone()).key(""));
    let columns = [
        ("program", of("program")),
        ("installation_sha256", installations::digest_from_provenance(inputs)),
        ("parameters", of("parameters")),
        ("inputs", key),
    ];
    let columns = columns.into_iter().map(|(name, value)| text(name, value.as_deref(), rows));
    columns.chain([schema_version(rows)]).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_all_rows_follow_from_stands_in_each() {
        let inputs =
            serde_json::json!({"program": "wingd 1", "camera.toml.sha256": "ab", "parameters": {"a": 1}});
        let columns = provenance(inputs.as_object().unwrap(), 2);
        let texts: Vec<String> = columns.iter().map(|column| column.values.text(1)).collect();
        assert_eq!((texts[0].as_str(), texts[2].as_str()), ("wingd 1", "{\"a\":1}"));
        assert_eq!((texts[1].len(), texts[3].len()), (64, 64));
        // The version of the columns stands in every row.
        assert!(provenance(&Map::new(), 1).iter().take(4).all(|column| column.values.text(0).is_empty()));
        assert_eq!(LiveFacts::empty().len(), 9 + 2 * Quantity::ALL.len() + 5);
    }
}
