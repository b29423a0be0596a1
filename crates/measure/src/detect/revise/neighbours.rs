//! Repeated measurement of markers with size, blur and darkness predicted from their neighbours.

use nalgebra::Vector2;

use crate::detect::accept::{
    found::FoundMarkers, preference::is_preferred, verdict::MeasuredMarker,
};
use crate::detect::appearance::parameters::{EDGE_END_BLURS, MarkerPattern};
use crate::detect::attempt::{strategies::Measurer, whole::looks_cut};
use crate::detect::detection::{RejectReason, covariance::CovarianceSource};
use crate::detect::estimate::{options::PRIOR, prior::darkness_for_grey_ratio};
use crate::detect::hypothesis::prior::{EdgePrior, PriorValue, SizePrior};
use crate::detect::hypothesis::{Hypothesis, neighbours};
use crate::detect::numbers::{IMPROBABLE_SIGMAS, MIN_TYPICAL};
use crate::detect::occlusion::region::OcclusionBand;
use crate::detect::propose::{gather::BlobCollector, moments};
use crate::detect::revise::options::NEIGHBOUR;
use crate::detect::segment::blob;
use crate::estimation::robust::median;
use crate::ordering::sort_by_value;
use crate::raster::Raster;
use crate::setup::Shape;

/// Measures partly hidden discs again with the length predicted from the whole discs around them, including those of which
/// too little was visible before. Rejects discs whose length differs from the prediction: something else was taken for the
/// hidden end.
pub fn revise_with_size(
    measurer: &Measurer,
    found: &mut FoundMarkers,
    hidden: Vec<(Option<usize>, Hypothesis)>,
) {
    let mut wrong: Vec<usize> = Vec::new();
    let through_glare = measurer.through_glare();
    for (index, hypothesis) in hidden {
        let old = index.and_then(|i| found.measured.get(i));
        let Some(size) = predict_major_from_others(found, index, hypothesis.ellipse.centre) else {
            // The part under glare may be visible through it.
            let better = |new: &MeasuredMarker| {
                old.is_none_or(|old| is_preferred(&new.detection, &old.detection))
            };
            let shown = if old.is_some_and(MeasuredMarker::is_sure) {
                None
            } else {
                through_glare
                    .measure(&hypothesis)
                    .ok()
                    .filter(|new| new.through_glare && better(new))
            };
            shown
                .into_iter()
                .for_each(|shown| found.replace_or_add(index, shown));
            continue;
        };
        let fits = |m: &MeasuredMarker| has_predicted_length(m, size, IMPROBABLE_SIGMAS);
        // Whole discs may lie next to saturated areas.
        if old.is_some_and(|old| old.is_whole && old.is_sure() && fits(old)) {
            continue;
        }
        // The measurement with the predicted size uses more information than the previous one, and replaces it.
        let remeasured = through_glare
            .measure(&with_predicted_size(hypothesis, size))
            .ok()
            .filter(fits);
        match remeasured {
            Some(remeasured) => found.replace_or_add(index, remeasured),
            None => wrong.extend(index.filter(|_| old.is_some_and(|old| !fits(old)))),
        }
    }
    wrong.sort_unstable();
    wrong.dedup();
    found.reject_indices(RejectReason::Uncertain, &wrong);
}

/// Returns the hypothesis with a predicted semi-major axis, px. The visible end keeps its position.
fn with_predicted_size(mut hypothesis: Hypothesis, major: PriorValue) -> Hypothesis {
    let by = major.value - hypothesis.ellipse.major;
    let shift = |band: &OcclusionBand| {
        let longer = band.axis * by;
        match (band.from.is_finite(), band.to.is_finite()) {
            (true, false) => longer,
            (false, true) => -longer,
            _ => Vector2::zeros(),
        }
    };
    let shift: Vector2<f64> = hypothesis.glare().map(shift).sum();
    hypothesis.ellipse.centre += shift;
    hypothesis.ellipse.major = major.value;
    hypothesis.prior.size = Some(SizePrior { major, slope: None });
    hypothesis
}

/// Returns whether a thin marker may have been rejected only because its blur and thickness are not separable.
pub fn is_unsure(reason: RejectReason, hypothesis: &Hypothesis) -> bool {
    use RejectReason::{NoConvergence, NotAnEllipse, TooSmall, Uncertain};
    match reason {
        NoConvergence | NotAnEllipse | Uncertain => true,
        TooSmall => hypothesis.pattern == MarkerPattern::Disc,
        _ => false,
    }
}

/// Measures markers about as thin as the blur again, with blur and darkness from the markers around them. Discs must also
/// have the length predicted by their neighbours.
pub fn revise_with_edge_prior(
    measurer: &Measurer,
    found: &mut FoundMarkers,
    unsure: Vec<Hypothesis>,
) {
    for mut hypothesis in unsure {
        let ellipse = hypothesis.ellipse;
        if found.contains(ellipse.centre) {
            continue;
        }
        hypothesis.prior.edge = edge_prior(found, ellipse.centre)
            .filter(|edge| ellipse.minor < EDGE_END_BLURS * edge.blur.value);
        if hypothesis.prior.edge.is_none() {
            continue;
        }
        let mut size = None;
        if hypothesis.pattern == MarkerPattern::Disc {
            size = predict_major_from_others(found, None, ellipse.centre);
            size = size.filter(|major| ellipse.major > NEIGHBOUR.min_visible * major.value);
            let Some(size) = size else { continue };
            hypothesis = with_predicted_size(hypothesis, size);
        }
        let measured = measurer.measure(&hypothesis).ok();
        let sure = |m: &MeasuredMarker| {
            size.is_none_or(|size| has_predicted_length(m, size, NEIGHBOUR.max_thin_size_sigmas))
        };
        if let Some(measured) = measured.filter(sure) {
            let own = measured.detection.ellipse();
            found.rejected.retain(|r| !own.contains(r.centre_px));
            found.measured.push(measured);
        }
    }
}

/// Measures discs in regions with uneven background, segmented at one threshold, if nothing else was found there.
pub fn find_against_one_level(
    measurer: &Measurer,
    found: &mut FoundMarkers,
    seen: &Raster,
    gathered: &BlobCollector,
    is_included: impl Fn(&Hypothesis) -> bool,
) {
    let coarse = gathered.far_frame();
    for region in &gathered.uneven {
        if found.contains(region.centre(coarse.factor)) {
            continue;
        }
        for blob in blob::blobs_against_surround(seen, coarse, region) {
            if blob.at_edge || looks_cut(&blob) || found.contains(blob.centroid) {
                continue;
            }
            let disc = moments::disc_from_blob(usize::MAX, &blob).filter(&is_included);
            let measured = disc.map(|disc| measurer.measure(&disc));
            found.measured.extend(measured.and_then(Result::ok));
        }
    }
}

/// Predicts the semi-major axis of a disc at a position, px, from all measured markers except one.
pub fn predict_major_from_others(
    found: &FoundMarkers,
    own: Option<usize>,
    at: Vector2<f64>,
) -> Option<PriorValue> {
    let others = found
        .measured
        .iter()
        .enumerate()
        .filter(|(i, _)| Some(*i) != own);
    neighbours::predict_major(others.map(|(_, m)| &m.detection), at)
}

/// Increases the covariance of thin discs whose length differs from the prediction of their neighbours by more than two
/// standard deviations: something at one
/// end was taken for a part of the disc, so the centre may be displaced along the axis by as much. Rejects discs that
/// differ by a large fraction of their length.
pub fn inflate_length_outliers(found: &mut FoundMarkers) {
    let inflations: Vec<f64> = (found.measured.iter().enumerate())
        .map(|(i, own)| {
            let d = &own.detection;
            let thin = d.shape == Shape::Circle && d.semi_minor_px < EDGE_END_BLURS * own.blur;
            let size = if thin {
                predict_major_from_others(found, Some(i), d.centre_px)
            } else {
                None
            };
            let Some(major) = size else { return 0.0 };
            let longer = (d.semi_major_px - major.value).powi(2);
            let chance = own.major_sigma_px.powi(2) + major.sigma * major.sigma;
            if longer > 2.0 * 2.0 * chance {
                longer - chance
            } else {
                0.0
            }
        })
        .collect();
    let mut none = Vec::new();
    for (i, (MeasuredMarker { detection: own, .. }, inflation)) in
        found.measured.iter_mut().zip(inflations).enumerate()
    {
        own.covariance_px2.add_along(
            CovarianceSource::NeighbourLength,
            own.ellipse().major_direction(),
            inflation,
        );
        none.extend(
            (inflation > (NEIGHBOUR.max_length_error * own.semi_major_px).powi(2)).then_some(i),
        );
    }
    found.reject_indices(RejectReason::Uncertain, &none);
}

/// Returns the prior of an edge from the markers nearest to a position, if there are enough.
fn edge_prior(found: &FoundMarkers, at: Vector2<f64>) -> Option<EdgePrior> {
    let mut near: Vec<&MeasuredMarker> = found.measured.iter().collect();
    if near.len() < MIN_TYPICAL {
        return None;
    }
    let distance = |m: &MeasuredMarker| (m.detection.centre_px - at).norm_squared();
    sort_by_value(&mut near, |one| distance(one));
    near.truncate(MIN_TYPICAL);
    let blur = median(near.iter().map(|m| m.blur).collect())?;
    let darkness = median(near.iter().map(|m| m.darkness).collect())?;
    let dark = darkness_for_grey_ratio((1.0 - darkness).max(0.0));
    Some(EdgePrior {
        blur: PriorValue::with_relative_sigma(blur, PRIOR.edge_scatter),
        dark: PriorValue {
            value: dark,
            sigma: PRIOR.edge_scatter,
        },
    })
}

/// Returns whether a disc has the predicted length, px, within a number of standard deviations.
pub fn has_predicted_length(disc: &MeasuredMarker, major: PriorValue, sigmas: f64) -> bool {
    (disc.detection.semi_major_px - major.value).abs() < sigmas * major.sigma
}
