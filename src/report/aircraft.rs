//! The aircraft's data of a flight, source by source, joined with its shots.

use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::SeriesData;
use crate::aircraft::{Layout, Received, Track};
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;
use crate::store::aircraft::AircraftLine;
use crate::store::{Disk, FlightRef, StoreError, aircraft, catalogue};

/// A feed as long as nothing came between its lines, or a table that was taken in. Nothing is deleted: a source that was
/// withdrawn stays in the flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// From 1, in the order in which they came: the latest of those that tell a quantity at a frame counts.
    pub number: usize,
    /// Where it comes from and how it is read, as the first line of its files says.
    pub head: Value,
    /// Its lines.
    pub lines: Vec<Received>,
    /// When it was withdrawn.
    pub withdrawn: Option<jiff::Timestamp>,
}

/// Head of a file that says that a source does not count.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Withdrawal {
    /// The source's number.
    pub withdraws: usize,
    /// When that was said.
    pub at: jiff::Timestamp,
}

impl Source {
    /// How its lines are read; `None` where that is not known.
    pub fn layout(&self) -> Option<Layout> {
        self.head.get("layout").cloned().and_then(|layout| serde_json::from_value(layout).ok())
    }

    /// A table's name, or a feed's address.
    pub fn name(&self) -> String {
        let told = ["table", "udp", "tcp"].iter().find_map(|key| self.head.get(*key)?.as_str());
        told.unwrap_or("a feed").to_owned()
    }
}

/// The sources of a flight, and what could not be read. Files with one head that follow on each other are one source.
pub fn sources(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> Result<(Vec<Source>, Vec<String>), StoreError> {
    let (all, mut notes) = aircraft::read_aircraft(disk, root, flight)?;
    let mut found: Vec<Source> = vec![];
    let mut goes_on = false;
    for (head, lines) in all {
        if let Ok(Withdrawal { withdraws, at }) = serde_json::from_value(head.source.clone()) {
            match found.iter_mut().find(|source| source.number == withdraws) {
                Some(source) => source.withdrawn = source.withdrawn.or(Some(at)),
                None => {
                    notes.push(format!("{}: source {withdraws}, which was withdrawn, is not here", flight.id))
                }
            }
            goes_on = false;
            continue;
        }
        let lines = lines.into_iter().map(|AircraftLine { at, line }| Received { at, line });
        match found.last_mut().filter(|last| goes_on && last.head == head.source) {
            Some(source) => source.lines.extend(lines),
            None => {
                let number = found.len() + 1;
                found.push(Source { number, head: head.source, lines: lines.collect(), withdrawn: None });
            }
        }
        goes_on = true;
    }
    Ok((found, notes))
}

/// The samples of a flight's sources that count, and what could not be read.
pub fn track(disk: &dyn Disk, root: &Path, flight: &FlightRef) -> Result<(Track, Vec<String>), StoreError> {
    let (all, mut notes) = sources(disk, root, flight)?;
    let mut track = Track::default();
    for source in all.iter().filter(|source| source.withdrawn.is_none()) {
        match source.layout() {
            Some(layout) => {
                track.begin_source(source.number);
                track.add(&layout, &source.lines);
            }
            None => notes.push(format!("{}: aircraft data of an unknown layout are not shown", flight.id)),
        }
    }
    Ok((track, notes))
}

/// Gives each shot its state.
pub fn join(track: &Track, series: &mut SeriesData) {
    if track.is_empty() {
        return;
    }
    for shot in &mut series.shots {
        shot.aircraft =
            shot.stamp.as_ref().map(|stamp| track.at(stamp, shot.exposure.as_ref())).unwrap_or_default();
    }
}

/// When each frame of a flight was taken. Series that cannot be read are passed over: `wingd verify` names them.
pub fn frames(disk: &dyn Disk, flight: &FlightRef) -> Result<Vec<(Stamp, Option<Exposure>)>, StoreError> {
    let series = catalogue::list_series(disk, flight)?;
    let manifests = series.iter().filter_map(|series| catalogue::read_series_manifest(disk, series).ok());
    let shots = manifests.flat_map(|manifest| manifest.shots).filter(|shot| shot.frame.is_some());
    Ok(shots.map(|shot| (shot.stamp, shot.exposure)).collect())
}
