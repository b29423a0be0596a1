//! One frame is decoded, its markers are detected and identified.

use std::time::Instant;

use sha2::{Digest, Sha256};

use super::decode;
use super::located::{self, Picture, looked_closer};
use crate::aircraft::State;
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

pub use super::located::identified;

/// What is done with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    /// Bytes to a grey picture.
    Decode,
    /// Markers in it.
    Detect,
    /// Their names.
    Identify,
    /// The adjustment.
    Solve,
}

/// A stage's duration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stage {
    /// Which one.
    pub work: Work,
    /// Milliseconds.
    pub ms: f64,
}

impl Stage {
    /// What was begun at `started` and ends now.
    pub fn ended(work: Work, started: Instant) -> Self {
        Self { work, ms: 1e3 * started.elapsed().as_secs_f64() }
    }
}

/// What was seen in one frame.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct ProcessedFrame {
    /// File name of the frame.
    pub image: String,
    /// SHA-256 of its bytes.
    pub digest: String,
    /// Size, px; `None` where it could not be decoded.
    pub size: Option<(usize, usize)>,
    /// All that the detector says; circles' perspective bias removed where identified.
    pub detections: Detections,
    /// Who is who; `None` without an orientation.
    pub identities: Option<Identities>,
    /// For the adjustment.
    pub observations: Vec<Observation>,
    /// Markers of which a person said something: where they are (`None`), or why they are not to be used.
    pub manual: Vec<(usize, Option<String>)>,
    /// Whether the frame cannot be solved because nobody could name what was detected.
    pub is_unnamed: bool,
    /// The camera's mounting, where it is known.
    pub mounting: Option<Mounting>,
    /// What the aircraft's data say of it; empty where nothing does.
    pub aircraft: State,
    /// Why the frame cannot be solved; one sentence with the mend.
    pub failure: Option<Reason>,
    /// Stages and their durations.
    pub stages: Vec<Stage>,
}

impl ProcessedFrame {
    /// From measurements by hand.
    pub fn manual<'a>(name: &str, observations: impl IntoIterator<Item = &'a ManualObservation>) -> Self {
        let mut sighting = Self { image: name.into(), ..Self::default() };
        sighting.add_manual(observations);
        sighting
    }

    /// What a person says beside what was detected: where both are of one marker, the person's stands for it. A frame whose
    /// detections nobody could name may be solved by what a person named in it.
    pub fn add_manual<'a>(&mut self, observations: impl IntoIterator<Item = &'a ManualObservation>) {
        for o in observations {
            let marker = o.marker;
            self.observations.retain(|seen| seen.marker != marker);
            let said = match o.place {
                Some(ManualPosition { pixel, covariance_px2 }) => {
                    self.observations.push(Observation { marker, pixel, covariance_px2 });
                    self.failure.take_if(|_| self.is_unnamed);
                    None
                }
                None => Some(rejection(o)),
            };
            self.manual.push((marker, said));
        }
        self.observations.sort_by_key(|o| o.marker);
    }

    /// The same, with none that were detected: for a picture that nothing is looked for in.
    pub fn only_manual<'a>(
        name: &str,
        bytes: &[u8],
        observations: impl IntoIterator<Item = &'a ManualObservation>,
    ) -> Self {
        Self { digest: unseen(name, bytes).digest, ..Self::manual(name, observations) }
    }

    /// Without anything seen, and why.
    pub fn failed(image: impl Into<String>, reason: impl Into<Reason>) -> Self {
        Self { image: image.into(), failure: Some(reason.into()), ..Self::default() }
    }

    /// Takes up what is detected in a picture, which comes back, or why there is none.
    pub(super) fn look<P: AsRef<Raster>>(
        &mut self,
        decode: impl FnOnce() -> Result<P, decode::DecodeError>,
        detect: impl FnOnce(&Raster) -> Detections,
    ) -> Option<P> {
        let picture = self.decoded(decode)?;
        self.detections = self.timed(Work::Detect, || detect(picture.as_ref()));
        Some(picture)
    }

    /// Takes up a picture's size, or why there is none.
    fn decoded<P: AsRef<Raster>>(
        &mut self,
        decode: impl FnOnce() -> Result<P, decode::DecodeError>,
    ) -> Option<P> {
        match self.timed(Work::Decode, decode) {
            Err(error) => {
                self.failure = Some(Reason::of(error));
                None
            }
            Ok(picture) => {
                let raster = picture.as_ref();
                self.size = Some((raster.width(), raster.height()));
                Some(picture)
            }
        }
    }

    /// Decodes what was not yet, and takes up what is detected in all of it.
    pub(super) fn look_at_all(&mut self, part: &mut PartialImage) {
        let all = Tiles::all(part.raster().width(), part.raster().height());
        self.timed(Work::Decode, || part.decode_tiles(all));
        self.detections = self.timed(Work::Detect, || detect::detect(part.raster()));
    }

    pub(super) fn timed<T>(&mut self, work: Work, run: impl FnOnce() -> T) -> T {
        let started = Instant::now();
        let result = run();
        self.stages.push(Stage::ended(work, started));
        result
    }
}

/// Why a marker is not used that a person rejected.
pub(super) fn rejection(of: &ManualObservation) -> String {
    let [who, _, why] = &of.note;
    let by = if who.is_empty() { String::new() } else { format!(" ({who})") };
    let because = if why.is_empty() { String::new() } else { format!(": {why}") };
    format!("rejected by hand{by}{because}")
}

/// Decodes and detects; with an orientation also identifies and removes the perspective bias.
pub fn process_frame(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
    installation: &Installation,
    orientation: Option<&Orientation>,
) -> ProcessedFrame {
    let setup = &installation.setup;
    let size = (setup.lens.width as usize, setup.lens.height as usize);
    let mut sighting = unseen(name, bytes);
    let first = |width, height| match orientation.filter(|_| (width, height) == size) {
        Some(orientation) => detect::tiles_read(&identify::predict_nearest(setup, orientation), width, height),
        None => Tiles::all(width, height),
    };
    let Some(mut part) = sighting.decoded(|| decode::decode_part(bytes, format, &first)) else {
        return sighting;
    };
    let fits = sighting.size == Some(size);
    let located = |orientation| look_located(&mut sighting, &mut part, setup, orientation);
    if orientation.filter(|_| fits).and_then(located).is_none() {
        sighting.look_at_all(&mut part);
        recognise_if_it_fits(&mut sighting, part.raster(), installation, orientation);
    }
    sighting
}

/// The same from the whole frame, also where the installation says where to look: all that is there is seen, and why a candidate
/// was turned down. The picture comes back for drawing.
pub fn process_full_frame(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
    installation: &Installation,
    orientation: Option<&Orientation>,
) -> (ProcessedFrame, Option<Raster>) {
    let (mut sighting, raster) = detect_only(name, bytes, format);
    if let Some(raster) = &raster {
        recognise_if_it_fits(&mut sighting, raster, installation, orientation);
    }
    (sighting, raster)
}

/// Names what was detected in a frame of the camera's size, where there is an orientation.
fn recognise_if_it_fits(
    sighting: &mut ProcessedFrame,
    raster: &Raster,
    installation: &Installation,
    orientation: Option<&Orientation>,
) {
    sighting.failure = size_fault(raster, installation);
    if let (None, Some(orientation)) = (&sighting.failure, orientation) {
        recognise(sighting, raster, installation, orientation);
    }
}

/// Looks where the installation says, from the nearest markers outwards ([`identify::locate`]); only what may show markers is
/// decoded. What is like a marker that is missing, and shows aside of its place, is taken up. `None` where that leads nowhere.
fn look_located(
    sighting: &mut ProcessedFrame,
    part: &mut PartialImage,
    setup: &Setup,
    orientation: &Orientation,
) -> Option<()> {
    let found = sighting.timed(Work::Detect, || located::detected(part, setup, orientation))?;
    let name = |found, part: &mut PartialImage| identified(setup, orientation, part, found);
    let mut known = sighting.timed(Work::Identify, || name(found, part)).ok()?;
    let aside = sighting.timed(Work::Detect, || located::aside(part, setup, orientation, &known));
    if !aside.is_empty() {
        known.0.add(aside);
        known = sighting.timed(Work::Identify, || name(known.0, part)).ok()?;
    }
    take_up(sighting, setup, orientation, Ok(known));
    Some(())
}

/// Decodes and detects, without any knowledge of the wing. The picture comes back for drawing.
pub fn detect_only(name: &str, bytes: &[u8], format: Option<&Format>) -> (ProcessedFrame, Option<Raster>) {
    let mut sighting = unseen(name, bytes);
    let raster = sighting.look(|| decode::decode(bytes, format), detect::detect);
    (sighting, raster)
}

pub(super) fn unseen(name: &str, bytes: &[u8]) -> ProcessedFrame {
    ProcessedFrame {
        image: name.into(),
        digest: hex::encode(Sha256::digest(bytes)),
        ..ProcessedFrame::default()
    }
}

/// A sentence where the frame is not of the calibrated camera's size.
pub fn size_fault(raster: &Raster, installation: &Installation) -> Option<Reason> {
    let lens = &installation.setup.lens;
    let fits = raster.width() == lens.width as usize && raster.height() == lens.height as usize;
    let turned = raster.width() == lens.height as usize && raster.height() == lens.width as usize;
    let frame = format!("{} x {} px", raster.width(), raster.height());
    let camera = format!("{} x {} px", lens.width, lens.height);
    let text = match (fits, turned) {
        (true, _) => return None,
        (false, true) => format!(
            "the frame is {frame}, camera.toml is for {camera}: it was turned by 90 degrees; switch the rotation of \
             pictures off in the camera and in what copies them"
        ),
        (false, false) => format!(
            "the frame is {frame}, but camera.toml was calibrated for {camera}; use the camera's full frames"
        ),
    };
    Some(text.into())
}

/// Identities, closer looks at markers that are hidden in part or hardly seen, perspective bias, observations.
pub fn recognise(
    sighting: &mut ProcessedFrame,
    raster: &Raster,
    installation: &Installation,
    orientation: &Orientation,
) {
    let setup = &installation.setup;
    let found = sighting.detections.clone();
    let known = sighting.timed(Work::Identify, || identified(setup, orientation, &mut { raster }, found));
    take_up(sighting, setup, orientation, known);
}

/// The same, and what foretells the next frame: what was found without a closer look, and who that is. Guided detection does not
/// find what only a closer look shows: were it promised, the whole frame would be searched each time.
pub(super) fn recognise_for_next(
    sighting: &mut ProcessedFrame,
    picture: &mut impl Picture,
    installation: &Installation,
    orientation: &Orientation,
) -> Option<(Vec<Detection>, Identities)> {
    let setup = &installation.setup;
    let found = sighting.detections.clone();
    let mut plainly = None;
    let known = sighting.timed(Work::Identify, || {
        let first = identify::identify_markers(setup, orientation, &found.markers)?;
        plainly = Some((found.markers.clone(), first.clone()));
        Ok(looked_closer(setup, orientation, picture, found, first))
    });
    take_up(sighting, setup, orientation, known);
    plainly
}

fn take_up(
    sighting: &mut ProcessedFrame,
    setup: &Setup,
    orientation: &Orientation,
    known: Result<(Detections, Identities), IdentifyError>,
) {
    match known {
        Err(error) => {
            sighting.failure = Some(unidentified(setup, orientation, sighting, error));
            sighting.is_unnamed = true;
        }
        Ok((found, identities)) => {
            let centred = identify::remove_perspective_bias(setup, orientation, &found.markers, &identities);
            sighting.observations = observations(&centred, &identities);
            sighting.detections = Detections { markers: centred, ..found };
            sighting.identities = Some(identities);
        }
    }
}

/// Why a frame's markers have no names: what they fit after all, or the failure itself.
fn unidentified(
    setup: &Setup,
    orientation: &Orientation,
    sighting: &ProcessedFrame,
    error: IdentifyError,
) -> Reason {
    let cause = match error {
        IdentifyError::TooFew { .. } => None,
        _ => identify::diagnose_flight_frame(setup, orientation, &sighting.detections.markers),
    };
    cause.map_or_else(|| Reason::of(error), |cause| Reason::from(cause.to_string()))
}

/// The identified detections, in the survey's order.
fn observations(detections: &[Detection], identities: &Identities) -> Vec<Observation> {
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

/// Where the ground frames show the identified markers: the weighted mean over the frames.
pub fn ground_sights(
    setup: &Setup,
    frames: &[Vec<Detection>],
    fit: &OrientationFit,
) -> Vec<GroundObservation> {
    let sights = frames.iter().zip(&fit.identities).flat_map(|(found, identities)| {
        let centred = identify::remove_perspective_bias(setup, &fit.orientation, found, identities);
        observations(&centred, identities)
    });
    let sights = sights.map(|Observation { marker, pixel, covariance_px2 }| GroundObservation {
        marker,
        pixel,
        covariance_px2,
    });
    GroundObservation::means(setup.markers.len(), sights)
}
