//! Guided search for the markers of a frame, from the nearest outwards: markers near the camera hardly move, and each
//! marker found improves the prediction of the next ones. No other frame is used.

use super::Identities;
use super::beam::WingState;
use super::fit::StatePrior;
use super::flight::{MIN_IDENTIFIED, find_solutions};
use super::matching::{MatchingProblem, RefinedMatch};
use super::points::{PatchNodes, PatchPrediction};
use super::scan::DEFLECTION_RANGE;
use super::scene::{Matrix8, WingView};
use crate::detect::{Detection, MarkerPrediction};
use crate::ordering::sort_by_value;

/// Search radii in standard deviations: of a uniform prior, and of a fitted state.
const SEARCH_SIGMAS: (f64, f64) = (2.0, 4.0);
/// Smallest search radius, px: error of the simple beam.
const MIN_DIAMETER_PX: f64 = 10.0;
/// Minimum number of markers of the first round, nearest first: four determine a state, and one may be hidden.
const MIN_FIRST_ROUND: usize = 5;
/// Minimum number of markers of a later round.
const MIN_LATER_ROUND: usize = 3;
/// Search radius below which a marker is searched for in any number, px: the area is hardly larger than a marker.
const NEAR_PX: f64 = 60.0;
/// Search radius at which all markers are searched for together, px.
const SETTLED_PX: f64 = 40.0;
/// Distance below which two detections are equal, px.
const MIN_SEPARATION_PX: f64 = 3.0;
/// Relative variation of the curvature's shape along the span between wings, as in [`super::scan`].
const SHAPE_FRACTION: f64 = 0.5;
/// Standard deviation of the tip's twist, rad, as in [`super::scan`].
const TWIST_RAD: f64 = 0.06;
/// Half the range of the tip's deflection over the span within which a patch looks similar: it changes the length of a patch
/// seen at grazing incidence by a fifth.
const PATCH_DEFLECTION: f64 = 0.02;
/// Tip deflection over the span of a transport aircraft in cruise.
const CRUISE_DEFLECTION: f64 = 0.05;

impl WingView<'_> {
    /// Returns the prior before any detection: the wing may be bent as far as the identification scans.
    fn search_prior(&self) -> StatePrior {
        let span = self.beam.length_m;
        let (low, high) = DEFLECTION_RANGE;
        // A curvature c that decreases to 0 at the tip deflects the tip by c / 3 times the span squared.
        let [middle, half] =
            [0.5 * (low + high), 0.5 * (high - low)].map(|deflection| 3.0 * deflection / span);
        let bend = half / SEARCH_SIGMAS.0;
        let [x, y, z] = self.turn_sigmas();
        let shape = SHAPE_FRACTION * bend;
        let mean = WingState::from([middle, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let sigma = WingState::from([bend, shape, shape, TWIST_RAD, TWIST_RAD, x, y, z]);
        StatePrior { mean, sigma }
    }

    /// Predicts the image of each marker for a state with a covariance.
    fn predict_by_marker(
        &self,
        state: &WingState,
        covariance: &Matrix8,
        sigmas: f64,
    ) -> Vec<Option<MarkerPrediction>> {
        let markers = self
            .setup
            .markers
            .iter()
            .zip(self.marker_outlines(state))
            .zip(self.linearise(state));
        markers
            .map(|((marker, outline), predicted)| {
                let predicted = predicted?;
                let off = predicted.sigma_px(covariance) * sigmas;
                self.visible_prediction(
                    marker.shape,
                    &outline?,
                    off.add_scalar(MIN_DIAMETER_PX),
                    true,
                )
            })
            .collect()
    }

    /// Predicts the markers that [`WingView::locate_markers`] searches for first.
    pub fn predict_nearest(&self) -> Vec<MarkerPrediction> {
        let prior = self.search_prior();
        let predicted_by_marker =
            self.predict_by_marker(&prior.mean, &prior.covariance_matrix(), SEARCH_SIGMAS.0);
        let first = next_markers(
            &predicted_by_marker,
            &vec![false; predicted_by_marker.len()],
            MIN_FIRST_ROUND,
        );
        first
            .into_iter()
            .filter_map(|j| predicted_by_marker[j].clone())
            .collect()
    }

    /// Searches for the markers of a frame, the nearest to the camera first; each round predicts the next markers.
    /// `detect_at` detects markers in predicted areas, as [`crate::detect::detect_guided`] does. Returns predictions of all
    /// markers, or `None` if the search fails.
    pub fn locate_markers(
        &self,
        detect_at: impl FnMut(&[MarkerPrediction]) -> Vec<Detection>,
    ) -> Option<Vec<MarkerPrediction>> {
        let predict = |state: &WingState, covariance: &Matrix8, sigmas: f64| {
            self.predict_by_marker(state, covariance, sigmas)
        };
        let located = self.locate(
            self.search_prior(),
            Vec::new(),
            predict,
            SETTLED_PX,
            detect_at,
        )?;
        Some(located.into_iter().flatten().collect())
    }

    /// Returns deflections of the tip over the span that a wing can have, the most frequent in flight first; the patches of
    /// points look similar within [`PATCH_DEFLECTION`] of each.
    pub fn patch_deflections() -> Vec<f64> {
        let step = 1.5 * PATCH_DEFLECTION;
        let count = |limit: f64| (limit / step).ceil() as i32;
        let mut all: Vec<f64> = (count(DEFLECTION_RANGE.0)..=count(DEFLECTION_RANGE.1))
            .map(|k| step * f64::from(k))
            .collect();
        sort_by_value(&mut all, |deflection| {
            (deflection - CRUISE_DEFLECTION).abs()
        });
        all
    }

    /// Returns the prior of a wing whose tip is deflected by about `deflection` spans.
    fn patch_prior(&self, deflection: f64) -> StatePrior {
        let span = self.beam.length_m;
        let [mean, half] = [deflection, PATCH_DEFLECTION].map(|part| 3.0 * part / span);
        let bend = half / SEARCH_SIGMAS.0;
        let shape = SHAPE_FRACTION * (bend + mean.abs());
        let [x, y, z] = self.turn_sigmas();
        let sigma = WingState::from([
            bend + 0.2 * mean.abs(),
            shape,
            shape,
            TWIST_RAD,
            TWIST_RAD,
            x,
            y,
            z,
        ]);
        StatePrior {
            mean: WingState::from([mean, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
            sigma,
        }
    }

    /// Locates points as [`Self::locate_markers`] does markers, in addition to the markers `found`, on a wing whose tip is
    /// deflected by about `deflection` spans. `match_at` returns the places at which the patches of a point may be.
    pub fn locate_points(
        &self,
        patches: &PatchNodes,
        deflection: f64,
        found: Vec<Detection>,
        match_at: impl FnMut(&[Vec<PatchPrediction>]) -> Vec<Detection>,
    ) -> Option<Vec<PatchPrediction>> {
        let predict = |state: &WingState, covariance: &Matrix8, sigmas: f64| {
            self.predict_patches_by_marker(patches, state, covariance, sigmas)
        };
        let located = self.locate(self.patch_prior(deflection), found, predict, 0.0, match_at)?;
        Some(located.into_iter().flatten().flatten().collect())
    }

    /// Searches for markers until all predictions have a search radius below `settled_px`, or all markers were searched for.
    fn locate<T: PredictedArea>(
        &self,
        prior: StatePrior,
        mut found: Vec<Detection>,
        predict: impl Fn(&WingState, &Matrix8, f64) -> Vec<Option<T>>,
        settled_px: f64,
        mut detect_at: impl FnMut(&[T]) -> Vec<Detection>,
    ) -> Option<Vec<Option<T>>> {
        let mut predicted_by_marker =
            predict(&prior.mean, &prior.covariance_matrix(), SEARCH_SIGMAS.0);
        let mut searched = vec![false; predicted_by_marker.len()];
        let mut last: Option<RefinedMatch> = None;
        loop {
            let least = if searched.contains(&true) {
                MIN_LATER_ROUND
            } else {
                MIN_FIRST_ROUND
            };
            let next = next_markers(&predicted_by_marker, &searched, least);
            if next.is_empty() {
                return last.map(|_| predicted_by_marker);
            }
            let targets: Vec<T> = next
                .iter()
                .filter_map(|&j| predicted_by_marker[j].clone())
                .collect();
            next.iter().for_each(|&j| searched[j] = true);
            for new in detect_at(&targets) {
                let is_new = |old: &Detection| {
                    old.marker != new.marker
                        || (old.centre_px - new.centre_px).norm() > MIN_SEPARATION_PX
                };
                if found.iter().all(is_new) {
                    found.push(new);
                }
            }
            if found.len() < MIN_IDENTIFIED {
                continue;
            }
            let problem = MatchingProblem::new(self, &found);
            // Detections are only appended, so earlier pairs stay valid.
            let further = last
                .as_ref()
                .and_then(|last| problem.refine(&last.prior, &last.pairs));
            let Some(best) = further.or_else(|| find_solutions(&problem).into_iter().next()) else {
                continue;
            };
            predicted_by_marker = predict(&best.state, &best.covariance, SEARCH_SIGMAS.1);
            if predicted_by_marker
                .iter()
                .flatten()
                .all(|p| p.radius_px() < settled_px)
            {
                return Some(predicted_by_marker);
            }
            last = Some(best);
        }
    }

    /// Predicts all markers of a frame from `found` detections near the camera, where the wing hardly moves. Markers of
    /// `identities`, from an earlier frame, are predicted as visible. Returns `None` if the detections do not fit the wing.
    pub fn predict_from_found(
        &self,
        found: &[Detection],
        identities: &Identities,
    ) -> Option<Vec<MarkerPrediction>> {
        if found.len() < MIN_IDENTIFIED {
            return None;
        }
        let best = find_solutions(&MatchingProblem::new(self, found))
            .into_iter()
            .next()?;
        let predicted_by_marker =
            self.predict_by_marker(&best.state, &best.covariance, SEARCH_SIGMAS.1);
        let known = |(j, p): (usize, Option<MarkerPrediction>)| {
            Some(MarkerPrediction {
                seen: identities.marker_of.contains(&Some(j)),
                ..p?
            })
        };
        Some(
            predicted_by_marker
                .into_iter()
                .enumerate()
                .filter_map(known)
                .collect(),
        )
    }
}

/// Predicted image of a marker or point with the area in which it is searched for.
pub(super) trait PredictedArea: Clone {
    /// Returns half the larger side of the area, px.
    fn radius_px(&self) -> f64;
}

impl PredictedArea for MarkerPrediction {
    fn radius_px(&self) -> f64 {
        self.search_px.amax()
    }
}

impl PredictedArea for Vec<PatchPrediction> {
    fn radius_px(&self) -> f64 {
        self.first().map_or(f64::INFINITY, |p| p.search_px.amax())
    }
}

/// Returns the next markers to search for, at least `least`, those with the smallest search radius first.
fn next_markers<T: PredictedArea>(
    predicted_by_marker: &[Option<T>],
    searched: &[bool],
    least: usize,
) -> Vec<usize> {
    let far = |j: usize| {
        predicted_by_marker[j]
            .as_ref()
            .map_or(f64::INFINITY, PredictedArea::radius_px)
    };
    let mut open: Vec<usize> = (0..predicted_by_marker.len())
        .filter(|&j| !searched[j] && predicted_by_marker[j].is_some())
        .collect();
    sort_by_value(&mut open, |&i| far(i));
    let enough = open
        .iter()
        .filter(|&&j| far(j) < NEAR_PX)
        .count()
        .max(least);
    open.truncate(enough);
    open
}
