//! The blobs of all levels, each once, and what they may be; bounded, so that clutter cannot take for ever.

use std::collections::HashMap;

use nalgebra::Vector2;

use crate::measure::detect::hypothesis::Hypothesis;
use crate::measure::detect::propose::moments;
use crate::measure::detect::segment::background::{Coarse, Region};
use crate::measure::detect::segment::blob::Blob;
use crate::measure::detect::segment::{background, blob};
use crate::measure::raster::Raster;

/// Most regions of a level that are taken up at full resolution.
const MAX_REGIONS: usize = 2000;
/// Grey over background, in 1/256, from which on black is so light that quadrants' white, where that is the background, takes
/// it above the black that lies before the skin.
const PALE: u16 = 140;
/// How many times larger than a region that went on outside its window what has swallowed it at the next level is, for it
/// to be seen by itself; and how large, reduced px, and how dark, as grey over background in 1/256, it must be for that.
const SWALLOWED: usize = 4;
const SWALLOWED_LEAST: usize = 4;
const SWALLOWED_DARK: u16 = 200;
/// Most blobs, pairs of blobs and hypotheses of a kind: far above what a wing shows, but a town beside it, or a board, shows
/// hundreds. The largest are kept.
const MAX_BLOBS: usize = 3000;
const MAX_PAIRS: usize = 30_000;
const MAX_CANDIDATES: usize = 1000;
/// The same of quadrants whose white is no lighter than their black, and of regions whose background is uneven.
const MAX_UNLIKELY: usize = 100;
/// What windows may hold together, in frames.
const WINDOWS: usize = 4;

/// Blobs of all levels, each once, from windows that together hold no more than some frames; against the near background,
/// then thick ones against the far; last those of dark regions that something larger has swallowed. Beside them the regions
/// without a disc's shape whose background is uneven.
pub fn find_blobs(image: &Raster, coarse: &mut Coarse, faint: bool) -> (Vec<Blob>, Vec<Region>) {
    let (mut out, mut uneven) = (Once::default(), Vec::<Region>::new());
    let (mut done, mut open) = (Vec::<Region>::new(), Vec::<Region>::new());
    let mut late: Vec<Blob> = Vec::new();
    let laxest = background::levels(faint) - 1;
    let mut budget = WINDOWS * coarse.width * coarse.height;
    let largest = (coarse.width * coarse.height / 8).max(64);
    let mut darkness = coarse.darkness(faint);
    for (far, level) in [false, true].into_iter().flat_map(|far| (0..=laxest).map(move |level| (far, level)))
    {
        if far && level == 0 {
            coarse.look_far();
            darkness = coarse.darkness(faint);
            done.clear();
            open.clear();
        }
        let mut regions = coarse.regions(&darkness, level, faint);
        let least = if far { background::THICK } else { 0 };
        regions.retain(|r| r.width() * r.height() <= largest && r.width().min(r.height()) >= least);
        regions.sort_by_key(|r| std::cmp::Reverse(r.area));
        regions.truncate(MAX_REGIONS);
        // Uneven ones are seen again where nothing is found in them in the end.
        for region in open.drain(..).filter(|region| is_swallowed(region, &regions)) {
            if !coarse.is_uneven(&region) {
                late.extend(blob::blobs_against_surround(image, coarse, &region));
            }
        }
        for region in regions {
            if done.iter().any(|d| d.stands_for(&region)) {
                continue;
            }
            let Some(left) = budget.checked_sub(region.width() * region.height()) else { continue };
            budget = left;
            let (blobs, cut) = blob::blobs(image, coarse, &region);
            let pale = region.least > PALE && region.width().min(region.height()) >= background::THICK / 2;
            let once_more = (cut && level == laxest) || (pale && !cut);
            if !once_more && coarse.is_uneven(&region) && !blobs.iter().any(is_disc) {
                uneven.push(region.clone());
            }
            blobs.into_iter().for_each(|blob| out.add(blob));
            if once_more {
                let again = blob::blobs_against_surround(image, coarse, &region);
                again.into_iter().for_each(|blob| out.add(blob));
            }
            if cut { open.push(region) } else { done.push(region) }
        }
    }
    late.into_iter().for_each(|blob| out.add(blob));
    out.keep(MAX_BLOBS);
    keep_largest(&mut uneven, MAX_UNLIKELY, |region| region.area as f64);
    (out.blobs, uneven)
}

/// Whether a dark region has flown together with something far larger, or too large, at the next level: a disc in a shadow's
/// band does, whose background is the light on both sides of that.
fn is_swallowed(region: &Region, next: &[Region]) -> bool {
    let dark = region.area >= SWALLOWED_LEAST && region.least < SWALLOWED_DARK;
    let into = || next.iter().filter(|other| other.contains(region)).map(|other| other.area).min();
    dark && into().is_none_or(|area| area > SWALLOWED * region.area)
}

/// Whether a blob has a disc's shape.
fn is_disc(blob: &Blob) -> bool {
    moments::disc(0, blob).is_some()
}

/// The `most` largest; the order changes only where there are more.
fn keep_largest<T>(items: &mut Vec<T>, most: usize, size: impl Fn(&T) -> f64) {
    if items.len() > most {
        items.sort_by(|a, b| size(b).total_cmp(&size(a)));
        items.truncate(most);
    }
}

/// Blobs, each once, found again by their place.
#[derive(Default)]
struct Once {
    blobs: Vec<Blob>,
    /// Of each cell of the picture the blobs with their centroid in it.
    cells: HashMap<[i32; 2], Vec<usize>>,
}

impl Once {
    /// Centroids of one thing, taken up twice, lie nearer to each other, px.
    const NEAR: f64 = 2.0;
    /// Side of a cell, px: some markers' thickness, so that few hold more than one or two.
    const CELL: f64 = 32.0;

    /// Takes up a blob unless one that is as large to a quarter is there; but one with a disc's shape beside one without.
    fn add(&mut self, blob: Blob) {
        // Of thick quadrants the near background shows the greater part only: such are told apart to a twentieth.
        const THICK: f64 = 5000.0;
        const PARTED: f64 = 0.7;
        let alike = if blob.area > THICK && blob.fill() < PARTED { 0.95 } else { 0.75 };
        let same = |b: &Blob| {
            (b.centroid - blob.centroid).norm_squared() < Self::NEAR * Self::NEAR
                && (alike..1.0 / alike).contains(&(b.area / blob.area))
        };
        let stands_for = |b: &Blob| same(b) && (is_disc(b) || !is_disc(&blob));
        if !self.near(blob.centroid).any(stands_for) {
            self.put(blob);
        }
        // What clutter shows must not be kept for ever.
        if self.blobs.len() >= 4 * MAX_BLOBS {
            self.keep(2 * MAX_BLOBS);
        }
    }

    /// Keeps the largest.
    fn keep(&mut self, most: usize) {
        if self.blobs.len() > most {
            let mut blobs = std::mem::take(&mut self.blobs);
            keep_largest(&mut blobs, most, |blob| blob.area);
            self.cells.clear();
            blobs.into_iter().for_each(|blob| self.put(blob));
        }
    }

    /// The blobs of all cells that hold a place less than [`Self::NEAR`] away.
    fn near(&self, at: Vector2<f64>) -> impl Iterator<Item = &Blob> {
        let [low, high] = [-Self::NEAR, Self::NEAR].map(|off| Self::cell(at.add_scalar(off)));
        let cells = (low[1]..=high[1]).flat_map(move |y| (low[0]..=high[0]).map(move |x| [x, y]));
        let places = cells.filter_map(|cell| self.cells.get(&cell)).flatten();
        places.filter_map(|&place| self.blobs.get(place))
    }

    fn put(&mut self, blob: Blob) {
        self.cells.entry(Self::cell(blob.centroid)).or_default().push(self.blobs.len());
        self.blobs.push(blob);
    }

    fn cell(at: Vector2<f64>) -> [i32; 2] {
        (at / Self::CELL).map(|v| v.floor() as i32).into()
    }
}

/// Blobs and pairs of blobs that may be two black quadrants.
pub fn quadrants(image: &Raster, blobs: &[Blob], pairs: &[[usize; 2]]) -> Vec<Hypothesis> {
    let single = (0..blobs.len()).map(|i| vec![i]);
    let mut pairs = pairs.to_vec();
    keep_largest(&mut pairs, MAX_PAIRS, |p| p.iter().filter_map(|&i| blobs.get(i)).map(|b| b.area).sum());
    let double = pairs.into_iter().map(|p| p.to_vec());
    let mut out: Vec<Hypothesis> =
        single.chain(double).filter_map(|i| moments::quadrants(&i, blobs)).collect();
    if out.len() > MAX_UNLIKELY {
        // Nearly all of what has the shape is no darker where it should be black; so are a few true ones, thin for the blur.
        let (likely, mut others): (Vec<_>, Vec<_>) =
            out.into_iter().partition(|hypothesis| hypothesis.white_over_black(image) > 0);
        out = likely;
        keep_largest(&mut out, MAX_CANDIDATES, Hypothesis::size);
        keep_largest(&mut others, MAX_UNLIKELY, Hypothesis::size);
        out.append(&mut others);
    }
    out
}

/// Blobs that may be discs.
pub fn discs(blobs: &[Blob]) -> Vec<Hypothesis> {
    let mut out = blobs.iter().enumerate().filter_map(|(i, blob)| moments::disc(i, blob)).collect();
    keep_largest(&mut out, MAX_CANDIDATES, Hypothesis::size);
    out
}
