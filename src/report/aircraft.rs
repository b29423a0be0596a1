//! The aircraft's data of a flight are joined with its shots here.

use std::path::Path;

use super::SeriesData;
use crate::aircraft::{Layout, Received, Track};
use crate::store::aircraft::AircraftLine;
use crate::store::{Disk, FlightRef, StoreError, aircraft};

/// The samples of a flight, and what could not be read.
pub fn track(disk: &dyn Disk, root: &Path, flight: &FlightRef) -> Result<(Track, Vec<String>), StoreError> {
    let (all, mut notes) = aircraft::read(disk, root, flight)?;
    let mut track = Track::default();
    for (head, lines) in all {
        let layout = head.source.get("layout").cloned().map(serde_json::from_value::<Layout>);
        match layout {
            Some(Ok(layout)) => {
                let received = |line: AircraftLine| Received { at: line.at, line: line.line };
                track.add(&layout, &lines.into_iter().map(received).collect::<Vec<_>>());
            }
            _ => notes.push(format!("{}: aircraft data of an unknown layout are not shown", flight.id)),
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
