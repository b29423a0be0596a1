//! Blobs: dark regions segmented at full resolution, with their moments.

use nalgebra::{Matrix2, Vector2};

use super::background::{DarkRegion, ReducedFrame};
use super::bitmask::{LevelSide, WORD_BITS, mark_below, mark_side};
use super::components::Run;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::numbers::TINY;
use crate::detect::segment::{components, options::BLOB};
use crate::dispatch::wide;
use crate::ordering::sort_by_value;
use crate::raster::Raster;

/// Connected set of full-resolution pixels that are darker than a level halfway to the background.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Blob {
    /// Bounding box, px, inclusive: x0, y0, x1, y1.
    pub bounds: [usize; 4],
    /// Runs of the blob: row, first column, last column.
    pub runs: Vec<[u32; 3]>,
    pub area: f64,
    pub centroid: Vector2<f64>,
    /// Second central moments, px^2.
    pub covariance: Matrix2<f64>,
    /// True if it reaches the edge of the frame.
    pub at_edge: bool,
}

/// Window of a region: first and last column and row, the last excluded.
#[derive(Clone, Copy)]
struct RegionWindow {
    x0: usize,
    y0: usize,
    x1: usize,
    y1: usize,
}

/// Number of rows that are marked before their runs are extracted.
const ROW_GROUP: usize = 16;

/// Returns the blobs of one region, and true if one of them extends beyond its window.
pub fn region_blobs(
    image: &Raster,
    coarse: &ReducedFrame,
    region: &DarkRegion,
) -> (Vec<Blob>, bool) {
    let least = f64::from(region.least) / 256.0;
    let level = ((least + 0.5 * (1.0 - least)) * 256.0) as u32;
    blobs_below(
        image,
        coarse,
        region,
        [BLOB.pad; 2],
        Threshold::Share(level),
    )
}

/// Returns the blobs of a region that extends beyond its window at every level: the local background was too bright, as
/// next to the white of a quadrant or below the sky, so that the skin counted as dark. Here the level of the region's
/// surroundings is the limit, and the window is larger, because faint tips are not part of the region: up to half of a flat
/// marker, and more of flat quadrants.
pub fn blobs_against_surround(
    image: &Raster,
    coarse: &ReducedFrame,
    region: &DarkRegion,
) -> Vec<Blob> {
    let (dark, skin) = dark_and_skin(coarse, region);
    let sides = region.sides();
    let longest = sides[0].max(sides[1]);
    let flat = 3 * region.area < longest * longest;
    // A region longer than a marker already contains the marker.
    let most = BLOB
        .max_length_px
        .max(image.width().max(image.height()) / BLOB.long_side_divisor)
        / coarse.factor;
    let more = |side: usize| {
        if flat {
            side.max(longest / 4)
        } else {
            longest / 4
        }
    };
    let window = |times: usize| {
        let pad = sides.map(|side| times * (BLOB.pad + more(side).min(most.saturating_sub(side))));
        blobs_below(
            image,
            coarse,
            region,
            pad,
            Threshold::Between { dark, skin },
        )
    };
    let (blobs, cut) = window(1);
    let mut out = if cut && blobs.is_empty() {
        window(2).0
    } else {
        blobs
    };
    // A large window also shows other objects.
    out.retain(|blob| region.overlaps_box(&blob.bounds, coarse.factor));
    out
}

/// Returns the darkest reduced pixel of a region, and the median of those two pixels outside its bounds.
fn dark_and_skin(coarse: &ReducedFrame, region: &DarkRegion) -> (u32, u32) {
    let [x0, y0, x1, y1] = region.bounds;
    let (x0, y0) = (x0.saturating_sub(2), y0.saturating_sub(2));
    let (x1, y1) = (
        (x1 + 2).min(coarse.width - 1),
        (y1 + 2).min(coarse.height - 1),
    );
    let (mut dark, mut ring) = (255, Vec::new());
    for y in y0..=y1 {
        let row = &coarse.mean[y * coarse.width..][..coarse.width];
        dark = row[x0..=x1].iter().fold(dark, |d, &v| d.min(v));
        if y == y0 || y == y1 {
            ring.extend_from_slice(&row[x0..=x1]);
        } else {
            ring.extend([row[x0], row[x1]]);
        }
    }
    let middle = ring.len() / 2;
    (
        u32::from(dark),
        u32::from(*ring.select_nth_unstable(middle).1),
    )
}

/// Returns the blobs of pixels below a level with their centroid in an outline, the largest first, that lie entirely in a
/// box around it (see [`enlarged_box`]).
pub fn dark_parts(image: &Raster, ellipse: &Ellipse, margin: f64, level: u8) -> Vec<Blob> {
    let (low, high) = enlarged_box(ellipse, margin);
    let mut out = blobs_in_box(image, low, high, LevelSide::Darker(level));
    out.retain(|blob| ellipse.contains(blob.centroid));
    sort_by_value(&mut out, |one| -one.area);
    out
}

/// Returns the box around an outline, enlarged by 30 % and a margin, px.
pub fn enlarged_box(ellipse: &Ellipse, margin: f64) -> (Vector2<f64>, Vector2<f64>) {
    let reach = (ellipse.half_extent() * BLOB.about).add_scalar(margin);
    (ellipse.centre - reach, ellipse.centre + reach)
}

/// Returns the blobs of pixels on one side of a level that lie entirely in a box.
pub fn blobs_in_box(
    image: &Raster,
    low: Vector2<f64>,
    high: Vector2<f64>,
    side: LevelSide,
) -> Vec<Blob> {
    let end = |v: f64, most: usize| (v.ceil().max(0.0) as usize).saturating_add(1).min(most);
    let window = RegionWindow {
        x0: low.x.floor().max(0.0) as usize,
        y0: low.y.floor().max(0.0) as usize,
        x1: end(high.x, image.width()),
        y1: end(high.y, image.height()),
    };
    if window.x0 >= window.x1 || window.y0 >= window.y1 {
        return Vec::new();
    }
    window
        .blobs(
            image,
            &mut window.marked_runs(image, |_, row, marks| mark_side(row, side, marks)),
        )
        .0
}

/// Rule for the grey value below which a pixel is dark, given its background.
#[derive(Clone, Copy)]
enum Threshold {
    /// Fraction of the background, in 1/256.
    Share(u32),
    /// Level halfway between a dark one and the background, which is limited to that of the skin.
    Between { dark: u32, skin: u32 },
}

wide! {
    /// Replaces background grey levels by the levels below which a pixel is dark.
    fn to_thresholds(values: &mut [u8], threshold: Threshold) = background_to_thresholds_generic
}

#[inline(always)]
fn background_to_thresholds_generic(values: &mut [u8], threshold: Threshold) {
    match threshold {
        Threshold::Share(level) => {
            values
                .iter_mut()
                .for_each(|v| *v = (u32::from(*v) * level).div_ceil(256).min(255) as u8);
        }
        Threshold::Between { dark, skin } => {
            // A value nearer to the dark level is not background: the background lies beyond the examined distances.
            let half = (dark + skin) / 2;
            let background = |v: u32| if v < half { skin } else { v.min(skin) };
            values
                .iter_mut()
                .for_each(|v| *v = (dark + background(u32::from(*v))).div_ceil(2).min(255) as u8);
        }
    }
}

/// Returns the connected sets below a threshold that depends on the local background, and true if one of them extends
/// beyond the region's window.
fn blobs_below(
    image: &Raster,
    coarse: &ReducedFrame,
    region: &DarkRegion,
    pad: [usize; 2],
    threshold: Threshold,
) -> (Vec<Blob>, bool) {
    let window = RegionWindow::from_region(image, coarse, region, pad);
    window.blobs(image, &mut window.dark_runs(image, coarse, threshold))
}

/// Repeats the value of each block for its `factor` pixels in a row, as far as there are blocks.
fn repeat_blocks(blocks: &[u8], factor: usize, out: &mut [u8]) {
    if factor == 4 {
        out.as_chunks_mut::<4>()
            .0
            .iter_mut()
            .zip(blocks)
            .for_each(|(pixels, &v)| *pixels = [v; 4]);
    } else {
        out.chunks_mut(factor)
            .zip(blocks)
            .for_each(|(pixels, &v)| pixels.fill(v));
    }
}

impl RegionWindow {
    /// Creates a window with a margin of reduced pixels around a region: left and right, above and below.
    fn from_region(
        image: &Raster,
        coarse: &ReducedFrame,
        region: &DarkRegion,
        pad: [usize; 2],
    ) -> Self {
        let (f, [x0, y0, x1, y1]) = (coarse.factor, region.bounds);
        let [beside, above] = pad.map(|pad| pad * f);
        Self {
            x0: (x0 * f).saturating_sub(beside),
            y0: (y0 * f).saturating_sub(above),
            x1: ((x1 + 1) * f + beside).min(image.width()),
            y1: ((y1 + 1) * f + above).min(image.height()),
        }
    }

    /// Returns the runs of marked pixels. `mark` is called for each row, with its pixels up to the end of the last word
    /// within the image, and sets the marks word by word.
    fn marked_runs(
        &self,
        image: &Raster,
        mut mark: impl FnMut(usize, &[u8], &mut [u64]),
    ) -> Vec<Run> {
        let width = self.x1 - self.x0;
        let end = (self.x0 + width.next_multiple_of(WORD_BITS)).min(image.width());
        let words = width.div_ceil(WORD_BITS).max(1);
        let (mut out, mut marks) = (Vec::new(), vec![0; ROW_GROUP * words]);
        // Rows are read in groups, because marking them does not depend on their contents.
        for first in (self.y0..self.y1).step_by(ROW_GROUP) {
            let rows = || first..self.y1.min(first + ROW_GROUP);
            for (y, marks) in rows().zip(marks.chunks_exact_mut(words)) {
                mark(y, &image.row(y)[self.x0..end], marks);
            }
            for (y, marks) in rows().zip(marks.chunks_exact(words)) {
                components::find_runs_in_words(marks.iter().copied(), width, y, &mut out);
            }
        }
        out
    }

    /// Returns the runs of pixels below the threshold of their background.
    fn dark_runs(&self, image: &Raster, coarse: &ReducedFrame, threshold: Threshold) -> Vec<Run> {
        let f = coarse.factor;
        let width = self.x1 - self.x0;
        let (mut blocks, mut limits) = (Vec::new(), vec![0; width.next_multiple_of(WORD_BITS)]);
        self.marked_runs(image, |y, pixels, marks| {
            if y == self.y0 || y % f == 0 {
                // Windows begin with a block; pixels beyond the last complete block use its value.
                let row = &coarse.background[(y / f).min(coarse.height - 1) * coarse.width..]
                    [..coarse.width];
                blocks.clear();
                blocks.extend(row[self.x0 / f..].iter().take(width.div_ceil(f)));
                blocks.resize(width.div_ceil(f), row.last().copied().unwrap_or(0));
                to_thresholds(&mut blocks, threshold);
                repeat_blocks(&blocks, f, &mut limits);
            }
            mark_below(pixels, &limits, marks);
        })
    }

    /// Returns the blobs of runs whose columns count from the window's, and true if some extend beyond it.
    fn blobs(&self, image: &Raster, runs: &mut [Run]) -> (Vec<Blob>, bool) {
        for run in &mut *runs {
            run.from += self.x0 as u32;
            run.to += self.x0 as u32;
        }
        let (mut out, mut cut) = (Vec::new(), false);
        for set in components::connected_sets(runs).iter() {
            if self.is_cut(image, set) {
                cut = true;
            } else if set.iter().map(|r| r.to + 1 - r.from).sum::<u32>() >= BLOB.min_pixels {
                out.push(Blob::new(image, set));
            }
        }
        (out, cut)
    }

    /// Returns true if the set extends beyond the window; a laxer level contains it completely.
    fn is_cut(&self, image: &Raster, set: &[Run]) -> bool {
        let (left, top) = (self.x0 > 0, self.y0 > 0);
        let (right, low) = (self.x1 < image.width(), self.y1 < image.height());
        set.iter().any(|r| {
            (left && r.from as usize == self.x0)
                || (right && r.to as usize + 1 == self.x1)
                || (top && r.y as usize == self.y0)
                || (low && r.y as usize + 1 == self.y1)
        })
    }
}

impl Blob {
    fn new(image: &Raster, set: &[Run]) -> Self {
        let mut blob = Self {
            runs: set.iter().map(|r| [r.y, r.from, r.to]).collect(),
            ..Self::default()
        };
        blob.measure();
        let b = blob.bounds;
        blob.at_edge =
            b[0] == 0 || b[1] == 0 || b[2] + 1 >= image.width() || b[3] + 1 >= image.height();
        blob
    }

    /// Computes bounds and moments from the runs, each run integrated in closed form.
    fn measure(&mut self) {
        let (mut n, mut first, mut second) = (0.0, Vector2::zeros(), Matrix2::zeros());
        let mut bounds = [usize::MAX, usize::MAX, 0, 0];
        for r in &self.runs {
            let length = f64::from(r[2] - r[1] + 1);
            let at = Vector2::new(0.5 * (f64::from(r[1]) + f64::from(r[2])), f64::from(r[0]));
            n += length;
            first += at * length;
            second += at * at.transpose() * length;
            second[(0, 0)] += length * length * length / 12.0;
            second[(1, 1)] += length / 12.0;
            bounds[0] = bounds[0].min(r[1] as usize);
            bounds[1] = bounds[1].min(r[0] as usize);
            bounds[2] = bounds[2].max(r[2] as usize);
            bounds[3] = bounds[3].max(r[0] as usize);
        }
        self.bounds = bounds;
        self.area = n;
        self.centroid = first / n;
        self.covariance = second / n - self.centroid * self.centroid.transpose();
    }

    /// Returns the points half a pixel outside the first and last pixel of each row and column.
    pub fn contour(&self) -> Vec<Vector2<f64>> {
        let [x0, y0, x1, y1] = self.bounds;
        let mut rows = vec![(u32::MAX, 0); y1 - y0 + 1];
        let mut columns = vec![(u32::MAX, 0); x1 - x0 + 1];
        for &[y, from, to] in &self.runs {
            let row = &mut rows[y as usize - y0];
            *row = (row.0.min(from), row.1.max(to));
            for column in &mut columns[from as usize - x0..=to as usize - x0] {
                *column = (column.0.min(y), column.1.max(y));
            }
        }
        let mut out = Vec::with_capacity(2 * (rows.len() + columns.len()));
        for (y, &(from, to)) in (y0..).zip(&rows) {
            out.push(Vector2::new(f64::from(from) - 0.5, y as f64));
            out.push(Vector2::new(f64::from(to) + 0.5, y as f64));
        }
        for (x, &(from, to)) in (x0..).zip(&columns) {
            out.push(Vector2::new(x as f64, f64::from(from) - 0.5));
            out.push(Vector2::new(x as f64, f64::from(to) + 0.5));
        }
        out
    }

    /// Returns the number of pixels relative to that of the ellipse with the same second moments: 1 for an ellipse.
    pub fn fill(&self) -> f64 {
        let det = self.covariance.determinant().max(TINY);
        self.area / (4.0 * std::f64::consts::PI * det.sqrt())
    }
}

impl Ellipse {
    /// Returns the ellipse of inertia of a blob.
    pub fn from_blob(blob: &Blob) -> Self {
        Self::from_moments(blob.centroid, blob.covariance, 2.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn background_nearer_to_the_dark_than_to_the_skin_is_ignored() {
        // The sky, the skin, skin in the shade, another marker.
        let mut values = [230, 120, 90, 50];
        to_thresholds(
            &mut values,
            Threshold::Between {
                dark: 40,
                skin: 120,
            },
        );
        assert_eq!(values, [80, 80, 65, 80]);
    }
}
