//! Repeated measurement of discs under the decal of a neighbouring disc.

use nalgebra::Matrix2;

use super::neighbours::{has_predicted_length, predict_major_from_others};
use crate::detect::accept::options::VERDICT;
use crate::detect::accept::{
    found::FoundMarkers, preference::fits_better, verdict::MeasuredMarker,
};
use crate::detect::attempt::strategies::Measurer;
use crate::detect::detection::{RejectReason, covariance::CovarianceSource};
use crate::detect::hypothesis::{Hypothesis, prior::PriorValue};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::numbers::IMPROBABLE_SIGMAS;
use crate::detect::occlusion::decal::{self, ROW_DIRECTION};
use crate::detect::propose::decal_cut;
use crate::detect::revise::options::UNDER_DECAL;
use crate::detect::segment::blob::Blob;
use crate::setup::Shape;

/// Disc of which a blob may show a part.
struct PartialDisc<'a> {
    blob: &'a Blob,
    index: usize,
    /// Neighbouring disc whose decal may hide it.
    neighbour: &'a MeasuredMarker,
    /// Semi-major axis, px.
    size: PriorValue,
    /// Previous measurement as a disc of that size.
    old: Option<&'a MeasuredMarker>,
}

impl PartialDisc<'_> {
    /// Returns whether a measurement is too thin compared with the neighbour: a decal that ends along a disc leaves what
    /// looks like a thinner one.
    fn is_thin(&self, m: &MeasuredMarker) -> bool {
        axis_ratio(m) < UNDER_DECAL.thin_ratio * axis_ratio(self.neighbour)
    }

    /// Returns whether the disc was seen whole.
    fn is_seen_whole(&self) -> bool {
        self.old
            .is_some_and(|old| old.is_whole && !self.is_thin(old))
    }

    /// Returns whether a new measurement is one of the disc. It uses size and shape and therefore replaces a measurement of
    /// a part.
    fn matches_disc(&self, new: &MeasuredMarker) -> bool {
        has_predicted_length(new, self.size, IMPROBABLE_SIGMAS)
            && is_within_factor(
                new.detection.contrast,
                self.neighbour.detection.contrast,
                UNDER_DECAL.max_contrast_ratio,
            )
            && !self
                .neighbour
                .detection
                .ellipse()
                .contains(new.detection.centre_px)
    }

    /// Measures the part of the disc outside the decal, for a decal along rows and one along the line in which the blob
    /// ends.
    fn measure(
        &self,
        measurer: &Measurer,
        is_included: impl Fn(&Hypothesis) -> bool,
    ) -> Option<MeasuredMarker> {
        let other_ellipse = self.neighbour.detection.ellipse();
        let under = |axis| {
            let hypothesis = decal_cut::disc_under_decal(
                measurer.image,
                self.blob,
                &other_ellipse,
                axis,
                self.size,
                self.neighbour.blur,
            )?;
            let hypothesis = Some(Hypothesis {
                blobs: vec![self.index],
                ..hypothesis
            })
            .filter(&is_included)?;
            measurer
                .measure(&hypothesis)
                .ok()
                .filter(|new| self.matches_disc(new))
        };
        let both = [
            Some(ROW_DIRECTION),
            decal::find_cut_direction(self.blob, &other_ellipse),
        ]
        .into_iter()
        .flatten()
        .filter_map(under);
        both.reduce(|one, other| {
            if fits_better(&other.detection, &one.detection) {
                other
            } else {
                one
            }
        })
    }
}

/// Returns the outline of a disc that is too thin compared with its neighbour, and the covariance to add, px^2: it may be
/// displaced across by the missing thickness.
fn inflation_if_thin(
    thin: &MeasuredMarker,
    neighbour: &MeasuredMarker,
) -> Option<(Ellipse, Matrix2<f64>)> {
    let (ellipse, other_ellipse) = (thin.detection.ellipse(), neighbour.detection.ellipse());
    let least = if thin.is_whole {
        UNDER_DECAL.thin_ratio_whole
    } else {
        UNDER_DECAL.thin_ratio_part
    };
    let is_far_thinner = axis_ratio(thin) < least * axis_ratio(neighbour)
        // Dirt is shorter than half of it.
        && is_within_factor(ellipse.major, other_ellipse.major, 2.0);
    let off = ellipse.minor_direction() * (axis_ratio(neighbour) * ellipse.major - ellipse.minor);
    is_far_thinner.then(|| (ellipse, off * off.transpose()))
}

/// Measures the visible part of discs under the decal of a neighbour, with the length predicted from the neighbours and the
/// shape of that neighbour. Candidates are blobs without a marker, and markers that are too thin or of another size.
/// Increases the covariance of those that are too thin and cannot be measured this way.
pub fn revise_under_decals(
    measurer: &Measurer,
    found: &mut FoundMarkers,
    is_included: impl Fn(&Hypothesis) -> bool,
) {
    let is_disc = |m: &MeasuredMarker| m.detection.shape == Shape::Circle;
    let has_decal = |m: &MeasuredMarker| is_disc(m) && m.is_sure();
    let reach = |m: &MeasuredMarker| decal_cut::decal_reach(&m.detection.ellipse());
    let decals: Vec<[f64; 4]> = found
        .measured
        .iter()
        .filter(|m| has_decal(m))
        .map(reach)
        .collect();
    let touched = |blob: &Blob| {
        !blob.at_edge
            && decals
                .iter()
                .any(|decal| decal_cut::overlaps_box(blob, decal))
    };
    let mut inflations: Vec<(Ellipse, Matrix2<f64>)> = Vec::new();
    for (index, blob) in measurer
        .blobs
        .iter()
        .enumerate()
        .filter(|(_, blob)| touched(blob))
    {
        let own = found
            .measured
            .iter()
            .position(|m| m.detection.ellipse().contains(blob.centroid));
        let slot = own.and_then(|own| found.measured.get(own));
        if slot.is_some_and(|slot| !is_disc(slot)) {
            continue;
        }
        // The disc may have been found at two thresholds.
        let others = found
            .measured
            .iter()
            .filter(|m| !m.detection.ellipse().contains(blob.centroid));
        let near = |m: &&MeasuredMarker| has_decal(m) && decal_cut::overlaps_box(blob, &reach(m));
        let apart = |m: &MeasuredMarker| (m.detection.centre_px - blob.centroid).norm();
        let neighbour = others
            .filter(near)
            .min_by(|one, other| apart(one).total_cmp(&apart(other)));
        let Some(neighbour) =
            neighbour.filter(|m| apart(m) < UNDER_DECAL.max_distance * m.detection.semi_major_px)
        else {
            continue;
        };
        let other_ellipse = neighbour.detection.ellipse();
        let left = blob.area / (std::f64::consts::PI * other_ellipse.major * other_ellipse.minor);
        let size = if (UNDER_DECAL.min_area..1.0).contains(&left) {
            predict_major_from_others(found, own, blob.centroid)
        } else {
            None
        };
        let size = size.filter(|major| {
            is_within_factor(major.value, other_ellipse.major, UNDER_DECAL.max_size_ratio)
        });
        let part = size.map(|size| PartialDisc {
            blob,
            index,
            neighbour,
            size,
            old: slot.filter(|m| has_predicted_length(m, size, IMPROBABLE_SIGMAS)),
        });
        if part.as_ref().is_some_and(PartialDisc::is_seen_whole) {
            continue;
        }
        let Some(measured) = part.and_then(|part| part.measure(measurer, &is_included)) else {
            inflations.extend(slot.and_then(|slot| inflation_if_thin(slot, neighbour)));
            continue;
        };
        let ellipse = measured.detection.ellipse();
        found.rejected.retain(|r| !ellipse.contains(r.centre_px));
        // The part may also have been segmented at another threshold.
        let is_part = |m: &MeasuredMarker| {
            is_disc(m)
                && ellipse.contains(m.detection.centre_px)
                && axis_ratio(m) < UNDER_DECAL.thin_ratio * axis_ratio(&measured)
        };
        let parts = found
            .measured
            .iter()
            .enumerate()
            .filter(|(k, m)| Some(*k) != own && is_part(m));
        let parts: Vec<usize> = parts.map(|(k, _)| k).collect();
        found.replace_or_add(own, measured);
        found.reject_indices(RejectReason::Duplicate, &parts);
    }
    apply_inflations(found, &inflations);
}

/// Increases the covariances of discs with some outlines, at any threshold, or rejects those for which the increase is too
/// large.
fn apply_inflations(found: &mut FoundMarkers, inflations: &[(Ellipse, Matrix2<f64>)]) {
    let is_it = |m: &MeasuredMarker, ellipse: &Ellipse| {
        let own = m.detection.ellipse();
        ellipse.contains(own.centre)
            && is_within_factor(own.minor, ellipse.minor, UNDER_DECAL.max_size_ratio)
    };
    let mut none = Vec::new();
    for (i, m) in found.measured.iter_mut().enumerate() {
        if let Some((_, inflation)) = inflations.iter().find(|(ellipse, _)| is_it(m, ellipse)) {
            m.detection
                .covariance_px2
                .add(CovarianceSource::NeighbourThickness, *inflation);
            none.extend(
                (inflation.trace() > VERDICT.max_sigma_px * VERDICT.max_sigma_px).then_some(i),
            );
        }
    }
    found.reject_indices(RejectReason::Uncertain, &none);
}

/// Returns a disc's thickness over its length.
fn axis_ratio(disc: &MeasuredMarker) -> f64 {
    disc.detection.semi_minor_px / disc.detection.semi_major_px
}

/// Returns whether two positive numbers differ by less than a factor.
fn is_within_factor(one: f64, other: f64, factor: f64) -> bool {
    one < factor * other && other < factor * one
}
