//! The blobs of all levels, each once, and what they may be; bounded, so that clutter cannot take for ever.

use std::collections::HashMap;

use nalgebra::Vector2;

use crate::detect::hypothesis::Hypothesis;
use crate::detect::propose::moments;
use crate::detect::propose::options::{GATHER, MOMENTS};
use crate::detect::segment::background::{ReducedFrame, DarkRegion};
use crate::detect::segment::windows::SearchArea;
use crate::detect::segment::{background, blob, blob::Blob, options::BACKGROUND};
use crate::raster::Raster;

/// What a frame's levels have shown so far: blobs, each once, from windows that together hold no more than some frames.
pub struct BlobCollector {
    /// Of the near background, and of the far one, against which only thick regions are seen; `None` where none are sought.
    near: BackgroundLevels,
    far: Option<BackgroundLevels>,
    unique: UniqueBlobs,
    /// Regions without a disc's shape whose background is uneven.
    pub uneven: Vec<DarkRegion>,
    /// Blobs of dark regions that something larger has swallowed, taken up last.
    swallowed: Vec<Blob>,
    /// How long a region may be to be seen once more against what surrounds it, reduced px.
    longest: f64,
}

/// The levels against one background.
struct BackgroundLevels {
    coarse: ReducedFrame,
    /// The first level that has not been looked at.
    next: usize,
    /// Least thickness of a region, reduced px.
    least: usize,
    /// Regions that are done with, by their darkest, and those that went on outside their window at the last level.
    done: HashMap<u16, Vec<DarkRegion>>,
    open: Vec<DarkRegion>,
}

impl BackgroundLevels {
    fn new(coarse: ReducedFrame, least: usize) -> Self {
        Self { coarse, next: 0, least, done: HashMap::new(), open: Vec::new() }
    }
}

impl BlobCollector {
    /// Nothing yet of a part of a picture, in which nothing is sought that is longer than so many px.
    pub fn new(image: &Raster, part: SearchArea, longest_px: f64) -> Self {
        let near = background::reduce_frame(image, part);
        let far = near.with_far_background();
        let factor = near.factor as f64;
        Self {
            near: BackgroundLevels::new(near, 0),
            far: far.map(|far| BackgroundLevels::new(far, BACKGROUND.thick)),
            unique: UniqueBlobs::default(),
            uneven: Vec::new(),
            swallowed: Vec::new(),
            longest: longest_px / factor,
        }
    }

    /// Against the far background, where there is one.
    pub fn far_frame(&self) -> &ReducedFrame {
        &self.far.as_ref().unwrap_or(&self.near).coarse
    }

    /// Takes up the levels of a usual or a faint frame that were not looked at before; whether there are any: what more regions
    /// pass than are looked at lies in the picture's grain.
    pub fn search_levels(&mut self, image: &Raster, faint: bool) -> bool {
        let darkness = self.near.coarse.passed_levels(faint);
        let passes = |level: &usize| {
            *level < background::level_count(false)
                || self.near.coarse.dark_regions(&darkness, *level, faint).len() <= GATHER.regions
        };
        let new = (self.near.next..background::level_count(faint)).take_while(passes);
        let end = new.last().map(|level| level + 1);
        let Some(end) = end else { return false };
        self.unique.drop_provisional();
        let Self { near, far, unique: once, uneven, swallowed: late, longest } = self;
        let budget = GATHER.frames * near.coarse.width * near.coarse.height;
        let mut findings = LevelFindings { unique: once, uneven, swallowed: late, budget, laxest: end - 1, longest: *longest };
        let far = far.as_mut().map(|far| (far.coarse.passed_levels(faint), far));
        for (darkness, levels) in std::iter::once((darkness, near)).chain(far) {
            for level in levels.next..end {
                let regions = levels.coarse.dark_regions(&darkness, level, faint);
                findings.search_level(image, levels, level, regions);
            }
            levels.next = end;
        }
        // What is swallowed is taken up again after the next levels.
        self.swallowed.iter().for_each(|blob| self.unique.add(blob.clone(), Retention::Provisional));
        self.unique.truncate_to(GATHER.blobs);
        keep_largest(&mut self.uneven, GATHER.uneven, |region| region.area as f64);
        true
    }

    /// All that was found, in the order of discovery by call.
    pub fn blobs(&self) -> &[Blob] {
        &self.unique.blobs
    }
}

/// Where a level's findings go.
struct LevelFindings<'a> {
    unique: &'a mut UniqueBlobs,
    uneven: &'a mut Vec<DarkRegion>,
    swallowed: &'a mut Vec<Blob>,
    /// What windows may still hold, reduced px.
    budget: usize,
    /// The last level that is looked at.
    laxest: usize,
    /// How long a region may be to be seen once more against what surrounds it, reduced px.
    longest: f64,
}

impl LevelFindings<'_> {
    /// Takes up the regions that pass one level.
    fn search_level(&mut self, image: &Raster, levels: &mut BackgroundLevels, level: usize, mut regions: Vec<DarkRegion>) {
        let BackgroundLevels { coarse, least, done, open, .. } = levels;
        let largest = (coarse.width * coarse.height / 8).max(64);
        regions.retain(|r| {
            let [width, height] = r.sides();
            width * height <= largest && width.min(height) >= *least
        });
        regions.sort_by_key(|r| std::cmp::Reverse(r.area));
        regions.truncate(GATHER.regions);
        // Uneven ones are seen again where nothing is found in them in the end.
        for region in open.drain(..).filter(|region| is_swallowed(region, &regions)) {
            if !coarse.is_uneven(&region) {
                self.swallowed.extend(blob::blobs_against_surround(image, coarse, &region));
            }
        }
        for region in regions {
            if done.get(&region.least).is_some_and(|done| done.iter().any(|d| d.is_same_region(&region))) {
                continue;
            }
            let [width, height] = region.sides();
            let Some(left) = self.budget.checked_sub(width * height) else { continue };
            self.budget = left;
            let (blobs, cut) = blob::region_blobs(image, coarse, &region);
            let pale = region.least > GATHER.pale && width.min(height) >= BACKGROUND.thick / 2;
            let at_last = cut && level == self.laxest;
            let once_more = (at_last || (pale && !cut)) && width.max(height) as f64 <= self.longest;
            if !once_more && coarse.is_uneven(&region) && !blobs.iter().any(is_disc) {
                self.uneven.push(region.clone());
            }
            blobs.into_iter().for_each(|blob| self.unique.add(blob, Retention::Firm));
            if once_more {
                // At a laxer level the region may lie wholly in its window.
                let kept = if at_last { Retention::Provisional } else { Retention::Firm };
                let again = blob::blobs_against_surround(image, coarse, &region);
                again.into_iter().for_each(|blob| self.unique.add(blob, kept));
            }
            if cut { open.push(region) } else { done.entry(region.least).or_default().push(region) }
        }
    }
}

/// Whether a dark region has flown together with something far larger, or too large, at the next level: a disc in a shadow's
/// band does, whose background is the light on both sides of that.
fn is_swallowed(region: &DarkRegion, next: &[DarkRegion]) -> bool {
    let dark = region.area >= GATHER.swallowed_least && region.least < GATHER.swallowed_dark;
    let into = || next.iter().filter(|other| other.contains(region)).map(|other| other.area).min();
    dark && into().is_none_or(|area| area > GATHER.swallowed * region.area)
}

/// Whether a blob has a disc's shape.
fn is_disc(blob: &Blob) -> bool {
    moments::disc_from_blob(0, blob).is_some()
}

/// The `most` largest; the order changes only where there are more.
fn keep_largest<T>(items: &mut Vec<T>, most: usize, size: impl Fn(&T) -> f64) {
    if items.len() > most {
        items.sort_by(|a, b| size(b).total_cmp(&size(a)));
        items.truncate(most);
    }
}

/// Whether a blob stays when further levels are looked at, which may show more of the same thing.
#[derive(Clone, Copy, PartialEq)]
enum Retention {
    Firm,
    Provisional,
}

/// Blobs, each once, found again by their place.
#[derive(Default)]
struct UniqueBlobs {
    blobs: Vec<Blob>,
    /// Of each of them.
    kept: Vec<Retention>,
    /// Of each cell of the picture the blobs with their centroid in it.
    cells: HashMap<[i32; 2], Vec<usize>>,
}

impl UniqueBlobs {
    /// Takes up a blob unless one that is as large to a quarter is there; but one with a disc's shape beside one without.
    fn add(&mut self, blob: Blob, kept: Retention) {
        // Of thick quadrants the near background shows the greater part only.
        let in_part = blob.area > GATHER.thick_px && blob.fill() < GATHER.max_partial_fill;
        let alike = if in_part { GATHER.min_area_ratio_partial } else { GATHER.min_area_ratio };
        let same = |b: &Blob| {
            (b.centroid - blob.centroid).norm_squared() < GATHER.near_px * GATHER.near_px
                && (alike..1.0 / alike).contains(&(b.area / blob.area))
        };
        let stands_for = |b: &Blob| same(b) && (is_disc(b) || !is_disc(&blob));
        if !self.blobs_near(blob.centroid).any(stands_for) {
            self.insert(blob, kept);
        }
        // What clutter shows must not be kept for ever.
        if self.blobs.len() >= 4 * GATHER.blobs {
            self.truncate_to(2 * GATHER.blobs);
        }
    }

    /// Keeps the largest.
    fn truncate_to(&mut self, most: usize) {
        if self.blobs.len() > most {
            let mut all = self.drain_all();
            keep_largest(&mut all, most, |(blob, _)| blob.area);
            all.into_iter().for_each(|(blob, kept)| self.insert(blob, kept));
        }
    }

    fn drop_provisional(&mut self) {
        let firm = self.drain_all().into_iter().filter(|(_, kept)| *kept == Retention::Firm);
        firm.for_each(|(blob, kept)| self.insert(blob, kept));
    }

    /// All of them, of which none are left.
    fn drain_all(&mut self) -> Vec<(Blob, Retention)> {
        self.cells.clear();
        std::mem::take(&mut self.blobs).into_iter().zip(std::mem::take(&mut self.kept)).collect()
    }

    /// The blobs of all cells that hold a place less than `GATHER.near_px` away.
    fn blobs_near(&self, at: Vector2<f64>) -> impl Iterator<Item = &Blob> {
        let [low, high] = [-GATHER.near_px, GATHER.near_px].map(|off| Self::cell_index(at.add_scalar(off)));
        let cells = (low[1]..=high[1]).flat_map(move |y| (low[0]..=high[0]).map(move |x| [x, y]));
        let places = cells.filter_map(|cell| self.cells.get(&cell)).flatten();
        places.filter_map(|&place| self.blobs.get(place))
    }

    fn insert(&mut self, blob: Blob, kept: Retention) {
        self.cells.entry(Self::cell_index(blob.centroid)).or_default().push(self.blobs.len());
        self.blobs.push(blob);
        self.kept.push(kept);
    }

    fn cell_index(at: Vector2<f64>) -> [i32; 2] {
        (at / GATHER.cell_px).map(|v| v.floor() as i32).into()
    }
}

/// Blobs and pairs of blobs that may be two black quadrants: of what has their shape, what is lighter where it should be white.
/// Few true ones are not, thin for the blur, and those are sought by their white.
pub fn quadrant_hypotheses(image: &Raster, noise: f64, blobs: &[Blob], pairs: &[[usize; 2]]) -> Vec<Hypothesis> {
    let single = (0..blobs.len()).map(|i| vec![i]);
    let mut pairs = pairs.to_vec();
    keep_largest(&mut pairs, GATHER.pairs, |p| p.iter().filter_map(|&i| blobs.get(i)).map(|b| b.area).sum());
    let double = pairs.into_iter().map(|p| p.to_vec());
    let least = MOMENTS.white_over_black.max(noise);
    let mut out: Vec<Hypothesis> = (single.chain(double))
        .filter_map(|i| moments::quadrants_from_blobs(&i, blobs))
        .filter(|hypothesis| hypothesis.white_over_black(image) > least)
        .collect();
    keep_largest(&mut out, GATHER.hypotheses, Hypothesis::size);
    out
}

/// Blobs that may be discs.
pub fn disc_hypotheses(blobs: &[Blob]) -> Vec<Hypothesis> {
    let mut out = blobs.iter().enumerate().filter_map(|(i, blob)| moments::disc_from_blob(i, blob)).collect();
    keep_largest(&mut out, GATHER.hypotheses, Hypothesis::size);
    out
}
