//! Decoding of one frame, detection and identification of its markers.

use std::time::Instant;

use sha2::{Digest, Sha256};

use super::decode;
use super::located::{self, PartialSource, refine_detections};
use crate::aircraft::AircraftState;
use crate::camera::Format;
use crate::installation::{Installation, ManualObservation, ManualPosition};
use crate::measure::adjust::{Mounting, Observation};
use crate::measure::detect::{self, Detection, Detections};
use crate::measure::identify::{self, IdentifyError, Identities, OrientationFit};
use crate::measure::jpeg::PartialImage;
use crate::measure::raster::Raster;
use crate::measure::setup::{GroundObservation, Orientation, Setup};
use crate::measure::tiles::Tiles;
use crate::record::Reason;

pub use super::located::identify_and_refine;

/// Processing step of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// Decoding of the file to a grey image.
    Decode,
    /// Detection of markers.
    Detect,
    /// Identification of the detected markers.
    Identify,
    /// Adjustment.
    Solve,
}

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
        Self { work, ms: 1e3 * started.elapsed().as_secs_f64() }
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
    pub fn from_manual<'a>(name: &str, observations: impl IntoIterator<Item = &'a ManualObservation>) -> Self {
        let mut processed = Self { image: name.into(), ..Self::default() };
        processed.add_manual(observations);
        processed
    }

    /// Adds manual observations, which replace detections of the same markers.
    ///
    /// A frame whose detections could not be identified may be solved by them.
    pub fn add_manual<'a>(&mut self, observations: impl IntoIterator<Item = &'a ManualObservation>) {
        for o in observations {
            let marker = o.marker;
            self.observations.retain(|seen| seen.marker != marker);
            let rejection = match o.place {
                Some(ManualPosition { pixel, covariance_px2 }) => {
                    self.observations.push(Observation { marker, pixel, covariance_px2 });
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
        Self { digest: new_frame(name, bytes).digest, ..Self::from_manual(name, observations) }
    }

    /// Creates a frame without observations, with the reason.
    pub fn failed(image: impl Into<String>, reason: impl Into<Reason>) -> Self {
        Self { image: image.into(), failure: Some(reason.into()), ..Self::default() }
    }

    /// Decodes an image and stores its size and detections, or the failure. Returns the image.
    pub(super) fn detect_in<P: AsRef<Raster>>(
        &mut self,
        decode: impl FnOnce() -> Result<P, decode::DecodeError>,
        detect: impl FnOnce(&Raster) -> Detections,
    ) -> Option<P> {
        let image = self.decode_with(decode)?;
        self.detections = self.timed(Work::Detect, || detect(image.as_ref()));
        Some(image)
    }

    /// Decodes an image and stores its size, or the failure. Returns the image.
    fn decode_with<P: AsRef<Raster>>(&mut self, decode: impl FnOnce() -> Result<P, decode::DecodeError>) -> Option<P> {
        match self.timed(Work::Decode, decode) {
            Err(error) => {
                self.failure = Some(Reason::from_error(error));
                None
            }
            Ok(image) => {
                let raster = image.as_ref();
                self.size = Some((raster.width(), raster.height()));
                Some(image)
            }
        }
    }

    /// Decodes the remaining tiles and detects markers in the full image.
    pub(super) fn detect_full(&mut self, part: &mut PartialImage) {
        let all = Tiles::all(part.raster().width(), part.raster().height());
        self.timed(Work::Decode, || part.decode_tiles(all));
        self.detections = self.timed(Work::Detect, || detect::detect(part.raster()));
    }

    pub(super) fn timed<T>(&mut self, work: Work, run: impl FnOnce() -> T) -> T {
        let started = Instant::now();
        let result = run();
        self.stages.push(StageTime::since(work, started));
        result
    }
}

/// Returns the reason for a marker that a person rejected.
pub(super) fn rejection_reason(of: &ManualObservation) -> String {
    let [who, _, why] = &of.note;
    let author = if who.is_empty() { String::new() } else { format!(" ({who})") };
    let because = if why.is_empty() { String::new() } else { format!(": {why}") };
    format!("rejected manually{author}{because}")
}

/// Decodes a frame and detects markers; with an orientation, identifies them and removes the perspective bias.
pub fn process_frame(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
    installation: &Installation,
    orientation: Option<&Orientation>,
) -> ProcessedFrame {
    let setup = &installation.setup;
    let size = (setup.lens.width as usize, setup.lens.height as usize);
    let mut processed = new_frame(name, bytes);
    let first = |width, height| match orientation.filter(|_| (width, height) == size) {
        Some(orientation) => detect::tiles_read(&identify::predict_nearest(setup, orientation), width, height),
        None => Tiles::all(width, height),
    };
    let Some(mut part) = processed.decode_with(|| decode::decode_partial(bytes, format, &first)) else {
        return processed;
    };
    let fits = processed.size == Some(size);
    let located = |orientation| search_located(&mut processed, &mut part, setup, orientation);
    if orientation.filter(|_| fits).and_then(located).is_none() {
        processed.detect_full(&mut part);
        identify_if_size_fits(&mut processed, part.raster(), installation, orientation);
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
    installation: &Installation,
    orientation: Option<&Orientation>,
) -> (ProcessedFrame, Option<Raster>) {
    let (mut processed, raster) = detect_only(name, bytes, format);
    if let Some(raster) = &raster {
        identify_if_size_fits(&mut processed, raster, installation, orientation);
    }
    (processed, raster)
}

/// Identifies the detections of a frame that has the camera's size, if there is an orientation.
fn identify_if_size_fits(
    processed: &mut ProcessedFrame,
    raster: &Raster,
    installation: &Installation,
    orientation: Option<&Orientation>,
) {
    processed.failure = size_fault(raster, installation);
    if let (None, Some(orientation)) = (&processed.failure, orientation) {
        identify_frame(processed, raster, installation, orientation);
    }
}

/// Searches at the positions that the installation predicts, from the nearest markers outwards
/// ([`identify::locate_markers`]); only the tiles that may show markers are decoded.
///
/// Candidates for missing markers away from their positions are added. Returns `None` if the search fails.
fn search_located(
    processed: &mut ProcessedFrame,
    part: &mut PartialImage,
    setup: &Setup,
    orientation: &Orientation,
) -> Option<()> {
    let found = processed.timed(Work::Detect, || located::detect_located(part, setup, orientation))?;
    let name = |found, part: &mut PartialImage| identify_and_refine(setup, orientation, part, found);
    let mut known = processed.timed(Work::Identify, || name(found, part)).ok()?;
    let displaced = processed.timed(Work::Detect, || located::detect_displaced(part, setup, orientation, &known));
    if !displaced.is_empty() {
        known.0.add(displaced);
        known = processed.timed(Work::Identify, || name(known.0, part)).ok()?;
    }
    store_identities(processed, setup, orientation, Ok(known));
    Some(())
}

/// Decodes an image and detects markers, without an installation. Returns the image for drawing.
pub fn detect_only(name: &str, bytes: &[u8], format: Option<&Format>) -> (ProcessedFrame, Option<Raster>) {
    let mut processed = new_frame(name, bytes);
    let raster = processed.detect_in(|| decode::decode_image(bytes, format), detect::detect);
    (processed, raster)
}

pub(super) fn new_frame(name: &str, bytes: &[u8]) -> ProcessedFrame {
    ProcessedFrame { image: name.into(), digest: hex::encode(Sha256::digest(bytes)), ..ProcessedFrame::default() }
}

/// Returns a message if the frame does not have the calibrated camera's size.
pub fn size_fault(raster: &Raster, installation: &Installation) -> Option<Reason> {
    let lens = &installation.setup.lens;
    let fits = raster.width() == lens.width as usize && raster.height() == lens.height as usize;
    let rotated = raster.width() == lens.height as usize && raster.height() == lens.width as usize;
    let frame = format!("{} x {} px", raster.width(), raster.height());
    let camera = format!("{} x {} px", lens.width, lens.height);
    let text = match (fits, rotated) {
        (true, _) => return None,
        (false, true) => format!(
            "the frame is {frame}, camera.toml is for {camera}: it was rotated by 90 degrees; switch off the \
             rotation of images in the camera and in the program that copies them"
        ),
        (false, false) => {
            format!("the frame is {frame}, but camera.toml was calibrated for {camera}; use the camera's full frames")
        }
    };
    Some(text.into())
}

/// Identifies detections, refines partly hidden or poorly visible markers, removes the perspective bias, and stores the
/// observations.
pub fn identify_frame(
    processed: &mut ProcessedFrame,
    raster: &Raster,
    installation: &Installation,
    orientation: &Orientation,
) {
    let setup = &installation.setup;
    let found = processed.detections.clone();
    let known = processed.timed(Work::Identify, || identify_and_refine(setup, orientation, &mut { raster }, found));
    store_identities(processed, setup, orientation, known);
}

/// Identifies detections as [`identify_frame`] does and returns those found without a second pass, which predict the next
/// frame.
///
/// Guided detection does not find markers that need a second pass: if they were predicted, every frame would be searched in
/// full.
pub(super) fn identify_for_tracking(
    processed: &mut ProcessedFrame,
    image: &mut impl PartialSource,
    installation: &Installation,
    orientation: &Orientation,
) -> Option<(Vec<Detection>, Identities)> {
    let setup = &installation.setup;
    let found = processed.detections.clone();
    let mut plainly = None;
    let known = processed.timed(Work::Identify, || {
        let first = identify::identify_markers(setup, orientation, &found.markers)?;
        plainly = Some((found.markers.clone(), first.clone()));
        Ok(refine_detections(setup, orientation, image, found, first))
    });
    store_identities(processed, setup, orientation, known);
    plainly
}

fn store_identities(
    processed: &mut ProcessedFrame,
    setup: &Setup,
    orientation: &Orientation,
    known: Result<(Detections, Identities), IdentifyError>,
) {
    match known {
        Err(error) => {
            processed.failure = Some(unidentified_reason(setup, orientation, processed, error));
            processed.is_unnamed = true;
        }
        Ok((found, identities)) => {
            let centred = identify::remove_perspective_bias(setup, orientation, &found.markers, &identities);
            processed.observations = identified_observations(&centred, &identities);
            processed.detections = Detections { markers: centred, ..found };
            processed.identities = Some(identities);
        }
    }
}

/// Returns why the markers of a frame could not be identified: the diagnosed cause, or else the error itself.
fn unidentified_reason(
    setup: &Setup,
    orientation: &Orientation,
    processed: &ProcessedFrame,
    error: IdentifyError,
) -> Reason {
    let cause = match error {
        IdentifyError::TooFew { .. } => None,
        _ => identify::diagnose_flight_frame(setup, orientation, &processed.detections.markers),
    };
    cause.map_or_else(|| Reason::from_error(error), |cause| Reason::from(cause.to_string()))
}

/// Returns the identified detections as observations, in the order of the survey.
fn identified_observations(detections: &[Detection], identities: &Identities) -> Vec<Observation> {
    let mut list: Vec<Observation> = detections
        .iter()
        .zip(&identities.marker_of)
        .filter_map(|(d, marker)| {
            marker.map(|marker| Observation { marker, pixel: d.centre_px, covariance_px2: *d.covariance_px2 })
        })
        .collect();
    list.sort_by_key(|o| o.marker);
    list
}

/// Returns the mean observations of the identified markers, weighted over the ground frames.
pub fn ground_observations(setup: &Setup, frames: &[Vec<Detection>], fit: &OrientationFit) -> Vec<GroundObservation> {
    let observed = frames.iter().zip(&fit.identities).flat_map(|(found, identities)| {
        let centred = identify::remove_perspective_bias(setup, &fit.orientation, found, identities);
        identified_observations(&centred, identities)
    });
    let observed = observed.map(|Observation { marker, pixel, covariance_px2 }| GroundObservation {
        marker,
        pixel,
        covariance_px2,
    });
    GroundObservation::mean_observations(setup.markers.len(), observed)
}
