//! Aircraft data of a flight, source by source, joined with its shots.

use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::SeriesData;
use crate::aircraft::{AircraftTrack, Layout};
use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;
use wingd_store::aircraft::AircraftLine;
use wingd_store::{Disk, FlightRef, StoreResult, aircraft, catalogue};

/// Source of aircraft data: lines recorded from a feed without interruption, or an imported table. Nothing is deleted: a
/// withdrawn source stays in the flight.
#[derive(Clone, Debug, PartialEq)]
pub struct AircraftSource {
    /// Number of the source, from 1, in order of arrival. If several sources give a quantity at a frame, the latest counts.
    pub number: usize,
    /// Origin and layout of the lines, from the first line of the source's files.
    pub head: Value,
    pub lines: Vec<AircraftLine>,
    /// Time of withdrawal; `None` for a source in use.
    pub withdrawn: Option<jiff::Timestamp>,
}

/// First line of a file that withdraws a source.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Withdrawal {
    /// Number of the withdrawn source.
    pub withdraws: usize,
    /// Time of the withdrawal.
    pub at: jiff::Timestamp,
}

impl AircraftSource {
    /// Returns the layout of the lines; `None` if it is unknown.
    pub fn layout(&self) -> Option<Layout> {
        self.head
            .get("layout")
            .cloned()
            .and_then(|layout| serde_json::from_value(layout).ok())
    }

    /// Returns the table's name or the feed's address.
    pub fn name(&self) -> String {
        let origin = ["table", "udp", "tcp"]
            .iter()
            .find_map(|key| self.head.get(*key)?.as_str());
        origin.unwrap_or("a feed").to_owned()
    }
}

/// Reads the sources of a flight, and notes on unreadable lines. Consecutive files with the same head are one source.
pub fn read_sources(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> StoreResult<(Vec<AircraftSource>, Vec<String>)> {
    let (all, mut notes) = aircraft::read_aircraft(disk, root, flight)?;
    let mut found: Vec<AircraftSource> = vec![];
    let mut is_continued = false;
    for (head, lines) in all {
        if let Ok(Withdrawal { withdraws, at }) = serde_json::from_value(head.source.clone()) {
            match found.iter_mut().find(|source| source.number == withdraws) {
                Some(source) => source.withdrawn = source.withdrawn.or(Some(at)),
                None => notes.push(format!(
                    "{}: a withdrawal names source {withdraws}, which does not exist",
                    flight.id
                )),
            }
            is_continued = false;
            continue;
        }
        match found
            .last_mut()
            .filter(|last| is_continued && last.head == head.source)
        {
            Some(source) => source.lines.extend(lines),
            None => {
                let number = found.len() + 1;
                found.push(AircraftSource {
                    number,
                    head: head.source,
                    lines,
                    withdrawn: None,
                });
            }
        }
        is_continued = true;
    }
    Ok((found, notes))
}

/// Reads the samples of all sources in use of a flight, and notes on unreadable lines.
pub fn read_track(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> StoreResult<(AircraftTrack, Vec<String>)> {
    let (all, mut notes) = read_sources(disk, root, flight)?;
    let mut track = AircraftTrack::default();
    for source in all.iter().filter(|source| source.withdrawn.is_none()) {
        match source.layout() {
            Some(layout) => {
                track.begin_source(source.number);
                track.add_lines(&layout, &source.lines);
            }
            None => notes.push(format!(
                "{}: source {} of aircraft data ({}) has a layout that this version does not read; convert its table with \
                 `wingd-table` and import it again",
                flight.id,
                source.number,
                source.name()
            )),
        }
    }
    Ok((track, notes))
}

/// Sets the aircraft state of each shot of a series.
pub fn join_aircraft_data(track: &AircraftTrack, series: &mut SeriesData) {
    if track.is_empty() {
        return;
    }
    for shot in &mut series.shots {
        shot.aircraft = shot
            .stamp
            .as_ref()
            .map(|stamp| track.state_at(stamp, shot.exposure.as_ref()))
            .unwrap_or_default();
    }
}

/// Reads the time of each frame of a flight. Unreadable series are skipped; `wingd verify` lists them.
pub fn read_frame_times(
    disk: &dyn Disk,
    flight: &FlightRef,
) -> StoreResult<Vec<(Stamp, Option<Exposure>)>> {
    let series = catalogue::list_series(disk, flight)?;
    let manifests = series
        .iter()
        .filter_map(|series| catalogue::read_series_manifest(disk, series).ok());
    let shots = manifests
        .flat_map(|manifest| manifest.shots)
        .filter(|shot| shot.frame.is_some());
    Ok(shots.map(|shot| (shot.stamp, shot.exposure)).collect())
}
