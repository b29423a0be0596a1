//! State of the wing for known identities, and predictions from it.

use nalgebra::Vector2;

use super::beam::WingState;
use super::bias::correct_centres;
use super::fit::{Clutter, MatchedPair, StatePrior, solve_step};
use super::outline::DiscOutline;
use super::scene::{WingView, is_usable};
use super::{Identities, PredictedMarker};
use crate::detect::{Detection, ExpectedMarker, MarkerPrediction};
use crate::observation::Observation;
use crate::setup::Shape;

/// Prior standard deviations of the wing state if the identities are known: three terms of the curvature, 1/m, two of the
/// twist, rad. Larger than any wing bends.
const WING_SIGMAS: [f64; 5] = [0.01, 0.005, 0.005, 0.06, 0.05];
/// Maximum number of linear steps; four or five are typical.
const MAX_STEPS: usize = 15;
/// Step of the state at convergence, 1/m and rad: 0.001 px.
const SETTLED: f64 = 1e-7;

/// Largest shift of the image until the next frame, px.
const NEXT_SHIFT_PX: f64 = 8.0;

/// Fits the state to identified detections; `None` if they are too few or do not fit.
pub(super) fn fit_state(scene: &WingView<'_>, detections: &[Detection], identities: &Identities) -> Option<WingState> {
    fit_state_from(scene, detections, identities, super::flight::MIN_IDENTIFIED)
}

/// Fits the state to at least `least` identified detections. Identities known from elsewhere, for example from manual
/// marks, need no redundancy.
fn fit_state_from(
    scene: &WingView<'_>,
    detections: &[Detection],
    identities: &Identities,
    least: usize,
) -> Option<WingState> {
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
    let [x, y, z] = scene.turn_sigmas();
    let sigma = WingState::from([a, b, c, d, e, x, y, z]);
    let prior = StatePrior { mean: WingState::zeros(), sigma };
    let mut state = prior.mean;
    for _ in 0..MAX_STEPS {
        let predicted = scene.linearise(&state);
        let step = solve_step(&pairs, &predicted, detections, &prior, &state, Clutter::new(0, &scene.setup.lens))?;
        state += step.delta;
        if step.delta.amax() < SETTLED {
            break;
        }
    }
    state.iter().all(|v| v.is_finite()).then_some(state)
}

/// Removes the perspective bias; see [`super::remove_perspective_bias`].
pub(super) fn remove_bias(scene: &WingView<'_>, detections: &[Detection], identities: &Identities) -> Vec<Detection> {
    let Some(first) = fit_state(scene, detections, identities) else { return detections.to_vec() };
    let once = correct_centres(scene, &first, detections, identities);
    match fit_state(scene, &once, identities) {
        Some(second) => correct_centres(scene, &second, detections, identities),
        None => once,
    }
}

/// Predicts the markers for a second pass; see [`super::predict_second_pass`].
pub(super) fn predict_second_pass(
    scene: &WingView<'_>,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<ExpectedMarker> {
    let Some(state) = fit_state(scene, detections, identities) else { return Vec::new() };
    let markers = scene.setup.markers.iter().zip(scene.marker_outlines(&state)).enumerate();
    let expected = markers.filter_map(|(i, (marker, outline))| {
        let found = identities.marker_of.iter().position(|m| *m == Some(i));
        Some(ExpectedMarker {
            prediction: visible_prediction(scene, marker.shape, &outline?, Vector2::zeros(), found.is_some())?,
            found,
            marker: i,
        })
    });
    expected.collect()
}

/// Predicts the markers from observations; see [`super::predict_markers`].
pub(super) fn predict_markers(scene: &WingView<'_>, observations: &[Observation]) -> Vec<PredictedMarker> {
    let (seen, identities) = identified_detections(observations);
    let state = fit_state_from(scene, &seen, &identities, 1).unwrap_or_else(WingState::zeros);
    let markers = scene.setup.markers.iter().zip(scene.marker_outlines(&state)).enumerate();
    let predicted = markers.filter_map(|(marker, (surveyed, outline))| {
        let outline = outline?;
        let seen = observations.iter().any(|o| o.marker == marker);
        let prediction = visible_prediction(scene, surveyed.shape, &outline, Vector2::zeros(), seen)?;
        Some(PredictedMarker { marker, prediction, point_px: outline.point_px })
    });
    predicted.collect()
}

/// Corrects a marker's centre; see [`super::correct_marker_centre`].
pub(super) fn correct_marker_centre(
    scene: &WingView<'_>,
    observations: &[Observation],
    marker: usize,
    found: &Detection,
) -> Detection {
    let others: Vec<Observation> = observations.iter().filter(|o| o.marker != marker).cloned().collect();
    let (mut seen, mut identities) = identified_detections(&others);
    seen.push(found.clone());
    identities.marker_of.push(Some(marker));
    let Some(state) = fit_state_from(scene, &seen, &identities, 1) else { return found.clone() };
    correct_centres(scene, &state, &seen, &identities).pop().unwrap_or_else(|| found.clone())
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
    };
    let marker_of = observations.iter().map(|o| Some(o.marker)).collect();
    (observations.iter().map(detection).collect(), Identities { marker_of, ..Identities::default() })
}

/// Returns the prediction of a marker if its image is in the frame.
pub(super) fn visible_prediction(
    scene: &WingView<'_>,
    shape: Shape,
    outline: &DiscOutline,
    search_px: Vector2<f64>,
    seen: bool,
) -> Option<MarkerPrediction> {
    scene.setup.lens.contains(&outline.ellipse_px).then_some(MarkerPrediction {
        shape,
        centre_px: outline.ellipse_px,
        semi_major_px: outline.semi_major_px,
        semi_minor_px: outline.semi_minor_px,
        angle_rad: outline.angle_rad,
        search_px,
        seen,
    })
}

/// Predicts the markers of the next frame; see [`super::predict_next_frame_within`].
pub(super) fn predict_next_frame(
    scene: &WingView<'_>,
    detections: &[Detection],
    identities: &Identities,
    deflection_m: f64,
) -> Vec<MarkerPrediction> {
    let Some(state) = fit_state(scene, detections, identities) else { return Vec::new() };
    let mut deflected = state;
    // Curvature that decreases to 0 at the tip: the typical effect of a change of load.
    deflected[0] += 3.0 * deflection_m / scene.beam.length_m.powi(2);
    let moved = scene.project_markers(&deflected);
    let markers = scene.setup.markers.iter().zip(scene.marker_outlines(&state)).zip(moved);
    markers
        .enumerate()
        .filter_map(|(i, ((marker, outline), moved))| {
            let outline = outline?;
            let travel = moved.map_or(0.0, |m| (m - outline.point_px).norm());
            let seen = identities.marker_of.contains(&Some(i));
            visible_prediction(scene, marker.shape, &outline, Vector2::repeat(travel + NEXT_SHIFT_PX), seen)
        })
        .collect()
}
