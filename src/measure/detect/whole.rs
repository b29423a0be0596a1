//! Stage 3: what a blob measures as a whole disc, and what is tried where a part of it is hidden.

use nalgebra::Vector2;

use super::super::raster::Raster;
use super::super::setup::Shape;
use super::blob::{self, Blob};
use super::candidate::{self, Candidate, Foretold, Like};
use super::coarse::{Coarse, Region};
use super::counts::Counts;
use super::judge::Measured;
use super::measure::{Bounds, measure};
use super::model::Pattern;
use super::noise::FRAYING;
use super::outline::Outline;
use super::sheet::{self, ROWS};
use super::sought::usual_dark;
use super::{Detection, Found, RejectReason, arc, glare};

/// Skin about a disc that tells its grey, px.
const BESIDE: f64 = 6.0;
/// Least share of a disc's length that must be seen of it.
const SEEN: f64 = 0.4;
/// Standard deviations of the size that discs about it foretell beyond which a disc is another thing.
pub const UNLIKE: f64 = 4.0;
/// The same where a disc is so thin that it tells little more than that size.
const UNLIKE_THIN: f64 = 2.5;
/// The same where its standard deviation shall say so.
const UNLIKELY: f64 = 2.0;
/// Markers that tell blur and darkness of those between them, and how far these differ from one to another: the blur as a
/// share.
const ENOUGH: usize = 5;
const SAME_BLUR: f64 = 0.1;
const SAME_DARK: f64 = 0.1;
/// Semi-minor axis, in blurs, below which a marker does not tell them apart.
const THIN: f64 = 3.0;
/// How much squarer than a whole disc one may look that blur, or strong noise, has frayed.
const FRAYED: f64 = 1.15;
const FRAYED_BY_NOISE: f64 = 1.5;

/// Measures discs that are hidden in part once more, when the whole ones about them have told how
/// large they are; also those of which too little was seen before. One of quite another size is turned down: something
/// else passes for its hidden end.
pub fn again_with_size(known: &Whole, found: &mut Found, hidden: Vec<(Option<usize>, Candidate)>) {
    let mut wrong: Vec<usize> = Vec::new();
    let bounds = Bounds { through_glare: true, ..known.bounds };
    for (index, mut candidate) in hidden {
        let Some((major, deviation)) = foretold_major(found, index, candidate.outline.centre) else {
            // What glare lies over may show as a whole.
            let slot = index.and_then(|i| found.measured.get_mut(i));
            if slot.as_ref().is_none_or(|slot| !slot.is_sure()) {
                let shown = measure(known.image, known.blobs, &candidate, bounds).ok();
                match (shown.filter(|m| m.through_glare), slot) {
                    (Some(shown), Some(slot)) => *slot = shown,
                    (shown, _) => found.measured.extend(shown),
                }
            }
            continue;
        };
        // The end that is seen stays where it is.
        for band in &candidate.bands {
            let longer = band.axis * (major - candidate.outline.major);
            candidate.outline.centre += match (band.from.is_finite(), band.to.is_finite()) {
                (true, false) => longer,
                (false, true) => -longer,
                _ => Vector2::zeros(),
            };
        }
        candidate.outline.major = major;
        candidate.foretold = Some(Foretold::of_major((major, deviation)));
        let like = |m: &Measured| is_as_long(m, (major, deviation), UNLIKE);
        let again = measure(known.image, known.blobs, &candidate, bounds).ok().filter(like);
        let slot = index.and_then(|i| found.measured.get_mut(i));
        // Whole discs may lie beside what is saturated.
        if slot.as_ref().is_some_and(|slot| slot.is_whole && slot.is_sure() && like(slot)) {
            continue;
        }
        match (again, slot) {
            (Some(again), Some(slot)) => *slot = again,
            (Some(again), None) => found.measured.push(again),
            (None, Some(slot)) if !like(slot) => wrong.extend(index),
            (None, _) => {}
        }
    }
    wrong.sort_unstable();
    wrong.dedup();
    found.turn_down_these(RejectReason::Uncertain, &wrong);
}

/// Whether a thin marker may be turned down so only because it does not tell blur and thickness apart.
pub fn is_unsure(reason: RejectReason, candidate: &Candidate) -> bool {
    use RejectReason::{NoConvergence, NotAnEllipse, TooSmall, Uncertain};
    match reason {
        NoConvergence | NotAnEllipse | Uncertain => true,
        TooSmall => candidate.pattern == Pattern::Disc,
        _ => false,
    }
}

/// Measures what is about as thin as the blur once more, when the markers about it have told blur and darkness. Discs also
/// need to be as long as those about them foretell.
pub fn again_with_like(known: &Whole, found: &mut Found, unsure: Vec<Candidate>) {
    for mut candidate in unsure {
        let outline = candidate.outline;
        if found.holds(outline.centre) {
            continue;
        }
        candidate.like = like(found, outline.centre).filter(|like| outline.minor < THIN * like.blur.0);
        if candidate.like.is_none() {
            continue;
        }
        let mut size = None;
        if candidate.pattern == Pattern::Disc {
            size = foretold_major(found, None, outline.centre);
            size = size.filter(|(major, _)| outline.major > SEEN * major);
            let Some((major, deviation)) = size else { continue };
            candidate.outline.major = major;
            candidate.foretold = Some(Foretold::of_major((major, deviation)));
        }
        let measured = measure(known.image, known.blobs, &candidate, known.bounds).ok();
        let sure = |m: &Measured| size.is_none_or(|size| is_as_long(m, size, UNLIKE_THIN));
        if let Some(measured) = measured.filter(sure) {
            let own = measured.detection.outline();
            found.rejected.retain(|r| !own.holds(r.centre_px));
            found.measured.push(measured);
        }
    }
}

/// Measures discs in regions whose background is uneven, seen against one level, where nothing else was found.
pub fn with_uneven(
    known: &Whole,
    found: &mut Found,
    (seen, coarse, regions): (&Raster, &Coarse, &[Region]),
    wanted: impl Fn(&Candidate) -> bool,
) {
    for region in regions {
        if found.holds(region.middle(coarse.factor)) {
            continue;
        }
        for blob in blob::blobs_against_surround(seen, coarse, region) {
            if blob.at_edge || looks_cut(&blob) || found.holds(blob.centroid) {
                continue;
            }
            let disc = candidate::disc(usize::MAX, &blob).filter(&wanted);
            let measured = disc.map(|disc| measure(known.image, known.blobs, &disc, known.bounds));
            found.measured.extend(measured.and_then(Result::ok));
        }
    }
}

/// The semi-major axis of a disc at a place and its standard deviation, px, from all that was found but itself.
pub fn foretold_major(found: &Found, own: Option<usize>, at: Vector2<f64>) -> Option<(f64, f64)> {
    let others = found.measured.iter().enumerate().filter(|(i, _)| Some(*i) != own);
    arc::foretold_major(others.map(|(_, m)| &m.detection), at)
}

/// Where a thin disc is longer or shorter than those about it foretell, something at one of its ends passes for a part of
/// it: the centre may be off along the axis by as much, which its standard deviation then says. What is off by a good part
/// of its length is none of them.
pub fn doubt_unlike(found: &mut Found) {
    const NONE: f64 = 0.25;
    let doubts: Vec<f64> = (found.measured.iter().enumerate())
        .map(|(i, own)| {
            let d = &own.detection;
            let thin = d.shape == Shape::Circle && d.semi_minor_px < THIN * own.blur;
            let size = if thin { foretold_major(found, Some(i), d.centre_px) } else { None };
            let Some((major, deviation)) = size else { return 0.0 };
            let longer = (d.semi_major_px - major).powi(2);
            let chance = own.length.powi(2) + deviation * deviation;
            if longer > UNLIKELY * UNLIKELY * chance { longer - chance } else { 0.0 }
        })
        .collect();
    let mut none = Vec::new();
    for (i, (Measured { detection: own, .. }, doubt)) in found.measured.iter_mut().zip(doubts).enumerate() {
        let axis = own.outline().axis();
        own.covariance_px2 += axis * axis.transpose() * doubt;
        none.extend((doubt > (NONE * own.semi_major_px).powi(2)).then_some(i));
    }
    found.turn_down_these(RejectReason::Uncertain, &none);
}

/// What the markers nearest to a place tell of an edge, where there are some.
fn like(found: &Found, at: Vector2<f64>) -> Option<Like> {
    let mut near: Vec<&Measured> = found.measured.iter().collect();
    if near.len() < ENOUGH {
        return None;
    }
    let distance = |m: &Measured| (m.detection.centre_px - at).norm_squared();
    near.sort_by(|one, other| distance(one).total_cmp(&distance(other)));
    near.truncate(ENOUGH);
    let blur = super::middle(near.iter().map(|m| m.blur).collect())?;
    let darkness = super::middle(near.iter().map(|m| m.darkness).collect())?;
    let dark = usual_dark((1.0 - darkness).max(0.0));
    Some(Like { blur: (blur, SAME_BLUR * blur), dark: (dark, SAME_DARK) })
}

/// Whether a disc is as long as was foretold with some deviation, px, to so many of them.
pub fn is_as_long(disc: &Measured, (major, deviation): (f64, f64), most: f64) -> bool {
    (disc.detection.semi_major_px - major).abs() < most * deviation
}

/// Blobs measured as whole discs, each once.
pub struct Whole<'a> {
    pub image: &'a Raster,
    pub blobs: &'a [Blob],
    pub bounds: Bounds,
    known: Vec<Option<Result<Measured, RejectReason>>>,
}

impl<'a> Whole<'a> {
    /// Nothing measured yet.
    pub fn new(image: &'a Raster, blobs: &'a [Blob], bounds: Bounds) -> Self {
        Self { image, blobs, bounds, known: (0..blobs.len()).map(|_| None).collect() }
    }

    /// What the blob of a disc's candidate measures, whose place is not known to be hidden.
    pub fn measure(&mut self, index: usize, candidate: &Candidate) -> Result<Measured, RejectReason> {
        let measured = || measure(self.image, self.blobs, candidate, self.bounds);
        match self.known.get_mut(index) {
            Some(known) => known.get_or_insert_with(measured).clone(),
            None => measured(),
        }
    }

    /// What a blob measures that looks like a whole disc; `None` for others.
    fn measure_round(&mut self, index: usize) -> Option<Result<Measured, RejectReason>> {
        let round = self.blobs.get(index).filter(|b| !looks_cut(b)).and_then(|b| candidate::disc(index, b));
        round.map(|disc| self.measure(index, &disc))
    }

    /// Whether a blob is a whole disc whose place is told well: the image model tells.
    pub fn is_sure_disc(&mut self, index: usize) -> bool {
        matches!(self.measure_round(index), Some(Ok(disc)) if disc.is_sure())
    }

    /// Whether the two blobs of a pair are whole discs side by side: the image model tells.
    pub fn are_discs(&mut self, candidate: &Candidate) -> bool {
        let mut disc =
            |&i: &usize| matches!(self.measure_round(i), Some(Ok(_) | Err(RejectReason::Uncertain)));
        candidate.blobs.len() == 2 && candidate.blobs.iter().all(&mut disc)
    }

    /// Whether in what was measured as quadrants lie two discs or more, each of which leaves less than half the residuals.
    pub fn hold_discs(&mut self, quadrants: &Detection) -> bool {
        const BETTER: f64 = 0.5;
        let whole = quadrants.outline();
        let mut found: Vec<Outline> = Vec::new();
        for (i, _) in self.blobs.iter().enumerate().filter(|(_, b)| whole.holds(b.centroid)) {
            let Some(Ok(disc)) = self.measure_round(i) else { continue };
            let outline = disc.detection.outline();
            let better = disc.is_sure() && disc.detection.fit_rms < BETTER * quadrants.fit_rms;
            if better && !found.iter().any(|other| other.holds(outline.centre)) {
                found.push(outline);
            }
        }
        found.len() > 1
    }
}

/// Whether a blob is too square for a whole disc of its size.
fn looks_cut(blob: &Blob) -> bool {
    cut_by(blob) > 1.0
}

/// Whether a blob that looks cut by nothing may be a whole disc all the same, which blur or noise has frayed.
fn is_frayed(blob: &Blob, noise: f64) -> bool {
    cut_by(blob) < if noise > FRAYING { FRAYED_BY_NOISE } else { FRAYED }
}

/// How square a blob is against what a whole disc of its size may be.
pub fn cut_by(blob: &Blob) -> f64 {
    let minor = Outline::of(blob).minor.max(0.5);
    candidate::squareness(blob) / (0.13 + 1.3 / (minor * minor))
}

/// The candidate of a disc that only looks cut because its threshold followed a background that something beside it
/// lowers, as a line at its tip does: seen once more against one level.
fn at_one_level(image: &Raster, blob: &Blob, index: usize) -> Option<Candidate> {
    let seen = Outline::of(blob);
    let (low, high) = blob::about(&seen, BESIDE);
    let about = image.part(low, high, 1).map(|(_, _, value)| value);
    let own = blob.runs.iter().flat_map(|&[y, from, to]| {
        image.row(y as usize).iter().take(to as usize + 1).skip(from as usize).copied()
    });
    let (black, skin) = (Counts::of(own).middle()?, Counts::of(about).middle()?);
    let found = blob::dark_parts(image, &seen, BESIDE, black.midpoint(skin) as u8);
    candidate::disc(index, found.iter().find(|blob| !looks_cut(blob))?)
}

/// A disc that a neighbour's sheet cuts, with what it measures: along rows or columns, or where that fails, along the line
/// in which its rim ends.
fn under_sheet(
    candidate: &Candidate,
    blob: &Blob,
    blobs: &[Blob],
    measured: impl Fn(&Candidate) -> Result<Measured, RejectReason>,
) -> Option<(Candidate, Result<Measured, RejectReason>)> {
    let with = |hidden: Candidate| {
        let answer = measured(&hidden);
        (hidden, answer)
    };
    let level = arc::completed(candidate, blob, blobs, |_| ROWS).map(with);
    if matches!(level, Some((_, Ok(_)))) {
        return level;
    }
    let cut =
        |other: &Blob| if arc::is_ellipse(other) { sheet::cut(blob, &Outline::of(other)) } else { None };
    let slanted = arc::completed(candidate, blob, blobs, |other| cut(other).unwrap_or(ROWS));
    let is_slanted = |hidden: &Candidate| hidden.hidden.iter().any(|sheet| sheet.axis != ROWS);
    let slanted = slanted.filter(|hidden| hidden.alike && is_slanted(hidden)).map(with);
    slanted.filter(|(_, answer)| answer.is_ok()).or(level)
}

/// A disc whose outline is not an ellipse's may have a part hidden by its neighbour, or by glare. With
/// what was measured the candidate of its whole outline, where size alone is missing to do it better.
pub fn measure_whole_or_hidden(
    known: &mut Whole,
    candidate: &Candidate,
) -> (Result<Measured, RejectReason>, Option<Candidate>) {
    let Whole { image, blobs, bounds, .. } = *known;
    let measured = |candidate: &Candidate| measure(image, blobs, candidate, bounds);
    let single = match candidate.blobs[..] {
        [index] if candidate.pattern == Pattern::Disc => blobs.get(index).map(|b| (index, b)),
        _ => None,
    };
    let Some((index, blob)) = single.filter(|(_, b)| !b.at_edge) else {
        return (measured(candidate), None);
    };
    let whole =
        if looks_cut(blob) { Err(RejectReason::NotAnEllipse) } else { known.measure(index, candidate) };
    // A disc that is measured badly although it looks whole may end in glare.
    if whole.as_ref().is_ok_and(Measured::is_sure) {
        let drowned = if glare::ends_in_white(image, &candidate.outline) {
            glare::completed(image, candidate, index, blobs)
        } else {
            None
        };
        return (whole, drowned);
    }
    let drowned = glare::completed(image, candidate, index, blobs);
    match drowned.as_ref().map(measured) {
        Some(Ok(part)) => (Ok(part), drowned),
        _ if whole.is_ok() => (whole, drowned),
        _ if !looks_cut(blob) => (whole, drowned),
        failed => match under_sheet(candidate, blob, blobs, measured) {
            None => {
                let again = drowned.is_none().then(|| at_one_level(image, blob, index)).flatten();
                match again.map(|candidate| measured(&candidate)) {
                    Some(Ok(found)) => (Ok(found), None),
                    _ if drowned.is_none() && is_frayed(blob, bounds.noise) => {
                        (known.measure(index, candidate), Some(candidate.clone()))
                    }
                    _ => (failed.unwrap_or(whole), drowned),
                }
            }
            Some((hidden, Ok(part))) => (Ok(part), hidden.alike.then_some(hidden)),
            Some((_, reason)) => (reason, drowned),
        },
    }
}
