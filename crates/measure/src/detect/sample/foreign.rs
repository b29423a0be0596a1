//! Pixels that a fit excludes because they are near other dark objects.

use super::bands::EdgeBands;
use crate::detect::appearance::parameters::{BLUR, HALO, LIGHT, MarkerParameters, light_at};
use crate::detect::hypothesis::Hypothesis;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::image::scanline::{EllipseFrame, PixelBox, Ring};
use crate::detect::segment::blob::Blob;
use crate::raster::Raster;

/// Margin around another blob that is excluded, px: the blur is not known yet.
const MARGIN_PX: usize = 3;
/// Margin around pixels that are darker than the light by a limit, blurs. With a limit of 25 % of the contrast it ends 2.2
/// blurs from the edge, where 1.4 % of the contrast remains. In a sharpened image the halo reaches as far as the blur of
/// the copy.
const MARGIN_BLURS: f64 = 1.5;

/// Excluded pixels of a box.
struct PixelMask {
    area: PixelBox,
    /// Margin around an object that is excluded as well, px.
    margin: usize,
    marks: Option<Vec<bool>>,
}

impl PixelMask {
    /// Marks the pixels near a run.
    fn mark_run(&mut self, y: usize, from: usize, to: usize) {
        let [x0, y0, x1, y1] = self.area;
        let width = x1 - x0 + 1;
        let marks = self
            .marks
            .get_or_insert_with(|| vec![false; width * (y1 - y0 + 1)]);
        let margin = self.margin;
        let (from, to) = (from.saturating_sub(margin).max(x0), (to + margin).min(x1));
        for row in y.saturating_sub(margin).max(y0)..=(y + margin).min(y1) {
            if from <= to {
                marks[(row - y0) * width + from - x0..=(row - y0) * width + to - x0].fill(true);
            }
        }
    }
}

/// Marks the pixels near those outside the disc's outline that are darker than the light by more than `limit`.
pub fn mask_darker(
    image: &Raster,
    ellipse: &Ellipse,
    bands: EdgeBands,
    area: PixelBox,
    m: &MarkerParameters,
    limit: f64,
) -> Option<Vec<bool>> {
    let margin = (MARGIN_BLURS * m[BLUR].hypot(m[HALO]))
        .ceil()
        .clamp(1.0, 2.0 * MARGIN_PX as f64) as usize;
    let mut mask = PixelMask {
        area,
        margin,
        marks: None,
    };
    let frame = EllipseFrame::new(ellipse);
    let reach = f64::from(bands.flat) + margin as f64;
    // No pixel lighter than this is darker than the light anywhere in the ring.
    let (p, q) = (1.0 + reach / ellipse.major, 1.0 + reach / ellipse.minor);
    let most =
        m[LIGHT] + (m[LIGHT + 1].abs() + m[LIGHT + 3].abs() * p) * p + m[LIGHT + 2].abs() * q
            - limit;
    let most = most.ceil().clamp(0.0, f64::from(u8::MAX)) as u8;
    let ring = Ring::new(&frame, f64::from(bands.edge) + 1.0, reach);
    for y in area[1]..=area[3] {
        let row = image.row(y);
        for columns in ring.columns(y as f64, area).into_iter().flatten() {
            let dark = row
                .get(columns.clone())
                .is_some_and(|some| some.iter().fold(255, |l, &v| v.min(l)) < most);
            for x in columns.filter(|_| dark) {
                let (s, t) = frame.to_local(x as f64, y as f64);
                let (p, q) = (s / ellipse.major, t / ellipse.minor);
                if f64::from(row[x]) < light_at(m, p, q) - limit {
                    mask.mark_run(y, x, x);
                }
            }
        }
    }
    mask.marks
}

/// Marks the pixels of a box near blobs that do not belong to the hypothesis. Returns `None` if there are none.
pub fn mask_foreign(blobs: &[Blob], hypothesis: &Hypothesis, area: PixelBox) -> Option<Vec<bool>> {
    let ellipse = &hypothesis.ellipse;
    let [x0, y0, x1, y1] = area;
    let mut mask = PixelMask {
        area,
        margin: MARGIN_PX,
        marks: None,
    };
    for (i, blob) in blobs.iter().enumerate() {
        let b = blob.bounds;
        let apart = b[0] > x1 + MARGIN_PX
            || b[2] + MARGIN_PX < x0
            || b[1] > y1 + MARGIN_PX
            || b[3] + MARGIN_PX < y0;
        if apart
            || ellipse.contains(blob.centroid)
            || hypothesis.blobs.contains(&i)
            || is_own_at_laxer_level(blobs, hypothesis, blob)
        {
            continue;
        }
        for run in &blob.runs {
            let [y, from, to] = run.map(|v| v as usize);
            mask.mark_run(y, from, to);
        }
    }
    mask.marks
}

/// Returns true if a blob contains the hypothesis's own blob, joined with a line that touches it at a laxer level.
fn is_own_at_laxer_level(blobs: &[Blob], hypothesis: &Hypothesis, other: &Blob) -> bool {
    let middle = |blob: &Blob| blob.runs.get(blob.runs.len() / 2).copied();
    let own = hypothesis
        .blobs
        .iter()
        .filter_map(|&i| blobs.get(i))
        .filter_map(middle);
    own.into_iter().any(|[y, from, to]| {
        let at = (from + to) / 2;
        other
            .runs
            .iter()
            .any(|r| r[0] == y && (r[1]..=r[2]).contains(&at))
    })
}
