//! Markers whose outline the orientation predicts. Where glare hides an end, or where a disc is as thin as the
//! blur, size and place are told badly together; with the surveyed diameter at the known distance only the place is sought.
//! Quadrants that glare cuts, or that something dark touches, may look like none any more; within their outline the edges that
//! are seen tell the crossing.

use nalgebra::{Matrix2, Vector2};

use crate::detect::accept::{better::is_preferred, options::CONSISTENCY, verdict::MeasuredMarker};
use crate::detect::accept::{correlated, dirt, lost_contrast, misfit};
use crate::detect::appearance::parameters::MarkerPattern;
use crate::detect::attempt::{ladder::Measurer, measure::Bounds};
use crate::detect::detection::covariance::{CovarianceSource, mahalanobis};
use crate::detect::detection::{Detection, Detections, MarkerPrediction, by_place};
use crate::detect::hypothesis::Hypothesis;
use crate::detect::hypothesis::prior::{EdgePrior, PriorValue, MarkerPrior, SizePrior, SlopePrior};
use crate::detect::image::ellipse::{Ellipse, half_turn};
use crate::detect::occlusion::{decal::ROW_DIRECTION, glare, options::GLARE};
use crate::detect::propose::{decal_cut, quadrant_edges};
use crate::detect::revise::options::{NEIGHBOUR, ORIENTATION};
use crate::estimation::robust::median;
use crate::raster::Raster;
use crate::setup::Shape;

/// A marker that should be in the frame, from its orientation and the markers that are known.
#[derive(Clone, Debug, PartialEq)]
pub struct ExpectedMarker {
    /// Its image in this frame.
    pub prediction: MarkerPrediction,
    /// Which detection it is, if it was found.
    pub found: Option<usize>,
    /// Which marker of the survey it is.
    pub marker: usize,
}

/// Sum of a place's variances from which on a disc is looked at again, px^2. Chosen with [`ORIENTATION`].
pub const UNSURE_PX2: f64 = 0.04;

/// How the predicted sizes fail: ratios of the axes, and the difference of the directions, rad.
struct SizeDeviations {
    major: PriorValue,
    minor: PriorValue,
    angle: PriorValue,
}

/// The frame's sure discs, as predicted and as found.
struct ReliableDiscs(Vec<(MarkerPrediction, Detection)>);

impl ReliableDiscs {
    fn of(found: &[Detection], expected: &[ExpectedMarker]) -> Self {
        let pair = |e: &ExpectedMarker| Some((e.prediction.clone(), found.get(e.found?)?.clone()));
        let sure = |(_, d): &(MarkerPrediction, Detection)| {
            d.shape == Shape::Circle && d.variance() < ORIENTATION.sure_px2
        };
        Self(expected.iter().filter_map(pair).filter(sure).collect())
    }

    /// How the sizes of a marker fail: the major axis as all discs tell, the others as those do that are predicted in about the
    /// same direction, for they follow the skin's slope, which is another at the leading edge than at the trailing one.
    fn sizes(&self, expected: &MarkerPrediction) -> SizeDeviations {
        let mut alike: Vec<_> = self.0.iter().collect();
        let aside = |p: &MarkerPrediction| half_turn(p.angle_rad - expected.angle_rad).abs();
        alike.sort_by(|(one, _), (other, _)| aside(one).total_cmp(&aside(other)));
        let few = alike.len().min(ORIENTATION.alike);
        let usual = |count: usize, value: &dyn Fn(&MarkerPrediction, &Detection) -> f64, least: f64| {
            let all: Vec<f64> = alike[..count].iter().map(|(p, d)| value(p, d)).collect();
            let value = median(all.clone()).filter(|_| all.len() >= ORIENTATION.enough)?;
            let off = median(all.iter().map(|v| (v - value).abs()).collect())?;
            Some(PriorValue { value, sigma: least.max(ORIENTATION.sigma_over_median * off) })
        };
        let major = usual(alike.len(), &|p, d| d.semi_major_px / p.semi_major_px, ORIENTATION.major);
        let minor = usual(few, &|p, d| d.semi_minor_px / p.semi_minor_px, ORIENTATION.minor);
        let angle = usual(few, &|p, d| half_turn(d.angle_rad - p.angle_rad), ORIENTATION.angle_rad);
        SizeDeviations {
            major: major.unwrap_or(PriorValue { value: 1.0, sigma: ORIENTATION.unknown }),
            minor: minor.unwrap_or(PriorValue { value: 1.0, sigma: 2.0 * ORIENTATION.minor }),
            angle: angle.unwrap_or(PriorValue::zero(2.0 * ORIENTATION.angle_rad)),
        }
    }
}

impl SizeDeviations {
    /// The hypothesis of an expected marker, with glare reaching so much farther than it is seen (`ORIENTATION.fringes`).
    fn hypothesis(&self, image: &Raster, expected: &MarkerPrediction, fringe: f64) -> Option<Hypothesis> {
        let ellipse = expected.ellipse()?;
        let (major, minor) = (self.major.value * ellipse.major, self.minor.value * ellipse.minor);
        let ellipse = Ellipse { major, minor, angle: half_turn(ellipse.angle + self.angle.value), ..ellipse };
        let (bands, hypothesis) = match expected.shape {
            Shape::Circle => {
                let bands = glare::find_glare_bands(image, &ellipse, GLARE.begin_ratio, fringe);
                (bands, Hypothesis::of(MarkerPattern::Disc, ellipse, Vec::new()))
            }
            Shape::Quadrant => {
                // White must not pass for lit skin. Without glare something dark may touch them.
                let beside = Ellipse { minor: ellipse.minor + ORIENTATION.aside_px, ..ellipse };
                let bands = glare::find_slanting_glare(image, &beside, ORIENTATION.blinds);
                let inner = ellipse.larger(ORIENTATION.inner, 0.0);
                let hypothesis = quadrant_edges::place_quadrants(&inner, image, &bands)?;
                (bands, hypothesis)
            }
        };
        let slope = SlopePrior {
            minor: PriorValue { value: ellipse.minor, sigma: self.minor.sigma * expected.semi_minor_px },
            angle: PriorValue { value: ellipse.angle, sigma: self.angle.sigma },
        };
        let major = PriorValue { value: ellipse.major, sigma: self.major.sigma * expected.semi_major_px };
        let size = SizePrior { major, slope: Some(slope) };
        let prior = MarkerPrior { size: Some(size), ..hypothesis.prior };
        Some(Hypothesis { prior, ..hypothesis }.with_glare(bands))
    }

    /// Doubts a disc that is longer or thicker than predicted: something beside an edge passes for a part of it, and the centre
    /// may be off by as much. Not quadrants, whose crossing no outline tells.
    fn inflate(&self, expected: &MarkerPrediction, disc: &mut Detection) {
        if disc.shape == Shape::Quadrant {
            return;
        }
        let ellipse = disc.ellipse();
        let doubt = |axis: Vector2<f64>, size: f64, ratio: PriorValue, predicted: f64| {
            // Both ends tell the size as well as the centre.
            let chance = axis.dot(&(*disc.covariance_px2 * axis)) + (ratio.sigma * predicted).powi(2);
            let off = (size - ratio.value * predicted).powi(2);
            let is_unlike = off > ORIENTATION.unlike_sigmas * ORIENTATION.unlike_sigmas * chance;
            axis * axis.transpose() * if is_unlike { off - chance } else { 0.0 }
        };
        let doubt = doubt(ellipse.axis(), disc.semi_major_px, self.major, expected.semi_major_px)
            + doubt(ellipse.across(), disc.semi_minor_px, self.minor, expected.semi_minor_px);
        disc.covariance_px2.add(CovarianceSource::SurveyedSize, doubt);
    }
}

/// Measures the expected discs that were not found, or whose place is told badly, once more with the size that is predicted,
/// and quadrants that were not found; whether that is better for any. The markers stay in order.
pub fn second_pass(image: &Raster, found: &mut Detections, expected: &[ExpectedMarker]) -> bool {
    let Some(psf) = found.psf_sigma_px else { return false };
    let sure = ReliableDiscs::of(&found.markers, expected);
    let off = |(p, d): &(MarkerPrediction, Detection)| (d.centre_px - p.centre_px).norm();
    let near_px = ORIENTATION.near_px;
    let usual = median(sure.0.iter().map(off).collect());
    let most = usual.map_or(near_px, |usual| near_px.max(ORIENTATION.farther * usual));
    let (blur, overshoot) = (ORIENTATION.softer * psf, found.overshoot);
    let bounds = Bounds { blur, through_glare: true, overshoot, ..Bounds::of(found.noise) };
    let ladder = Measurer::new(image, &[], bounds);
    let look = SecondPass { ladder, found, sure: &sure, psf, most };
    let mut new: Vec<(Option<usize>, MeasuredMarker)> = Vec::new();
    let mut unlike: Vec<(usize, Matrix2<f64>)> = Vec::new();
    for expected in expected {
        new.extend(look.again(expected, &mut unlike));
    }
    let changed = !new.is_empty();
    // Else another look decides.
    for (i, inflation) in unlike.into_iter().filter(|_| !changed) {
        if let Some(old) = found.markers.get_mut(i) {
            old.covariance_px2.add(CovarianceSource::SecondLook, inflation);
        }
    }
    for ExpectedMarker { prediction, found: own, .. } in expected {
        if let Some(disc) = own.and_then(|i| found.markers.get_mut(i)) {
            sure.sizes(prediction).inflate(prediction, disc);
        }
    }
    put(found, new);
    changed
}

/// Puts new answers in the places of former ones, or beside them.
fn put(found: &mut Detections, new: Vec<(Option<usize>, MeasuredMarker)>) {
    let mut quadrants: Vec<Ellipse> = Vec::new();
    for (own, measured) in new {
        let ellipse = measured.detection.ellipse();
        found.rejected.retain(|r| !ellipse.contains(r.centre_px));
        quadrants.extend((measured.detection.shape == Shape::Quadrant).then_some(ellipse));
        match own.and_then(|i| found.markers.get_mut(i)) {
            Some(old) => *old = measured.detection,
            None => found.markers.push(measured.detection),
        }
    }
    // A black part of them may have passed for a disc.
    let part = |d: &Detection, q: &Ellipse| q.centre != d.centre_px && q.contains(d.centre_px);
    found.markers.retain(|d| !quadrants.iter().any(|q| part(d, q)));
    found.markers.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
}

/// An expected marker, how its sizes fail, and the outlines of all others.
struct SearchTarget<'a> {
    prediction: &'a MarkerPrediction,
    sizes: SizeDeviations,
    others: Vec<Ellipse>,
}

/// A look at a frame in which some markers have been found.
struct SecondPass<'a> {
    ladder: Measurer<'a>,
    found: &'a Detections,
    sure: &'a ReliableDiscs,
    psf: f64,
    /// How far from its expected place a marker may be, px.
    most: f64,
}

impl SecondPass<'_> {
    /// A better answer for an expected marker, if there is one, with the place of the former one; beside it by how much former
    /// ones are doubted that stay.
    fn again(
        &self,
        ExpectedMarker { prediction, found: own, .. }: &ExpectedMarker,
        unlike: &mut Vec<(usize, Matrix2<f64>)>,
    ) -> Option<(Option<usize>, MeasuredMarker)> {
        let markers = &self.found.markers;
        let old = own.and_then(|i| markers.get(i));
        let surer = |than: f64| old.is_some_and(|d| d.variance() < than);
        // A crossing is told well by whatever shows it.
        let is_disc = prediction.shape == Shape::Circle;
        if surer(if is_disc { ORIENTATION.hidden_px2 } else { f64::INFINITY }) {
            return None;
        }
        let is_sure = surer(if is_disc { UNSURE_PX2 } else { f64::INFINITY });
        let others = markers.iter().enumerate().filter(|(i, _)| Some(*i) != *own);
        let others = others.map(|(_, d)| d.ellipse()).collect();
        let sought = SearchTarget { prediction, sizes: self.sure.sizes(prediction), others };
        self.hypotheses(&sought, is_sure).into_iter().find_map(|hypothesis| {
            let (measured, whole) = self.measured(&sought, hypothesis)?;
            let centre = measured.detection.centre_px;
            // It may have been found and left without a name.
            let own = own.or_else(|| {
                markers.iter().position(|d| d.ellipse().normalized_radius(centre) < CONSISTENCY.within)
            });
            let mut old = own.and_then(|i| markers.get(i)).cloned();
            // What has another size than predicted may have another place too.
            old.iter_mut().for_each(|old| sought.sizes.inflate(prediction, old));
            let near = (centre - prediction.centre_px).norm() < self.most;
            let new = &measured.detection;
            // What is taken for hidden may be seen as a whole.
            let is_sure = |old: &Detection| whole || new.variance() < ORIENTATION.surer * old.variance();
            let beats = |old: &Detection| new.shape == old.shape && is_preferred(new, old) && is_sure(old);
            let better = near && old.as_ref().is_none_or(beats);
            if let (false, true, Some(i), Some(old)) = (better, near && whole, own, &old) {
                unlike.extend(disagreement(new, old).map(|inflation| (i, inflation)));
            }
            better.then_some((own, measured))
        })
    }

    /// What an expected marker may be, in the order in which it is tried; of one that is sure enough only what a decal leaves.
    fn hypotheses(&self, sought: &SearchTarget, is_sure: bool) -> Vec<Hypothesis> {
        let SearchTarget { prediction, sizes, others } = sought;
        let fringes = if is_sure { &ORIENTATION.fringes[1..] } else { &ORIENTATION.fringes[..] };
        let of = |fringe: &f64| sizes.hypothesis(self.ladder.image, prediction, *fringe);
        let mut hypotheses: Vec<Hypothesis> = fringes.iter().filter_map(of).collect();
        hypotheses.dedup();
        // Only where it does not look whole is it taken for hidden.
        let hidden = |last| decal_cut::occluded_disc(self.ladder.image, last, others, ROW_DIRECTION, self.psf);
        let hidden = hypotheses.last().and_then(hidden);
        hypotheses.retain(|_| !is_sure);
        hypotheses.extend(hidden);
        hypotheses
    }

    /// What a hypothesis measures, as accurately as the frame's markers and its size say; and whether it was seen as a whole.
    fn measured(&self, sought: &SearchTarget, mut hypothesis: Hypothesis) -> Option<(MeasuredMarker, bool)> {
        let (SearchTarget { prediction, sizes, others }, psf) = (sought, self.psf);
        if prediction.shape == Shape::Circle && hypothesis.ellipse.minor < NEIGHBOUR.thin_blurs * psf {
            hypothesis.prior.edge = Some(EdgePrior {
                blur: PriorValue::to_share(psf, NEIGHBOUR.same_blur),
                dark: PriorValue::UNKNOWN,
            });
        }
        let mut measured = self.ladder.measure(&hypothesis).ok()?;
        correlated::raise_for_correlation(&mut measured, self.found.inflation);
        dirt::inflate_for_dirt(self.ladder.image, &mut measured, others);
        misfit::inflate_for_misfit(self.ladder.image, &mut measured, self.found.noise);
        lost_contrast::add_lost_contrast(&mut measured, self.found.lost_contrast_px);
        if prediction.shape == Shape::Quadrant {
            measured.detection.semi_major_px /= ORIENTATION.inner;
            measured.detection.semi_minor_px /= ORIENTATION.inner;
        }
        sizes.inflate(prediction, &mut measured.detection);
        Some((measured, !hypothesis.is_under_decal()))
    }
}

/// What a former answer that stays is doubted by, px^2, where another look at the same disc sees it farther away than a
/// standard deviation: pixels that are the same should tell the same.
fn disagreement(new: &Detection, old: &Detection) -> Option<Matrix2<f64>> {
    let apart = new.centre_px - old.centre_px;
    let off = mahalanobis(&apart, &old.covariance_px2);
    (new.shape == old.shape && off > 1.0 && off.is_finite()).then(|| apart * apart.transpose())
}
