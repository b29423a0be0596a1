//! What a blob measures as a whole disc, and what is tried where a part of it is hidden.

use super::measure::{Bounds, is_too_small, measure};
use crate::measure::detect::accept::verdict::Measured;
use crate::measure::detect::appearance::parameters::Pattern;
use crate::measure::detect::attempt::options::WHOLE;
use crate::measure::detect::detection::{Detection, RejectReason};
use crate::measure::detect::hypothesis::Hypothesis;
use crate::measure::detect::image::ellipse::Ellipse;
use crate::measure::detect::image::histogram::Histogram;
use crate::measure::detect::image::noise::FRAYING;
use crate::measure::detect::occlusion::decal::ROWS;
use crate::measure::detect::occlusion::{decal, glare};
use crate::measure::detect::propose::{glare_cut, moments, partial_ellipse};
use crate::measure::detect::segment::blob;
use crate::measure::detect::segment::blob::Blob;
use crate::measure::raster::Raster;

/// Blobs measured as whole discs, each once.
pub struct WholeDiscs<'a> {
    pub image: &'a Raster,
    pub blobs: &'a [Blob],
    pub bounds: Bounds,
    known: Vec<Option<Result<Measured, RejectReason>>>,
}

impl<'a> WholeDiscs<'a> {
    /// Nothing measured yet.
    pub fn new(image: &'a Raster, blobs: &'a [Blob], bounds: Bounds) -> Self {
        Self { image, blobs, bounds, known: (0..blobs.len()).map(|_| None).collect() }
    }

    /// What the blob of a disc's hypothesis measures, whose place is not known to be hidden.
    pub fn measure(&mut self, index: usize, hypothesis: &Hypothesis) -> Result<Measured, RejectReason> {
        let measured = || measure(self.image, self.blobs, hypothesis, self.bounds);
        match self.known.get_mut(index) {
            Some(known) => known.get_or_insert_with(measured).clone(),
            None => measured(),
        }
    }

    /// What a blob measures that looks like a whole disc; `None` for others.
    fn measure_round(&mut self, index: usize) -> Option<Result<Measured, RejectReason>> {
        let round = self.blobs.get(index).filter(|b| !looks_cut(b)).and_then(|b| moments::disc(index, b));
        round.map(|disc| self.measure(index, &disc))
    }

    /// Whether a blob is a whole disc whose place is told well: the image model tells.
    pub fn is_sure_disc(&mut self, index: usize) -> bool {
        matches!(self.measure_round(index), Some(Ok(disc)) if disc.is_sure())
    }

    /// Whether the two blobs of a pair are whole discs side by side: the image model tells.
    pub fn are_discs(&mut self, hypothesis: &Hypothesis) -> bool {
        let mut disc =
            |&i: &usize| matches!(self.measure_round(i), Some(Ok(_) | Err(RejectReason::Uncertain)));
        hypothesis.blobs.len() == 2 && hypothesis.blobs.iter().all(&mut disc)
    }

    /// Whether in what was measured as quadrants lie two discs or more, each of which leaves less than half the residuals.
    pub fn hold_discs(&mut self, quadrants: &Detection) -> bool {
        let whole = quadrants.ellipse();
        let mut found: Vec<Ellipse> = Vec::new();
        for (i, _) in self.blobs.iter().enumerate().filter(|(_, b)| whole.holds(b.centroid)) {
            let Some(Ok(disc)) = self.measure_round(i) else { continue };
            let ellipse = disc.detection.ellipse();
            let better = disc.is_sure() && disc.detection.fit_rms < WHOLE.better * quadrants.fit_rms;
            if better && !found.iter().any(|other| other.holds(ellipse.centre)) {
                found.push(ellipse);
            }
        }
        found.len() > 1
    }
}

/// Whether a blob is too square for a whole disc of its size.
pub fn looks_cut(blob: &Blob) -> bool {
    cut_by(blob) > 1.0
}

/// Whether a blob that looks cut by nothing may be a whole disc all the same, which blur or noise has frayed.
fn is_frayed(image: &Raster, blob: &Blob, noise: f64) -> bool {
    let contrast = || levels(image, blob).map_or(0.0, |(black, skin)| skin as f64 - black as f64);
    let by_noise = noise > FRAYING || noise > WHOLE.fraying_noise * contrast();
    cut_by(blob) < if by_noise { WHOLE.frayed_by_noise } else { WHOLE.frayed }
}

/// Grey values of a blob and of the skin about it.
fn levels(image: &Raster, blob: &Blob) -> Option<(usize, usize)> {
    let (low, high) = blob::about(&Ellipse::of(blob), WHOLE.beside_px);
    let about = Histogram::of(image.part(low, high, 1).map(|(_, _, value)| value));
    let own = blob.runs.iter().flat_map(|&[y, from, to]| {
        image.row(y as usize).iter().take(to as usize + 1).skip(from as usize).copied()
    });
    let (black, middle) = (Histogram::of(own).middle()?, about.middle()?);
    // Between close neighbours most of what is about is as black.
    let lightest = about.at(about.total() * 9 / 10)?;
    Some((black, if middle < black.midpoint(lightest) { lightest } else { middle }))
}

/// How square a blob is against what a whole disc of its size may be.
pub fn cut_by(blob: &Blob) -> f64 {
    let minor = Ellipse::of(blob).minor.max(0.5);
    moments::squareness(blob) / (0.13 + 1.3 / (minor * minor))
}

/// The hypothesis of a disc that only looks cut because its threshold followed a background that something beside it
/// lowers, as a line at its tip does: seen once more against one level.
fn at_one_level(image: &Raster, blob: &Blob, index: usize) -> Option<Hypothesis> {
    let seen = Ellipse::of(blob);
    let (black, skin) = levels(image, blob)?;
    let found = blob::dark_parts(image, &seen, WHOLE.beside_px, black.midpoint(skin) as u8);
    moments::disc(index, found.iter().find(|blob| !looks_cut(blob))?)
}

/// A disc that a neighbour's decal cuts, with what it measures: along rows or columns, or where that fails, along the line
/// in which its rim ends.
fn under_decal(
    hypothesis: &Hypothesis,
    blob: &Blob,
    blobs: &[Blob],
    measured: impl Fn(&Hypothesis) -> Result<Measured, RejectReason>,
) -> Option<(Hypothesis, Result<Measured, RejectReason>)> {
    let with = |hidden: Hypothesis| {
        let answer = measured(&hidden);
        (hidden, answer)
    };
    let level = partial_ellipse::completed(hypothesis, blob, blobs, |_| ROWS).map(with);
    if matches!(level, Some((_, Ok(_)))) {
        return level;
    }
    let cut = |other: &Blob| {
        if partial_ellipse::is_ellipse(other) { decal::cut(blob, &Ellipse::of(other)) } else { None }
    };
    let slanted = partial_ellipse::completed(hypothesis, blob, blobs, |other| cut(other).unwrap_or(ROWS));
    let is_slanted = |hidden: &Hypothesis| hidden.decals().any(|decal| decal.axis != ROWS);
    let slanted = slanted.filter(|hidden| hidden.prior.twin && is_slanted(hidden)).map(with);
    slanted.filter(|(_, answer)| answer.is_ok()).or(level)
}

/// A disc whose outline is not an ellipse's may have a part hidden by its neighbour, or by glare. With
/// what was measured the hypothesis of its whole outline, where size alone is missing to do it better.
pub fn measure_whole_or_hidden(
    known: &mut WholeDiscs,
    hypothesis: &Hypothesis,
) -> (Result<Measured, RejectReason>, Option<Hypothesis>) {
    let WholeDiscs { image, blobs, bounds, .. } = *known;
    let measured = |hypothesis: &Hypothesis| measure(image, blobs, hypothesis, bounds);
    let single = match hypothesis.blobs[..] {
        [index] if hypothesis.pattern == Pattern::Disc => blobs.get(index).map(|b| (index, b)),
        _ => None,
    };
    let Some((index, blob)) = single.filter(|(_, b)| !b.at_edge) else {
        return (measured(hypothesis), None);
    };
    if is_too_small(&hypothesis.ellipse) {
        return (Err(RejectReason::TooSmall), None);
    }
    let whole =
        if looks_cut(blob) { Err(RejectReason::NotAnEllipse) } else { known.measure(index, hypothesis) };
    // A disc that is measured badly although it looks whole may end in glare.
    if whole.as_ref().is_ok_and(Measured::is_sure) {
        let occluded = if glare::ends_in_white(image, &hypothesis.ellipse) {
            glare_cut::completed(image, hypothesis, index, blobs)
        } else {
            None
        };
        return (whole, occluded);
    }
    let occluded = glare_cut::completed(image, hypothesis, index, blobs);
    match occluded.as_ref().map(measured) {
        Some(Ok(part)) => (Ok(part), occluded),
        _ if whole.is_ok() => (whole, occluded),
        _ if !looks_cut(blob) => (whole, occluded),
        failed => {
            let reason = match under_decal(hypothesis, blob, blobs, measured) {
                Some((hidden, Ok(part))) => return (Ok(part), hidden.prior.twin.then_some(hidden)),
                Some((_, reason)) => reason,
                None => failed.unwrap_or(whole),
            };
            let again = occluded.is_none().then(|| at_one_level(image, blob, index)).flatten();
            match again.map(|hypothesis| measured(&hypothesis)) {
                Some(Ok(found)) => (Ok(found), None),
                _ if occluded.is_none() && is_frayed(image, blob, bounds.noise) => {
                    (known.measure(index, hypothesis), Some(hypothesis.clone()))
                }
                _ => (reason, occluded),
            }
        }
    }
}
