//! Detection around predicted markers: the same search, but only there.

use std::ops::Range;

use nalgebra::Vector2;

use super::candidate::{Candidate, Outline};
use super::coarse::{self, Part, THICK, Window};
use super::{Detection, Found, Prediction, noise};

/// How much a marker may differ from its prediction: axes, as a ratio, and beside that the minor, px.
const ALIKE: f64 = 1.3;
const ALIKE_PX: f64 = 1.0;
/// Skin around a marker, in which its threshold changes and it may still grow, px.
const SKIRT: f64 = 12.0;
/// How far beyond that a marker's fit, its seams and the skin beside it are looked at, px.
const MARGIN: usize = 40;

impl Prediction {
    /// The expected outline; `None` where a number is none of a marker's.
    fn outline(&self) -> Option<Outline> {
        let (major, minor) = (self.semi_major_px, self.semi_minor_px);
        let numbers = [self.centre_px.x, self.centre_px.y, self.angle_rad, self.search_px];
        let sound = numbers.iter().all(|v| v.is_finite())
            && (1.0..2000.0).contains(&major)
            && (0.5..2000.0).contains(&minor);
        sound.then_some(Outline { centre: self.centre_px, major, minor, angle: self.angle_rad })
    }

    /// How far the centre may be off, px.
    fn reach(&self) -> f64 {
        self.search_px.clamp(0.0, 500.0)
    }

    /// Whether a detection may be the predicted marker.
    pub(super) fn is_like(&self, found: &Detection) -> bool {
        let within = |a: f64, b: f64, px: f64| a < b * ALIKE + px && b < a * ALIKE + px;
        found.shape == self.shape
            && self.distance(&found.centre_px) <= self.reach()
            && within(found.semi_major_px, self.semi_major_px, ALIKE_PX)
            && within(found.semi_minor_px, self.semi_minor_px, ALIKE_PX)
    }

    fn distance(&self, at: &Vector2<f64>) -> f64 {
        (at - self.centre_px).norm()
    }
}

/// Where predicted markers may lie in a frame of `width` x `height` px.
pub fn part(predictions: &[Prediction], width: usize, height: usize) -> Part {
    let thickest = (THICK * coarse::factor(width, height)) as f64;
    let window = |p: &Prediction| {
        let outline = p.outline()?;
        let extent = outline.extent() * 1.1;
        let half = extent.add_scalar(p.reach() + SKIRT);
        let (low, high) = (outline.centre - half, outline.centre + half);
        Some(Window { low: low.into(), high: high.into(), thick: 2.0 * extent.min() > thickest })
    };
    let windows: Vec<Window> = predictions.iter().filter_map(window).collect();
    Part::about(&windows, width, height)
}

/// Of each row the columns that are read: about the markers, and all of the rows that tell the noise.
pub fn columns(predictions: &[Prediction], width: usize, height: usize) -> Vec<Range<usize>> {
    let mut out = part(predictions, width, height).columns(width, height, MARGIN);
    for y in noise::sampled(height) {
        if let Some(row) = out.get_mut(y) {
            *row = 0..width;
        }
    }
    out
}

/// Whether a candidate may be a predicted marker, or a part of it.
pub fn is_near(candidate: &Candidate, predictions: &[Prediction]) -> bool {
    predictions.iter().any(|p| {
        p.outline().is_some_and(|outline| {
            let (s, t) = outline.local(candidate.outline.centre);
            let reach = p.reach();
            (s / (outline.major + reach)).hypot(t / (outline.minor + reach)) < 1.0
        })
    })
}

/// Leaves of each prediction the detection that is nearest to it and like it.
pub fn keep_predicted(found: &mut Found, predictions: &[Prediction]) {
    let mut kept = vec![false; found.measured.len()];
    for prediction in predictions.iter().filter(|p| p.outline().is_some()) {
        let distance = |i: &usize| prediction.distance(&found.measured[*i].detection.centre_px);
        let like = (0..kept.len()).filter(|&i| prediction.is_like(&found.measured[i].detection));
        if let Some(i) = like.min_by(|i, j| distance(i).total_cmp(&distance(j))) {
            kept[i] = true;
        }
    }
    let mut kept = kept.into_iter();
    found.measured.retain(|_| kept.next().unwrap_or(false));
    found.rejected.clear();
}
