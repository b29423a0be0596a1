//! Discs over which the sheet of one beside them lies, measured once more when that one is known.

use nalgebra::Matrix2;

use super::neighbours::{UNLIKE, foretold_major, is_as_long};
use crate::measure::detect::accept::found::Found;
use crate::measure::detect::accept::verdict::Measured;
use crate::measure::detect::attempt::measure::measure;
use crate::measure::detect::attempt::whole::Whole;
use crate::measure::detect::detection::RejectReason;
use crate::measure::detect::hypothesis::candidate::Candidate;
use crate::measure::detect::image::ellipse::Outline;
use crate::measure::detect::occlusion::decal;
use crate::measure::detect::occlusion::decal::ROWS;
use crate::measure::detect::propose::decal_cut;
use crate::measure::detect::segment::blob::Blob;
use crate::measure::setup::Shape;

/// A disc whose sheet may hide one beside it: how far it may be, in semi-major axes; its size and contrast over the other's at
/// most; and the least share of its area that must be left of the other.
const BESIDE_IT: f64 = 1.5;
const SAME_SIZE: f64 = 1.1;
const SAME_CONTRAST: f64 = 1.3;
const LEFT: f64 = 0.25;
/// Flatness over that of the disc beside it below which what looks whole may be a part of a thicker one.
const THINNER: f64 = 0.88;
/// The same below which the skin's slope does not explain it; and below which of a disc that is known to be hidden in part
/// the hidden edge may lie elsewhere.
const FAR_THINNER: f64 = 0.7;
const THINNER_PART: f64 = 0.95;
/// Lengths of two markers over one another at most: dirt is shorter.
const SAME_KIND: f64 = 2.0;
/// Greatest doubt with which one that is too thin stays, px.
const MOST_DOUBT: f64 = 2.0;

/// What is known of a disc that a blob may show a part of.
struct Part<'a> {
    blob: &'a Blob,
    index: usize,
    /// The disc beside it, whose sheet may hide it.
    like: &'a Measured,
    /// Its semi-major axis and the standard deviation of that, px.
    size: (f64, f64),
    /// What was measured as a disc of that size.
    old: Option<&'a Measured>,
}

impl Part<'_> {
    /// Whether a disc is too thin beside that one: what a sheet leaves that ends along a disc looks like a thinner one.
    fn is_thin(&self, m: &Measured) -> bool {
        flatness(m) < THINNER * flatness(self.like)
    }

    /// Whether it was seen as a whole.
    fn is_seen(&self) -> bool {
        self.old.is_some_and(|old| old.is_whole && !self.is_thin(old))
    }

    /// Whether an answer is one for the disc, and better than what was measured before.
    fn is_better(&self, new: &Measured) -> bool {
        let better = self.old.is_none_or(|old| {
            let surer = !self.is_thin(old) && new.detection.variance() < old.detection.variance();
            surer || new.detection.fit_rms < old.detection.fit_rms
        });
        better
            && is_as_long(new, self.size, UNLIKE)
            && same(new.detection.contrast, self.like.detection.contrast, SAME_CONTRAST)
            && !self.like.detection.outline().holds(new.detection.centre_px)
    }

    /// What the sheet leaves of the disc, if it lies along rows or along the line in which the blob ends.
    fn measured(&self, known: &Whole, wanted: impl Fn(&Candidate) -> bool) -> Option<Measured> {
        let beside = self.like.detection.outline();
        let under = |axis| {
            let candidate =
                decal_cut::under(known.image, self.blob, &beside, axis, self.size, self.like.blur)?;
            let candidate = Some(Candidate { blobs: vec![self.index], ..candidate }).filter(&wanted)?;
            measure(known.image, known.blobs, &candidate, known.bounds).ok().filter(|new| self.is_better(new))
        };
        let both = [Some(ROWS), decal::cut(self.blob, &beside)].into_iter().flatten().filter_map(under);
        both.min_by(|a, b| a.detection.fit_rms.total_cmp(&b.detection.fit_rms))
    }
}

/// What the place of a disc is doubted by, px^2, that is too thin beside another one: it may lie as far across as it is too thin.
fn doubt_thin(thin: &Measured, like: &Measured) -> Option<(Outline, Matrix2<f64>)> {
    let (outline, beside) = (thin.detection.outline(), like.detection.outline());
    let least = if thin.is_whole { FAR_THINNER } else { THINNER_PART };
    let doubted = flatness(thin) < least * flatness(like) && same(outline.major, beside.major, SAME_KIND);
    let off = outline.across() * (flatness(like) * outline.major - outline.minor);
    doubted.then(|| (outline, off * off.transpose()))
}

/// Measures what the sheet of a disc leaves of one beside it, with the size that the discs about foretell and the shape of that
/// one: a blob in which nothing was found, something of another size, or something too thin. What is too thin and cannot be
/// told so is doubted.
pub fn again_under_sheets(known: &Whole, found: &mut Found, wanted: impl Fn(&Candidate) -> bool) {
    let is_disc = |m: &Measured| m.detection.shape == Shape::Circle;
    let has_sheet = |m: &Measured| is_disc(m) && m.is_sure();
    let reach = |m: &Measured| decal_cut::reach(&m.detection.outline());
    let sheets: Vec<[f64; 4]> = found.measured.iter().filter(|m| has_sheet(m)).map(reach).collect();
    let touched = |blob: &Blob| !blob.at_edge && sheets.iter().any(|sheet| decal_cut::meets(blob, sheet));
    let mut doubts: Vec<(Outline, Matrix2<f64>)> = Vec::new();
    for (index, blob) in known.blobs.iter().enumerate().filter(|(_, blob)| touched(blob)) {
        let own = found.measured.iter().position(|m| m.detection.outline().holds(blob.centroid));
        let slot = own.and_then(|own| found.measured.get(own));
        if slot.is_some_and(|slot| !is_disc(slot)) {
            continue;
        }
        // It may have been found at two levels.
        let others = found.measured.iter().filter(|m| !m.detection.outline().holds(blob.centroid));
        let near = |m: &&Measured| has_sheet(m) && decal_cut::meets(blob, &reach(m));
        let apart = |m: &Measured| (m.detection.centre_px - blob.centroid).norm();
        let like = others.filter(near).min_by(|one, other| apart(one).total_cmp(&apart(other)));
        let Some(like) = like.filter(|m| apart(m) < BESIDE_IT * m.detection.semi_major_px) else { continue };
        let beside = like.detection.outline();
        let left = blob.area / (std::f64::consts::PI * beside.major * beside.minor);
        let size = if (LEFT..1.0).contains(&left) { foretold_major(found, own, blob.centroid) } else { None };
        let size = size.filter(|(major, _)| same(*major, beside.major, SAME_SIZE));
        let part = size.map(|size| Part {
            blob,
            index,
            like,
            size,
            old: slot.filter(|m| is_as_long(m, size, UNLIKE)),
        });
        if part.as_ref().is_some_and(Part::is_seen) {
            continue;
        }
        let Some(measured) = part.and_then(|part| part.measured(known, &wanted)) else {
            doubts.extend(slot.and_then(|slot| doubt_thin(slot, like)));
            continue;
        };
        let outline = measured.detection.outline();
        found.rejected.retain(|r| !outline.holds(r.centre_px));
        // The same part may have been seen at another level.
        let is_part = |m: &Measured| {
            is_disc(m) && outline.holds(m.detection.centre_px) && flatness(m) < THINNER * flatness(&measured)
        };
        let parts = found.measured.iter().enumerate().filter(|(k, m)| Some(*k) != own && is_part(m));
        let parts: Vec<usize> = parts.map(|(k, _)| k).collect();
        match own.and_then(|own| found.measured.get_mut(own)) {
            Some(slot) => *slot = measured,
            None => found.measured.push(measured),
        }
        found.turn_down_these(RejectReason::Duplicate, &parts);
    }
    doubt(found, &doubts);
}

/// Raises the covariances of discs with some outlines, at whatever level they were seen, or turns down those that are doubted too
/// much.
fn doubt(found: &mut Found, doubts: &[(Outline, Matrix2<f64>)]) {
    let is_it = |m: &Measured, outline: &Outline| {
        let own = m.detection.outline();
        outline.holds(own.centre) && same(own.minor, outline.minor, SAME_SIZE)
    };
    let mut none = Vec::new();
    for (i, m) in found.measured.iter_mut().enumerate() {
        if let Some((_, doubt)) = doubts.iter().find(|(outline, _)| is_it(m, outline)) {
            m.detection.covariance_px2 += doubt;
            none.extend((doubt.trace() > MOST_DOUBT * MOST_DOUBT).then_some(i));
        }
    }
    found.turn_down_these(RejectReason::Uncertain, &none);
}

/// A disc's thickness over its length.
fn flatness(disc: &Measured) -> f64 {
    disc.detection.semi_minor_px / disc.detection.semi_major_px
}

/// Whether two positive numbers differ by less than a factor.
fn same(one: f64, other: f64, factor: f64) -> bool {
    one < factor * other && other < factor * one
}
