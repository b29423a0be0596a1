//! Frames of a store's flight prepared for adjustment: detections, mountings, aircraft data.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value};

use super::flight_marks::FlightMarks;
use super::stored_flights;
use crate::aircraft::AircraftTrack;
use crate::frame_format::Format;
use crate::installation::Installation;
use crate::pipeline::{self, ProcessedFrame, SolveJob, stages};
use crate::record::Reason;
use crate::results::aircraft;
use wingd_measure::adjust::Mounting;
use wingd_measure::setup::Orientation;
use wingd_store as store;
use wingd_store::manifest::SeriesCause;
use wingd_store::{Disk, FlightRef, FrameRef, StoreResult, catalogue};

/// Kind of a shot's failure if the camera was unplugged or lost power.
const CAMERA_GONE: &str = "gone";

/// Everything that the frames of a flight are processed with.
pub struct FlightInputs<'a> {
    pub installation: &'a Installation,
    pub orientation: &'a Orientation,
    pub aircraft: FlightAircraftData,
    pub marks: FlightMarks,
    /// Mounting of each frame by its digest; empty if the frames are not adjusted together.
    pub mountings: BTreeMap<String, Mounting>,
}

impl FlightInputs<'_> {
    /// Returns the inputs of results from these frames, which are adjusted jointly or each alone.
    pub fn provenance(&self, job: &SolveJob, jointly: Option<&[FrameRef]>) -> Map<String, Value> {
        let mut provenance = pipeline::provenance_map(self.installation, job);
        if let Some(frames) = jointly {
            let digests: String = frames
                .iter()
                .map(|frame| format!("{}\n", frame.entry.sha256))
                .collect();
            provenance.insert(
                "frames_together".into(),
                store::sha256_hex(digests.as_bytes()).into(),
            );
        }
        let named = [
            ("aircraft_data", &self.aircraft.digest),
            ("marks", &self.marks.digest),
        ];
        let there = named
            .into_iter()
            .filter_map(|(name, digest)| Some((name, digest.clone()?)));
        provenance.extend(there.map(|(name, digest)| (name.to_owned(), digest.into())));
        provenance
    }

    /// Detects and identifies the markers of a frame, and adds its manual marks, its aircraft data and its mounting.
    pub fn process_frame(&self, frame: &FrameRef, bytes: Result<&[u8], Reason>) -> ProcessedFrame {
        let name = stored_flights::frame_name(frame);
        let Self {
            installation,
            orientation,
            ..
        } = self;
        let mut processed = match (bytes, Format::from_manifest(&frame.entry.format)) {
            (Ok(bytes), Ok(format)) => stages::process_frame(
                &name,
                bytes,
                Some(&format),
                &installation.setup,
                Some(*orientation),
            ),
            (Err(reason), _) => ProcessedFrame::failed(&name, reason),
            (_, Err(unknown)) => ProcessedFrame::failed(&name, Reason::from_error(unknown)),
        };
        processed.aircraft = self
            .aircraft
            .track
            .state_at(&frame.stamp, frame.exposure.as_ref());
        processed.add_manual(self.marks.for_frame(&name));
        let mounting = self.mountings.get(&frame.entry.sha256).copied();
        ProcessedFrame {
            mounting,
            ..processed
        }
    }
}

/// Aircraft data of a flight, for solving its frames.
#[derive(Default)]
pub struct FlightAircraftData {
    pub track: AircraftTrack,
    /// Digest of the data; `None` if there are none.
    pub digest: Option<String>,
    /// Notes on the data.
    pub notes: Vec<String>,
}

impl FlightAircraftData {
    /// Reads the data.
    pub fn read(disk: &dyn Disk, root: &Path, flight: &FlightRef) -> StoreResult<Self> {
        let (track, mut notes) = aircraft::read_track(disk, root, flight)?;
        let mut digest = None;
        if !track.is_empty() {
            digest = store::aircraft::aircraft_digest(disk, root, flight)?;
            let samples = track.len();
            notes.push(format!(
                "{}: air data and wing temperature from {samples} aircraft samples",
                flight.id
            ));
        }
        Ok(Self {
            track,
            digest,
            notes,
        })
    }
}

/// Returns the mounting of each frame by its digest. A reboot or a lost camera begins a new mounting, because the camera
/// may have been taken down then. Reopening before each series, which the recorder does itself, does not. Imported images
/// have no entry: their mountings are unknown.
pub fn frame_mountings(
    disk: &dyn Disk,
    flight: &FlightRef,
) -> StoreResult<BTreeMap<String, Mounting>> {
    let mut all = BTreeMap::new();
    let (mut number, mut boot): (usize, Option<String>) = (0, None);
    for series in catalogue::list_series(disk, flight)? {
        let manifest = catalogue::read_series_manifest(disk, &series)?;
        let shots = manifest
            .shots
            .into_iter()
            .filter(|_| manifest.cause != SeriesCause::Imported);
        for shot in shots {
            let gone = shot
                .failures
                .iter()
                .any(|failure| failure.kind == CAMERA_GONE);
            let booted = boot
                .replace(shot.stamp.boot_id.clone())
                .is_some_and(|b| b != shot.stamp.boot_id);
            number += usize::from(gone || booted);
            all.extend(
                shot.frame
                    .map(|frame| (frame.sha256, Mounting::Numbered(number))),
            );
        }
    }
    Ok(all)
}
