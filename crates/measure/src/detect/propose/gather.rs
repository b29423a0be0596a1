//! Blobs of all levels, without duplicates, and the hypotheses they give; limited, so that clutter cannot take arbitrarily
//! long.

use std::collections::HashMap;

use nalgebra::Vector2;

use crate::detect::hypothesis::{Hypothesis, options::NEIGHBOURS};
use crate::detect::propose::moments;
use crate::detect::propose::options::{GATHER, MOMENTS};
use crate::detect::segment::background::{DarkRegion, ReducedFrame};
use crate::detect::segment::windows::SearchArea;
use crate::detect::segment::{background, blob, blob::Blob, options::BACKGROUND};
use crate::ordering::sort_by_value;
use crate::raster::Raster;

/// Blobs found at the levels of a frame so far, without duplicates, from windows whose total size is limited to a few
/// frames.
pub struct BlobCollector {
    /// Levels relative to the near background; `far` holds those relative to the far one, at which only thick regions are
    /// found, or `None` if no thick markers are searched for.
    near: BackgroundLevels,
    far: Option<BackgroundLevels>,
    unique: UniqueBlobs,
    /// Regions that do not have the shape of a disc and whose background is uneven.
    pub uneven: Vec<DarkRegion>,
    /// Blobs of dark regions that merged with a larger one; they are added last.
    swallowed: Vec<Blob>,
    /// Maximum length of a region that is segmented again relative to its surroundings, reduced px.
    longest: f64,
}

/// Levels relative to one background.
struct BackgroundLevels {
    coarse: ReducedFrame,
    /// First level that has not been searched.
    next: usize,
    /// Minimum thickness of a region, reduced px.
    least: usize,
    /// Completed regions by their darkest value; `open` holds those that extended beyond their window at the last level.
    done: HashMap<u16, Vec<DarkRegion>>,
    open: Vec<DarkRegion>,
}

impl BackgroundLevels {
    fn new(coarse: ReducedFrame, least: usize) -> Self {
        Self {
            coarse,
            next: 0,
            least,
            done: HashMap::new(),
            open: Vec::new(),
        }
    }
}

impl BlobCollector {
    /// Creates a collector without blobs for a part of an image, in which markers are at most `longest_px` long.
    pub fn new(image: &Raster, part: SearchArea, longest_px: f64) -> Self {
        let near = background::reduce_frame(image, part);
        let far = near.with_far_background();
        let factor = near.factor as f64;
        Self {
            near: BackgroundLevels::new(near, 0),
            far: far.map(|far| BackgroundLevels::new(far, BACKGROUND.near_reach())),
            unique: UniqueBlobs::default(),
            uneven: Vec::new(),
            swallowed: Vec::new(),
            longest: longest_px / factor,
        }
    }

    /// Returns the reduced frame with the far background, or with the near one if there is no far one.
    pub fn far_frame(&self) -> &ReducedFrame {
        &self.far.as_ref().unwrap_or(&self.near).coarse
    }

    /// Searches the levels of a default or a faint frame that were not searched before. Returns false if there are none. A
    /// level that more regions pass than are processed is in the noise of the image and is skipped.
    pub fn search_levels(&mut self, image: &Raster, faint: bool) -> bool {
        let darkness = self.near.coarse.passed_levels(faint);
        let passes = |level: &usize| {
            *level < background::level_count(false)
                || self
                    .near
                    .coarse
                    .dark_regions(&darkness, *level, faint)
                    .len()
                    <= GATHER.regions
        };
        let new = (self.near.next..background::level_count(faint)).take_while(passes);
        let end = new.last().map(|level| level + 1);
        let Some(end) = end else { return false };
        self.unique.drop_provisional_blobs();
        let Self {
            near,
            far,
            unique,
            uneven,
            swallowed,
            longest,
        } = self;
        let budget = GATHER.frames * near.coarse.width * near.coarse.height;
        let mut findings = LevelFindings {
            unique,
            uneven,
            swallowed,
            budget,
            laxest: end - 1,
            longest: *longest,
        };
        let far = far
            .as_mut()
            .map(|far| (far.coarse.passed_levels(faint), far));
        for (darkness, levels) in std::iter::once((darkness, near)).chain(far) {
            for level in levels.next..end {
                let regions = levels.coarse.dark_regions(&darkness, level, faint);
                findings.search_level(image, levels, level, regions);
            }
            levels.next = end;
        }
        // Merged blobs are added again after the next levels.
        self.swallowed
            .iter()
            .for_each(|blob| self.unique.add(blob.clone(), Retention::Provisional));
        self.unique.truncate_to(GATHER.blobs);
        keep_largest(&mut self.uneven, GATHER.uneven, |region| region.area as f64);
        true
    }

    /// Returns all blobs found, in order of discovery within each call.
    pub fn blobs(&self) -> &[Blob] {
        &self.unique.blobs
    }
}

/// Destination of the findings of a level.
struct LevelFindings<'a> {
    unique: &'a mut UniqueBlobs,
    uneven: &'a mut Vec<DarkRegion>,
    swallowed: &'a mut Vec<Blob>,
    /// Remaining total size of windows, reduced px.
    budget: usize,
    /// Last level that is searched.
    laxest: usize,
    /// Maximum length of a region that is segmented again relative to its surroundings, reduced px.
    longest: f64,
}

impl LevelFindings<'_> {
    /// Segments the regions that pass one level.
    fn search_level(
        &mut self,
        image: &Raster,
        levels: &mut BackgroundLevels,
        level: usize,
        mut regions: Vec<DarkRegion>,
    ) {
        let BackgroundLevels {
            coarse,
            least,
            done,
            open,
            ..
        } = levels;
        let largest = (coarse.width * coarse.height / 8).max(64);
        regions.retain(|r| {
            let [width, height] = r.sides();
            width * height <= largest && width.min(height) >= *least
        });
        regions.sort_by_key(|r| std::cmp::Reverse(r.area));
        regions.truncate(GATHER.regions);
        // Uneven regions are searched again at the end if nothing is found in them.
        for region in open
            .drain(..)
            .filter(|region| is_swallowed(region, &regions))
        {
            if !coarse.is_uneven(&region) {
                self.swallowed
                    .extend(blob::blobs_against_surround(image, coarse, &region));
            }
        }
        for region in regions {
            if done
                .get(&region.least)
                .is_some_and(|done| done.iter().any(|d| d.is_same_region(&region)))
            {
                continue;
            }
            let [width, height] = region.sides();
            let Some(left) = self.budget.checked_sub(width * height) else {
                continue;
            };
            self.budget = left;
            let (blobs, cut) = blob::region_blobs(image, coarse, &region);
            // At a laxer level the region may lie entirely in its window.
            let segment_again =
                cut && level == self.laxest && width.max(height) as f64 <= self.longest;
            if !segment_again && coarse.is_uneven(&region) && !blobs.iter().any(is_disc) {
                self.uneven.push(region.clone());
            }
            blobs
                .into_iter()
                .for_each(|blob| self.unique.add(blob, Retention::Firm));
            if segment_again {
                let again = blob::blobs_against_surround(image, coarse, &region);
                again
                    .into_iter()
                    .for_each(|blob| self.unique.add(blob, Retention::Provisional));
            }
            if cut {
                open.push(region)
            } else {
                done.entry(region.least).or_default().push(region)
            }
        }
    }
}

/// Returns true if a dark region merges with a far larger or too large one at the next level. This happens to a disc in the
/// band of a shadow, whose background is the light on both sides of the band.
fn is_swallowed(region: &DarkRegion, next: &[DarkRegion]) -> bool {
    let dark = region.area >= GATHER.swallowed_least && region.least < GATHER.swallowed_dark;
    let into = || {
        next.iter()
            .filter(|other| other.contains(region))
            .map(|other| other.area)
            .min()
    };
    dark && into().is_none_or(|area| area > GATHER.swallowed * region.area)
}

/// Returns true if a blob has the shape of a disc.
fn is_disc(blob: &Blob) -> bool {
    moments::disc_from_blob(0, blob).is_some()
}

/// Keeps the `most` largest items; the order changes only if there are more.
fn keep_largest<T>(items: &mut Vec<T>, most: usize, size: impl Fn(&T) -> f64) {
    if items.len() > most {
        sort_by_value(items, |one| -size(one));
        items.truncate(most);
    }
}

/// Decides if a blob stays when further levels are searched, which may show more of the same object.
#[derive(Clone, Copy, PartialEq)]
enum Retention {
    Firm,
    Provisional,
}

/// Blobs without duplicates, indexed by position.
#[derive(Default)]
struct UniqueBlobs {
    blobs: Vec<Blob>,
    /// Retention of each blob.
    kept: Vec<Retention>,
    /// Indices of the blobs with their centroid in a cell of the image.
    cells: HashMap<[i32; 2], Vec<usize>>,
}

impl UniqueBlobs {
    /// Adds a blob unless there is one of similar size at its position.
    fn add(&mut self, blob: Blob, kept: Retention) {
        // With the near background, only the larger part of thick quadrants is visible.
        let in_part = blob.area > GATHER.thick_px && blob.fill() < GATHER.max_partial_fill;
        let min_ratio = if in_part {
            GATHER.min_area_ratio_partial
        } else {
            GATHER.min_area_ratio
        };
        let same = |b: &Blob| {
            (b.centroid - blob.centroid).norm_squared() < NEIGHBOURS.same_px * NEIGHBOURS.same_px
                && (min_ratio..1.0 / min_ratio).contains(&(b.area / blob.area))
        };
        if !self.blobs_near(blob.centroid).any(same) {
            self.insert(blob, kept);
        }
        // Blobs of clutter must not accumulate without limit.
        if self.blobs.len() >= 4 * GATHER.blobs {
            self.truncate_to(2 * GATHER.blobs);
        }
    }

    /// Keeps the `most` largest blobs.
    fn truncate_to(&mut self, most: usize) {
        if self.blobs.len() > most {
            let mut all = self.drain_all();
            keep_largest(&mut all, most, |(blob, _)| blob.area);
            all.into_iter()
                .for_each(|(blob, kept)| self.insert(blob, kept));
        }
    }

    fn drop_provisional_blobs(&mut self) {
        let firm = self
            .drain_all()
            .into_iter()
            .filter(|(_, kept)| *kept == Retention::Firm);
        firm.for_each(|(blob, kept)| self.insert(blob, kept));
    }

    /// Removes and returns all blobs.
    fn drain_all(&mut self) -> Vec<(Blob, Retention)> {
        self.cells.clear();
        std::mem::take(&mut self.blobs)
            .into_iter()
            .zip(std::mem::take(&mut self.kept))
            .collect()
    }

    /// Returns the blobs of all cells with a position less than `NEIGHBOURS.same_px` away.
    fn blobs_near(&self, at: Vector2<f64>) -> impl Iterator<Item = &Blob> {
        let [low, high] = [-NEIGHBOURS.same_px, NEIGHBOURS.same_px]
            .map(|off| Self::cell_index(at.add_scalar(off)));
        let cells = (low[1]..=high[1]).flat_map(move |y| (low[0]..=high[0]).map(move |x| [x, y]));
        let places = cells.filter_map(|cell| self.cells.get(&cell)).flatten();
        places.filter_map(|&place| self.blobs.get(place))
    }

    fn insert(&mut self, blob: Blob, kept: Retention) {
        self.cells
            .entry(Self::cell_index(blob.centroid))
            .or_default()
            .push(self.blobs.len());
        self.blobs.push(blob);
        self.kept.push(kept);
    }

    fn cell_index(at: Vector2<f64>) -> [i32; 2] {
        (at / GATHER.cell_px).map(|v| v.floor() as i32).into()
    }
}

/// Returns hypotheses of quadrants from blobs and pairs of blobs: those that have the shape of two black quadrants and are
/// lighter at the position of the white ones. A few real ones, thin relative to the blur, are not; they are found by their
/// white.
pub fn quadrant_hypotheses(
    image: &Raster,
    noise: f64,
    blobs: &[Blob],
    pairs: &[[usize; 2]],
) -> Vec<Hypothesis> {
    let single = (0..blobs.len()).map(|i| vec![i]);
    let mut pairs = pairs.to_vec();
    keep_largest(&mut pairs, GATHER.pairs, |p| {
        p.iter().filter_map(|&i| blobs.get(i)).map(|b| b.area).sum()
    });
    let double = pairs.into_iter().map(|p| p.to_vec());
    let least = MOMENTS.white_over_black.max(noise);
    let mut out: Vec<Hypothesis> = (single.chain(double))
        .filter_map(|i| moments::quadrants_from_blobs(&i, blobs))
        .filter(|hypothesis| hypothesis.white_over_black(image) > least)
        .collect();
    keep_largest(&mut out, GATHER.hypotheses, Hypothesis::size);
    out
}

/// Returns hypotheses of discs from blobs.
pub fn disc_hypotheses(blobs: &[Blob]) -> Vec<Hypothesis> {
    let mut out = blobs
        .iter()
        .enumerate()
        .filter_map(|(i, blob)| moments::disc_from_blob(i, blob))
        .collect();
    keep_largest(&mut out, GATHER.hypotheses, Hypothesis::size);
    out
}
