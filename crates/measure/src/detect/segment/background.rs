//! Frame reduced by block means, local background, and dark regions relative to it.

use std::rc::Rc;

use nalgebra::Vector2;

use super::components::Run;
use super::windows::{SearchArea, block_size};
use crate::detect::segment::{components, options::BACKGROUND};
use crate::dispatch::wide;
use crate::raster::Raster;

/// Number of levels at which a frame is searched.
const DEFAULT_LEVELS: usize = BACKGROUND.default_levels;
/// Number of levels at which a faint frame is searched: all.
const FAINT_LEVELS: usize = BACKGROUND.levels.len();

/// Reduced frame with its local background.
pub struct ReducedFrame {
    /// Side of a block, px.
    pub factor: usize,
    /// Reduced pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Block means.
    pub mean: Rc<Vec<u8>>,
    /// Local background: the brightest level that is reached on both sides of the pixel, along a row or a column, at one of
    /// the distances.
    pub background: Vec<u8>,
    part: SearchArea,
}

impl ReducedFrame {
    /// Returns the frame with its background raised to that at larger distances; `None` if no thick markers are searched
    /// for.
    pub fn with_far_background(&self) -> Option<Self> {
        if !self.part.has_thick {
            return None;
        }
        let Self {
            factor,
            width,
            height,
            ref mean,
            ref part,
            ..
        } = *self;
        let (mean, part, background) = (
            Rc::clone(mean),
            part.clone(),
            part.copy_known(&self.background, width),
        );
        let mut far = Self {
            factor,
            width,
            height,
            mean,
            background,
            part,
        };
        far.raise_background(&BACKGROUND.far);
        Some(far)
    }
}

/// Connected set of dark reduced pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DarkRegion {
    /// First column and row, last column and row, reduced px.
    pub bounds: [usize; 4],
    /// Reduced pixels.
    pub area: usize,
    /// Minimum ratio of grey to background, in 1/256.
    pub least: u16,
}

impl DarkRegion {
    /// Returns the numbers of columns and rows.
    pub fn sides(&self) -> [usize; 2] {
        let [x0, y0, x1, y1] = self.bounds;
        [x1 - x0 + 1, y1 - y0 + 1]
    }

    /// Returns the centre of the bounds, px.
    pub fn centre(&self, factor: usize) -> Vector2<f64> {
        let [x0, y0, x1, y1] = self.bounds;
        let sums = Vector2::new((x0 + x1 + 1) as f64, (y0 + y1 + 1) as f64);
        (sums * (0.5 * factor as f64)).add_scalar(-0.5)
    }

    /// Returns true if a box of pixels (first column, first row, last column, last row) overlaps the region's bounds.
    pub fn overlaps_box(&self, bounds: &[usize; 4], factor: usize) -> bool {
        let ([x0, y0, x1, y1], [left, top, right, low]) = (self.bounds, bounds.map(|v| v / factor));
        left <= x1 && right >= x0 && top <= y1 && low >= y0
    }

    /// Returns true if another region lies within the bounds of this one.
    pub fn contains(&self, other: &Self) -> bool {
        let (a, b) = (&self.bounds, &other.bounds);
        a[0] <= b[0] && a[1] <= b[1] && a[2] >= b[2] && a[3] >= b[3]
    }

    /// Returns true if `other`, of a laxer level, is the same object with a fringe.
    pub fn is_same_region(&self, other: &Self) -> bool {
        let mut sides = self.bounds.iter().zip(&other.bounds);
        self.least == other.least && sides.all(|(a, b)| a.abs_diff(*b) <= 2)
    }
}

/// Reduces a part of `image` to block means, 0 elsewhere, and computes their background. An incomplete block at the right
/// or lower edge is omitted.
pub fn reduce_frame(image: &Raster, part: SearchArea) -> ReducedFrame {
    let factor = block_size(image.width(), image.height());
    let (width, height) = (image.width() / factor, image.height() / factor);
    let mut mean = vec![0u8; width * height];
    for (y, span) in &part.means {
        let row = |k: usize| &image.row(y * factor + k)[span.start * factor..span.end * factor];
        let out = &mut mean[y * width..][span.clone()];
        if factor == 4 {
            means_of_16([row(0), row(1), row(2), row(3)], out);
        } else {
            means_of_4([row(0), row(1)], out);
        }
    }
    let background = part.copy_known(&mean, width);
    let mut coarse = ReducedFrame {
        factor,
        width,
        height,
        mean: Rc::new(mean),
        background,
        part,
    };
    coarse.raise_background(&BACKGROUND.reach);
    coarse
}

wide! {
    /// Computes means of blocks of 4 x 4 px.
    fn means_of_16(rows: [&[u8]; 4], out: &mut [u8]) = means_of_16_generic
}

/// Computes means of blocks of 4 x 4 px; four bytes of a row are summed as two halves of a word.
#[inline(always)]
fn means_of_16_generic(rows: [&[u8]; 4], out: &mut [u8]) {
    const LOW: u32 = 0x00ff_00ff;
    let [a, b, c, d] = rows.map(|row| row.as_chunks::<4>().0);
    let halves = |four: &[u8; 4]| {
        let word = u32::from_le_bytes(*four);
        (word & LOW) + ((word >> 8) & LOW)
    };
    for ((o, (a, b)), (c, d)) in out.iter_mut().zip(a.iter().zip(b)).zip(c.iter().zip(d)) {
        let sum = (halves(a) + halves(b)) + (halves(c) + halves(d));
        *o = (((sum & 0xffff) + (sum >> 16) + 8) >> 4) as u8;
    }
}

/// Computes means of blocks of 2 x 2 px.
fn means_of_4(rows: [&[u8]; 2], out: &mut [u8]) {
    let [a, b] = rows.map(|row| row.as_chunks::<2>().0);
    let both = |two: &[u8; 2]| u16::from(two[0]) + u16::from(two[1]);
    for (o, (a, b)) in out.iter_mut().zip(a.iter().zip(b)) {
        *o = ((both(a) + both(b) + 2) >> 2) as u8;
    }
}

impl ReducedFrame {
    /// Raises the background of every pixel to the maximum, over distances and directions, of the lower of both sides.
    fn raise_background(&mut self, reach: &[usize]) {
        let Self {
            width,
            height,
            mean,
            background,
            part,
            ..
        } = self;
        for (y, span) in &part.searched {
            let row = |y: usize| &mean[y * *width..][..*width];
            let out = &mut background[y * *width..][..*width];
            for &d in reach {
                let inner = span.start.max(d)..span.end.min(width.saturating_sub(d));
                if !inner.is_empty() {
                    let own = row(*y);
                    let (left, right) = (
                        inner.start - d..inner.end - d,
                        inner.start + d..inner.end + d,
                    );
                    raise_row(&mut out[inner], &own[left], &own[right]);
                }
                if *y >= d && y + d < *height {
                    raise_row(
                        &mut out[span.clone()],
                        &row(y - d)[span.clone()],
                        &row(y + d)[span.clone()],
                    );
                }
            }
        }
    }
}

wide! {
    /// Raises each value of `out` to the lower of both sides.
    fn raise_row(out: &mut [u8], one: &[u8], other: &[u8]) = raise_row_to_lower_side_generic
}

#[inline(always)]
fn raise_row_to_lower_side_generic(out: &mut [u8], one: &[u8], other: &[u8]) {
    // In full steps, the last of them ending at the end of the row: raising a value twice has no effect.
    const STEP: usize = 32;
    let raise = |(o, (&a, &b)): (&mut u8, (&u8, &u8))| *o = (*o).max(a.min(b));
    let last = out.len().checked_sub(STEP);
    for from in last
        .into_iter()
        .flat_map(|last| (0..last).step_by(STEP).chain([last]))
    {
        let (one, other) = (
            one[from..].first_chunk::<STEP>(),
            other[from..].first_chunk::<STEP>(),
        );
        if let (Some(out), Some(one), Some(other)) =
            (out[from..].first_chunk_mut::<STEP>(), one, other)
        {
            out.iter_mut().zip(one.iter().zip(other)).for_each(raise);
        }
    }
    if last.is_none() {
        out.iter_mut().zip(one.iter().zip(other)).for_each(raise);
    }
}

/// Returns the number of levels.
pub fn level_count(faint: bool) -> usize {
    if faint { FAINT_LEVELS } else { DEFAULT_LEVELS }
}

/// Runs of pixels that pass any level, and the number of levels that each pixel passes, run by run.
pub struct PassedLevels {
    runs: Vec<Run>,
    passed: Vec<u8>,
}

wide! {
    fn count_passed(mean: &[u8], background: &[u8], out: &mut [u8]) = count_passed_generic::<DEFAULT_LEVELS>
}

wide! {
    fn count_passed_faint(mean: &[u8], background: &[u8], out: &mut [u8]) = count_passed_generic::<FAINT_LEVELS>
}

/// Counts the levels, of the first `COUNT`, that each pixel passes.
#[inline(always)]
fn count_passed_generic<const COUNT: usize>(mean: &[u8], background: &[u8], out: &mut [u8]) {
    let levels: [u16; COUNT] = std::array::from_fn(|i| BACKGROUND.levels[i]);
    for ((o, &v), &b) in out.iter_mut().zip(mean).zip(background) {
        let (grey, bright) = (
            u16::from(v) * 256,
            u16::from(b.saturating_sub(BACKGROUND.above_noise)),
        );
        *o = levels
            .iter()
            .map(|&level| u8::from(grey < bright * level))
            .sum();
    }
}

impl ReducedFrame {
    /// Counts the levels that each pixel passes.
    pub fn passed_levels(&self, faint: bool) -> PassedLevels {
        let (mut runs, mut passed, mut row) = (Vec::new(), Vec::new(), vec![0u8; self.width]);
        let pass = if faint {
            count_passed_faint
        } else {
            count_passed
        };
        for (y, span) in &self.part.searched {
            let part = y * self.width + span.start..y * self.width + span.end;
            let (first, row) = (runs.len(), &mut row[..span.len()]);
            pass(&self.mean[part.clone()], &self.background[part], row);
            components::find_runs(row, *y, &mut runs);
            for run in &mut runs[first..] {
                passed.extend_from_slice(&row[run.from as usize..=run.to as usize]);
                run.from += span.start as u32;
                run.to += span.start as u32;
            }
        }
        PassedLevels { runs, passed }
    }

    /// Returns true if the relative variation of the background within a region's bounds exceeds
    /// `BACKGROUND.uneven_percent`.
    pub fn is_uneven(&self, region: &DarkRegion) -> bool {
        let (mut least, mut most) = (u8::MAX, 0);
        let [x0, y0, x1, y1] = region.bounds;
        for y in y0..=y1 {
            for &v in &self.background[y * self.width..][x0..=x1] {
                (least, most) = (least.min(v), most.max(v));
            }
        }
        u32::from(most - least) * 100 > BACKGROUND.uneven_percent * u32::from(most)
    }

    /// Returns the dark regions at the `level`-th level, ordered by their first pixel.
    pub fn dark_regions(&self, dark: &PassedLevels, level: usize, faint: bool) -> Vec<DarkRegion> {
        let least = (level_count(faint) - level) as u8;
        let runs = components::runs_at_least(&dark.runs, &dark.passed, least);
        components::connected_sets(&runs)
            .iter()
            .map(|set| self.region_from_runs(set))
            .collect()
    }

    fn region_from_runs(&self, runs: &[Run]) -> DarkRegion {
        let mut region = DarkRegion {
            bounds: [usize::MAX, usize::MAX, 0, 0],
            area: 0,
            least: 256,
        };
        // Grey and background of the darkest pixel, compared by products.
        let mut darkest = [256u32, 255];
        for &Run { y, from, to } in runs {
            let [y, from, to] = [y, from, to].map(|v| v as usize);
            region.area += to + 1 - from;
            let [x0, y0, x1, y1] = region.bounds;
            region.bounds = [x0.min(from), y0.min(y), x1.max(to), y1.max(y)];
            let pixels = y * self.width + from..=y * self.width + to;
            for (&v, &b) in self.mean[pixels.clone()]
                .iter()
                .zip(&self.background[pixels])
            {
                let [v, b] = [u32::from(v), u32::from(b).max(1)];
                if v * darkest[1] < darkest[0] * b {
                    darkest = [v, b];
                }
            }
        }
        region.least = (darkest[0] * 255 / darkest[1]) as u16;
        region
    }
}
