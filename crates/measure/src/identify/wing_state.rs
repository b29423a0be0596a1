//! State of the wing for known identities, and predictions from it.

use nalgebra::Vector2;

use super::beam::WingState;
use super::bias::correct_centres;
use super::fit::{Clutter, MatchedPair, StatePrior, solve_step};
use super::outline::DiscOutline;
use super::scene::{Matrix8, PredictedImage, WingView, is_usable};
use super::{Identities, PredictedMarker};
use crate::detect::{Detection, ExpectedMarker, MarkerPrediction};
use crate::observation::Observation;
use crate::setup::Shape;

/// Prior standard deviations of the wing state if the identities are known: three terms of the curvature, 1/m, two of the
/// twist, rad. Larger than any wing bends.
pub(super) const WING_SIGMAS: [f64; 5] = [0.01, 0.005, 0.005, 0.06, 0.05];
/// Maximum number of linear steps; four or five are typical.
const MAX_STEPS: usize = 15;
/// Step of the state at convergence, 1/m and rad: 0.001 px.
const SETTLED: f64 = 1e-7;

/// Largest shift of the image until the next frame, px.
const NEXT_SHIFT_PX: f64 = 8.0;
/// Standard deviations within which a marker lies at its predicted position: 1 in 370 at random.
const EXPECTED_SIGMAS: f64 = 3.0;

/// State fitted to identified detections.
pub(super) struct FittedState {
    pub(super) state: WingState,
    pub(super) covariance: Matrix8,
    /// Predicted images of the markers.
    pub(super) images: Vec<Option<PredictedImage>>,
}

impl WingView<'_> {
    /// Fits the state to identified detections; `None` if they are too few or do not fit.
    pub(super) fn fit_state(
        &self,
        detections: &[Detection],
        identities: &Identities,
    ) -> Option<FittedState> {
        self.fit_state_from(detections, identities, super::flight::MIN_IDENTIFIED)
    }

    /// Fits the state to at least `least` identified detections. Identities known from elsewhere, for example from manual
    /// marks, need no redundancy.
    fn fit_state_from(
        &self,
        detections: &[Detection],
        identities: &Identities,
        least: usize,
    ) -> Option<FittedState> {
        let pairs: Vec<MatchedPair> = identities
            .marker_of
            .iter()
            .enumerate()
            .filter_map(|(i, j)| Some((i, (*j)?)))
            .filter(|(i, _)| detections.get(*i).is_some_and(is_usable))
            .collect();
        if pairs.len() < least {
            return None;
        }
        let [a, b, c, d, e] = WING_SIGMAS;
        let [x, y, z] = self.turn_sigmas();
        let sigma = WingState::from([a, b, c, d, e, x, y, z]);
        let prior = StatePrior {
            mean: WingState::zeros(),
            sigma,
        };
        let mut fitted = FittedState {
            state: prior.mean,
            covariance: Matrix8::zeros(),
            images: Vec::new(),
        };
        for _ in 0..MAX_STEPS {
            fitted.images = self.linearise(&fitted.state);
            let clutter = Clutter::new(0, &self.setup.lens);
            let step = solve_step(
                &pairs,
                &fitted.images,
                detections,
                &prior,
                &fitted.state,
                clutter,
            )?;
            fitted.state += step.delta;
            fitted.covariance = step.covariance;
            if step.delta.amax() < SETTLED {
                break;
            }
        }
        fitted.state.iter().all(|v| v.is_finite()).then_some(fitted)
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
        let markers = self
            .setup
            .markers
            .iter()
            .zip(self.marker_outlines(&fitted.state))
            .zip(&fitted.images)
            .enumerate();
        let expected = markers.filter_map(|(i, ((marker, outline), image))| {
            let found = identities.marker_of.iter().position(|m| *m == Some(i));
            let search_px = image.as_ref()?.sigma_px(&fitted.covariance) * EXPECTED_SIGMAS;
            Some(ExpectedMarker {
                prediction: self.visible_prediction(
                    marker.shape,
                    &outline?,
                    search_px,
                    found.is_some(),
                )?,
                found,
                marker: i,
            })
        });
        expected.collect()
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
        let Some(FittedState { state, .. }) = self.fit_state(detections, identities) else {
            return Vec::new();
        };
        let mut deflected = state;
        // Curvature that decreases to 0 at the tip: the typical effect of a change of load.
        deflected[0] += 3.0 * deflection_m / self.beam.length_m.powi(2);
        let moved = self.project_markers(&deflected);
        let markers = self
            .setup
            .markers
            .iter()
            .zip(self.marker_outlines(&state))
            .zip(moved);
        markers
            .enumerate()
            .filter_map(|(i, ((marker, outline), moved))| {
                let outline = outline?;
                let travel = moved.map_or(0.0, |m| (m - outline.point_px).norm());
                let seen = identities.marker_of.contains(&Some(i));
                self.visible_prediction(
                    marker.shape,
                    &outline,
                    Vector2::repeat(travel + NEXT_SHIFT_PX),
                    seen,
                )
            })
            .collect()
    }

    /// Returns the prediction of a marker if its image is in the frame.
    pub(super) fn visible_prediction(
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
