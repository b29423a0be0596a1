//! Where a frame shows the markers, from the nearest outwards: those near the camera hardly move, and each one that is found
//! tells better where the next ones are. Nothing is known of any other frame.

use nalgebra::Vector2;

use super::beam::State;
use super::fit::Prior;
use super::flight::{MIN_IDENTIFIED, find_solutions};
use super::matching::{Problem, Refined};
use super::scan::DEFLECTION_RANGE;
use super::scene::{Matrix8, Scene};
use super::wing_state::visible_prediction;
use crate::detect::{Detection, MarkerPrediction};

/// Standard deviations within which a marker is sought: before anything is known, of a range that is as likely everywhere; and of
/// a fitted state.
const SEARCH_SIGMAS: (f64, f64) = (2.0, 4.0);
/// Least by which a marker may be off its prediction, px: what the simple beam leaves.
const MIN_DIAMETER_PX: f64 = 10.0;
/// Markers of the first round at least, nearest first: four tell a state, and one may be hidden.
const MIN_FIRST_ROUND: usize = 5;
/// Markers of a later round at least.
const MIN_LATER_ROUND: usize = 3;
/// How far a marker may be off to be sought whatever the number, px: what then is searched is hardly larger than a marker.
const NEAR_PX: f64 = 60.0;
/// How far markers may be off where all of them are sought together, px.
const SETTLED_PX: f64 = 40.0;
/// Two detections nearer to each other are one, px.
pub const MIN_SEPARATION_PX: f64 = 3.0;
/// Share of a curvature by which its shape along the span differs from wing to wing, as [`super::scan`] allows for.
const SHAPE_FRACTION: f64 = 0.5;
/// Twist of the tip, rad, standard deviation, as there.
const TWIST_RAD: f64 = 0.06;

/// What is known before a frame is looked at: the wing may be bent as far as the identification scans.
fn search_prior(scene: &Scene<'_>) -> Prior {
    let span = scene.beam.length_m;
    let (low, high) = DEFLECTION_RANGE;
    // Curvature that falls to 0 at the tip deflections that by a third of it times the span squared.
    let [middle, half] = [0.5 * (low + high), 0.5 * (high - low)].map(|deflection| 3.0 * deflection / span);
    let bend = half / SEARCH_SIGMAS.0;
    let [x, y, z] = scene.turn_sigmas();
    let shape = SHAPE_FRACTION * bend;
    let mean = State::from([middle, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let sigma = State::from([bend, shape, shape, TWIST_RAD, TWIST_RAD, x, y, z]);
    Prior { mean, sigma }
}

/// Where the markers are expected in a state that is known so well; by marker.
fn predict_by_marker(scene: &Scene<'_>, state: &State, covariance: &Matrix8, sigmas: f64) -> Vec<Option<MarkerPrediction>> {
    let markers = scene.setup.markers.iter().zip(scene.marker_outlines(state)).zip(scene.linearise(state));
    markers
        .map(|((marker, outline), predicted)| {
            let predicted = predicted?;
            let spread =
                predicted.jacobian * covariance * predicted.jacobian.transpose() + predicted.covariance;
            let off = Vector2::new(spread[(0, 0)], spread[(1, 1)]).map(|v| sigmas * v.max(0.0).sqrt());
            visible_prediction(scene, marker.shape, &outline?, off.add_scalar(MIN_DIAMETER_PX), true)
        })
        .collect()
}

/// See [`super::nearest`].
pub(super) fn predict_nearest(scene: &Scene<'_>) -> Vec<MarkerPrediction> {
    let prior = search_prior(scene);
    let where_to = predict_by_marker(scene, &prior.mean, &prior.covariance(), SEARCH_SIGMAS.0);
    let first = next_markers(&where_to, &vec![false; where_to.len()], MIN_FIRST_ROUND);
    first.into_iter().filter_map(|j| where_to[j].clone()).collect()
}

/// See [`super::locate`].
pub(super) fn locate_markers(
    scene: &Scene<'_>,
    mut look: impl FnMut(&[MarkerPrediction]) -> Vec<Detection>,
) -> Option<Vec<MarkerPrediction>> {
    let prior = search_prior(scene);
    let mut where_to = predict_by_marker(scene, &prior.mean, &prior.covariance(), SEARCH_SIGMAS.0);
    let mut looked = vec![false; where_to.len()];
    let mut found: Vec<Detection> = Vec::new();
    let mut last: Option<Refined> = None;
    loop {
        let next = next_markers(&where_to, &looked, if looked.contains(&true) { MIN_LATER_ROUND } else { MIN_FIRST_ROUND });
        if next.is_empty() {
            return last.map(|_| where_to.into_iter().flatten().collect());
        }
        let sought: Vec<MarkerPrediction> = next.iter().filter_map(|&j| where_to[j].clone()).collect();
        next.iter().for_each(|&j| looked[j] = true);
        for new in look(&sought) {
            let is_new = |old: &Detection| (old.centre_px - new.centre_px).norm() > MIN_SEPARATION_PX;
            if found.iter().all(is_new) {
                found.push(new);
            }
        }
        if found.len() < MIN_IDENTIFIED {
            continue;
        }
        let problem = Problem::new(scene, &found);
        // What was found stays where it is in the list, and so do its pairs.
        let further = last.as_ref().and_then(|last| problem.refine(&last.prior, &last.pairs));
        let Some(best) = further.or_else(|| find_solutions(&problem).into_iter().next()) else { continue };
        where_to = predict_by_marker(scene, &best.state, &best.covariance, SEARCH_SIGMAS.1);
        let settled = |p: &MarkerPrediction| p.search_px.amax() < SETTLED_PX;
        if where_to.iter().flatten().all(settled) {
            return Some(where_to.into_iter().flatten().collect());
        }
        last = Some(best);
    }
}

/// See [`super::onwards`].
pub(super) fn predict_from_found(
    scene: &Scene<'_>,
    found: &[Detection],
    seen: &[Option<usize>],
) -> Option<Vec<MarkerPrediction>> {
    if found.len() < MIN_IDENTIFIED {
        return None;
    }
    let best = find_solutions(&Problem::new(scene, found)).into_iter().next()?;
    let where_to = predict_by_marker(scene, &best.state, &best.covariance, SEARCH_SIGMAS.1).into_iter().enumerate();
    let known =
        |(j, p): (usize, Option<MarkerPrediction>)| Some(MarkerPrediction { seen: seen.contains(&Some(j)), ..p? });
    Some(where_to.filter_map(known).collect())
}

/// The markers to be looked for next: at least so many that have not been, those first whose place is known best.
fn next_markers(where_to: &[Option<MarkerPrediction>], looked: &[bool], least: usize) -> Vec<usize> {
    let far = |j: usize| where_to[j].as_ref().map_or(f64::INFINITY, |p| p.search_px.amax());
    let mut open: Vec<usize> = (0..where_to.len()).filter(|&j| !looked[j] && where_to[j].is_some()).collect();
    open.sort_by(|&i, &j| far(i).total_cmp(&far(j)));
    let enough = open.iter().filter(|&&j| far(j) < NEAR_PX).count().max(least);
    open.truncate(enough);
    open
}
