//! Places in a search area that look like a template: normalised cross-correlation at whole pixels.

use nalgebra::Vector2;

use super::patch::GreyPatch;
use crate::dispatch::wide;
use crate::identify::PATCH_REACH_PX;
use crate::ordering::sort_by_value;

/// Search radius from which the correlation begins at half the resolution, px: it then takes a sixteenth of the time.
const HALVED_FROM_PX: usize = 7;
/// Search radius at full resolution around the places found at half of it, px.
const REFINED_PX: usize = 2;
/// Difference of the correlation at half the resolution within which a place may be the most similar at full resolution.
const COARSE_MARGIN: f64 = 0.3;
/// Smallest correlation of a place: the median of unlike patches with one line each is below.
pub(super) const MIN_CORRELATION: f64 = 0.4;
/// Largest number of places.
const MAX_PLACES: usize = 5;
/// Number of sums that are added at once: single-precision values in the widest register, 512 bits.
const LANES: usize = 16;
/// Number of shifts whose sums are added together: each waits for its own last addition.
const SHIFTS: usize = 4;

/// Place that looks like the template.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LikePlace {
    /// Shift of the place on the grid of the ground frame, px.
    pub(super) shift: Vector2<f64>,
    pub(super) correlation: f64,
}

/// Finds the places within `search` px of the centre, most similar first.
pub(super) fn find_like_places(
    template: &GreyPatch,
    patch: &GreyPatch,
    search: [usize; 2],
) -> Vec<LikePlace> {
    let reach = PATCH_REACH_PX;
    let mut places = if search[0].max(search[1]) < HALVED_FROM_PX {
        Correlator::new(template, patch, reach).find_peaks([0, 0], search)
    } else {
        let (small, half) = (template.halved(), patch.halved());
        let coarse = Correlator::new(&small, &half, reach / 2)
            .find_peaks([0, 0], search.map(|s| s.div_ceil(2)));
        let fine = Correlator::new(template, patch, reach);
        let refine = |place: &LikePlace| {
            let centre = [2 * place.shift.x as isize, 2 * place.shift.y as isize];
            fine.find_peaks(centre, [REFINED_PX; 2]).into_iter().next()
        };
        let best = coarse.first().map_or(0.0, |place| place.correlation);
        coarse
            .iter()
            .filter(|place| place.correlation > best - COARSE_MARGIN)
            .filter_map(refine)
            .collect()
    };
    sort_by_value(&mut places, |place| -place.correlation);
    let mut kept: Vec<LikePlace> = Vec::new();
    for place in places {
        if kept
            .iter()
            .all(|other| (other.shift - place.shift).amax() > REFINED_PX as f64)
        {
            kept.push(place);
        }
    }
    kept
}

wide! {
    /// Sums the products of rows with those of a patch from a column and row on, at [`SHIFTS`] shifts along u.
    fn multiply_rows(rows: &[Vec<f32>], patch: &GreyPatch, start: [usize; 2], out: &mut [f32; SHIFTS])
        = multiply_rows_inline
}

#[inline(always)]
fn multiply_rows_inline(
    rows: &[Vec<f32>],
    patch: &GreyPatch,
    [left, top]: [usize; 2],
    out: &mut [f32; SHIFTS],
) {
    let mut sums = [[0.0; LANES]; SHIFTS];
    for (row, line) in rows.iter().zip(patch.rows().skip(top)) {
        for (k, a) in row.chunks_exact(LANES).enumerate() {
            for (shift, sums) in sums.iter_mut().enumerate() {
                let b = line.get(left + shift + k * LANES..).unwrap_or(&[]);
                match b.first_chunk::<LANES>() {
                    Some(b) => sums
                        .iter_mut()
                        .zip(a.iter().zip(b))
                        .for_each(|(sum, (a, b))| *sum += a * b),
                    None => sums
                        .iter_mut()
                        .zip(a.iter().zip(b))
                        .for_each(|(sum, (a, b))| *sum += a * b),
                }
            }
        }
    }
    *out = sums.map(|lanes| lanes.iter().sum());
}

/// A template without its mean, and sums over the patch that it is compared with.
struct Correlator<'a> {
    patch: &'a GreyPatch,
    reach: usize,
    /// Rows of the template, filled with zeros to a multiple of [`LANES`].
    rows: Vec<Vec<f32>>,
    norm: f64,
    /// Sums of the values and of their squares over the patch above and left of each pixel.
    sums: Vec<[f64; 2]>,
}

impl<'a> Correlator<'a> {
    fn new(template: &GreyPatch, patch: &'a GreyPatch, reach: usize) -> Self {
        let side = 2 * reach + 1;
        let [left, top] = template.size().map(|own| (own - side) / 2);
        let lines: Vec<&[f32]> = (top..top + side)
            .map(|j| &template.row(j)[left..left + side])
            .collect();
        let mean = lines.iter().flat_map(|line| line.iter()).sum::<f32>() / (side * side) as f32;
        let padded = |line: &&[f32]| {
            let mut row: Vec<f32> = line.iter().map(|v| v - mean).collect();
            row.resize(side.next_multiple_of(LANES), 0.0);
            row
        };
        let rows: Vec<Vec<f32>> = lines.iter().map(padded).collect();
        let norm = rows
            .iter()
            .flatten()
            .map(|v| f64::from(v * v))
            .sum::<f64>()
            .sqrt();
        let [width, height] = patch.size();
        let mut sums = vec![[0.0; 2]; (width + 1) * (height + 1)];
        for (j, row) in patch.rows().enumerate() {
            let mut line = [0.0; 2];
            for (i, value) in row.iter().enumerate() {
                let value = f64::from(*value);
                line = [line[0] + value, line[1] + value * value];
                let above = sums[j * (width + 1) + i + 1];
                sums[(j + 1) * (width + 1) + i + 1] = [above[0] + line[0], above[1] + line[1]];
            }
        }
        Self {
            patch,
            reach,
            rows,
            norm,
            sums,
        }
    }

    /// Writes the correlations at shifts along u from one on; 0 if the patch ends within the template.
    fn correlate(&self, [x, y]: [isize; 2], out: &mut [f64]) {
        let side = 2 * self.reach + 1;
        let [width, height] = self.patch.size();
        let [x, y] = [x + (width / 2) as isize, y + (height / 2) as isize]
            .map(|at| at - self.reach as isize);
        let is_inside = |at: isize, size: usize| at >= 0 && at as usize + side <= size;
        for (x, out) in (x..).step_by(SHIFTS).zip(out.chunks_mut(SHIFTS)) {
            let mut products = [0.0; SHIFTS];
            if x >= 0 && y >= 0 {
                multiply_rows(
                    &self.rows,
                    self.patch,
                    [x as usize, y as usize],
                    &mut products,
                );
            }
            for ((x, out), product) in (x..).zip(out).zip(products) {
                let inside = is_inside(x, width) && is_inside(y, height);
                *out = if inside {
                    self.normalise(product, [x as usize, y as usize])
                } else {
                    0.0
                };
            }
        }
    }

    /// Returns the correlation from the sum of products at a column and row of the patch.
    fn normalise(&self, product: f32, [left, top]: [usize; 2]) -> f64 {
        let side = 2 * self.reach + 1;
        let corner =
            |i: usize, j: usize| self.sums[(top + j) * (self.patch.size()[0] + 1) + left + i];
        let [all, right, below, both] = [
            corner(0, 0),
            corner(side, 0),
            corner(0, side),
            corner(side, side),
        ];
        let area = |k: usize| both[k] - right[k] - below[k] + all[k];
        let variance = area(1) - area(0) * area(0) / (side * side) as f64;
        let norm = self.norm * variance.max(0.0).sqrt();
        if norm > 1e-3 {
            f64::from(product) / norm
        } else {
            0.0
        }
    }

    /// Finds the local maxima within `search` px of a shift, most similar first.
    fn find_peaks(&self, centre: [isize; 2], search: [usize; 2]) -> Vec<LikePlace> {
        let [a, b] = search.map(|s| s as isize);
        let width = (2 * a + 1) as usize;
        let mut map = vec![0.0; width * (2 * b + 1) as usize];
        (-b..)
            .zip(map.chunks_exact_mut(width))
            .for_each(|(y, row)| self.correlate([centre[0] - a, centre[1] + y], row));
        let mut places: Vec<LikePlace> = Vec::new();
        for (at, &correlation) in map
            .iter()
            .enumerate()
            .filter(|(_, c)| **c > MIN_CORRELATION)
        {
            let (i, j) = ((at % width) as isize - a, (at / width) as isize - b);
            let around = (-1..=1).flat_map(|y| (-1..=1).map(move |x| (i + x, j + y)));
            let inside = around.filter(|(x, y)| x.abs() <= a && y.abs() <= b);
            let highest = inside
                .map(|(x, y)| map[(y + b) as usize * width + (x + a) as usize])
                .fold(0.0, f64::max);
            if correlation >= highest {
                let shift = Vector2::new((centre[0] + i) as f64, (centre[1] + j) as f64);
                places.push(LikePlace { shift, correlation });
            }
        }
        sort_by_value(&mut places, |place| -place.correlation);
        places.truncate(MAX_PLACES);
        places
    }
}
