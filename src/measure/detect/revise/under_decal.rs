//! Discs over which the decal of one beside them lies, measured once more when that one is known.

use nalgebra::Matrix2;

use super::neighbours::{is_as_long, predicted_major};
use crate::detect::accept::verdict::MeasuredMarker;
use crate::detect::accept::{better::fits_better, found::FoundMarkers, options::VERDICT};
use crate::detect::attempt::ladder::Measurer;
use crate::detect::detection::{RejectReason, covariance::CovarianceSource};
use crate::detect::hypothesis::{Hypothesis, prior::PriorValue};
use crate::detect::image::ellipse::Ellipse;
use crate::detect::occlusion::decal::{self, ROW_DIRECTION};
use crate::detect::propose::decal_cut;
use crate::detect::revise::options::{NEIGHBOUR, UNDER_DECAL};
use crate::detect::segment::blob::Blob;
use crate::setup::Shape;

/// What is known of a disc that a blob may show a part of.
struct PartialDisc<'a> {
    blob: &'a Blob,
    index: usize,
    /// The disc beside it, whose decal may hide it.
    neighbour: &'a MeasuredMarker,
    /// Its semi-major axis, px.
    size: PriorValue,
    /// What was measured as a disc of that size.
    old: Option<&'a MeasuredMarker>,
}

impl PartialDisc<'_> {
    /// Whether a disc is too thin beside that one: what a decal leaves that ends along a disc looks like a thinner one.
    fn is_thin(&self, m: &MeasuredMarker) -> bool {
        flatness(m) < UNDER_DECAL.thinner * flatness(self.neighbour)
    }

    /// Whether it was seen as a whole.
    fn is_seen(&self) -> bool {
        self.old.is_some_and(|old| old.is_whole && !self.is_thin(old))
    }

    /// Whether an answer is one for the disc. With size and shape it knows more than one of a part, which it replaces.
    fn is_for_it(&self, new: &MeasuredMarker) -> bool {
        is_as_long(new, self.size, NEIGHBOUR.unlike_sigmas)
            && same(new.detection.contrast, self.neighbour.detection.contrast, UNDER_DECAL.same_contrast)
            && !self.neighbour.detection.ellipse().contains(new.detection.centre_px)
    }

    /// What the decal leaves of the disc, if it lies along rows or along the line in which the blob ends.
    fn measured(&self, ladder: &Measurer, wanted: impl Fn(&Hypothesis) -> bool) -> Option<MeasuredMarker> {
        let beside = self.neighbour.detection.ellipse();
        let under = |axis| {
            let hypothesis =
                decal_cut::disc_under_decal(ladder.image, self.blob, &beside, axis, self.size, self.neighbour.blur)?;
            let hypothesis = Some(Hypothesis { blobs: vec![self.index], ..hypothesis }).filter(&wanted)?;
            ladder.measure(&hypothesis).ok().filter(|new| self.is_for_it(new))
        };
        let both = [Some(ROW_DIRECTION), decal::find_cut_direction(self.blob, &beside)].into_iter().flatten().filter_map(under);
        both.reduce(|one, other| if fits_better(&other.detection, &one.detection) { other } else { one })
    }
}

/// What the place of a disc is doubted by, px^2, that is too thin beside another one: it may lie as far across as it is too thin.
fn inflation_of_thin(thin: &MeasuredMarker, neighbour: &MeasuredMarker) -> Option<(Ellipse, Matrix2<f64>)> {
    let (ellipse, beside) = (thin.detection.ellipse(), neighbour.detection.ellipse());
    let least = if thin.is_whole { UNDER_DECAL.far_thinner } else { UNDER_DECAL.thinner_part };
    let is_far_thinner = flatness(thin) < least * flatness(neighbour)
        && same(ellipse.major, beside.major, UNDER_DECAL.same_kind);
    let off = ellipse.across() * (flatness(neighbour) * ellipse.major - ellipse.minor);
    is_far_thinner.then(|| (ellipse, off * off.transpose()))
}

/// Measures what the decal of a disc leaves of one beside it, with the size that the discs about predict and the shape of that
/// one: a blob in which nothing was found, something of another size, or something too thin. What is too thin and cannot be
/// told so is doubted.
pub fn revise_under_decals(ladder: &Measurer, found: &mut FoundMarkers, wanted: impl Fn(&Hypothesis) -> bool) {
    let is_disc = |m: &MeasuredMarker| m.detection.shape == Shape::Circle;
    let has_decal = |m: &MeasuredMarker| is_disc(m) && m.is_sure();
    let reach = |m: &MeasuredMarker| decal_cut::decal_reach(&m.detection.ellipse());
    let decals: Vec<[f64; 4]> = found.measured.iter().filter(|m| has_decal(m)).map(reach).collect();
    let touched = |blob: &Blob| !blob.at_edge && decals.iter().any(|decal| decal_cut::overlaps_box(blob, decal));
    let mut inflations: Vec<(Ellipse, Matrix2<f64>)> = Vec::new();
    for (index, blob) in ladder.blobs.iter().enumerate().filter(|(_, blob)| touched(blob)) {
        let own = found.measured.iter().position(|m| m.detection.ellipse().contains(blob.centroid));
        let slot = own.and_then(|own| found.measured.get(own));
        if slot.is_some_and(|slot| !is_disc(slot)) {
            continue;
        }
        // It may have been found at two levels.
        let others = found.measured.iter().filter(|m| !m.detection.ellipse().contains(blob.centroid));
        let near = |m: &&MeasuredMarker| has_decal(m) && decal_cut::overlaps_box(blob, &reach(m));
        let apart = |m: &MeasuredMarker| (m.detection.centre_px - blob.centroid).norm();
        let neighbour = others.filter(near).min_by(|one, other| apart(one).total_cmp(&apart(other)));
        let Some(neighbour) = neighbour.filter(|m| apart(m) < UNDER_DECAL.beside * m.detection.semi_major_px)
        else {
            continue;
        };
        let beside = neighbour.detection.ellipse();
        let left = blob.area / (std::f64::consts::PI * beside.major * beside.minor);
        let size = if (UNDER_DECAL.left..1.0).contains(&left) {
            predicted_major(found, own, blob.centroid)
        } else {
            None
        };
        let size = size.filter(|major| same(major.value, beside.major, UNDER_DECAL.same_size));
        let part = size.map(|size| PartialDisc {
            blob,
            index,
            neighbour,
            size,
            old: slot.filter(|m| is_as_long(m, size, NEIGHBOUR.unlike_sigmas)),
        });
        if part.as_ref().is_some_and(PartialDisc::is_seen) {
            continue;
        }
        let Some(measured) = part.and_then(|part| part.measured(ladder, &wanted)) else {
            inflations.extend(slot.and_then(|slot| inflation_of_thin(slot, neighbour)));
            continue;
        };
        let ellipse = measured.detection.ellipse();
        found.rejected.retain(|r| !ellipse.contains(r.centre_px));
        // The same part may have been seen at another level.
        let is_part = |m: &MeasuredMarker| {
            is_disc(m)
                && ellipse.contains(m.detection.centre_px)
                && flatness(m) < UNDER_DECAL.thinner * flatness(&measured)
        };
        let parts = found.measured.iter().enumerate().filter(|(k, m)| Some(*k) != own && is_part(m));
        let parts: Vec<usize> = parts.map(|(k, _)| k).collect();
        found.replace_or_add(own, measured);
        found.reject_indices(RejectReason::Duplicate, &parts);
    }
    inflate(found, &inflations);
}

/// Raises the covariances of discs with some outlines, at whatever level they were seen, or turns down those that are doubted too
/// much.
fn inflate(found: &mut FoundMarkers, inflations: &[(Ellipse, Matrix2<f64>)]) {
    let is_it = |m: &MeasuredMarker, ellipse: &Ellipse| {
        let own = m.detection.ellipse();
        ellipse.contains(own.centre) && same(own.minor, ellipse.minor, UNDER_DECAL.same_size)
    };
    let mut none = Vec::new();
    for (i, m) in found.measured.iter_mut().enumerate() {
        if let Some((_, inflation)) = inflations.iter().find(|(ellipse, _)| is_it(m, ellipse)) {
            m.detection.covariance_px2.add(CovarianceSource::NeighbourThickness, *inflation);
            none.extend((inflation.trace() > VERDICT.vaguest_px * VERDICT.vaguest_px).then_some(i));
        }
    }
    found.reject_indices(RejectReason::Uncertain, &none);
}

/// A disc's thickness over its length.
fn flatness(disc: &MeasuredMarker) -> f64 {
    disc.detection.semi_minor_px / disc.detection.semi_major_px
}

/// Whether two positive numbers differ by less than a factor.
fn same(one: f64, other: f64, factor: f64) -> bool {
    one < factor * other && other < factor * one
}
