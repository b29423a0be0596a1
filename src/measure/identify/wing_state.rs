//! With the identities known: the state of the wing, and what follows from it.

use nalgebra::Vector2;

use super::beam::State;
use super::bias::correct_centres;
use super::fit::{Clutter, Pair, Prior, solve_step};
use super::outline::Outline;
use super::scene::{Scene, is_usable};
use super::{Identities, PredictedMarker};
use crate::detect::{Detection, ExpectedMarker, MarkerPrediction};
use crate::observation::Observation;
use crate::setup::Shape;

/// What a wing may do where its markers are known, standard deviations: three terms of the curvature, 1/m, two of the twist,
/// rad. Wider than any wing bends.
const WING_SIGMAS: [f64; 5] = [0.01, 0.005, 0.005, 0.06, 0.05];
/// Linear steps at most; they settle in four or five.
const MAX_STEPS: usize = 15;
/// A step of the state that no longer matters, 1/m and rad: 0.001 px.
const SETTLED: f64 = 1e-7;

/// How far the image may shift, px.
const NEXT_SHIFT_PX: f64 = 8.0;

/// The state that fits identified detections, and `None` where they are too few or do not fit.
pub(super) fn fit_state(
    scene: &Scene<'_>,
    detections: &[Detection],
    identities: &Identities,
) -> Option<State> {
    fit_state_from(scene, detections, identities, super::flight::MIN_IDENTIFIED)
}

/// The same from so many detections at least: names that nobody guessed need none to check them by.
fn fit_state_from(
    scene: &Scene<'_>,
    detections: &[Detection],
    identities: &Identities,
    least: usize,
) -> Option<State> {
    let pairs: Vec<Pair> = identities
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
    let sigma = State::from([a, b, c, d, e, x, y, z]);
    let prior = Prior { mean: State::zeros(), sigma };
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

/// See [`super::remove_perspective_bias`].
pub(super) fn remove_bias(
    scene: &Scene<'_>,
    detections: &[Detection],
    identities: &Identities,
) -> Vec<Detection> {
    let Some(first) = fit_state(scene, detections, identities) else { return detections.to_vec() };
    let once = correct_centres(scene, &first, detections, identities);
    match fit_state(scene, &once, identities) {
        Some(second) => correct_centres(scene, &second, detections, identities),
        None => once,
    }
}

/// See [`super::expect`].
pub(super) fn predict_second_pass(
    scene: &Scene<'_>,
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

/// See [`super::foretell`].
pub(super) fn predict_markers(scene: &Scene<'_>, observations: &[Observation]) -> Vec<PredictedMarker> {
    let (seen, identities) = identified_detections(observations);
    let state = fit_state_from(scene, &seen, &identities, 1).unwrap_or_else(State::zeros);
    let markers = scene.setup.markers.iter().zip(scene.marker_outlines(&state)).enumerate();
    let foretold = markers.filter_map(|(marker, (surveyed, outline))| {
        let outline = outline?;
        let seen = observations.iter().any(|o| o.marker == marker);
        let prediction = visible_prediction(scene, surveyed.shape, &outline, Vector2::zeros(), seen)?;
        Some(PredictedMarker { marker, prediction, point_px: outline.point_px })
    });
    foretold.collect()
}

/// See [`super::centre_of`].
pub(super) fn correct_marker_centre(
    scene: &Scene<'_>,
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

/// Observations as detections with names. They are centres already: as crossings no bias is taken from them.
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

/// A marker's image, if it lies in the frame.
pub(super) fn visible_prediction(
    scene: &Scene<'_>,
    shape: Shape,
    outline: &Outline,
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

/// See [`super::predict_within`].
pub(super) fn predict_next_frame(
    scene: &Scene<'_>,
    detections: &[Detection],
    identities: &Identities,
    deflection_m: f64,
) -> Vec<MarkerPrediction> {
    let Some(state) = fit_state(scene, detections, identities) else { return Vec::new() };
    let mut deflected = state;
    // Curvature that falls to 0 at the tip: the usual change of a load.
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
