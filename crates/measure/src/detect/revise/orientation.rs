//! Second pass over markers whose outline the orientation predicts.
//!
//! If glare hides an end of a disc, or if a disc is as thin as the blur, size and position are determined poorly together.
//! With the surveyed diameter at the known distance, only the position is estimated. Quadrants cut by glare or touched by
//! something dark may not be recognised; within their predicted outline the visible edges determine the crossing.

use nalgebra::Vector2;

use crate::detect::accept::{correlated, dirt, lost_contrast, misfit};
use crate::detect::accept::{
    options::CONSISTENCY, preference::is_preferred, verdict::MeasuredMarker,
};
use crate::detect::appearance::parameters::{EDGE_END_BLURS, MarkerPattern};
use crate::detect::attempt::{measure::Bounds, strategies::Measurer};
use crate::detect::detection::covariance::CovarianceSource;
use crate::detect::detection::{Detection, Detections, MarkerPrediction, compare_positions};
use crate::detect::estimate::options::PRIOR;
use crate::detect::hypothesis::Hypothesis;
use crate::detect::hypothesis::prior::{EdgePrior, MarkerPrior, PriorValue, SizePrior, SlopePrior};
use crate::detect::image::ellipse::{Ellipse, wrap_half_turn};
use crate::detect::numbers::{MIN_TYPICAL, SIGNIFICANT_SIGMAS};
use crate::detect::occlusion::{decal::ROW_DIRECTION, glare, options::GLARE};
use crate::detect::propose::{decal_cut, quadrant_edges};
use crate::detect::revise::options::ORIENTATION;
use crate::estimation::robust::{SIGMA_OVER_MEDIAN, median};
use crate::ordering::sort_by_value;
use crate::raster::Raster;
use crate::setup::Shape;

/// Marker predicted in the frame from its orientation and the known markers.
#[derive(Clone, Debug, PartialEq)]
pub struct ExpectedMarker {
    /// Predicted image in this frame.
    pub prediction: MarkerPrediction,
    /// Index of its detection, if it was found.
    pub found: Option<usize>,
    /// Index of the marker in the survey.
    pub marker: usize,
}

/// Sum of a position's variances from which on a disc is measured again, px^2. Chosen with [`ORIENTATION`].
pub const UNSURE_PX2: f64 = 0.04;

/// Errors of the predicted sizes: ratios of the axes, and differences of the directions, rad.
struct SizeDeviations {
    major: PriorValue,
    minor: PriorValue,
    angle: PriorValue,
}

/// Precisely measured discs of the frame, as predicted and as found.
struct ReliableDiscs(Vec<(MarkerPrediction, Detection)>);

impl ReliableDiscs {
    fn new(found: &[Detection], expected: &[ExpectedMarker]) -> Self {
        let pair = |e: &ExpectedMarker| Some((e.prediction.clone(), found.get(e.found?)?.clone()));
        let sure = |(_, d): &(MarkerPrediction, Detection)| {
            d.shape == Shape::Circle && d.variance() < ORIENTATION.reliable_px2
        };
        Self(expected.iter().filter_map(pair).filter(sure).collect())
    }

    /// Estimates the errors of a marker's predicted size: the major axis from all discs, minor axis and direction from
    /// those with the most similar predicted direction, because these depend on the skin's slope, which differs between
    /// leading and trailing edge.
    fn size_deviations(&self, expected: &MarkerPrediction) -> SizeDeviations {
        let mut similar: Vec<_> = self.0.iter().collect();
        let difference =
            |p: &MarkerPrediction| wrap_half_turn(p.angle_rad - expected.angle_rad).abs();
        sort_by_value(&mut similar, |(one, _)| difference(one));
        let few = similar.len().min(MIN_TYPICAL);
        let typical =
            |count: usize, value: &dyn Fn(&MarkerPrediction, &Detection) -> f64, least: f64| {
                let all: Vec<f64> = similar[..count].iter().map(|(p, d)| value(p, d)).collect();
                let value = median(all.clone()).filter(|_| all.len() >= ORIENTATION.min_discs)?;
                let off = median(all.iter().map(|v| (v - value).abs()).collect())?;
                Some(PriorValue {
                    value,
                    sigma: least.max(SIGMA_OVER_MEDIAN * off),
                })
            };
        let major = typical(
            similar.len(),
            &|p, d| d.semi_major_px / p.semi_major_px,
            ORIENTATION.major_sigma,
        );
        let minor = typical(
            few,
            &|p, d| d.semi_minor_px / p.semi_minor_px,
            ORIENTATION.minor_sigma,
        );
        let angle = typical(
            few,
            &|p, d| wrap_half_turn(d.angle_rad - p.angle_rad),
            ORIENTATION.angle_sigma_rad,
        );
        SizeDeviations {
            major: major.unwrap_or(PriorValue {
                value: 1.0,
                sigma: ORIENTATION.unknown_major_sigma,
            }),
            minor: minor.unwrap_or(PriorValue {
                value: 1.0,
                sigma: 2.0 * ORIENTATION.minor_sigma,
            }),
            angle: angle.unwrap_or(PriorValue::zero(2.0 * ORIENTATION.angle_sigma_rad)),
        }
    }
}

impl SizeDeviations {
    /// Builds the hypothesis of a predicted marker.
    fn hypothesis(&self, image: &Raster, expected: &MarkerPrediction) -> Option<Hypothesis> {
        let ellipse = expected.ellipse()?;
        let (major, minor) = (
            self.major.value * ellipse.major,
            self.minor.value * ellipse.minor,
        );
        let ellipse = Ellipse {
            major,
            minor,
            angle: wrap_half_turn(ellipse.angle + self.angle.value),
            ..ellipse
        };
        let (bands, hypothesis) = match expected.shape {
            Shape::Circle => {
                let bands = glare::find_glare_bands(image, &ellipse, GLARE.begin_ratio);
                (
                    bands,
                    Hypothesis::new(MarkerPattern::Disc, ellipse, Vec::new()),
                )
            }
            Shape::Point => return None,
            Shape::Quadrant => {
                // White must not be taken for lit skin. Without glare, something dark may touch the quadrants.
                let wider = Ellipse {
                    minor: ellipse.minor + ORIENTATION.outline_error_px,
                    ..ellipse
                };
                let bands = glare::find_slanting_glare(image, &wider, GLARE.bright_ratio);
                let inner = ellipse.enlarged(ORIENTATION.inner_fraction, 0.0);
                let hypothesis = quadrant_edges::place_quadrants(&inner, image, &bands)?;
                (bands, hypothesis)
            }
        };
        let slope = SlopePrior {
            minor: PriorValue {
                value: ellipse.minor,
                sigma: self.minor.sigma * expected.semi_minor_px,
            },
            angle: PriorValue {
                value: ellipse.angle,
                sigma: self.angle.sigma,
            },
        };
        let major = PriorValue {
            value: ellipse.major,
            sigma: self.major.sigma * expected.semi_major_px,
        };
        let size = SizePrior {
            major,
            slope: Some(slope),
        };
        let prior = MarkerPrior {
            size: Some(size),
            ..hypothesis.prior
        };
        Some(
            Hypothesis {
                prior,
                ..hypothesis
            }
            .with_glare(bands),
        )
    }

    /// Increases the covariance of a disc that is longer or thicker than predicted: something next to an edge was taken for
    /// a part of it, and the centre may be displaced by as much. Quadrants stay unchanged, because their crossing does not
    /// depend on the outline.
    fn inflate_size_outlier(&self, expected: &MarkerPrediction, disc: &mut Detection) {
        if disc.shape == Shape::Quadrant {
            return;
        }
        let ellipse = disc.ellipse();
        let variance = |axis: Vector2<f64>, size: f64, ratio: PriorValue, predicted: f64| {
            // Both ends determine the size as precisely as the centre.
            let chance =
                axis.dot(&(*disc.covariance_px2 * axis)) + (ratio.sigma * predicted).powi(2);
            let off = (size - ratio.value * predicted).powi(2);
            let is_unlike = off > SIGNIFICANT_SIGMAS * SIGNIFICANT_SIGMAS * chance;
            axis * axis.transpose() * if is_unlike { off - chance } else { 0.0 }
        };
        let variance = variance(
            ellipse.major_direction(),
            disc.semi_major_px,
            self.major,
            expected.semi_major_px,
        ) + variance(
            ellipse.minor_direction(),
            disc.semi_minor_px,
            self.minor,
            expected.semi_minor_px,
        );
        disc.covariance_px2
            .add(CovarianceSource::SurveyedSize, variance);
    }
}

/// Measures predicted discs that were not found or have a poorly determined position again, with the predicted size, and
/// predicted quadrants that were not found. Returns whether any measurement improved. The markers stay in order.
pub fn second_pass(image: &Raster, found: &mut Detections, expected: &[ExpectedMarker]) -> bool {
    let Some(psf) = found.psf_sigma_px else {
        return false;
    };
    let sure = ReliableDiscs::new(&found.markers, expected);
    let off = |(p, d): &(MarkerPrediction, Detection)| (d.centre_px - p.centre_px).norm();
    let near_px = ORIENTATION.max_distance_px;
    let typical = median(sure.0.iter().map(off).collect());
    let max_distance_px = typical.map_or(near_px, |typical| {
        near_px.max(ORIENTATION.distance_factor * typical)
    });
    let (blur, overshoot) = (ORIENTATION.max_blur_ratio * psf, found.overshoot);
    let bounds = Bounds {
        blur,
        through_glare: true,
        overshoot,
        ..Bounds::from_noise(found.noise)
    };
    let measurer = Measurer::new(image, &[], bounds);
    let pass = SecondPass {
        measurer,
        found,
        sure: &sure,
        psf,
        max_distance_px,
    };
    let new: Vec<_> = expected
        .iter()
        .filter_map(|expected| pass.remeasure(expected))
        .collect();
    let changed = !new.is_empty();
    for ExpectedMarker {
        prediction,
        found: own,
        ..
    } in expected
    {
        if let Some(disc) = own.and_then(|i| found.markers.get_mut(i)) {
            sure.size_deviations(prediction)
                .inflate_size_outlier(prediction, disc);
        }
    }
    replace_markers(found, new);
    changed
}

/// Replaces markers by new measurements or adds them.
fn replace_markers(found: &mut Detections, new: Vec<(Option<usize>, MeasuredMarker)>) {
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
    // A black part of the quadrants may have been taken for a disc.
    let part = |d: &Detection, q: &Ellipse| q.centre != d.centre_px && q.contains(d.centre_px);
    found
        .markers
        .retain(|d| !quadrants.iter().any(|q| part(d, q)));
    found
        .markers
        .sort_by(|a, b| compare_positions(&a.centre_px, &b.centre_px));
}

/// Predicted marker, the errors of its size, and the outlines of all other markers.
struct SearchTarget<'a> {
    prediction: &'a MarkerPrediction,
    sizes: SizeDeviations,
    others: Vec<Ellipse>,
}

/// Second pass over a frame in which some markers have been found.
struct SecondPass<'a> {
    measurer: Measurer<'a>,
    found: &'a Detections,
    sure: &'a ReliableDiscs,
    psf: f64,
    /// Largest distance of a marker from its predicted position, px. For quadrants the search range of the prediction counts
    /// if it is larger.
    max_distance_px: f64,
}

impl SecondPass<'_> {
    /// Measures a predicted marker again. Returns a better measurement, if there is one, with the index of the previous
    /// one.
    fn remeasure(
        &self,
        ExpectedMarker {
            prediction,
            found: own,
            ..
        }: &ExpectedMarker,
    ) -> Option<(Option<usize>, MeasuredMarker)> {
        let markers = &self.found.markers;
        let old = own.and_then(|i| markers.get(i));
        let is_below = |than: f64| old.is_some_and(|d| d.variance() < than);
        // A detected crossing is precise enough.
        let is_disc = prediction.shape == Shape::Circle;
        if is_below(if is_disc {
            ORIENTATION.recheck_px2
        } else {
            f64::INFINITY
        }) {
            return None;
        }
        let is_sure = is_below(if is_disc { UNSURE_PX2 } else { f64::INFINITY });
        let others = markers.iter().enumerate().filter(|(i, _)| Some(*i) != *own);
        let others = others.map(|(_, d)| d.ellipse()).collect();
        let target = SearchTarget {
            prediction,
            sizes: self.sure.size_deviations(prediction),
            others,
        };
        self.hypotheses(&target, is_sure)
            .into_iter()
            .find_map(|hypothesis| {
                let (measured, whole) = self.measure(&target, hypothesis)?;
                let centre = measured.detection.centre_px;
                // The marker may have been found but not identified.
                let own = own.or_else(|| {
                    markers.iter().position(|d| {
                        d.ellipse().normalized_radius(centre) < CONSISTENCY.same_radius
                    })
                });
                let mut old = own.and_then(|i| markers.get(i)).cloned();
                // A marker of another size than predicted may have another position too.
                old.iter_mut()
                    .for_each(|old| target.sizes.inflate_size_outlier(prediction, old));
                // Only quadrants have a crossing; a dark area may be another disc or dirt.
                let search_px = if is_disc {
                    0.0
                } else {
                    prediction.search_px.norm()
                };
                let near =
                    (centre - prediction.centre_px).norm() < self.max_distance_px.max(search_px);
                let new = &measured.detection;
                // A marker assumed to be hidden may be seen whole: the new measurement must have half the variance.
                let is_sure = |old: &Detection| whole || new.variance() < 0.5 * old.variance();
                let beats = |old: &Detection| {
                    new.shape == old.shape && is_preferred(new, old) && is_sure(old)
                };
                let better = near && old.as_ref().is_none_or(beats);
                better.then_some((own, measured))
            })
    }

    /// Returns the hypotheses for a predicted marker, in the order in which they are tried; for a precise one only the part
    /// outside a decal.
    fn hypotheses(&self, target: &SearchTarget, is_sure: bool) -> Vec<Hypothesis> {
        let SearchTarget {
            prediction,
            sizes,
            others,
        } = target;
        let whole = sizes.hypothesis(self.measurer.image, prediction);
        // The disc is assumed to be hidden only if it does not look whole.
        let hidden = |whole| {
            decal_cut::occluded_disc(self.measurer.image, whole, others, ROW_DIRECTION, self.psf)
        };
        let hidden = whole.as_ref().and_then(hidden);
        whole
            .filter(|_| !is_sure)
            .into_iter()
            .chain(hidden)
            .collect()
    }

    /// Measures a hypothesis, with the contributions of the frame's markers and its size to the covariance; also returns
    /// whether it was seen whole.
    fn measure(
        &self,
        target: &SearchTarget,
        mut hypothesis: Hypothesis,
    ) -> Option<(MeasuredMarker, bool)> {
        let (
            SearchTarget {
                prediction,
                sizes,
                others,
            },
            psf,
        ) = (target, self.psf);
        if prediction.shape == Shape::Circle && hypothesis.ellipse.minor < EDGE_END_BLURS * psf {
            hypothesis.prior.edge = Some(EdgePrior {
                blur: PriorValue::with_relative_sigma(psf, PRIOR.edge_scatter),
                dark: PriorValue::UNKNOWN,
            });
        }
        let mut measured = self.measurer.measure(&hypothesis).ok()?;
        correlated::raise_for_correlation(&mut measured, self.found.inflation);
        dirt::inflate_for_dirt(self.measurer.image, &mut measured, others);
        misfit::inflate_for_misfit(self.measurer.image, &mut measured, self.found.noise);
        lost_contrast::add_lost_contrast(&mut measured, self.found.lost_contrast_px);
        let (detection, inner) = (&mut measured.detection, &hypothesis.ellipse);
        // The outline of narrow quadrants is fitted; that of others stays the inner part of the predicted one.
        if prediction.shape == Shape::Quadrant && detection.semi_major_px == inner.major {
            detection.semi_major_px /= ORIENTATION.inner_fraction;
            detection.semi_minor_px /= ORIENTATION.inner_fraction;
        }
        sizes.inflate_size_outlier(prediction, &mut measured.detection);
        Some((measured, !hypothesis.is_under_decal()))
    }
}
