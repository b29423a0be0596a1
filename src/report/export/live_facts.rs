//! Beside a live result stands what the aircraft's data say at its instant, and what it follows from: the same columns as of
//! frames.

use serde_json::{Map, Value};

use super::columns::{Column, Values};
use crate::aircraft::{Quantity, State, Track};
use crate::clock::Stamp;
use crate::clock::exposure::{Exposure, Source};
use crate::clock::quality::Quality;
use crate::store::columns::{Block, Head};
use crate::store::live::names;
use crate::store::{Inputs, installations};

/// Standard deviations of a result's instant, s, where a table has them.
const EXPOSURE_SIGMA: &str = "exposure_sigma";
const CLOCK_SIGMA: &str = "clock_sigma";

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
        let mut columns = aircraft(&[]);
        columns.extend(provenance(&Map::new(), 0));
        columns
    }

    /// A block's rows.
    pub fn rows(&self, head: &Head, block: &Block) -> Vec<Column> {
        let column = |name: &str| block.column(head.table.find(name)?.0);
        let instants = Instants {
            utc: column(names::UTC),
            since_boot_s: column(names::SINCE_BOOT),
            exposure_sigma_s: column(EXPOSURE_SIGMA),
            clock_sigma_s: column(CLOCK_SIGMA),
        };
        let state = |row: usize| match self.track.is_empty() {
            true => State::new(),
            false => instants.state(&self.track, &head.began, row).unwrap_or_default(),
        };
        let mut columns = aircraft(&(0..block.len()).map(state).collect::<Vec<_>>());
        let inputs = head.table.source.get(names::PROVENANCE).and_then(Value::as_object);
        columns.extend(provenance(&inputs.cloned().unwrap_or_default(), block.len()));
        columns
    }
}

impl Instants {
    /// What the aircraft's data say of a row; `None` where its instant is not known.
    fn state(&self, track: &Track, began: &Stamp, row: usize) -> Option<State> {
        let of = |column: &Option<Vec<f64>>| {
            column.as_ref()?.get(row).copied().filter(|value: &f64| value.is_finite())
        };
        let utc = jiff::Timestamp::from_microsecond(of(&self.utc)? as i64).ok()?;
        let by_utc_s = began.since_boot_s + utc.duration_since(began.utc).as_secs_f64();
        let since_boot_s = of(&self.since_boot_s).unwrap_or(by_utc_s);
        let clock_sigma_s = of(&self.clock_sigma_s);
        let utc_synchronised = began.utc_synchronised || clock_sigma_s.is_some();
        let stamp = Stamp { utc, utc_synchronised, since_boot_s, boot_id: began.boot_id.clone() };
        let exposure = Exposure {
            exposure_time: utc,
            exposure_since_boot_s: since_boot_s,
            exposure_sigma_s: of(&self.exposure_sigma_s).unwrap_or(0.0),
            exposure_source: Source::AskedAndDelivered,
            exposure_delay_s: None,
            clock_sigma_s,
            clock: Quality::default(),
            camera_clock_offset_s: None,
        };
        Some(track.at(&stamp, Some(&exposure)))
    }
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
        ("installation_sha256", installations::named(inputs)),
        ("parameters", of("parameters")),
        ("inputs", key),
    ];
    let column = |(name, value): (&str, Option<String>)| Column {
        name: name.to_owned(),
        values: Values::Text(vec![value; rows]),
    };
    columns.map(column).into()
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
        assert!(provenance(&Map::new(), 1).iter().all(|column| column.values.text(0).is_empty()));
        assert_eq!(LiveFacts::empty().len(), 2 * Quantity::ALL.len() + 4);
    }
}
