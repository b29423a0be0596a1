//! What of a frame is searched: all of it, or the surroundings of predicted markers.

use nalgebra::Vector2;

use crate::detect::accept::{found::FoundMarkers, verdict::MeasuredMarker};
use crate::detect::appearance::parameters::MarkerPattern;
use crate::detect::detection::{Detection, MarkerPrediction};
use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::{ellipse::Ellipse, noise};
use crate::detect::segment::windows::{self, SearchArea, SearchWindow};
use crate::setup::Shape;
use crate::tiles::Tiles;

/// How much a marker's axes may differ from their prediction, a ratio. Chosen; `tests/detect/guided.rs` holds this and the
/// next ones.
const ALIKE: f64 = 1.3;
/// The same beside that, px: of a thin disc's minor axis.
const ALIKE_PX: f64 = 1.0;
/// Share of a marker's axes that must be seen of it.
const PART: f64 = 0.3;
/// How much longer it may look before it is measured, a ratio.
const WIDER: f64 = 1.6;
/// How far a centre may be off at most, px: a bound on time.
const MAX_DISTANCE_PX: f64 = 500.0;
/// How much larger than predicted a marker may show, a ratio.
const LARGER: f64 = 1.1;
/// Skin around a marker, in which its threshold changes and it may still grow, px.
const SKIRT: f64 = 12.0;
/// How far beyond that a marker's fit, its seams and the skin beside it are looked at, px.
const MARGIN: usize = 40;

impl MarkerPrediction {
    /// How far the centre may be off along u and v, px.
    fn reach(&self) -> Vector2<f64> {
        self.search_px.map(|far| far.clamp(0.0, MAX_DISTANCE_PX))
    }

    /// A place moved towards the predicted centre by as much as that may be off.
    fn drawn_in(&self, at: Vector2<f64>) -> Vector2<f64> {
        let off = at - self.centre_px;
        at - off.zip_map(&self.reach(), |off, reach| off.clamp(-reach, reach))
    }

    /// Whether a detection may be the predicted marker.
    fn is_like(&self, found: &Detection) -> bool {
        let within = |a: f64, b: f64, px: f64| a < b * ALIKE + px && b < a * ALIKE + px;
        found.shape == self.shape
            && (found.centre_px - self.centre_px)
                .zip_fold(&self.reach(), true, |all, off, reach| all && off.abs() <= reach)
            && within(found.semi_major_px, self.semi_major_px, ALIKE_PX)
            && within(found.semi_minor_px, self.semi_minor_px, ALIKE_PX)
    }

    fn distance(&self, at: &Vector2<f64>) -> f64 {
        (at - self.centre_px).norm()
    }

    /// Whether a hypothesis may be the marker, or what is seen of it.
    fn is_near(&self, hypothesis: &Hypothesis) -> bool {
        let seen = &hypothesis.ellipse;
        let shape = if hypothesis.pattern == MarkerPattern::Disc { Shape::Circle } else { Shape::Quadrant };
        let near = |ellipse: Ellipse| {
            let (s, t) = ellipse.local(self.drawn_in(seen.centre));
            let part = |a: f64, b: f64| a > PART * b - ALIKE_PX && a < WIDER * b + ALIKE_PX;
            inside(s / ellipse.major, t / ellipse.minor)
                && part(seen.major, ellipse.major)
                && part(seen.minor, ellipse.minor)
        };
        self.shape == shape && self.ellipse().is_some_and(near)
    }
}

/// What of a frame is searched.
#[derive(Clone, Copy)]
pub enum Scope<'a> {
    /// All of it.
    Frame,
    /// What lies about predicted markers: the same search, but only there.
    Around(&'a [MarkerPrediction]),
}

impl Scope<'_> {
    fn predictions(&self) -> Option<&[MarkerPrediction]> {
        match self {
            Self::Frame => None,
            Self::Around(predictions) => Some(predictions),
        }
    }

    /// Where markers may lie; `None` where that is anywhere.
    fn windows(&self) -> Option<Vec<SearchWindow>> {
        let window = |p: &MarkerPrediction| {
            let ellipse = p.ellipse()?;
            let extent = ellipse.extent() * LARGER;
            let half = (extent + p.reach()).add_scalar(SKIRT);
            let (low, high) = (ellipse.centre - half, ellipse.centre + half);
            Some(SearchWindow { low: low.into(), high: high.into(), thick: 2.0 * extent.min() })
        };
        Some(self.predictions()?.iter().filter_map(window).collect())
    }

    /// The part of a frame of `width` x `height` px in which markers may lie.
    pub fn part(&self, width: usize, height: usize) -> SearchArea {
        self.windows().map_or_else(|| SearchArea::full_frame(width, height), |w| SearchArea::from_windows(&w, width, height))
    }

    /// How long a thing may look that is sought, px.
    pub fn longest_px(&self) -> f64 {
        let Some(predictions) = self.predictions() else { return f64::INFINITY };
        let long = |p: &MarkerPrediction| 2.0 * (WIDER * p.semi_major_px + ALIKE_PX);
        predictions.iter().map(long).fold(0.0, f64::max)
    }

    /// What of a frame of `width` x `height` px is looked at: what lies about the markers.
    pub fn tiles(&self, width: usize, height: usize) -> Tiles {
        let all = || Tiles::all(width, height);
        self.windows().map_or_else(all, |sought| windows::required_tiles(&sought, width, height, MARGIN))
    }

    /// What is read, beside that the rows that tell the noise.
    pub fn tiles_read(&self, width: usize, height: usize) -> Tiles {
        let mut tiles = self.tiles(width, height);
        noise::sampled(height).for_each(|y| tiles.mark(0..width, y..y + 1));
        tiles
    }

    /// Whether a hypothesis may be a marker that is sought, or what is seen of it.
    pub fn wants(&self, hypothesis: &Hypothesis) -> bool {
        self.predictions().is_none_or(|sought| sought.iter().any(|p| p.is_near(hypothesis)))
    }

    /// Whether a hypothesis is none of the markers that are sought, for each that it is near has been found beside it as a
    /// whole.
    pub fn is_beside(&self, hypothesis: &Hypothesis, found: &[MeasuredMarker]) -> bool {
        let Some(predictions) = self.predictions() else { return false };
        let seen = &hypothesis.ellipse;
        let beside = |m: &&MeasuredMarker| {
            let own = m.detection.ellipse();
            m.is_sure() && m.is_whole && !own.contains(seen.centre) && !seen.contains(own.centre)
        };
        let found: Vec<&Detection> = found.iter().filter(beside).map(|m| &m.detection).collect();
        let there = matched(&found, predictions).1;
        predictions.iter().zip(there).all(|(p, there)| there || !p.is_near(hypothesis))
    }

    /// What is sought and has not been found; `None` where that may be anything.
    pub fn missing(&self, found: &[MeasuredMarker]) -> Option<Vec<MarkerPrediction>> {
        Some(missing(found, self.predictions()?).cloned().collect())
    }

    /// The quadrants that are still sought; `None` where that may be any.
    pub fn missing_quadrants(&self, found: &[MeasuredMarker]) -> Option<Vec<MarkerPrediction>> {
        let quadrants = |p: &&MarkerPrediction| p.shape == Shape::Quadrant;
        Some(missing(found, self.predictions()?).filter(quadrants).cloned().collect())
    }
}

/// Whether a place in semi-axes lies in their ellipse.
fn inside(p: f64, q: f64) -> bool {
    p * p + q * q < 1.0
}

/// The predicted markers that have not been found yet.
fn missing<'a>(
    found: &[MeasuredMarker],
    predictions: &'a [MarkerPrediction],
) -> impl Iterator<Item = &'a MarkerPrediction> + use<'a> {
    let found: Vec<&Detection> = found.iter().map(|m| &m.detection).collect();
    let there = matched(&found, predictions).1;
    predictions.iter().zip(there).filter(|(_, there)| !there).map(|(p, _)| p)
}

/// Whether what is seen may be a part of one of the predicted markers.
pub fn may_show_part_of(seen: &Ellipse, predictions: &[MarkerPrediction]) -> bool {
    predictions.iter().filter_map(|p| Some((p.ellipse()?, p.drawn_in(seen.centre)))).any(|(ellipse, at)| {
        let (s, t) = ellipse.local(at);
        inside(s / (WIDER * ellipse.major), t / (WIDER * ellipse.minor))
    })
}

/// For each detection whether it is a predicted marker, and for each prediction whether one is it: the nearest pairs that
/// are alike, none twice.
pub fn matched(found: &[&Detection], predictions: &[MarkerPrediction]) -> (Vec<bool>, Vec<bool>) {
    let mut pairs = Vec::new();
    for (i, prediction) in predictions.iter().enumerate().filter(|(_, p)| p.ellipse().is_some()) {
        let alike = found.iter().enumerate().filter(|(_, d)| prediction.is_like(d));
        pairs.extend(alike.map(|(j, d)| (prediction.distance(&d.centre_px), i, j)));
    }
    pairs.sort_by(|one, other| one.0.total_cmp(&other.0));
    let (mut taken, mut there) = (vec![false; found.len()], vec![false; predictions.len()]);
    for (_, i, j) in pairs {
        if !there[i] && !taken[j] {
            (there[i], taken[j]) = (true, true);
        }
    }
    (taken, there)
}

/// Leaves the predicted markers.
pub fn keep_predicted(found: &mut FoundMarkers, predictions: &[MarkerPrediction]) {
    let detections: Vec<&Detection> = found.measured.iter().map(|m| &m.detection).collect();
    let mut kept = matched(&detections, predictions).0.into_iter();
    found.measured.retain(|_| kept.next().unwrap_or(false));
    found.rejected.clear();
}

#[cfg(test)]
mod tests {
    use super::*;
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
        }
    }

    #[test]
    fn one_detection_is_one_marker() {
        let predictions = [prediction(100.0), prediction(150.0)];
        let found = [detection(110.0, 20.0), detection(112.0, 40.0)];
        let (taken, there) = matched(&found.iter().collect::<Vec<_>>(), &predictions);
        // The second is of another size; the first is no answer for both.
        assert_eq!((taken, there), (vec![true, false], vec![true, false]));
        let found = [detection(158.0, 20.0), detection(108.0, 21.0)];
        let (taken, there) = matched(&found.iter().collect::<Vec<_>>(), &predictions);
        assert_eq!((taken, there), (vec![true, true], vec![true, true]));
    }

    #[test]
    fn what_lies_beside_markers_that_are_found_is_not_measured() {
        let sure =
            |x: f64| Detection { covariance_px2: (Matrix2::identity() * 1e-3).into(), ..detection(x, 20.0) };
        let found = |x: f64| MeasuredMarker::whole(sure(x));
        let seen = |x: f64| {
            let ellipse = Ellipse { centre: Vector2::new(x, 52.0), major: 8.0, minor: 3.0, angle: 0.0 };
            Hypothesis::of(MarkerPattern::Disc, ellipse, Vec::new())
        };
        let two = [prediction(100.0), prediction(150.0)];
        let is_beside = |at: f64, found: &[MeasuredMarker]| Scope::Around(&two).is_beside(&seen(at), found);
        assert!(is_beside(125.0, &[found(100.0), found(150.0)]));
        // It may be the other one, or what is taken for the first is only a part of it; or that is hardly seen.
        assert!(!is_beside(125.0, &[found(100.0)]));
        assert!(!is_beside(105.0, &[found(100.0), found(150.0)]));
        let vague = MeasuredMarker::whole(detection(150.0, 20.0));
        assert!(!is_beside(125.0, &[found(100.0), vague]));
    }

    #[test]
    fn only_what_is_missing_is_sought_further() {
        let quadrants = MarkerPrediction { shape: Shape::Quadrant, ..prediction(1000.0) };
        let sought = [prediction(100.0), quadrants.clone()];
        let missing = Scope::Around(&sought).missing_quadrants(&[]).expect("predictions");
        assert_eq!(missing, [quadrants]);
        let part = |x: f64| Ellipse { centre: Vector2::new(x, 52.0), major: 8.0, minor: 2.0, angle: 0.0 };
        let seen = [1060.0, 1110.0, 100.0].map(|x| may_show_part_of(&part(x), &missing));
        assert_eq!(seen, [true, false, false]);
    }

    #[test]
    fn what_is_read_lies_about_the_predictions() {
        let tiles = |sought: &[MarkerPrediction]| Scope::Around(sought).tiles_read(4000, 3000);
        let about = tiles(&[prediction(1000.0)]);
        let read = (0..375).map(|row| about.row(row).iter().filter(|m| **m).count()).sum::<usize>();
        let none = tiles(&[]);
        let rows = (0..375).filter(|row| none.row(*row)[0]).count();
        assert!(about.row(6)[115..135].iter().all(|m| *m) && !about.row(6)[250]);
        assert!(read < rows * 500 + 375 * 500 / 20, "{read} tiles are read");
        // What lies outside, or is no number, asks for nothing.
        let absent = MarkerPrediction { centre_px: Vector2::new(-1e12, f64::NAN), ..prediction(0.0) };
        let outside = MarkerPrediction { centre_px: Vector2::new(9e9, 9e9), ..prediction(0.0) };
        assert!(tiles(&[absent, outside]) == none && rows == noise::sampled(3000).count());
    }
}
