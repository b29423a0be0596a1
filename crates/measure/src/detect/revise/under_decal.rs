//! Repeated measurement of discs under the decal of a neighbouring disc.

use super::neighbours::{has_predicted_length, predict_major_from_others};
use crate::detect::accept::{found::FoundMarkers, verdict::MeasuredMarker};
use crate::detect::attempt::strategies::Measurer;
use crate::detect::detection::RejectReason;
use crate::detect::hypothesis::{Hypothesis, prior::PriorValue};
use crate::detect::numbers::IMPROBABLE_SIGMAS;
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

    /// Measures the part of the disc outside the decal.
    fn measure(
        &self,
        measurer: &Measurer,
        is_included: impl Fn(&Hypothesis) -> bool,
    ) -> Option<MeasuredMarker> {
        let hypothesis = decal_cut::disc_under_decal(
            measurer.image,
            self.blob,
            &self.neighbour.detection.ellipse(),
            self.size,
            self.neighbour.blur,
        )?;
        let hypothesis = Some(Hypothesis {
            blobs: vec![self.index],
            ..hypothesis
        })
        .filter(is_included)?;
        measurer
            .measure(&hypothesis)
            .ok()
            .filter(|new| self.matches_disc(new))
    }
}

/// Measures the visible part of discs under the decal of a neighbour, with the length predicted from the neighbours and the
/// shape of that neighbour. Candidates are blobs without a marker, and markers that are too thin or of another size.
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
}

/// Returns a disc's thickness over its length.
fn axis_ratio(disc: &MeasuredMarker) -> f64 {
    disc.detection.semi_minor_px / disc.detection.semi_major_px
}

/// Returns whether two positive numbers differ by less than a factor.
fn is_within_factor(one: f64, other: f64, factor: f64) -> bool {
    one < factor * other && other < factor * one
}
