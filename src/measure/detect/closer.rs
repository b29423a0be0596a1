//! Stage 7: discs whose size the orientation foretells. Where glare drowns an end, or where a disc is as thin as the blur,
//! size and place are told badly together; with the surveyed diameter at the known distance only the place is sought.

use nalgebra::{Matrix2, Vector2};

use super::super::raster::Raster;
use super::super::setup::Shape;
use super::candidate::{Candidate, Foretold, Like};
use super::judge::Measured;
use super::measure::{Bounds, measure};
use super::model::Pattern;
use super::outline::{Outline, half_turn};
use super::{Detection, Detections, Prediction, by_place, clumped, glare, middle};

/// A marker that should be in the frame, from its orientation and the markers that are known.
#[derive(Clone, Debug, PartialEq)]
pub struct Expected {
    /// Its image in this frame.
    pub prediction: Prediction,
    /// Which detection it is, if it was found.
    pub found: Option<usize>,
}

/// Sum of a place's variances from which on a disc is looked at again, px^2.
pub const UNSURE_PX2: f64 = 0.04;
/// The same up to which a disc tells how the foretold sizes fail.
const SURE: f64 = 0.08;
/// Discs that tell it.
const ENOUGH: usize = 3;
/// How far foretold sizes fail at least, as shares: the major axis is the diameter over the distance, the minor and the
/// direction follow the skin's slope, which a bending wing changes; and the major where nothing tells it.
const MAJOR: f64 = 0.003;
const MINOR: f64 = 0.03;
const ANGLE: f64 = 0.015;
const UNKNOWN: f64 = 0.01;
/// How far from its expected place a disc may be, px.
const NEAR: f64 = 4.0;
/// Standard deviations by which both answers may differ.
const ALIKE: f64 = 4.0;
/// Standard deviations by which a size differs from the foretold one that say that something is wrong.
const UNLIKE: f64 = 3.0;
/// The greatest blur over the frame's.
const SOFTER: f64 = 2.5;
/// Semi-minor axis, in blurs, below which a disc does not tell the blur, and how far that differs in a frame, as a share.
const THIN: f64 = 3.0;
const SAME_BLUR: f64 = 0.1;

/// How the foretold sizes fail: each a usual ratio, or difference, and its deviation.
struct Sizes {
    major: (f64, f64),
    minor: (f64, f64),
    angle: (f64, f64),
}

impl Sizes {
    fn of(found: &[Detection], expected: &[Expected]) -> Self {
        let pair = |e: &Expected| Some((e.prediction.clone(), found.get(e.found?)?.clone()));
        let sure =
            |(_, d): &(Prediction, Detection)| d.shape == Shape::Circle && d.covariance_px2.trace() < SURE;
        let sure: Vec<(Prediction, Detection)> = expected.iter().filter_map(pair).filter(sure).collect();
        let spread = |value: &dyn Fn(&Prediction, &Detection) -> f64, least: f64| {
            let all: Vec<f64> = sure.iter().map(|(p, d)| value(p, d)).collect();
            let usual = middle(all.clone()).filter(|_| all.len() >= ENOUGH);
            let off = usual.and_then(|usual| middle(all.iter().map(|v| (v - usual).abs()).collect()));
            Some((usual?, least.max(1.5 * off?)))
        };
        Self {
            major: spread(&|p, d| d.semi_major_px / p.semi_major_px, MAJOR).unwrap_or((1.0, UNKNOWN)),
            minor: spread(&|p, d| d.semi_minor_px / p.semi_minor_px, MINOR).unwrap_or((1.0, 2.0 * MINOR)),
            angle: spread(&|p, d| half_turn(d.angle_rad - p.angle_rad), ANGLE).unwrap_or((0.0, 2.0 * ANGLE)),
        }
    }

    /// The candidate of an expected disc.
    fn candidate(&self, expected: &Prediction) -> Option<Candidate> {
        let outline = expected.outline()?;
        let (major, minor) = (self.major.0 * outline.major, self.minor.0 * outline.minor);
        let outline = Outline { major, minor, angle: half_turn(outline.angle + self.angle.0), ..outline };
        let foretold = Foretold {
            major: self.major.1 * expected.semi_major_px,
            minor: self.minor.1 * expected.semi_minor_px,
            angle: self.angle.1,
        };
        Some(Candidate { foretold: Some(foretold), ..Candidate::of(Pattern::Disc, outline, Vec::new()) })
    }

    /// What a disc that is longer or thicker than foretold is doubted by, px^2: something beside an edge passes for a part of
    /// it, and the centre may be off by as much.
    fn doubt(&self, expected: &Prediction, disc: &Detection) -> Matrix2<f64> {
        let along = disc.outline().axis();
        let across = Vector2::new(-along.y, along.x);
        let axes = [
            (along, disc.semi_major_px, self.major, expected.semi_major_px),
            (across, disc.semi_minor_px, self.minor, expected.semi_minor_px),
        ];
        let doubt = |(axis, size, (ratio, deviation), foretold): (Vector2<f64>, f64, (f64, f64), f64)| {
            // Both ends tell the size as well as the centre.
            let chance = axis.dot(&(disc.covariance_px2 * axis)) + (deviation * foretold).powi(2);
            let off = (size - ratio * foretold).powi(2);
            axis * axis.transpose() * if off > UNLIKE * UNLIKE * chance { off - chance } else { 0.0 }
        };
        axes.into_iter().map(doubt).sum()
    }
}

/// Measures the expected discs that were not found, or whose place is told badly, once more with the size that is foretold;
/// whether that is better for any. The markers stay in order.
pub fn look_closer(image: &Raster, found: &mut Detections, expected: &[Expected]) -> bool {
    let Some(psf) = found.psf_sigma_px else { return false };
    let sizes = Sizes::of(&found.markers, expected);
    let bounds = Bounds { blur: SOFTER * psf, through_glare: true, ..Bounds::of(found.noise) };
    let mut new: Vec<(Option<usize>, Measured)> = Vec::new();
    for Expected { prediction, found: own } in expected.iter().filter(|e| e.prediction.shape == Shape::Circle)
    {
        let old = own.and_then(|i| found.markers.get(i));
        if old.is_some_and(|d| d.covariance_px2.trace() < UNSURE_PX2) {
            continue;
        }
        let Some(mut candidate) = sizes.candidate(prediction) else { continue };
        candidate.bands = glare::lit(image, &candidate.outline);
        if candidate.outline.minor < THIN * psf {
            candidate.like = Some(Like { blur: (psf, SAME_BLUR * psf), dark: (0.7, f64::INFINITY) });
        }
        let Ok(mut measured) = measure(image, &[], &candidate, bounds) else { continue };
        clumped::raise(&mut measured, found.clumping);
        let centre = measured.detection.centre_px;
        // It may have been found and left without a name.
        let own = own.or_else(|| found.markers.iter().position(|d| d.outline().outwards(centre) < 0.5));
        let old = own.and_then(|i| found.markers.get(i));
        let near = (centre - prediction.centre_px).norm() < NEAR;
        if near && old.is_none_or(|old| is_better(&measured.detection, old)) {
            new.push((own, measured));
        }
    }
    let changed = !new.is_empty();
    for Expected { prediction, found: own } in expected {
        if let Some(disc) = own.and_then(|i| found.markers.get_mut(i)).filter(|d| d.shape == Shape::Circle) {
            disc.covariance_px2 += sizes.doubt(prediction, disc);
        }
    }
    for (own, measured) in new {
        let outline = measured.detection.outline();
        found.rejected.retain(|r| !outline.holds(r.centre_px));
        match own.and_then(|i| found.markers.get_mut(i)) {
            Some(old) => *old = measured.detection,
            None => found.markers.push(measured.detection),
        }
    }
    found.markers.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    changed
}

/// Whether an answer is surer than the former one, and no other.
fn is_better(new: &Detection, old: &Detection) -> bool {
    let apart: Vector2<f64> = new.centre_px - old.centre_px;
    let both = new.covariance_px2 + old.covariance_px2;
    let off = both.try_inverse().map_or(f64::INFINITY, |inverse| apart.dot(&(inverse * apart)));
    let surer = new.shape == old.shape && new.covariance_px2.trace() < old.covariance_px2.trace();
    surer && off < ALIKE * ALIKE
}
