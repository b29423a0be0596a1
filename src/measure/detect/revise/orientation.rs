//! Markers whose outline the orientation predicts. Where glare drowns an end, or where a disc is as thin as the
//! blur, size and place are told badly together; with the surveyed diameter at the known distance only the place is sought.
//! Quadrants that glare cuts may look like none any more; within their outline the edges that are seen tell the crossing.

use nalgebra::{Matrix2, Vector2};

use crate::measure::detect::accept::verdict::Measured;
use crate::measure::detect::accept::{correlated, dirt};
use crate::measure::detect::appearance::parameters::Pattern;
use crate::measure::detect::attempt::measure::{Bounds, measure};
use crate::measure::detect::detection::{Detection, Detections, Prediction, by_place};
use crate::measure::detect::hypothesis::Hypothesis;
use crate::measure::detect::hypothesis::prior::{EdgePrior, Prior, SizePrior, Slope};
use crate::measure::detect::image::ellipse::{Ellipse, half_turn};
use crate::measure::detect::image::histogram::middle;
use crate::measure::detect::occlusion::decal::ROWS;
use crate::measure::detect::occlusion::glare;
use crate::measure::detect::propose::{decal_cut, quadrant_edges};
use crate::measure::raster::Raster;
use crate::measure::setup::Shape;

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
/// The same of a disc over which another one's decal may lie: it is less sure than it looks.
const HIDDEN_PX2: f64 = 0.01;
/// The same up to which a disc tells how the predicted sizes fail.
const SURE: f64 = 0.08;
/// Discs that tell it at least, and how many of those alike tell what the skin's slope does.
const ENOUGH: usize = 3;
const LIKE: usize = 5;
/// How far predicted sizes fail at least, as shares: the major axis is the diameter over the distance, and prints differ; the
/// minor and the direction follow the skin's slope, which a bending wing changes; and the major where nothing tells it.
const MAJOR: f64 = 0.0015;
const MINOR: f64 = 0.03;
const ANGLE: f64 = 0.015;
const UNKNOWN: f64 = 0.01;
/// How far from its expected place a marker may be, px, unless the sure discs are farther.
const NEAR: f64 = 4.0;
/// Standard deviations by which both answers may differ.
const ALIKE: f64 = 4.0;
/// Share of the former variances from which on a disc is taken for hidden that may be seen as a whole.
const SURER: f64 = 0.5;
/// Standard deviations by which a size differs from the predicted one that say that something is wrong.
const UNLIKE: f64 = 3.0;
/// Share of quadrants that is surely theirs, wherever the skin slopes a little otherwise.
const INNER: f64 = 0.75;
/// How far quadrants' outline may be off, px.
const ASIDE: f64 = 8.0;
/// How much farther than it is seen glare is taken to reach, in ways from where it is seen to where it is bright: black is
/// lit long before the skin is. Where too little is left then, as far as it is seen.
const FRINGES: [f64; 2] = [1.0, 0.0];
/// How much lighter glare makes the skin where it leaves too little of an edge.
const BLINDS: f64 = 1.3;
/// The greatest blur over the frame's.
const SOFTER: f64 = 2.5;
/// Semi-minor axis, in blurs, below which a disc does not tell the blur, and how far that differs in a frame, as a share.
const THIN: f64 = 3.0;
const SAME_BLUR: f64 = 0.1;

/// How the predicted sizes fail: each a usual ratio, or difference, and its deviation.
struct Sizes {
    major: (f64, f64),
    minor: (f64, f64),
    angle: (f64, f64),
}

/// The frame's sure discs, as predicted and as found.
struct Sure(Vec<(Prediction, Detection)>);

impl Sure {
    fn of(found: &[Detection], expected: &[Expected]) -> Self {
        let pair = |e: &Expected| Some((e.prediction.clone(), found.get(e.found?)?.clone()));
        let sure = |(_, d): &(Prediction, Detection)| d.shape == Shape::Circle && d.variance() < SURE;
        Self(expected.iter().filter_map(pair).filter(sure).collect())
    }

    /// How the sizes of a marker fail: the major axis as all discs tell, the others as those do that are predicted in about the
    /// same direction, for they follow the skin's slope, which is another at the leading edge than at the trailing one.
    fn sizes(&self, expected: &Prediction) -> Sizes {
        let mut like: Vec<_> = self.0.iter().collect();
        let aside = |p: &Prediction| half_turn(p.angle_rad - expected.angle_rad).abs();
        like.sort_by(|(one, _), (other, _)| aside(one).total_cmp(&aside(other)));
        let few = like.len().min(LIKE);
        let spread = |count: usize, value: &dyn Fn(&Prediction, &Detection) -> f64, least: f64| {
            let all: Vec<f64> = like[..count].iter().map(|(p, d)| value(p, d)).collect();
            let usual = middle(all.clone()).filter(|_| all.len() >= ENOUGH);
            let off = usual.and_then(|usual| middle(all.iter().map(|v| (v - usual).abs()).collect()));
            Some((usual?, least.max(1.5 * off?)))
        };
        let major = spread(like.len(), &|p, d| d.semi_major_px / p.semi_major_px, MAJOR);
        let minor = spread(few, &|p, d| d.semi_minor_px / p.semi_minor_px, MINOR);
        let angle = spread(few, &|p, d| half_turn(d.angle_rad - p.angle_rad), ANGLE);
        Sizes {
            major: major.unwrap_or((1.0, UNKNOWN)),
            minor: minor.unwrap_or((1.0, 2.0 * MINOR)),
            angle: angle.unwrap_or((0.0, 2.0 * ANGLE)),
        }
    }
}

impl Sizes {
    /// The hypothesis of an expected disc, with glare reaching so much farther than it is seen (`FRINGES`), and of quadrants if
    /// glare lies over them: what else hides them is not known.
    fn hypothesis(&self, image: &Raster, expected: &Prediction, fringe: f64) -> Option<Hypothesis> {
        let ellipse = expected.ellipse()?;
        let (major, minor) = (self.major.0 * ellipse.major, self.minor.0 * ellipse.minor);
        let ellipse = Ellipse { major, minor, angle: half_turn(ellipse.angle + self.angle.0), ..ellipse };
        let (bands, hypothesis) = match expected.shape {
            Shape::Circle => {
                let bands = glare::lit(image, &ellipse, glare::BEGINS, fringe);
                (bands, Hypothesis::of(Pattern::Disc, ellipse, Vec::new()))
            }
            Shape::Quadrant => {
                // White must not pass for lit skin.
                let beside = Ellipse { minor: ellipse.minor + ASIDE, ..ellipse };
                let bands = glare::lit_slanting(image, &beside, BLINDS);
                if bands.is_empty() {
                    return None;
                }
                let (major, minor) = (INNER * ellipse.major, INNER * ellipse.minor);
                let hypothesis = quadrant_edges::placed(&Ellipse { major, minor, ..ellipse }, image, &bands)?;
                (bands, hypothesis)
            }
        };
        let slope = Slope {
            minor: (ellipse.minor, self.minor.1 * expected.semi_minor_px),
            angle: (ellipse.angle, self.angle.1),
        };
        let major = (ellipse.major, self.major.1 * expected.semi_major_px);
        let size = SizePrior { major, slope: Some(slope) };
        let prior = Prior { size: Some(size), ..hypothesis.prior };
        Some(Hypothesis { prior, ..hypothesis }.with_glare(bands))
    }

    /// What a disc that is longer or thicker than predicted is doubted by, px^2: something beside an edge passes for a part of
    /// it, and the centre may be off by as much. Nothing of quadrants, whose crossing no outline tells.
    fn inflation(&self, expected: &Prediction, disc: &Detection) -> Matrix2<f64> {
        if disc.shape == Shape::Quadrant {
            return Matrix2::zeros();
        }
        let ellipse = disc.ellipse();
        let (along, across) = (ellipse.axis(), ellipse.across());
        let axes = [
            (along, disc.semi_major_px, self.major, expected.semi_major_px),
            (across, disc.semi_minor_px, self.minor, expected.semi_minor_px),
        ];
        let inflation = |(axis, size, (ratio, deviation), foretold): (Vector2<f64>, f64, (f64, f64), f64)| {
            // Both ends tell the size as well as the centre.
            let chance = axis.dot(&(disc.covariance_px2 * axis)) + (deviation * foretold).powi(2);
            let off = (size - ratio * foretold).powi(2);
            axis * axis.transpose() * if off > UNLIKE * UNLIKE * chance { off - chance } else { 0.0 }
        };
        axes.into_iter().map(inflation).sum()
    }
}

/// Measures the expected discs that were not found, or whose place is told badly, once more with the size that is predicted,
/// and quadrants that were not found where glare lies over them; whether that is better for any. The markers stay in order.
pub fn look_closer(image: &Raster, found: &mut Detections, expected: &[Expected]) -> bool {
    let Some(psf) = found.psf_sigma_px else { return false };
    let sure = Sure::of(&found.markers, expected);
    let off = |(p, d): &(Prediction, Detection)| (d.centre_px - p.centre_px).norm();
    let most = middle(sure.0.iter().map(off).collect()).map_or(NEAR, |usual| NEAR.max(3.0 * usual));
    let bounds = Bounds { blur: SOFTER * psf, through_glare: true, ..Bounds::of(found.noise) };
    let mut new: Vec<(Option<usize>, Measured)> = Vec::new();
    let mut unlike: Vec<(usize, Matrix2<f64>)> = Vec::new();
    for Expected { prediction, found: own } in expected {
        let old = own.and_then(|i| found.markers.get(i));
        // A crossing is told well by whatever shows it.
        let [least, least_hidden] =
            if prediction.shape == Shape::Circle { [UNSURE_PX2, HIDDEN_PX2] } else { [f64::INFINITY; 2] };
        let surer = |than: f64| old.is_some_and(|d| d.variance() < than);
        if surer(least_hidden) {
            continue;
        }
        let sizes = sure.sizes(prediction);
        // Of one that is sure enough only a decal is asked for.
        let fringes = if surer(least) { &FRINGES[1..] } else { &FRINGES[..] };
        let hypotheses = fringes.iter().filter_map(|fringe| sizes.hypothesis(image, prediction, *fringe));
        let mut hypotheses: Vec<Hypothesis> = hypotheses.collect();
        hypotheses.dedup();
        // Only where it does not look whole is it taken for hidden.
        let others = found.markers.iter().enumerate().filter(|(i, _)| Some(*i) != *own);
        let others: Vec<Ellipse> = others.map(|(_, d)| d.ellipse()).collect();
        let hidden = hypotheses.last().and_then(|last| decal_cut::beside(image, last, &others, ROWS, psf));
        hypotheses.retain(|_| !surer(least));
        hypotheses.extend(hidden);
        let answer = hypotheses.into_iter().find_map(|mut hypothesis| {
            if prediction.shape == Shape::Circle && hypothesis.ellipse.minor < THIN * psf {
                hypothesis.prior.edge =
                    Some(EdgePrior { blur: (psf, SAME_BLUR * psf), dark: (0.7, f64::INFINITY) });
            }
            let mut measured = measure(image, &[], &hypothesis, bounds).ok()?;
            correlated::raise(&mut measured, found.inflation);
            dirt::inflate(image, &mut measured, &others);
            if prediction.shape == Shape::Quadrant {
                measured.detection.semi_major_px /= INNER;
                measured.detection.semi_minor_px /= INNER;
            }
            measured.detection.covariance_px2 += sizes.inflation(prediction, &measured.detection);
            let centre = measured.detection.centre_px;
            // It may have been found and left without a name.
            let named = own.is_some();
            let own = own.or_else(|| found.markers.iter().position(|d| d.ellipse().outwards(centre) < 0.5));
            let old = own.and_then(|i| found.markers.get(i)).map(|old| {
                // What has another size than predicted may have another place too.
                let covariance_px2 = old.covariance_px2 + sizes.inflation(prediction, old);
                Detection { covariance_px2, ..old.clone() }
            });
            let near = (centre - prediction.centre_px).norm() < most;
            let whole = !hypothesis.is_under_decal();
            let surer = if whole { 1.0 } else { SURER };
            let better =
                near && old.as_ref().is_none_or(|old| is_better(&measured.detection, old, surer, named));
            if let (false, true, Some(i), Some(old)) = (better, near && whole, own, &old) {
                unlike.extend(disagreement(&measured.detection, old).map(|inflation| (i, inflation)));
            }
            better.then_some((own, measured))
        });
        new.extend(answer);
    }
    let changed = !new.is_empty();
    // Else another look decides.
    for (i, inflation) in unlike.into_iter().filter(|_| !changed) {
        if let Some(old) = found.markers.get_mut(i) {
            old.covariance_px2 += inflation;
        }
    }
    for Expected { prediction, found: own } in expected {
        if let Some(disc) = own.and_then(|i| found.markers.get_mut(i)) {
            disc.covariance_px2 += sure.sizes(prediction).inflation(prediction, disc);
        }
    }
    let mut quadrants: Vec<Ellipse> = Vec::new();
    for (own, measured) in new {
        let ellipse = measured.detection.ellipse();
        found.rejected.retain(|r| !ellipse.holds(r.centre_px));
        quadrants.extend((measured.detection.shape == Shape::Quadrant).then_some(ellipse));
        match own.and_then(|i| found.markers.get_mut(i)) {
            Some(old) => *old = measured.detection,
            None => found.markers.push(measured.detection),
        }
    }
    // A black part of them may have passed for a disc.
    let part = |d: &Detection, q: &Ellipse| q.centre != d.centre_px && q.holds(d.centre_px);
    found.markers.retain(|d| !quadrants.iter().any(|q| part(d, q)));
    found.markers.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    changed
}

/// What a former answer that stays is doubted by, px^2, where another look at the same disc sees it farther away than a
/// standard deviation: pixels that are the same should tell the same.
fn disagreement(new: &Detection, old: &Detection) -> Option<Matrix2<f64>> {
    let apart: Vector2<f64> = new.centre_px - old.centre_px;
    let off = apart.dot(&(old.covariance_px2.try_inverse()? * apart));
    (new.shape == old.shape && off > 1.0).then(|| apart * apart.transpose())
}

/// Whether an answer is surer than the former one, by a factor of the variances, and no other. Quadrants that were found and
/// could not be named were measured wrongly: they have no say.
fn is_better(new: &Detection, old: &Detection, factor: f64, named: bool) -> bool {
    let apart: Vector2<f64> = new.centre_px - old.centre_px;
    let both = new.covariance_px2 + old.covariance_px2;
    let off = both.try_inverse().map_or(f64::INFINITY, |inverse| apart.dot(&(inverse * apart)));
    let is_surer = new.variance() < factor * old.variance();
    match new.shape {
        _ if new.shape != old.shape => false,
        Shape::Quadrant => off < ALIKE * ALIKE || !named && is_surer,
        Shape::Circle => is_surer && off < ALIKE * ALIKE,
    }
}
