//! Frames of a store's flight prepared for adjustment: detections, mountings, aircraft data.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Failure, store_access};
use crate::aircraft::AircraftTrack;
use crate::camera::Format;
use crate::installation::Installation;
use crate::measure::adjust::Mounting;
use crate::measure::setup::Orientation;
use crate::pipeline::{ProcessedFrame, stages};
use crate::record::Reason;
use crate::report::aircraft;
use crate::store::manifest::SeriesCause;
use crate::store::{self, Disk, FlightRef, FrameRef, StoreError, catalogue};

/// Kind of a shot's failure if the camera was unplugged or lost power.
const CAMERA_GONE: &str = "gone";

/// Detects and identifies the markers of a frame and adds its aircraft data.
pub(super) fn process_stored_frame(
    frame: &FrameRef,
    bytes: Result<&[u8], Reason>,
    installation: &Installation,
    orientation: &Orientation,
    track: &AircraftTrack,
) -> ProcessedFrame {
    let name = store_access::frame_name(frame);
    let processed = match (bytes, Format::from_manifest(&frame.entry.format)) {
        (Ok(bytes), Ok(format)) => {
            stages::process_frame(&name, bytes, Some(&format), &installation.setup, Some(orientation))
        }
        (Err(reason), _) => ProcessedFrame::failed(name, reason),
        (_, Err(unknown)) => ProcessedFrame::failed(name, Reason::from_error(unknown)),
    };
    let aircraft = track.state_at(&frame.stamp, frame.exposure.as_ref());
    ProcessedFrame { aircraft, ..processed }
}

/// Reads the aircraft data of a flight; also returns their digest if there are any.
pub(super) fn read_aircraft_data(
    disk: &dyn Disk,
    root: &Path,
    flight: &FlightRef,
) -> Result<(AircraftTrack, Option<String>), Failure> {
    let (track, notes) = aircraft::read_track(disk, root, flight)?;
    for note in notes {
        eprintln!("wingd: {note}");
    }
    if track.is_empty() {
        return Ok((track, None));
    }
    let digest = store::aircraft::aircraft_digest(disk, root, flight)?;
    eprintln!("wingd: {}: air data and wing temperature from {} aircraft samples", flight.id, track.len());
    Ok((track, digest))
}

/// Returns the mounting of each frame by its digest. A reboot or a lost camera begins a new mounting, because the camera
/// may have been taken down then. Reopening before each series, which the recorder does itself, does not. Imported images
/// have no entry: their mountings are unknown.
pub(super) fn frame_mountings(disk: &dyn Disk, flight: &FlightRef) -> Result<BTreeMap<String, Mounting>, StoreError> {
    let mut all = BTreeMap::new();
    let (mut number, mut boot): (usize, Option<String>) = (0, None);
    for series in catalogue::list_series(disk, flight)? {
        let manifest = catalogue::read_series_manifest(disk, &series)?;
        let shots = manifest.shots.into_iter().filter(|_| manifest.cause != SeriesCause::Imported);
        for shot in shots {
            let gone = shot.failures.iter().any(|failure| failure.kind == CAMERA_GONE);
            let booted = boot.replace(shot.stamp.boot_id.clone()).is_some_and(|b| b != shot.stamp.boot_id);
            number += usize::from(gone || booted);
            all.extend(shot.frame.map(|frame| (frame.sha256, Mounting::Numbered(number))));
        }
    }
    Ok(all)
}
