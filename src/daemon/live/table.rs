//! A live result becomes a row of the store's table (docs/store.md).

use serde_json::{Map, Value, json};

use super::result::LiveResult;
use crate::pipeline::stages::Search;
use crate::record::{CurveRecord, GlobalTest, ImageRecord, MarkerRecord, TorsionRecord};
use crate::store::columns::{Column, Kind, LiveTable, Row, UTC};
use crate::store::live::names;

/// What the rows are of: one result has shown how many markers, stations and pairs there are.
pub(crate) struct Table {
    pub table: LiveTable,
    markers: usize,
    stations: usize,
    pairs: usize,
    terms: usize,
}

type OfMarker = (&'static str, &'static str, fn(&MarkerRecord) -> Option<f64>);
type OfStation = (&'static str, &'static str, fn(&CurveRecord) -> Option<f64>);
type OfPair = (&'static str, &'static str, fn(&TorsionRecord) -> Option<f64>);

const MARKERS: [OfMarker; 12] = [
    ("u", "px", |m| m.u_px),
    ("v", "px", |m| m.v_px),
    ("sigma_u", "px", |m| m.sigma_u_px),
    ("sigma_v", "px", |m| m.sigma_v_px),
    ("residual_u", "px", |m| m.residual_u_px),
    ("residual_v", "px", |m| m.residual_v_px),
    ("lift", "m", |m| m.lift_m),
    ("sigma_lift", "m", |m| m.sigma_lift_m),
    ("lift_ground", "m", |m| m.lift_ground_m),
    ("sigma_lift_ground", "m", |m| m.sigma_lift_ground_m),
    ("lift_root", "m", |m| m.lift_root_m),
    ("sigma_lift_root", "m", |m| m.sigma_lift_root_m),
];
const STATIONS: [OfStation; 5] = [
    ("span", "m", |p| Some(p.span_m)),
    ("lift", "m", |p| Some(p.lift_m)),
    ("sigma_lift", "m", |p| p.sigma_lift_m),
    ("twist", "deg", |p| p.twist_deg),
    ("sigma_twist", "deg", |p| p.sigma_twist_deg),
];
const PAIRS: [OfPair; 4] = [
    ("angle", "deg", |t| t.angle_deg),
    ("sigma_angle", "deg", |t| t.sigma_deg),
    ("twist", "deg", |t| t.twist_deg),
    ("sigma_twist", "deg", |t| t.sigma_twist_deg),
];
/// Name, unit, kind of what a row has once.
const ONCE: [(&str, &str, Kind); 19] = [
    (names::UTC, UTC, Kind::U64),
    (names::SINCE_BOOT, "s", Kind::F64),
    ("exposure_sigma", "s", Kind::F32),
    ("clock_sigma", "s", Kind::F32),
    (names::NUMBER, "", Kind::U64),
    ("skipped", "", Kind::U64),
    ("solved", "", Kind::U8),
    ("whole_search", "", Kind::U8),
    ("mounting", "", Kind::U32),
    ("jolt", "", Kind::U8),
    ("latency", "ms", Kind::F32),
    ("variance_factor", "", Kind::F32),
    ("global_test_passed", "", Kind::U8),
    ("tip_lift", "m", Kind::F32),
    ("sigma_tip_lift", "m", Kind::F32),
    ("tip_lift_ground", "m", Kind::F32),
    ("sigma_tip_lift_ground", "m", Kind::F32),
    ("tip_lift_root", "m", Kind::F32),
    ("sigma_tip_lift_root", "m", Kind::F32),
];

impl Table {
    /// From a result with numbers; `source` says what all of them come from.
    pub fn of(result: &LiveResult, source: &Map<String, Value>) -> Self {
        let record = &result.record;
        let (markers, stations, pairs) = (record.markers.len(), record.curve.len(), record.torsion.len());
        let terms = result.curvature.as_ref().map_or(0, |c| c.per_m.len());
        let once = ONCE.map(|(name, unit, kind)| column(name.to_owned(), unit, kind, 1));
        let list = |list: &str, (name, unit): (&str, &str), width| {
            column(format!("{list}.{name}"), unit, Kind::F32, width)
        };
        let columns = once
            .into_iter()
            .chain(std::iter::once(column("markers.used".to_owned(), "", Kind::U8, markers)))
            .chain(MARKERS.map(|(name, unit, _)| list("markers", (name, unit), markers)))
            .chain(STATIONS.map(|(name, unit, _)| list("stations", (name, unit), stations)))
            .chain(PAIRS.map(|(name, unit, _)| list("torsion", (name, unit), pairs)))
            .chain([
                column(names::CURVATURE.to_owned(), "1/m", Kind::F64, terms),
                column(names::CURVATURE_COVARIANCE.to_owned(), "1/m2", Kind::F64, terms * (terms + 1) / 2),
            ])
            .filter(|column| column.width > 0)
            .collect();
        let table = LiveTable { source: described(record, source), columns };
        Self { table, markers, stations, pairs, terms }
    }

    /// A result's values.
    pub fn row(&self, result: &LiveResult) -> Row {
        let record = &result.record;
        let mut row = once(result);
        let none = f64::NAN;
        let used = |i: usize| record.markers.get(i).map_or(none, |m| f64::from(u8::from(m.used)));
        row.extend((0..self.markers).map(used));
        for (_, _, value) in MARKERS {
            row.extend((0..self.markers).map(|i| record.markers.get(i).and_then(value).unwrap_or(none)));
        }
        for (_, _, value) in STATIONS {
            row.extend((0..self.stations).map(|i| record.curve.get(i).and_then(value).unwrap_or(none)));
        }
        for (_, _, value) in PAIRS {
            row.extend((0..self.pairs).map(|i| record.torsion.get(i).and_then(value).unwrap_or(none)));
        }
        match result.curvature.as_ref().filter(|c| c.per_m.len() == self.terms) {
            Some(known) => row.extend(known.per_m.iter().chain(&known.covariance)),
            None => row.resize(row.len() + self.terms + self.terms * (self.terms + 1) / 2, none),
        }
        row
    }
}

fn column(name: String, unit: &str, kind: Kind, width: usize) -> Column {
    Column { name, unit: unit.to_owned(), kind, width }
}

/// In the order of [`ONCE`].
fn once(result: &LiveResult) -> Row {
    let (record, exposure) = (&result.record, &result.exposure);
    let flag = |yes: bool| f64::from(u8::from(yes));
    let or_none = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let tip = record.tip.as_ref().filter(|_| result.solved());
    vec![
        exposure.exposure_time.as_microsecond().max(0) as f64,
        exposure.exposure_since_boot_s,
        exposure.exposure_sigma_s,
        or_none(exposure.clock_sigma_s),
        result.number as f64,
        result.skipped as f64,
        flag(result.solved()),
        flag(result.search == Search::Whole),
        result.mounting as f64,
        flag(result.jolt),
        result.latency_ms,
        or_none(record.variance_factor),
        or_none(record.global_test.map(|test| flag(test == GlobalTest::Passed))),
        or_none(tip.map(|tip| tip.lift_m)),
        or_none(tip.and_then(|tip| tip.sigma_lift_m)),
        or_none(tip.and_then(|tip| tip.lift_ground_m)),
        or_none(tip.and_then(|tip| tip.sigma_lift_ground_m)),
        or_none(tip.and_then(|tip| tip.lift_root_m)),
        or_none(tip.and_then(|tip| tip.sigma_lift_root_m)),
    ]
}

/// What the lists of the columns are of.
fn described(record: &ImageRecord, source: &Map<String, Value>) -> Value {
    let ids: Vec<&str> = record.markers.iter().map(|m| m.id.as_str()).collect();
    let arcs: Vec<f64> = record.curve.iter().map(|p| p.arc_length_m).collect();
    let pairs: Vec<&str> = record.torsion.iter().map(|t| t.name.as_str()).collect();
    json!({
        names::PROVENANCE: source,
        "method": "live",
        "markers": ids,
        "stations": arcs,
        "torsion": pairs,
        "tip": record.tip.as_ref().map(|tip| &tip.marker),
    })
}
