//! Markers measured once more, when those about them have told size, blur and darkness.

use nalgebra::Vector2;

use crate::detect::accept::{better::is_preferred, found::FoundMarkers, verdict::MeasuredMarker};
use crate::detect::appearance::parameters::MarkerPattern;
use crate::detect::attempt::{ladder::Measurer, whole::looks_cut};
use crate::detect::detection::{RejectReason, covariance::CovarianceSource};
use crate::detect::estimate::prior::darkness_for_grey_ratio;
use crate::detect::hypothesis::prior::{EdgePrior, PriorValue, SizePrior};
use crate::detect::hypothesis::{Hypothesis, neighbours};
use crate::detect::occlusion::region::OcclusionBand;
use crate::detect::propose::{gather::BlobCollector, moments};
use crate::detect::revise::options::NEIGHBOUR;
use crate::detect::segment::blob;
use crate::estimation::robust::median;
use crate::raster::Raster;
use crate::setup::Shape;

/// Measures discs that are hidden in part once more, when the whole ones about them have told how
/// large they are; also those of which too little was seen before. One of quite another size is turned down: something
/// else passes for its hidden end.
pub fn revise_with_size(ladder: &Measurer, found: &mut FoundMarkers, hidden: Vec<(Option<usize>, Hypothesis)>) {
    let mut wrong: Vec<usize> = Vec::new();
    let through_glare = ladder.through_glare();
    for (index, hypothesis) in hidden {
        let old = index.and_then(|i| found.measured.get(i));
        let Some(size) = predicted_major(found, index, hypothesis.ellipse.centre) else {
            // What glare lies over may show as a whole.
            let better = |new: &MeasuredMarker| old.is_none_or(|old| is_preferred(&new.detection, &old.detection));
            let shown = if old.is_some_and(MeasuredMarker::is_sure) {
                None
            } else {
                through_glare.measure(&hypothesis).ok().filter(|new| new.through_glare && better(new))
            };
            shown.into_iter().for_each(|shown| found.replace_or_add(index, shown));
            continue;
        };
        let fits = |m: &MeasuredMarker| is_as_long(m, size, NEIGHBOUR.unlike_sigmas);
        // Whole discs may lie beside what is saturated.
        if old.is_some_and(|old| old.is_whole && old.is_sure() && fits(old)) {
            continue;
        }
        // With the size it knows more than the former answer, which it replaces.
        let again = through_glare.measure(&with_size(hypothesis, size)).ok().filter(fits);
        match again {
            Some(again) => found.replace_or_add(index, again),
            None => wrong.extend(index.filter(|_| old.is_some_and(|old| !fits(old)))),
        }
    }
    wrong.sort_unstable();
    wrong.dedup();
    found.reject_indices(RejectReason::Uncertain, &wrong);
}

/// The hypothesis with a predicted semi-major axis, px. The end that is seen stays where it is.
fn with_size(mut hypothesis: Hypothesis, major: PriorValue) -> Hypothesis {
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

/// Whether a thin marker may be turned down so only because it does not tell blur and thickness apart.
pub fn is_unsure(reason: RejectReason, hypothesis: &Hypothesis) -> bool {
    use RejectReason::{NoConvergence, NotAnEllipse, TooSmall, Uncertain};
    match reason {
        NoConvergence | NotAnEllipse | Uncertain => true,
        TooSmall => hypothesis.pattern == MarkerPattern::Disc,
        _ => false,
    }
}

/// Measures what is about as thin as the blur once more, when the markers about it have told blur and darkness. Discs also
/// need to be as long as those about them predict.
pub fn revise_with_edge_prior(ladder: &Measurer, found: &mut FoundMarkers, unsure: Vec<Hypothesis>) {
    for mut hypothesis in unsure {
        let ellipse = hypothesis.ellipse;
        if found.contains(ellipse.centre) {
            continue;
        }
        hypothesis.prior.edge = edge_prior(found, ellipse.centre)
            .filter(|edge| ellipse.minor < NEIGHBOUR.thin_blurs * edge.blur.value);
        if hypothesis.prior.edge.is_none() {
            continue;
        }
        let mut size = None;
        if hypothesis.pattern == MarkerPattern::Disc {
            size = predicted_major(found, None, ellipse.centre);
            size = size.filter(|major| ellipse.major > NEIGHBOUR.seen * major.value);
            let Some(size) = size else { continue };
            hypothesis = with_size(hypothesis, size);
        }
        let measured = ladder.measure(&hypothesis).ok();
        let sure = |m: &MeasuredMarker| size.is_none_or(|size| is_as_long(m, size, NEIGHBOUR.unlike_thin_sigmas));
        if let Some(measured) = measured.filter(sure) {
            let own = measured.detection.ellipse();
            found.rejected.retain(|r| !own.contains(r.centre_px));
            found.measured.push(measured);
        }
    }
}

/// Measures discs in regions whose background is uneven, seen against one level, where nothing else was found.
pub fn find_against_one_level(
    ladder: &Measurer,
    found: &mut FoundMarkers,
    seen: &Raster,
    gathered: &BlobCollector,
    wanted: impl Fn(&Hypothesis) -> bool,
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
            let disc = moments::disc_from_blob(usize::MAX, &blob).filter(&wanted);
            let measured = disc.map(|disc| ladder.measure(&disc));
            found.measured.extend(measured.and_then(Result::ok));
        }
    }
}

/// The semi-major axis of a disc at a place, px, from all that was found but itself.
pub fn predicted_major(found: &FoundMarkers, own: Option<usize>, at: Vector2<f64>) -> Option<PriorValue> {
    let others = found.measured.iter().enumerate().filter(|(i, _)| Some(*i) != own);
    neighbours::predicted_major(others.map(|(_, m)| &m.detection), at)
}

/// Where a thin disc is longer or shorter than those about it predict, something at one of its ends passes for a part of
/// it: the centre may be off along the axis by as much, which its standard deviation then says. What is off by a good part
/// of its length is none of them.
pub fn inflate_unlike(found: &mut FoundMarkers) {
    let inflations: Vec<f64> = (found.measured.iter().enumerate())
        .map(|(i, own)| {
            let d = &own.detection;
            let thin = d.shape == Shape::Circle && d.semi_minor_px < NEIGHBOUR.thin_blurs * own.blur;
            let size = if thin { predicted_major(found, Some(i), d.centre_px) } else { None };
            let Some(major) = size else { return 0.0 };
            let longer = (d.semi_major_px - major.value).powi(2);
            let chance = own.length.powi(2) + major.sigma * major.sigma;
            if longer > NEIGHBOUR.unlikely_sigmas * NEIGHBOUR.unlikely_sigmas * chance {
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
        own.covariance_px2.add_along(CovarianceSource::NeighbourLength, own.ellipse().axis(), inflation);
        none.extend((inflation > (NEIGHBOUR.none * own.semi_major_px).powi(2)).then_some(i));
    }
    found.reject_indices(RejectReason::Uncertain, &none);
}

/// What the markers nearest to a place tell of an edge, where there are some.
fn edge_prior(found: &FoundMarkers, at: Vector2<f64>) -> Option<EdgePrior> {
    let mut near: Vec<&MeasuredMarker> = found.measured.iter().collect();
    if near.len() < NEIGHBOUR.enough {
        return None;
    }
    let distance = |m: &MeasuredMarker| (m.detection.centre_px - at).norm_squared();
    near.sort_by(|one, other| distance(one).total_cmp(&distance(other)));
    near.truncate(NEIGHBOUR.enough);
    let blur = median(near.iter().map(|m| m.blur).collect())?;
    let darkness = median(near.iter().map(|m| m.darkness).collect())?;
    let dark = darkness_for_grey_ratio((1.0 - darkness).max(0.0));
    Some(EdgePrior {
        blur: PriorValue::to_share(blur, NEIGHBOUR.same_blur),
        dark: PriorValue { value: dark, sigma: NEIGHBOUR.same_dark },
    })
}

/// Whether a disc is as long as was predicted, px, to so many standard deviations.
pub fn is_as_long(disc: &MeasuredMarker, major: PriorValue, sigmas: f64) -> bool {
    (disc.detection.semi_major_px - major.value).abs() < sigmas * major.sigma
}
