//! Two sets of results of the same frames are compared here, frame by frame.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;

use super::number::words;
use crate::record::{ImageRecord, MarkerRecord, Provenance, Quality, Status, word};
use crate::store::result_sets::{self, ResultSet};
use crate::store::{Disk, FlightRef, SeriesRef, StoreError, catalogue};

/// One frame, on both sides.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Change {
    /// Its series.
    pub series: String,
    /// Its file.
    pub frame: String,
    /// Solved before and now; `None` where there is no result.
    pub status: (Option<Status>, Option<Status>),
    /// Of the outermost marker, before and now, m.
    pub tip_deflection_m: (Option<f64>, Option<f64>),
    /// Now less before, m; of the same marker only.
    pub change_m: Option<f64>,
    /// Now, m. The two come from one picture: this is a scale to judge by, not the change's own.
    pub sigma_m: Option<f64>,
    /// The change over that.
    pub change_sigmas: Option<f64>,
    /// The marker whose deflection changed most, and by how much, m.
    pub marker: Option<(String, f64)>,
    /// Of the first torsion pair's twist, now less before, degrees.
    pub twist_change_deg: Option<f64>,
}

impl Change {
    /// In a word or two.
    pub fn status_text(&self) -> String {
        let said = |status: Option<Status>| status.map_or("no result".to_owned(), word);
        let (old, new) = (said(self.status.0), said(self.status.1));
        if old == new { new } else { format!("{old} -> {new}") }
    }
}

/// A flight with the results of it that are meant.
#[derive(Clone, Debug)]
pub struct Side {
    /// The flight.
    pub flight: FlightRef,
    /// Its results.
    pub set: ResultSet,
}

/// All frames of two flights that are the same pictures (by SHA-256), in order.
pub fn changes(disk: &dyn Disk, old: &Side, new: &Side) -> Result<Vec<Change>, StoreError> {
    let mut before = BTreeMap::new();
    for series in catalogue::list_series(disk, &old.flight)? {
        before
            .extend(records(disk, &series, &old.set)?.into_iter().map(|(key, r)| (key.2.clone(), (key, r))));
    }
    let mut all = Vec::new();
    for series in catalogue::list_series(disk, &new.flight)? {
        for (key, record) in records(disk, &series, &new.set)? {
            let old = before.remove(&key.2).map(|(_, record)| record);
            all.push(change(key, old.as_ref(), Some(&record)));
        }
    }
    all.extend(before.into_values().map(|(key, record)| change(key, Some(&record), None)));
    all.sort_by(|a, b| (&a.series, &a.frame).cmp(&(&b.series, &b.frame)));
    Ok(all)
}

/// Series, frame, SHA-256.
type Key = (String, String, String);

fn records(
    disk: &dyn Disk,
    series: &SeriesRef,
    set: &ResultSet,
) -> Result<Vec<(Key, ImageRecord)>, StoreError> {
    let lines = result_sets::results_in_set(disk, series, Some(set))?.into_iter();
    let record = |value| serde_json::from_value::<ImageRecord>(value).ok();
    let lean = |r: ImageRecord| ImageRecord {
        quality: Quality::default(),
        curve: Vec::new(),
        provenance: Provenance::default(),
        ..r
    };
    let one = |line: crate::store::manifest::ResultLine| {
        Some(((series.id.clone(), line.frame, line.frame_sha256), lean(record(line.record)?)))
    };
    Ok(lines.filter_map(one).collect())
}

fn change(key: Key, old: Option<&ImageRecord>, new: Option<&ImageRecord>) -> Change {
    let tip = |record: Option<&ImageRecord>| record.and_then(|r| r.tip.clone());
    let (was, is) = (tip(old), tip(new));
    let same = was.as_ref().zip(is.as_ref()).filter(|(a, b)| a.marker == b.marker);
    let change_m = same.map(|(a, b)| b.deflection_m - a.deflection_m);
    let sigma_m = is.as_ref().and_then(|tip| tip.sigma_deflection_m);
    let twist = |record: Option<&ImageRecord>| record?.torsion.first()?.twist_deg;
    Change {
        series: key.0,
        frame: key.1,
        status: (old.map(|r| r.status), new.map(|r| r.status)),
        tip_deflection_m: (was.map(|t| t.deflection_m), is.map(|t| t.deflection_m)),
        change_m,
        sigma_m,
        change_sigmas: change_m.zip(sigma_m).filter(|(_, s)| *s > 0.0).map(|(c, s)| c / s),
        marker: old.zip(new).and_then(|(a, b)| largest(&a.markers, &b.markers)),
        twist_change_deg: twist(old).zip(twist(new)).map(|(a, b)| b - a),
    }
}

fn largest(old: &[MarkerRecord], new: &[MarkerRecord]) -> Option<(String, f64)> {
    let change = |m: &MarkerRecord| {
        let was = old.iter().find(|o| o.id == m.id)?.deflection_m?;
        Some((m.id.clone(), m.deflection_m? - was))
    };
    new.iter().filter_map(change).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
}

/// Inputs that differ: name, before, now.
pub fn inputs(old: &ResultSet, new: &ResultSet) -> Vec<(String, String, String)> {
    let text = |value: Option<&Value>| value.map_or("none".to_owned(), words);
    let mut names: Vec<&String> = old.provenance.keys().chain(new.provenance.keys()).collect();
    names.sort();
    names.dedup();
    let pair = |name: &String| (text(old.provenance.get(name)), text(new.provenance.get(name)));
    let differing = |name: &String| Some((name.clone(), pair(name))).filter(|(_, (a, b))| a != b);
    names.into_iter().filter_map(|name| differing(name).map(|(n, (a, b))| (n, a, b))).collect()
}

/// Over all frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Frames whose tip deflection can be compared.
    pub both: usize,
    /// m, with its sign.
    pub largest_m: Option<f64>,
    /// Largest change over its sigma, with its sign.
    pub largest_sigmas: Option<f64>,
    /// m.
    pub root_mean_square_m: Option<f64>,
    /// Solved now and not before.
    pub gained: usize,
    /// Solved before and not now.
    pub lost: usize,
    /// Without a result on one side.
    pub one_side: usize,
}

impl Summary {
    /// Of a flight's changes.
    pub fn of(changes: &[Change]) -> Self {
        let metres: Vec<f64> = changes.iter().filter_map(|c| c.change_m).collect();
        let extreme =
            |values: &mut dyn Iterator<Item = f64>| values.max_by(|a, b| a.abs().total_cmp(&b.abs()));
        let squares = metres.iter().map(|m| m * m).sum::<f64>();
        let ok = Some(Status::Ok);
        let count = |f: &dyn Fn(&Change) -> bool| changes.iter().filter(|c| f(c)).count();
        Self {
            both: metres.len(),
            largest_m: extreme(&mut metres.iter().copied()),
            largest_sigmas: extreme(&mut changes.iter().filter_map(|c| c.change_sigmas)),
            root_mean_square_m: (!metres.is_empty()).then(|| (squares / metres.len() as f64).sqrt()),
            gained: count(&|c| c.status.1 == ok && c.status.0 != ok),
            lost: count(&|c| c.status.0 == ok && c.status.1 != ok),
            one_side: count(&|c| c.status.0.is_none() || c.status.1.is_none()),
        }
    }
}
