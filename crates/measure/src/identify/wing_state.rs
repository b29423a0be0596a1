//! State of the wing for known identities, and predictions from it.

use nalgebra::Vector2;

use super::bias::correct_centres;
use super::fit::{ANY_DEFLECTION, MatchedPair, StateFit, StatePrior, fit_pairs};
use super::outline::DiscOutline;
use super::scene::{WingView, is_usable};
use super::wing::WingState;
use super::{Identities, PredictedMarker};
use crate::detect::{Detection, ExpectedMarker, MarkerPrediction};
use crate::observation::Observation;
use crate::setup::{Shape, SurveyMarker};

/// Step at convergence, px.
const SETTLED_PX: f64 = 1e-3;
/// Largest shift of the image until the next frame, px.
const NEXT_SHIFT_PX: f64 = 8.0;
/// Standard deviations within which a marker lies at its predicted position: 1 in 370 at random.
const EXPECTED_SIGMAS: f64 = 3.0;

impl WingView<'_> {
    /// Fits the state to identified detections; `None` if they are too few or do not fit.
    pub(super) fn fit_state(
        &self,
        detections: &[Detection],
        identities: &Identities,
    ) -> Option<StateFit> {
        self.fit_state_from(detections, identities, super::flight::MIN_IDENTIFIED)
    }

    /// Fits the state to at least `least` identified detections. Identities known from elsewhere, for example from manual
    /// marks, need no redundancy.
    fn fit_state_from(
        &self,
        detections: &[Detection],
        identities: &Identities,
        least: usize,
    ) -> Option<StateFit> {
        let pairs: Vec<MatchedPair> = identities
            .pairs()
            .into_iter()
            .filter(|(i, _)| detections.get(*i).is_some_and(is_usable))
            .collect();
        if pairs.len() < least {
            return None;
        }
        let prior = StatePrior::new(self, 0.0, ANY_DEFLECTION);
        fit_pairs(self, &pairs, detections, &prior, &prior.mean, SETTLED_PX)
    }

    /// Moves the identified markers' detections to the images of their true centres: the perspective bias of the ellipse is
    /// removed with the surveyed diameter and the local normal (docs/identification.md). The result has order and length of
    /// `detections`; unidentified ones are unchanged.
    pub fn remove_perspective_bias(
        &self,
        detections: &[Detection],
        identities: &Identities,
    ) -> Vec<Detection> {
        let Some(first) = self.fit_state(detections, identities) else {
            return detections.to_vec();
        };
        let once = correct_centres(self, &first.state, detections, identities);
        match self.fit_state(&once, identities) {
            Some(second) => correct_centres(self, &second.state, detections, identities),
            None => once,
        }
    }

    /// Predicts the markers of a frame for [`crate::detect::second_pass`], with the detections that were identified. Empty
    /// if too few are.
    pub fn predict_second_pass(
        &self,
        detections: &[Detection],
        identities: &Identities,
    ) -> Vec<ExpectedMarker> {
        let Some(fitted) = self.fit_state(detections, identities) else {
            return Vec::new();
        };
        let found = |marker| identities.marker_of.iter().position(|m| *m == Some(marker));
        let predicted = self.predict_each(&fitted.state, |marker, _| {
            let image = fitted.predicted[marker].as_ref()?;
            let search_px = image.sigma_px(&fitted.covariance) * EXPECTED_SIGMAS;
            Some((search_px, found(marker).is_some()))
        });
        let expected = |(marker, prediction): (usize, Option<MarkerPrediction>)| {
            Some(ExpectedMarker {
                prediction: prediction?,
                found: found(marker),
                marker,
            })
        };
        predicted
            .into_iter()
            .enumerate()
            .filter_map(expected)
            .collect()
    }

    /// Predicts the markers of a frame from observations of known identity, for example manual marks. One observation is
    /// enough, because none is needed to check the identities; without observations, the wing is predicted as on the
    /// ground. Markers outside the frame are omitted.
    pub fn predict_markers(&self, observations: &[Observation]) -> Vec<PredictedMarker> {
        let (seen, identities) = identified_detections(observations);
        let state = self
            .fit_state_from(&seen, &identities, 1)
            .map_or_else(WingState::zeros, |fitted| fitted.state);
        let markers = self
            .setup
            .markers
            .iter()
            .zip(self.marker_outlines(&state))
            .enumerate();
        let predicted = markers.filter_map(|(marker, (surveyed, outline))| {
            let outline = outline?;
            let seen = observations.iter().any(|o| o.marker == marker);
            // The neighbourhood of a point is drawn as a disc.
            let drawn = self.visible_prediction(Shape::Circle, &outline, Vector2::zeros(), seen)?;
            let prediction = MarkerPrediction {
                shape: surveyed.shape,
                ..drawn
            };
            Some(PredictedMarker {
                marker,
                prediction,
                point_px: outline.point_px,
            })
        });
        predicted.collect()
    }

    /// Moves a marker's measured outline to the image of the marker's centre. The state of the wing is fitted to the
    /// observations and this outline.
    pub fn correct_marker_centre(
        &self,
        observations: &[Observation],
        marker: usize,
        found: &Detection,
    ) -> Detection {
        let others: Vec<Observation> = observations
            .iter()
            .filter(|o| o.marker != marker)
            .cloned()
            .collect();
        let (mut seen, mut identities) = identified_detections(&others);
        seen.push(found.clone());
        identities.marker_of.push(Some(marker));
        let Some(fitted) = self.fit_state_from(&seen, &identities, 1) else {
            return found.clone();
        };
        correct_centres(self, &fitted.state, &seen, &identities)
            .pop()
            .unwrap_or_else(|| found.clone())
    }

    /// Predicts the markers of the next frame, found or not, from the identities of a frame, if the deflection of the tip
    /// may change by `deflection_m`, m. Empty if too few detections are identified.
    pub fn predict_next_frame(
        &self,
        detections: &[Detection],
        identities: &Identities,
        deflection_m: f64,
    ) -> Vec<MarkerPrediction> {
        let Some(StateFit { state, .. }) = self.fit_state(detections, identities) else {
            return Vec::new();
        };
        let mut deflected = state;
        deflected[0] += self.wing.curvature_per_m(deflection_m);
        let moved = self.project_markers(&deflected);
        let predicted = self.predict_each(&state, |marker, outline| {
            let travel = moved[marker].map_or(0.0, |m| (m - outline.point_px).norm());
            let seen = identities.marker_of.contains(&Some(marker));
            Some((Vector2::repeat(travel + NEXT_SHIFT_PX), seen))
        });
        predicted.into_iter().flatten().collect()
    }

    /// Predicts each marker at a state, given the largest deviation of its image and whether it was seen.
    pub(super) fn predict_each(
        &self,
        state: &WingState,
        search: impl Fn(usize, &DiscOutline) -> Option<(Vector2<f64>, bool)>,
    ) -> Vec<Option<MarkerPrediction>> {
        let markers = self.setup.markers.iter().zip(self.marker_outlines(state));
        let one = |(marker, (surveyed, outline)): (usize, (&SurveyMarker, Option<DiscOutline>))| {
            let outline = outline?;
            let (search_px, seen) = search(marker, &outline)?;
            self.visible_prediction(surveyed.shape, &outline, search_px, seen)
        };
        markers.enumerate().map(one).collect()
    }

    /// Returns the prediction of a marker if its image is in the frame.
    fn visible_prediction(
        &self,
        shape: Shape,
        outline: &DiscOutline,
        search_px: Vector2<f64>,
        seen: bool,
    ) -> Option<MarkerPrediction> {
        // Points have no outline that a detector could measure.
        (shape != Shape::Point && self.setup.lens.contains(&outline.ellipse_px)).then_some(
            MarkerPrediction {
                shape,
                centre_px: outline.ellipse_px,
                semi_major_px: outline.semi_major_px,
                semi_minor_px: outline.semi_minor_px,
                angle_rad: outline.angle_rad,
                search_px,
                seen,
            },
        )
    }
}

/// Converts observations to detections with identities. They have the shape of quadrant targets, for which no perspective
/// bias is removed.
fn identified_detections(observations: &[Observation]) -> (Vec<Detection>, Identities) {
    let detection = |o: &Observation| Detection {
        shape: Shape::Quadrant,
        centre_px: o.pixel,
        covariance_px2: o.covariance_px2.into(),
        semi_major_px: 1.0,
        semi_minor_px: 1.0,
        angle_rad: 0.0,
        fit_rms: 0.0,
        contrast: 0.0,
        marker: None,
    };
    let marker_of = observations.iter().map(|o| Some(o.marker)).collect();
    (
        observations.iter().map(detection).collect(),
        Identities {
            marker_of,
            ..Identities::default()
        },
    )
}
