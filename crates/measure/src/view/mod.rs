//! View of a frame: the search of its picture for the markers of a wing, their second passes and their names.
//!
//! | search | positions |
//! |---|---|
//! | [`process_frame`] | those of the installation, from the nearest marker outwards; if that names too few, the full frame |
//! | [`process_full_frame`] | the full frame |
//! | [`search_guided`] | those that an earlier frame predicts; if one is missing, the full frame |
//!
//! A picture is decoded as far as a search needs it ([`Picture`]). The time of the steps is measured by the caller, who
//! passes a function that is called at the end of each ([`Work`]).

mod picture;
mod points;

use super::detect::{self, Detection, Detections, GuidedDetector, MarkerPrediction};
use super::geometry::Lens;
use super::identify::{IdentifyError, Identities, MIN_IDENTIFIED, WingView};
use super::observation::Observation;
use super::raster::Raster;
use super::tiles::Tiles;

pub use picture::Picture;

/// Largest number of second passes. In flight, passes that add a marker do not count.
pub const MAX_PASSES: usize = 3;

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

/// Function that is called at the end of each step.
pub type StepEnd<'a> = &'a mut dyn FnMut(Work);

/// Extent of the search in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SearchMode {
    /// Search of the full frame.
    Full,
    /// Search around the positions that the previous frame predicts.
    Guided,
}

/// Reason why the markers of a frame have no names.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ViewFault {
    /// Frame of another size than the calibrated camera's: sizes of the frame and of the camera.
    #[error(
        "the frame is {0}, but camera.toml was calibrated for {1}; use the camera's full frames"
    )]
    Size(String, String),
    /// Frame that was rotated by 90 degrees: sizes of the frame and of the camera.
    #[error(
        "the frame is {0}, camera.toml is for {1}: it was rotated by 90 degrees; switch off the rotation of images in the \
         camera and in the program that copies them"
    )]
    Rotated(String, String),
    /// Detections that fit nothing, with the diagnosed cause.
    #[error("{0}")]
    Mismatch(String),
    /// Detections that could not be identified.
    #[error(transparent)]
    Unidentified(IdentifyError),
}

impl ViewFault {
    /// Fault of a frame of a wing without decals, until its points are found.
    const WITHOUT_DECALS: Self = Self::Unidentified(IdentifyError::TooFew {
        found: 0,
        needed: MIN_IDENTIFIED,
    });

    /// Returns whether the detections could not be identified.
    pub fn is_unnamed(&self) -> bool {
        matches!(self, Self::Mismatch(_) | Self::Unidentified(_))
    }

    /// Returns the fault of a frame that does not have the calibrated camera's size.
    pub fn from_size(raster: &Raster, lens: &Lens) -> Option<Self> {
        let frame = (raster.width(), raster.height());
        let camera = (lens.width as usize, lens.height as usize);
        let [seen, calibrated] =
            [frame, camera].map(|(width, height)| format!("{width} x {height} px"));
        match frame {
            _ if frame == camera => None,
            _ if frame == (camera.1, camera.0) => Some(Self::Rotated(seen, calibrated)),
            _ => Some(Self::Size(seen, calibrated)),
        }
    }
}

/// Markers of a frame.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct FrameMarkers {
    /// Output of the detector; perspective bias is removed from identified circles.
    pub detections: Detections,
    /// Identities of the detections; `None` if they were not identified.
    pub identities: Option<Identities>,
    /// Identities before the second passes.
    pub first_identities: Option<Identities>,
    /// Observations of the identified markers, in the order of the survey.
    pub observations: Vec<Observation>,
    /// Reason why the detections have no names.
    pub fault: Option<ViewFault>,
}

/// Returns the tiles of a frame of `width` x `height` px with which [`process_frame`] begins.
pub fn first_tiles(wing: Option<&WingView>, width: usize, height: usize) -> Tiles {
    let has_size = |wing: &&WingView| {
        (width, height)
            == (
                wing.setup.lens.width as usize,
                wing.setup.lens.height as usize,
            )
    };
    match wing.filter(has_size) {
        Some(wing) => detect::tiles_read(&wing.predict_nearest(), width, height),
        None => Tiles::all(width, height),
    }
}

/// Detects the markers of a frame and, with a wing, identifies them and removes the perspective bias.
///
/// Searches at the positions that the installation predicts. If that fails or names too few markers, searches the full frame
/// too, and takes what names more.
pub fn process_frame(
    picture: &mut impl Picture,
    wing: Option<&WingView>,
    ended: StepEnd,
) -> FrameMarkers {
    let fitting =
        wing.filter(|wing| ViewFault::from_size(picture.raster(), &wing.setup.lens).is_none());
    let Some(wing) = fitting else {
        return process_full_frame(picture, wing, ended);
    };
    let found = if wing.has_points_alone() {
        FrameMarkers {
            fault: Some(ViewFault::WITHOUT_DECALS),
            ..FrameMarkers::default()
        }
    } else {
        match (FrameView {
            wing,
            picture,
            ended,
        })
        .search()
        {
            Some(located) if wing.is_followed(&located.observations) => located,
            located => {
                let found = detect_full(picture, ended);
                let full = FrameView {
                    wing,
                    picture,
                    ended,
                }
                .name_markers(found);
                located
                    .filter(|located| located.observations.len() >= full.observations.len())
                    .unwrap_or(full)
            }
        }
    };
    points::add_points(wing, picture, found, ended)
}

/// Processes a frame as [`process_frame`] does, by a search of the full frame.
///
/// Everything visible is detected, and rejected candidates have a reason.
pub fn process_full_frame(
    picture: &mut impl Picture,
    wing: Option<&WingView>,
    ended: StepEnd,
) -> FrameMarkers {
    let found = detect_full(picture, ended);
    match wing {
        Some(wing) => FrameView {
            wing,
            picture,
            ended,
        }
        .name(found),
        None => FrameMarkers {
            detections: found,
            ..FrameMarkers::default()
        },
    }
}

/// Detects markers in the full frame.
fn detect_full(picture: &mut impl Picture, ended: StepEnd) -> Detections {
    let raster = picture.decode_all();
    ended(Work::Decode);
    let found = detect::detect(raster);
    ended(Work::Detect);
    found
}

/// Detects markers around `predictions`, and in the full frame if there are none.
///
/// If a marker of the previous frame is missing, the positions that `predict_again` derives from the markers found are
/// searched, then the full frame. `rejected` stays empty unless it was.
pub fn search_guided(
    picture: &mut impl Picture,
    predictions: &[MarkerPrediction],
    predict_again: impl FnOnce(&[Detection]) -> Option<Vec<MarkerPrediction>>,
    ended: StepEnd,
) -> (Detections, SearchMode) {
    if predictions.is_empty() {
        return (detect_full(picture, ended), SearchMode::Full);
    }
    let found = detect::detect_guided(picture.decode_around(predictions), predictions);
    ended(Work::Detect);
    if detect::is_complete(&found, predictions) {
        return (found, SearchMode::Guided);
    }
    if let Some(refined) = predict_again(&found.markers).filter(|refined| !refined.is_empty()) {
        let raster = picture.decode_around(&refined);
        ended(Work::Decode);
        let found = detect::detect_guided(raster, &refined);
        ended(Work::Detect);
        if detect::is_complete(&found, &refined) {
            return (found, SearchMode::Guided);
        }
    }
    (detect_full(picture, ended), SearchMode::Full)
}

/// Picture of a frame, and the wing that it shows.
pub struct FrameView<'a, P> {
    wing: &'a WingView<'a>,
    picture: &'a mut P,
    ended: StepEnd<'a>,
}

impl<'a, P: Picture> FrameView<'a, P> {
    /// Creates the view of a frame; `ended` is called at the end of each step.
    pub fn new(wing: &'a WingView, picture: &'a mut P, ended: StepEnd<'a>) -> Self {
        Self {
            wing,
            picture,
            ended,
        }
    }

    /// Searches at the positions that the installation predicts, from the nearest markers outwards
    /// ([`WingView::locate_markers`]), and names the markers. Returns `None` if that fails.
    fn search(mut self) -> Option<FrameMarkers> {
        let mut detector = GuidedDetector::new(self.picture.decode_around(&[]));
        let locate = |targets: &[MarkerPrediction]| {
            detector.detect_coarse(self.picture.decode_around(targets), targets)
        };
        let predictions = self.wing.locate_markers(locate);
        let found = predictions.map(|p| detector.detect(self.picture.decode_around(&p), &p));
        (self.ended)(Work::Detect);
        let found = found?;
        let (found, identities, first) = self.identify(found).ok()?;
        Some(self.build_unbiased_markers(found, identities, first))
    }

    /// Identifies detections, refines partly hidden or poorly visible markers, removes the perspective bias, and finds the
    /// points. Detections of a frame without the camera's size stay without names.
    pub fn name(&mut self, found: Detections) -> FrameMarkers {
        let found = self.name_markers(found);
        points::add_points(self.wing, self.picture, found, self.ended)
    }

    /// Identifies detections as [`Self::name`] does, without points.
    fn name_markers(&mut self, found: Detections) -> FrameMarkers {
        if let fault @ Some(_) = ViewFault::from_size(self.picture.raster(), &self.wing.setup.lens)
        {
            return FrameMarkers {
                detections: found,
                fault,
                ..FrameMarkers::default()
            };
        }
        match self.identify(found.clone()) {
            Ok((found, identities, first)) => self.build_unbiased_markers(found, identities, first),
            Err(error) => {
                let cause = match error {
                    IdentifyError::TooFew { .. } => None,
                    _ => self.wing.diagnose_frame(&found.markers),
                };
                let fault = Some(cause.map_or(ViewFault::Unidentified(error), ViewFault::Mismatch));
                FrameMarkers {
                    detections: found,
                    fault,
                    ..FrameMarkers::default()
                }
            }
        }
    }

    /// Identifies detections and refines them; also returns the identities before the second passes.
    fn identify(
        &mut self,
        found: Detections,
    ) -> Result<(Detections, Identities, Identities), IdentifyError> {
        let named = self.wing.identify_markers(&found.markers).map(|first| {
            let (found, identities) = self.refine(found, first.clone());
            (found, identities, first)
        });
        (self.ended)(Work::Identify);
        named
    }

    /// Refines identified detections by second passes. The perspective bias is not removed.
    pub fn refine(
        &mut self,
        mut found: Detections,
        mut identities: Identities,
    ) -> (Detections, Identities) {
        // More precise measurements improve the predictions of the others, and added markers those farther outboard.
        let mut without_new = 0;
        while without_new < MAX_PASSES {
            let expected = self.wing.predict_second_pass(&found.markers, &identities);
            let places: Vec<MarkerPrediction> =
                expected.iter().map(|e| e.prediction.clone()).collect();
            let mut refined = found.clone();
            if !detect::second_pass(self.picture.decode_around(&places), &mut refined, &expected) {
                return (refined, identities);
            }
            let Ok(again) = self.wing.identify_markers(&refined.markers) else {
                break;
            };
            without_new += usize::from(again.count_named() <= identities.count_named());
            (found, identities) = (refined, again);
        }
        (found, identities)
    }

    fn build_unbiased_markers(
        &self,
        found: Detections,
        identities: Identities,
        first: Identities,
    ) -> FrameMarkers {
        let markers = self
            .wing
            .remove_perspective_bias(&found.markers, &identities);
        FrameMarkers {
            observations: identities.observations(&markers),
            detections: Detections { markers, ..found },
            identities: Some(identities),
            first_identities: Some(first),
            fault: None,
        }
    }
}
