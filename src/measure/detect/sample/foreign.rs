//! Pixels that a fit leaves out: near other dark things.

use super::bands::Bands;
use crate::measure::detect::appearance::parameters::{LIGHT, Parameters, light_at};
use crate::measure::detect::hypothesis::candidate::Candidate;
use crate::measure::detect::image::ellipse::Outline;
use crate::measure::detect::image::scanline::{Box, Oval, columns, row_of};
use crate::measure::detect::segment::blob::Blob;
use crate::measure::raster::Raster;

/// How far what is near a thing is not used either, px.
const MARGIN: usize = 3;

/// Pixels of an area that are not used.
struct Mask {
    area: Box,
    marks: Option<Vec<bool>>,
}

impl Mask {
    /// Marks what is near a run of pixels.
    fn add(&mut self, y: usize, from: usize, to: usize) {
        let [x0, y0, x1, y1] = self.area;
        let width = x1 - x0 + 1;
        let marks = self.marks.get_or_insert_with(|| vec![false; width * (y1 - y0 + 1)]);
        let (from, to) = (from.saturating_sub(MARGIN).max(x0), (to + MARGIN).min(x1));
        for row in y.saturating_sub(MARGIN).max(y0)..=(y + MARGIN).min(y1) {
            if from <= to {
                marks[(row - y0) * width + from - x0..=(row - y0) * width + to - x0].fill(true);
            }
        }
    }
}

/// Pixels near others outside the disc's outline that are darker than the light by more than `limit`.
pub fn darker(
    image: &Raster,
    outline: &Outline,
    bands: Bands,
    area: Box,
    m: &Parameters,
    limit: f64,
) -> Option<Vec<bool>> {
    let mut mask = Mask { area, marks: None };
    let oval = Oval::new(outline);
    let reach = f64::from(bands.flat) + MARGIN as f64;
    // No pixel that is lighter than this is darker than the light anywhere near.
    let (p, q) = (1.0 + reach / outline.major, 1.0 + reach / outline.minor);
    let most = m[LIGHT] + (m[LIGHT + 1].abs() + m[LIGHT + 3].abs() * p) * p + m[LIGHT + 2].abs() * q - limit;
    let most = most.ceil().clamp(0.0, 255.0) as u8;
    let (outer, inner) = (oval.grown(reach), oval.grown(f64::from(bands.edge) + 1.0));
    for y in area[1]..=area[3] {
        let Some((from, to)) = row_of(&outer, y as f64) else { continue };
        let inside = row_of(&inner, y as f64).unwrap_or((to, to));
        let row = image.row(y);
        for columns in [columns(from, inside.0, area), columns(inside.1, to, area)] {
            let dark =
                row.get(columns.clone()).is_some_and(|some| some.iter().fold(255, |l, &v| v.min(l)) < most);
            for x in columns.filter(|_| dark) {
                let (s, t) = oval.local(x as f64, y as f64);
                let (p, q) = (s / outline.major, t / outline.minor);
                if f64::from(row[x]) < light_at(m, p, q) - limit {
                    mask.add(y, x, x);
                }
            }
        }
    }
    mask.marks
}

/// Pixels of the area near a blob that is not the candidate's; `None` where no such blob is near.
pub fn foreign(blobs: &[Blob], candidate: &Candidate, area: Box) -> Option<Vec<bool>> {
    let outline = &candidate.outline;
    let [x0, y0, x1, y1] = area;
    let mut mask = Mask { area, marks: None };
    for (i, blob) in blobs.iter().enumerate() {
        let b = blob.bounds;
        let apart = b[0] > x1 + MARGIN || b[2] + MARGIN < x0 || b[1] > y1 + MARGIN || b[3] + MARGIN < y0;
        if apart
            || outline.holds(blob.centroid)
            || candidate.blobs.contains(&i)
            || own_at_laxer_level(blobs, candidate, blob)
        {
            continue;
        }
        for run in &blob.runs {
            let [y, from, to] = run.map(|v| v as usize);
            mask.add(y, from, to);
        }
    }
    mask.marks
}

/// Whether a blob holds the candidate's own one: with a line that touches it at a laxer level.
fn own_at_laxer_level(blobs: &[Blob], candidate: &Candidate, other: &Blob) -> bool {
    let middle = |blob: &Blob| blob.runs.get(blob.runs.len() / 2).copied();
    let own = candidate.blobs.iter().filter_map(|&i| blobs.get(i)).filter_map(middle);
    own.into_iter().any(|[y, from, to]| {
        let at = (from + to) / 2;
        other.runs.iter().any(|r| r[0] == y && (r[1]..=r[2]).contains(&at))
    })
}
