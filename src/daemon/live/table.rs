//! Converts live results to rows of the store's table (docs/store.md).

use serde_json::{Map, Value, json};

use super::result::LiveResult;
use crate::clock::exposure::ExposureSource;
use crate::measure::view::SearchMode;
use crate::record::{
    CurveRecord, GlobalTestVerdict, ImageRecord, MarkerRecord, Reference, ReportedSigma, TorsionRecord, variant_name,
};
use crate::store::columns::{LiveColumn, LiveRow, LiveTable, ValueKind};
use crate::store::live::{SCALAR_COLUMNS, names};

/// Layout of the rows: columns and the numbers of markers, stations and pairs, taken from one result.
pub(crate) struct RowLayout {
    pub table: LiveTable,
    markers: usize,
    stations: usize,
    pairs: usize,
    terms: usize,
    words: WordCodes,
}

/// Meaning of the numbers in columns of words.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct WordCodes {
    /// Reasons of frames without numbers, in order of appearance.
    reasons: Vec<String>,
}

/// Maximum number of distinct reasons in a table. Each new one begins a file; apart from the numbers in them there are few.
const MAX_REASONS: usize = 32;
/// Reason that replaces all reasons beyond [`MAX_REASONS`].
const OTHER_REASON: &str = "one of more than 32 reasons; see the recorder's log";
const SOURCES: [ExposureSource; 6] = [
    ExposureSource::StartOfExposure,
    ExposureSource::EndOfFrame,
    ExposureSource::ReleaseEdge,
    ExposureSource::TriggerAndEvent,
    ExposureSource::AskedAndDelivered,
    ExposureSource::CameraClock,
];
const SIGMA_KINDS: [ReportedSigma; 2] = [ReportedSigma::Prior, ReportedSigma::Posterior];

impl WordCodes {
    /// Registers the reason of a result; returns whether it is new.
    pub fn register(&mut self, result: &LiveResult) -> bool {
        let Some(reason) = &result.record.reason else { return false };
        let known = self.reasons.contains(reason) || self.reasons.len() > MAX_REASONS;
        if !known {
            let one = if self.reasons.len() == MAX_REASONS { OTHER_REASON } else { reason.as_str() };
            self.reasons.push(one.to_owned());
        }
        !known
    }

    fn to_json(&self) -> Value {
        json!({
            names::REASON: self.reasons,
            names::EXPOSURE_SOURCE: SOURCES.map(ExposureSource::name),
            names::SIGMA_KIND: SIGMA_KINDS.map(variant_name),
            names::TIP_REFERENCE: Reference::ALL.map(variant_name),
        })
    }

    /// Returns the numbers of the word columns: exposure source, reason, kind of sigma, reference of the deflection.
    fn encode(&self, result: &LiveResult) -> [f64; 4] {
        let record = &result.record;
        let reason = record.reason.as_ref().map(|reason| {
            let known = self.reasons.iter().position(|one| one == reason);
            known.unwrap_or(self.reasons.len().saturating_sub(1))
        });
        let source = SOURCES.iter().position(|source| *source == result.exposure.exposure_source);
        let kind = record.sigma_kind.and_then(|kind| SIGMA_KINDS.iter().position(|one| *one == kind));
        let reference = record.tip.as_ref().and_then(|tip| tip.reference);
        let reference = reference.and_then(|reference| Reference::ALL.iter().position(|one| *one == reference));
        [source, reason, kind, reference].map(|code| code.map_or(f64::NAN, |code| code as f64))
    }
}

type MarkerColumn = (&'static str, &'static str, fn(&MarkerRecord) -> Option<f64>);
type StationColumn = (&'static str, &'static str, fn(&CurveRecord) -> Option<f64>);
type TorsionColumn = (&'static str, &'static str, fn(&TorsionRecord) -> Option<f64>);

const MARKERS: [MarkerColumn; 12] = [
    ("u", "px", |m| m.u_px),
    ("v", "px", |m| m.v_px),
    ("sigma_u", "px", |m| m.sigma_u_px),
    ("sigma_v", "px", |m| m.sigma_v_px),
    ("residual_u", "px", |m| m.residual_u_px),
    ("residual_v", "px", |m| m.residual_v_px),
    ("deflection", "m", |m| m.deflection_m),
    ("sigma_deflection", "m", |m| m.sigma_deflection_m),
    ("deflection_ground", "m", |m| m.deflection_ground_m),
    ("sigma_deflection_ground", "m", |m| m.sigma_deflection_ground_m),
    ("deflection_root", "m", |m| m.deflection_root_m),
    ("sigma_deflection_root", "m", |m| m.sigma_deflection_root_m),
];
const STATIONS: [StationColumn; 5] = [
    ("span", "m", |p| Some(p.span_m)),
    ("deflection", "m", |p| Some(p.deflection_m)),
    ("sigma_deflection", "m", |p| p.sigma_deflection_m),
    ("twist", "deg", |p| p.twist_deg),
    ("sigma_twist", "deg", |p| p.sigma_twist_deg),
];
const PAIRS: [TorsionColumn; 4] = [
    ("angle", "deg", |t| t.angle_deg),
    ("sigma_angle", "deg", |t| t.sigma_deg),
    ("twist", "deg", |t| t.twist_deg),
    ("sigma_twist", "deg", |t| t.sigma_twist_deg),
];
impl RowLayout {
    /// Creates the layout from a result with numbers; `source` is the provenance of all results, `words` the reasons
    /// registered so far.
    pub fn from_result(result: &LiveResult, source: &Map<String, Value>, words: &WordCodes) -> Self {
        let record = &result.record;
        let (markers, stations, pairs) = (record.markers.len(), record.curve.len(), record.torsion.len());
        let terms = result.curvature.as_ref().map_or(0, |c| c.per_m.len());
        let once = SCALAR_COLUMNS.map(|(name, unit, kind)| live_column(name.to_owned(), unit, kind, 1));
        let list = |list: &str, (name, unit): (&str, &str), width| {
            live_column(format!("{list}.{name}"), unit, ValueKind::F32, width)
        };
        let columns = once
            .into_iter()
            .chain(std::iter::once(live_column("markers.used".to_owned(), "", ValueKind::U8, markers)))
            .chain(MARKERS.map(|(name, unit, _)| list("markers", (name, unit), markers)))
            .chain(STATIONS.map(|(name, unit, _)| list("stations", (name, unit), stations)))
            .chain(PAIRS.map(|(name, unit, _)| list("torsion", (name, unit), pairs)))
            .chain([
                live_column(names::CURVATURE.to_owned(), "1/m", ValueKind::F64, terms),
                live_column(names::CURVATURE_COVARIANCE.to_owned(), "1/m2", ValueKind::F64, terms * (terms + 1) / 2),
            ])
            .filter(|column| column.width > 0)
            .collect();
        let words = words.clone();
        let table = LiveTable { source: describe_source(record, source, &words), columns };
        Self { table, markers, stations, pairs, terms, words }
    }

    /// Replaces the words; the table then begins a new file.
    pub fn set_words(&mut self, words: &WordCodes) {
        self.words = words.clone();
        if let Some(source) = self.table.source.as_object_mut() {
            source.insert(names::WORDS.to_owned(), words.to_json());
        }
    }

    /// Returns the values of a result in the order of the columns.
    pub fn row(&self, result: &LiveResult) -> LiveRow {
        let record = &result.record;
        let mut row = scalar_values(result);
        row.extend(self.words.encode(result));
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

fn live_column(name: String, unit: &str, kind: ValueKind, width: usize) -> LiveColumn {
    LiveColumn { name, unit: unit.to_owned(), kind, width }
}

/// Returns the values of [`SCALAR_COLUMNS`] in their order, without the word columns at its end.
fn scalar_values(result: &LiveResult) -> LiveRow {
    let (record, exposure) = (&result.record, &result.exposure);
    let flag = |yes: bool| f64::from(u8::from(yes));
    let or_none = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let tip = record.tip.as_ref().filter(|_| result.is_solved());
    vec![
        exposure.exposure_time.as_microsecond().max(0) as f64,
        exposure.exposure_since_boot_s,
        exposure.exposure_sigma_s,
        or_none(exposure.clock_sigma_s),
        result.number as f64,
        result.skipped as f64,
        flag(result.is_solved()),
        flag(result.search == SearchMode::Full),
        result.mounting as f64,
        flag(result.mount_disturbed),
        result.latency_ms,
        or_none(record.variance_factor),
        or_none(record.global_test.map(|test| flag(test == GlobalTestVerdict::Passed))),
        or_none(tip.map(|tip| tip.deflection_m)),
        or_none(tip.and_then(|tip| tip.sigma_deflection_m)),
        or_none(tip.and_then(|tip| tip.deflection_ground_m)),
        or_none(tip.and_then(|tip| tip.sigma_deflection_ground_m)),
        or_none(tip.and_then(|tip| tip.deflection_root_m)),
        or_none(tip.and_then(|tip| tip.sigma_deflection_root_m)),
        or_none(record.redundancy.map(|redundancy| redundancy as f64)),
        flag(exposure.clock.synchronised),
    ]
}

/// Returns the description of the list columns: ids, stations, pairs and words.
fn describe_source(record: &ImageRecord, source: &Map<String, Value>, words: &WordCodes) -> Value {
    let ids: Vec<&str> = record.markers.iter().map(|m| m.id.as_str()).collect();
    let arcs: Vec<f64> = record.curve.iter().map(|p| p.arc_length_m).collect();
    let pairs: Vec<&str> = record.torsion.iter().map(|t| t.name.as_str()).collect();
    json!({
        names::PROVENANCE: source,
        "method": "live",
        names::WORDS: words.to_json(),
        "markers": ids,
        "stations": arcs,
        "torsion": pairs,
        "tip": record.tip.as_ref().map(|tip| &tip.marker),
    })
}
