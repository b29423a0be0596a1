//! Decoding of one frame, detection and identification of its markers.

use std::time::Instant;

use sha2::{Digest, Sha256};

use super::decode;
use crate::aircraft::AircraftState;
use crate::frame_format::Format;
use crate::installation::{ManualObservation, ManualPosition};
use crate::record::Reason;
use wingd_measure::adjust::Mounting;
use wingd_measure::adjust::Observation;
use wingd_measure::detect::Detections;
use wingd_measure::identify::Identities;
use wingd_measure::identify::WingView;
use wingd_measure::raster::Raster;
use wingd_measure::setup::{Orientation, Setup};
use wingd_measure::tiles::Tiles;
use wingd_measure::view;
use wingd_measure::view::Picture;
use wingd_measure::view::{FrameMarkers, ViewFault};

pub use wingd_measure::view::Work;

/// Duration of a processing step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageTime {
    /// Step that took the time.
    pub work: Work,
    /// Duration, ms.
    pub ms: f64,
}

impl StageTime {
    /// Measures a step that began at `started` and ends now.
    pub fn since(work: Work, started: Instant) -> Self {
        Self {
            work,
            ms: 1e3 * started.elapsed().as_secs_f64(),
        }
    }
}

/// Detections, identities and observations of one frame.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct ProcessedFrame {
    /// File name of the frame.
    pub image: String,
    /// SHA-256 of its bytes.
    pub digest: String,
    /// Width and height, px; `None` if the frame could not be decoded.
    pub size: Option<(usize, usize)>,
    /// Output of the detector; perspective bias is removed from identified circles.
    pub detections: Detections,
    /// Identities of the detections; `None` without an orientation.
    pub identities: Option<Identities>,
    /// Observations for the adjustment.
    pub observations: Vec<Observation>,
    /// Markers with a manual observation: `None` for a marked position, or the reason for a rejection.
    pub manual: Vec<(usize, Option<String>)>,
    /// True if the frame cannot be solved because the detections could not be identified.
    pub is_unnamed: bool,
    /// Mounting of the camera, if known.
    pub mounting: Option<Mounting>,
    /// Aircraft data at the time of the frame; empty if there are none.
    pub aircraft: AircraftState,
    /// Reason why the frame cannot be solved: one sentence with the remedy.
    pub failure: Option<Reason>,
    /// Durations of the steps.
    pub stages: Vec<StageTime>,
}

impl ProcessedFrame {
    /// Creates a frame from manual observations alone.
    pub fn from_manual<'a>(
        name: &str,
        observations: impl IntoIterator<Item = &'a ManualObservation>,
    ) -> Self {
        let mut processed = Self {
            image: name.into(),
            ..Self::default()
        };
        processed.add_manual(observations);
        processed
    }

    /// Adds manual observations, which replace detections of the same markers.
    ///
    /// A frame whose detections could not be identified may be solved by them.
    pub fn add_manual<'a>(
        &mut self,
        observations: impl IntoIterator<Item = &'a ManualObservation>,
    ) {
        for o in observations {
            let marker = o.marker;
            self.observations.retain(|seen| seen.marker != marker);
            let rejection = match o.place {
                Some(ManualPosition {
                    pixel,
                    covariance_px2,
                }) => {
                    self.observations.push(Observation {
                        marker,
                        pixel,
                        covariance_px2,
                    });
                    self.failure.take_if(|_| self.is_unnamed);
                    None
                }
                None => Some(rejection_reason(o)),
            };
            self.manual.push((marker, rejection));
        }
        self.observations.sort_by_key(|o| o.marker);
    }

    /// Creates a frame from an image in which nothing is detected and from manual observations.
    pub fn without_detection<'a>(
        name: &str,
        bytes: &[u8],
        observations: impl IntoIterator<Item = &'a ManualObservation>,
    ) -> Self {
        let mut processed = Self::from_image(name, bytes);
        processed.add_manual(observations);
        processed
    }

    /// Creates a frame without observations, with the reason.
    pub fn failed(image: impl Into<String>, reason: impl Into<Reason>) -> Self {
        Self {
            image: image.into(),
            failure: Some(reason.into()),
            ..Self::default()
        }
    }

    /// Creates a frame of an image, without observations.
    pub(super) fn from_image(name: &str, bytes: &[u8]) -> Self {
        Self {
            image: name.into(),
            digest: hex::encode(Sha256::digest(bytes)),
            ..Self::default()
        }
    }

    /// Decodes an image and stores its size, or the failure. Returns the image.
    pub(super) fn decode<P: Picture>(
        &mut self,
        decode: impl FnOnce() -> Result<P, decode::DecodeError>,
    ) -> Option<P> {
        let decoded = self.timed(|ended| {
            let decoded = decode();
            ended(Work::Decode);
            decoded
        });
        match decoded {
            Err(error) => {
                self.failure = Some(Reason::from_error(error));
                None
            }
            Ok(picture) => {
                self.size = Some((picture.raster().width(), picture.raster().height()));
                Some(picture)
            }
        }
    }

    /// Runs steps, which report each end, and stores their durations.
    pub(super) fn timed<T>(&mut self, run: impl FnOnce(view::StepEnd) -> T) -> T {
        let mut started = Instant::now();
        run(&mut |work| {
            self.stages.push(StageTime::since(work, started));
            started = Instant::now();
        })
    }

    /// Fails the frame if it does not have the calibrated camera's size.
    pub(super) fn check_size(&mut self, raster: &Raster, setup: &Setup) {
        if let Some(fault) = ViewFault::from_size(raster, &setup.lens) {
            self.failure = Some(Reason::from_error(fault));
        }
    }

    /// Stores the markers of the frame.
    pub(super) fn set_markers(
        &mut self,
        FrameMarkers {
            detections,
            identities,
            observations,
            fault,
            ..
        }: FrameMarkers,
    ) {
        self.is_unnamed = fault.as_ref().is_some_and(ViewFault::is_unnamed);
        self.failure = fault.map(Reason::from_error);
        (self.detections, self.identities, self.observations) =
            (detections, identities, observations);
    }
}

/// Returns the reason for a marker that a person rejected.
pub(super) fn rejection_reason(of: &ManualObservation) -> String {
    let [who, _, why] = &of.note;
    let author = if who.is_empty() {
        String::new()
    } else {
        format!(" ({who})")
    };
    let because = if why.is_empty() {
        String::new()
    } else {
        format!(": {why}")
    };
    format!("rejected manually{author}{because}")
}

/// Decodes a frame and detects markers; with an orientation, identifies them and removes the perspective bias.
pub fn process_frame(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
    setup: &Setup,
    orientation: Option<&Orientation>,
) -> ProcessedFrame {
    let mut processed = ProcessedFrame::from_image(name, bytes);
    let wing = orientation.map(|orientation| WingView::in_flight(setup, orientation));
    let first = |width, height| view::first_tiles(wing.as_ref(), width, height);
    if let Some(mut picture) = processed.decode(|| decode::decode_partial(bytes, format, &first)) {
        let found =
            processed.timed(|ended| view::process_frame(&mut picture, wing.as_ref(), ended));
        processed.set_markers(found);
        processed.check_size(picture.raster(), setup);
    }
    processed
}

/// Processes a frame by a search of the full frame, even if the installation predicts the markers.
///
/// Everything visible is detected, and rejected candidates have a reason. Returns the image for drawing.
pub fn process_full_frame(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
    setup: &Setup,
    orientation: Option<&Orientation>,
) -> (ProcessedFrame, Option<Raster>) {
    let wing = orientation.map(|orientation| WingView::in_flight(setup, orientation));
    let (mut processed, raster) = search_full_frame(name, bytes, format, wing.as_ref());
    raster
        .iter()
        .for_each(|raster| processed.check_size(raster, setup));
    (processed, raster)
}

/// Decodes an image and detects markers, without an installation. Returns the image for drawing.
pub fn detect_only(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
) -> (ProcessedFrame, Option<Raster>) {
    search_full_frame(name, bytes, format, None)
}

fn search_full_frame(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
    wing: Option<&WingView>,
) -> (ProcessedFrame, Option<Raster>) {
    let mut processed = ProcessedFrame::from_image(name, bytes);
    let picture = processed.decode(|| decode::decode_partial(bytes, format, &Tiles::all));
    let raster = picture.map(|mut picture| {
        let found = processed.timed(|ended| view::process_full_frame(&mut picture, wing, ended));
        processed.set_markers(found);
        picture.into_raster()
    });
    (processed, raster)
}
