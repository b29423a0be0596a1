//! The frames of a store's flight on their way to an adjustment: what they show, their mountings, their air.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Failure, stores};
use crate::aircraft::Track;
use crate::camera::Format;
use crate::installation::Installation;
use crate::measure::adjust::Mounting;
use crate::measure::setup::Orientation;
use crate::pipeline::{ProcessedFrame, stages};
use crate::record::Reason;
use crate::report::aircraft;
use crate::store::manifest::Cause;
use crate::store::{self, Disk, FlightRef, FrameRef, StoreError, catalogue};

/// Kind of a shot's failure where the camera was unplugged or its power cut.
const GONE: &str = "gone";

/// What is seen in a frame, with its own air.
pub(super) fn sight(
    frame: &FrameRef,
    bytes: Result<&[u8], Reason>,
    installation: &Installation,
    orientation: &Orientation,
    track: &Track,
) -> ProcessedFrame {
    let name = stores::name_of(frame);
    let sighting = match (bytes, Format::of_manifest(&frame.entry.format)) {
        (Ok(bytes), Ok(format)) => {
            stages::process_frame(&name, bytes, Some(&format), installation, Some(orientation))
        }
        (Err(reason), _) => ProcessedFrame::failed(name, reason),
        (_, Err(unknown)) => ProcessedFrame::failed(name, Reason::of(unknown)),
    };
    let aircraft = track.at(&frame.stamp, frame.exposure.as_ref());
    ProcessedFrame { aircraft, ..sighting }
}

/// The aircraft's data of a flight, and their digest where there are any.
pub(super) fn aircraft_data(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> Result<(Track, Option<String>), Failure> {
    let (track, notes) = aircraft::track(disk, root, flight)?;
    for note in notes {
        eprintln!("wingd: {note}");
    }
    if track.is_empty() {
        return Ok((track, None));
    }
    let digest = store::aircraft::digest(disk, root, flight)?;
    eprintln!("wingd: {}: air and wing's temperature from {} aircraft samples", flight.id, track.len());
    Ok((track, digest))
}

/// Mounting of each frame by its digest: another one after a boot and from where the camera was gone, for nothing tells
/// that it was not taken down then. The recorder opens it anew before each series by itself, which says nothing. Of
/// imported pictures nothing is known: none of them stands here.
pub(super) fn mountings(
    disk: &dyn Disk,
    flight: &FlightRef,
) -> Result<BTreeMap<String, Mounting>, StoreError> {
    let mut all = BTreeMap::new();
    let (mut number, mut boot): (usize, Option<String>) = (0, None);
    for series in catalogue::series(disk, flight)? {
        let manifest = catalogue::manifest(disk, &series)?;
        let shots = manifest.shots.into_iter().filter(|_| manifest.cause != Cause::Imported);
        for shot in shots {
            let gone = shot.failures.iter().any(|failure| failure.kind == GONE);
            let booted = boot.replace(shot.stamp.boot_id.clone()).is_some_and(|b| b != shot.stamp.boot_id);
            number += usize::from(gone || booted);
            all.extend(shot.frame.map(|frame| (frame.sha256, Mounting::Numbered(number))));
        }
    }
    Ok(all)
}
