//! Comparison of two sets of results of the same frames, frame by frame.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::Value;

use wingd_evaluation::record::{
    ImageRecord, MarkerRecord, Provenance, Quality, RecordStatus, json_text, variant_name,
};
use wingd_store::result_sets;
use wingd_store::result_sets::ResultSet;
use wingd_store::{Disk, FlightRef, SeriesRef, StoreResult, catalogue};

/// Change of one frame's result between two result sets.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameChange {
    pub series: String,
    pub frame: String,
    /// Status before and after; `None` if there is no result.
    pub status: (Option<RecordStatus>, Option<RecordStatus>),
    /// Deflection of the outermost marker before and after, m.
    pub tip_deflection_m: (Option<f64>, Option<f64>),
    /// Deflection after minus before, m; `None` if the outermost marker differs.
    pub change_m: Option<f64>,
    /// Standard deviation of the new deflection, m. Both results use the same image, so this is a scale for the change, not
    /// its standard deviation.
    pub sigma_m: Option<f64>,
    /// Change divided by `sigma_m`.
    pub change_sigmas: Option<f64>,
    /// Marker with the largest change of deflection, and the change, m.
    pub marker: Option<(String, f64)>,
    /// Twist of the first torsion pair after minus before, degrees.
    pub twist_change_deg: Option<f64>,
}

impl FrameChange {
    /// Describes the status, or its change, in one or two words.
    pub fn status_text(&self) -> String {
        let text =
            |status: Option<RecordStatus>| status.map_or("no result".to_owned(), variant_name);
        let (old, new) = (text(self.status.0), text(self.status.1));
        if old == new {
            new
        } else {
            format!("{old} -> {new}")
        }
    }
}

/// Compares two result sets of a flight frame by frame; sorted by series and frame.
pub fn compare_frames(
    disk: &dyn Disk,
    flight: &FlightRef,
    old: &ResultSet,
    new: &ResultSet,
) -> StoreResult<Vec<FrameChange>> {
    let mut all = Vec::new();
    for series in catalogue::list_series(disk, flight)? {
        let before = read_records(disk, &series, old)?;
        let after = read_records(disk, &series, new)?;
        let frames: BTreeSet<&String> = before.keys().chain(after.keys()).collect();
        all.extend(frames.into_iter().map(|frame| {
            let name = (series.id.clone(), frame.clone());
            compare_frame_records(name, before.get(frame), after.get(frame))
        }));
    }
    Ok(all)
}

/// Reads the records that a set of results has of a series, by frame.
fn read_records(
    disk: &dyn Disk,
    series: &SeriesRef,
    set: &ResultSet,
) -> StoreResult<BTreeMap<String, ImageRecord>> {
    let record = |value| serde_json::from_value::<ImageRecord>(value).ok();
    let lean = |r: ImageRecord| ImageRecord {
        quality: Quality::default(),
        curve: Vec::new(),
        provenance: Provenance::default(),
        ..r
    };
    let one =
        |line: wingd_store::manifest::ResultLine| Some((line.frame, lean(record(line.record)?)));
    let records = result_sets::results_in_set(disk, series, Some(set), one)?;
    Ok(records.into_iter().collect())
}

fn compare_frame_records(
    (series, frame): (String, String),
    old: Option<&ImageRecord>,
    new: Option<&ImageRecord>,
) -> FrameChange {
    let tip = |record: Option<&ImageRecord>| record.and_then(|r| r.tip.clone());
    let (was, is) = (tip(old), tip(new));
    let same = was
        .as_ref()
        .zip(is.as_ref())
        .filter(|(a, b)| a.marker == b.marker);
    let change_m = same.map(|(a, b)| b.deflection_m - a.deflection_m);
    let sigma_m = is.as_ref().and_then(|tip| tip.sigma_deflection_m);
    let twist = |record: Option<&ImageRecord>| record?.torsion.first()?.twist_deg;
    FrameChange {
        series,
        frame,
        status: (old.map(|r| r.status), new.map(|r| r.status)),
        tip_deflection_m: (was.map(|t| t.deflection_m), is.map(|t| t.deflection_m)),
        change_m,
        sigma_m,
        change_sigmas: change_m
            .zip(sigma_m)
            .filter(|(_, s)| *s > 0.0)
            .map(|(c, s)| c / s),
        marker: old
            .zip(new)
            .and_then(|(a, b)| largest_marker_change(&a.markers, &b.markers)),
        twist_change_deg: twist(old).zip(twist(new)).map(|(a, b)| b - a),
    }
}

fn largest_marker_change(old: &[MarkerRecord], new: &[MarkerRecord]) -> Option<(String, f64)> {
    let change = |m: &MarkerRecord| {
        let was = old.iter().find(|o| o.id == m.id)?.deflection_m?;
        Some((m.id.clone(), m.deflection_m? - was))
    };
    new.iter()
        .filter_map(change)
        .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
}

/// Returns the inputs that differ between two result sets: name, before, after.
pub fn differing_inputs(old: &ResultSet, new: &ResultSet) -> Vec<(String, String, String)> {
    let text = |value: Option<&Value>| value.map_or("none".to_owned(), json_text);
    let mut names: Vec<&String> = old.provenance.keys().chain(new.provenance.keys()).collect();
    names.sort();
    names.dedup();
    let pair = |name: &String| {
        (
            text(old.provenance.get(name)),
            text(new.provenance.get(name)),
        )
    };
    let differing = |name: &String| Some((name.clone(), pair(name))).filter(|(_, (a, b))| a != b);
    names
        .into_iter()
        .filter_map(|name| differing(name).map(|(n, (a, b))| (n, a, b)))
        .collect()
}

/// Summary of the changes of all frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ChangeSummary {
    /// Number of frames whose tip deflections can be compared.
    pub both: usize,
    /// Change with the largest magnitude, m, signed.
    pub largest_m: Option<f64>,
    /// Largest change in units of its sigma, signed.
    pub largest_sigmas: Option<f64>,
    pub root_mean_square_m: Option<f64>,
    /// Number of frames solved only after.
    pub gained: usize,
    /// Number of frames solved only before.
    pub lost: usize,
    /// Number of frames with a result on one side only.
    pub one_side: usize,
}

impl ChangeSummary {
    /// Summarises the changes of a flight.
    pub fn from_changes(changes: &[FrameChange]) -> Self {
        let metres: Vec<f64> = changes.iter().filter_map(|c| c.change_m).collect();
        let extreme = |values: &mut dyn Iterator<Item = f64>| {
            values.max_by(|a, b| a.abs().total_cmp(&b.abs()))
        };
        let squares = metres.iter().map(|m| m * m).sum::<f64>();
        let ok = Some(RecordStatus::Ok);
        let count = |f: &dyn Fn(&FrameChange) -> bool| changes.iter().filter(|c| f(c)).count();
        Self {
            both: metres.len(),
            largest_m: extreme(&mut metres.iter().copied()),
            largest_sigmas: extreme(&mut changes.iter().filter_map(|c| c.change_sigmas)),
            root_mean_square_m: (!metres.is_empty())
                .then(|| (squares / metres.len() as f64).sqrt()),
            gained: count(&|c| c.status.1 == ok && c.status.0 != ok),
            lost: count(&|c| c.status.0 == ok && c.status.1 != ok),
            one_side: count(&|c| c.status.0.is_none() || c.status.1.is_none()),
        }
    }
}
