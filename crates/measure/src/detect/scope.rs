//! Searched part of a frame: all of it, or the surroundings of predicted markers.

use nalgebra::Vector2;

use crate::detect::accept::{found::FoundMarkers, verdict::MeasuredMarker};
use crate::detect::detection::{Detection, MarkerPrediction};
use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::{ellipse::Ellipse, noise};
use crate::detect::segment::windows::{self, SearchArea, SearchWindow};
use crate::ordering::sort_by_value;
use crate::setup::Shape;
use crate::tiles::Tiles;

/// Largest ratio of a marker's axes to the predicted ones. Chosen, as are the next ones; `tests/detect/guided.rs`.
const MAX_AXIS_RATIO: f64 = 1.3;
/// Additional difference of axes, px: for a thin disc's minor axis.
const AXIS_MARGIN_PX: f64 = 1.0;
/// Smallest visible fraction of a marker's axes.
const MIN_VISIBLE_FRACTION: f64 = 0.3;
/// Largest ratio of axes before the marker is measured.
const MAX_RAW_AXIS_RATIO: f64 = 1.6;
/// Largest distance of a centre from its prediction, px: limits the run time.
const MAX_DISTANCE_PX: f64 = 500.0;
/// Largest ratio of a marker's visible size to the predicted one.
const MAX_ENLARGEMENT: f64 = 1.1;
/// Skin around a marker, in which its threshold changes and it may still grow, px.
const SKIN_MARGIN_PX: f64 = 12.0;
/// Additional margin that the fit of a marker, its seams and the skin next to it need, px.
const READ_MARGIN_PX: usize = 40;

impl MarkerPrediction {
    /// Returns the largest deviation of the centre along u and v, px.
    fn search_range(&self) -> Vector2<f64> {
        self.search_px.map(|far| far.clamp(0.0, MAX_DISTANCE_PX))
    }

    /// Returns a position moved towards the predicted centre by at most the search range, px.
    fn shifted_to_prediction(&self, at: Vector2<f64>) -> Vector2<f64> {
        let off = at - self.centre_px;
        at - off.zip_map(&self.search_range(), |off, reach| off.clamp(-reach, reach))
    }

    /// Returns whether a detection can be the predicted marker.
    fn matches_detection(&self, found: &Detection) -> bool {
        let within =
            |a: f64, b: f64, px: f64| a < b * MAX_AXIS_RATIO + px && b < a * MAX_AXIS_RATIO + px;
        found.shape == self.shape
            && (found.centre_px - self.centre_px).zip_fold(
                &self.search_range(),
                true,
                |all, off, reach| all && off.abs() <= reach,
            )
            && within(found.semi_major_px, self.semi_major_px, AXIS_MARGIN_PX)
            && within(found.semi_minor_px, self.semi_minor_px, AXIS_MARGIN_PX)
    }

    fn distance(&self, at: &Vector2<f64>) -> f64 {
        (at - self.centre_px).norm()
    }

    /// Returns whether a hypothesis can be the marker, or its visible part.
    fn is_near(&self, hypothesis: &Hypothesis) -> bool {
        let seen = &hypothesis.ellipse;
        let near = |ellipse: Ellipse| {
            let (s, t) = ellipse.local_position(self.shifted_to_prediction(seen.centre));
            let part = |a: f64, b: f64| {
                a > MIN_VISIBLE_FRACTION * b - AXIS_MARGIN_PX
                    && a < MAX_RAW_AXIS_RATIO * b + AXIS_MARGIN_PX
            };
            is_in_unit_circle(s / ellipse.major, t / ellipse.minor)
                && part(seen.major, ellipse.major)
                && part(seen.minor, ellipse.minor)
        };
        self.shape == hypothesis.pattern.shape() && self.ellipse().is_some_and(near)
    }
}

/// Searched part of a frame.
#[derive(Clone, Copy)]
pub enum Scope<'a> {
    /// Full frame.
    Frame,
    /// Surroundings of predicted markers.
    Around(&'a [MarkerPrediction]),
}

impl Scope<'_> {
    fn predictions(&self) -> Option<&[MarkerPrediction]> {
        match self {
            Self::Frame => None,
            Self::Around(predictions) => Some(predictions),
        }
    }

    /// Returns the windows in which markers may lie; `None` for the full frame.
    fn windows(&self) -> Option<Vec<SearchWindow>> {
        let window = |p: &MarkerPrediction| {
            let ellipse = p.ellipse()?;
            let extent = ellipse.half_extent() * MAX_ENLARGEMENT;
            let half = (extent + p.search_range()).add_scalar(SKIN_MARGIN_PX);
            let (low, high) = (ellipse.centre - half, ellipse.centre + half);
            Some(SearchWindow {
                low: low.into(),
                high: high.into(),
                thick: 2.0 * extent.min(),
            })
        };
        Some(self.predictions()?.iter().filter_map(window).collect())
    }

    /// Returns the part of a frame of `width` x `height` px in which markers may lie.
    pub fn search_area(&self, width: usize, height: usize) -> SearchArea {
        self.windows().map_or_else(
            || SearchArea::full_frame(width, height),
            |w| SearchArea::from_windows(&w, width, height),
        )
    }

    /// Returns the largest length of a blob to segment, px.
    pub fn longest_px(&self) -> f64 {
        let Some(predictions) = self.predictions() else {
            return f64::INFINITY;
        };
        let long =
            |p: &MarkerPrediction| 2.0 * (MAX_RAW_AXIS_RATIO * p.semi_major_px + AXIS_MARGIN_PX);
        predictions.iter().map(long).fold(0.0, f64::max)
    }

    /// Returns the tiles of a frame of `width` x `height` px that a search uses: those around the markers.
    pub fn tiles(&self, width: usize, height: usize) -> Tiles {
        let all = || Tiles::all(width, height);
        self.windows().map_or_else(all, |targets| {
            windows::required_tiles(&targets, width, height, READ_MARGIN_PX)
        })
    }

    /// Returns the tiles that are read, including the rows sampled for the noise.
    pub fn tiles_read(&self, width: usize, height: usize) -> Tiles {
        let mut tiles = self.tiles(width, height);
        noise::sampled_rows(height).for_each(|y| tiles.mark(0..width, y..y + 1));
        tiles
    }

    /// Returns whether a hypothesis can be a marker that is searched for, or its visible part.
    pub fn includes(&self, hypothesis: &Hypothesis) -> bool {
        self.predictions()
            .is_none_or(|targets| targets.iter().any(|p| p.is_near(hypothesis)))
    }

    /// Returns whether a hypothesis is none of the markers that are searched for, because all that are near have been found
    /// whole next to it.
    pub fn is_explained(&self, hypothesis: &Hypothesis, found: &[MeasuredMarker]) -> bool {
        let Some(predictions) = self.predictions() else {
            return false;
        };
        let seen = &hypothesis.ellipse;
        let beside = |m: &&MeasuredMarker| {
            let own = m.detection.ellipse();
            m.is_sure() && m.is_whole && !own.contains(seen.centre) && !seen.contains(own.centre)
        };
        let found: Vec<&Detection> = found.iter().filter(beside).map(|m| &m.detection).collect();
        let there = match_predictions(&found, predictions).1;
        predictions
            .iter()
            .zip(there)
            .all(|(p, there)| there || !p.is_near(hypothesis))
    }

    /// Returns the predicted markers that have not been found; `None` for the full frame.
    pub fn missing(&self, found: &[MeasuredMarker]) -> Option<Vec<MarkerPrediction>> {
        let predictions = self.predictions()?;
        let found: Vec<&Detection> = found.iter().map(|m| &m.detection).collect();
        let there = match_predictions(&found, predictions).1;
        let missing = predictions.iter().zip(there).filter(|(_, there)| !there);
        Some(missing.map(|(p, _)| p.clone()).collect())
    }

    /// Returns the predicted quadrants that have not been found; `None` for the full frame.
    pub fn missing_quadrants(&self, found: &[MeasuredMarker]) -> Option<Vec<MarkerPrediction>> {
        let mut missing = self.missing(found)?;
        missing.retain(|p| p.shape == Shape::Quadrant);
        Some(missing)
    }
}

/// Returns whether a position in semi-axes is inside the ellipse.
fn is_in_unit_circle(p: f64, q: f64) -> bool {
    p * p + q * q < 1.0
}

/// Returns whether an outline can be a part of one of the predicted markers.
pub fn may_show_part_of(seen: &Ellipse, predictions: &[MarkerPrediction]) -> bool {
    predictions
        .iter()
        .filter_map(|p| Some((p.ellipse()?, p.shifted_to_prediction(seen.centre))))
        .any(|(ellipse, at)| {
            let (s, t) = ellipse.local_position(at);
            is_in_unit_circle(
                s / (MAX_RAW_AXIS_RATIO * ellipse.major),
                t / (MAX_RAW_AXIS_RATIO * ellipse.minor),
            )
        })
}

/// Matches detections and predictions: nearest compatible pairs first, none twice. Returns for each detection whether it is
/// a predicted marker, and for each prediction whether it was found.
pub fn match_predictions(
    found: &[&Detection],
    predictions: &[MarkerPrediction],
) -> (Vec<bool>, Vec<bool>) {
    let mut pairs = Vec::new();
    for (i, prediction) in predictions
        .iter()
        .enumerate()
        .filter(|(_, p)| p.ellipse().is_some())
    {
        let similar = found
            .iter()
            .enumerate()
            .filter(|(_, d)| prediction.matches_detection(d));
        pairs.extend(similar.map(|(j, d)| (prediction.distance(&d.centre_px), i, j)));
    }
    sort_by_value(&mut pairs, |one| one.0);
    let (mut taken, mut there) = (vec![false; found.len()], vec![false; predictions.len()]);
    for (_, i, j) in pairs {
        if !there[i] && !taken[j] {
            (there[i], taken[j]) = (true, true);
        }
    }
    (taken, there)
}

/// Removes all markers that are not predicted.
pub fn keep_predicted(found: &mut FoundMarkers, predictions: &[MarkerPrediction]) {
    let detections: Vec<&Detection> = found.measured.iter().map(|m| &m.detection).collect();
    let mut kept = match_predictions(&detections, predictions).0.into_iter();
    found.measured.retain(|_| kept.next().unwrap_or(false));
    found.rejected.clear();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::appearance::parameters::MarkerPattern;
    use nalgebra::Matrix2;

    fn prediction(x: f64) -> MarkerPrediction {
        MarkerPrediction {
            shape: Shape::Circle,
            centre_px: Vector2::new(x, 50.0),
            semi_major_px: 20.0,
            semi_minor_px: 4.0,
            angle_rad: 0.0,
            search_px: Vector2::repeat(60.0),
            seen: true,
        }
    }

    fn detection(x: f64, semi_major_px: f64) -> Detection {
        Detection {
            shape: Shape::Circle,
            centre_px: Vector2::new(x, 50.0),
            covariance_px2: Matrix2::identity().into(),
            semi_major_px,
            semi_minor_px: 4.0,
            angle_rad: 0.0,
            fit_rms: 1.0,
            contrast: 100.0,
            marker: None,
        }
    }

    #[test]
    fn one_detection_is_one_marker() {
        let predictions = [prediction(100.0), prediction(150.0)];
        let found = [detection(110.0, 20.0), detection(112.0, 40.0)];
        let (taken, there) = match_predictions(&found.iter().collect::<Vec<_>>(), &predictions);
        // The second has another size; the first cannot match both.
        assert_eq!((taken, there), (vec![true, false], vec![true, false]));
        let found = [detection(158.0, 20.0), detection(108.0, 21.0)];
        let (taken, there) = match_predictions(&found.iter().collect::<Vec<_>>(), &predictions);
        assert_eq!((taken, there), (vec![true, true], vec![true, true]));
    }

    #[test]
    fn hypotheses_next_to_found_markers_are_not_measured() {
        let sure = |x: f64| Detection {
            covariance_px2: (Matrix2::identity() * 1e-3).into(),
            ..detection(x, 20.0)
        };
        let found = |x: f64| MeasuredMarker::whole(sure(x));
        let seen = |x: f64| {
            let ellipse = Ellipse {
                centre: Vector2::new(x, 52.0),
                major: 8.0,
                minor: 3.0,
                angle: 0.0,
            };
            Hypothesis::new(MarkerPattern::Disc, ellipse, Vec::new())
        };
        let two = [prediction(100.0), prediction(150.0)];
        let is_beside =
            |at: f64, found: &[MeasuredMarker]| Scope::Around(&two).is_explained(&seen(at), found);
        assert!(is_beside(125.0, &[found(100.0), found(150.0)]));
        // The hypothesis may be the other marker; the first may be only a part of it; or the other is imprecise.
        assert!(!is_beside(125.0, &[found(100.0)]));
        assert!(!is_beside(105.0, &[found(100.0), found(150.0)]));
        let vague = MeasuredMarker::whole(detection(150.0, 20.0));
        assert!(!is_beside(125.0, &[found(100.0), vague]));
    }

    #[test]
    fn only_missing_markers_are_searched_for() {
        let quadrants = MarkerPrediction {
            shape: Shape::Quadrant,
            ..prediction(1000.0)
        };
        let targets = [prediction(100.0), quadrants.clone()];
        let missing = Scope::Around(&targets)
            .missing_quadrants(&[])
            .expect("predictions");
        assert_eq!(missing, [quadrants]);
        let part = |x: f64| Ellipse {
            centre: Vector2::new(x, 52.0),
            major: 8.0,
            minor: 2.0,
            angle: 0.0,
        };
        let seen = [1060.0, 1110.0, 100.0].map(|x| may_show_part_of(&part(x), &missing));
        assert_eq!(seen, [true, false, false]);
    }

    #[test]
    fn only_tiles_around_the_predictions_are_read() {
        let tiles = |targets: &[MarkerPrediction]| Scope::Around(targets).tiles_read(4000, 3000);
        let about = tiles(&[prediction(1000.0)]);
        let read = (0..375)
            .map(|row| about.row(row).iter().filter(|m| **m).count())
            .sum::<usize>();
        let none = tiles(&[]);
        let rows = (0..375).filter(|row| none.row(*row)[0]).count();
        assert!(about.row(6)[115..135].iter().all(|m| *m) && !about.row(6)[250]);
        assert!(read < rows * 500 + 375 * 500 / 20, "{read} tiles are read");
        // Predictions outside the frame or without numbers need no tiles.
        let absent = MarkerPrediction {
            centre_px: Vector2::new(-1e12, f64::NAN),
            ..prediction(0.0)
        };
        let outside = MarkerPrediction {
            centre_px: Vector2::new(9e9, 9e9),
            ..prediction(0.0)
        };
        assert!(tiles(&[absent, outside]) == none && rows == noise::sampled_rows(3000).count());
    }
}
