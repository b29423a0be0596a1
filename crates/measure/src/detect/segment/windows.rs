//! Parts of a frame that are searched, and parts that must be decoded to search them.

use std::ops::Range;

use super::options::BACKGROUND;
use crate::tiles::Tiles;

/// Returns the side of a block for a frame of this size, px.
pub fn block_size(width: usize, height: usize) -> usize {
    if width * height > 3_000_000 { 4 } else { 2 }
}

/// Row and range of its columns.
type RowSpan = (usize, Range<usize>);

/// Part of a frame that is searched, in reduced pixels, as row spans without overlap: those whose background is needed, and
/// those whose means it is computed from.
#[derive(Clone)]
pub struct SearchArea {
    pub(super) searched: Vec<RowSpan>,
    pub(super) means: Vec<RowSpan>,
    /// True if it may contain a thick marker, which is detected relative to the far background.
    pub(super) has_thick: bool,
}

/// Box around a predicted marker: first and last column and row, and its maximum thickness in the image, px.
pub struct SearchWindow {
    pub low: [f64; 2],
    pub high: [f64; 2],
    pub thick: f64,
}

/// Ranges of columns and rows, reduced px.
type ReducedBox = [Range<usize>; 2];

impl SearchWindow {
    /// Returns true if the marker may be so thick that it is detected relative to the far background.
    fn may_be_thick(&self, factor: usize) -> bool {
        // Both rims may cover a part of a reduced pixel.
        self.thick / factor as f64 + 2.0 >= BACKGROUND.near_reach() as f64
    }

    /// Returns the box in a frame of `width` x `height` reduced pixels, and the boxes from which its background is
    /// computed: one wider and one higher. They reach to the far distances only if the marker may be thick.
    fn reduced_boxes(&self, factor: usize, [width, height]: [usize; 2]) -> [ReducedBox; 3] {
        let Self { low, high, .. } = self;
        let reduced = |v: f64, most: usize| ((v / factor as f64).max(0.0) as usize).min(most);
        let columns = reduced(low[0], width)..reduced(high[0] + factor as f64, width);
        let rows = reduced(low[1], height)..reduced(high[1] + factor as f64, height);
        let (near, far) = (BACKGROUND.reach.last(), BACKGROUND.far.last());
        let reach = *if self.may_be_thick(factor) { far } else { near }.unwrap_or(&0);
        let (wider, higher) = (
            widen_range(&columns, reach, width),
            widen_range(&rows, reach, height),
        );
        [
            [columns.clone(), rows.clone()],
            [wider, rows],
            [columns, higher],
        ]
    }
}

/// Returns the tiles that must be decoded of a frame of `width` x `height` px to search the windows, with a margin around
/// each, px.
pub fn required_tiles(
    windows: &[SearchWindow],
    width: usize,
    height: usize,
    margin: usize,
) -> Tiles {
    let factor = block_size(width, height);
    let mut tiles = Tiles::none(width, height);
    for window in windows {
        // Smoothing needs one pixel more than the means.
        let margins = [margin, 1, 1];
        for ([columns, rows], margin) in window
            .reduced_boxes(factor, [width, height].map(|v| v / factor))
            .into_iter()
            .zip(margins)
        {
            if columns.is_empty() || rows.is_empty() {
                continue;
            }
            let [columns, rows] = [columns, rows]
                .map(|r| (r.start * factor).saturating_sub(margin)..r.end * factor + margin);
            tiles.mark(columns, rows);
        }
    }
    tiles
}

impl SearchArea {
    /// Returns the full area of a frame of `width` x `height` px.
    pub fn full_frame(width: usize, height: usize) -> Self {
        let factor = block_size(width, height);
        let rows: Vec<RowSpan> = (0..height / factor)
            .map(|y| (y, 0..width / factor))
            .collect();
        Self {
            searched: rows.clone(),
            means: rows,
            has_thick: true,
        }
    }

    /// Returns the area of windows in a frame of `width` x `height` px.
    pub fn from_windows(windows: &[SearchWindow], width: usize, height: usize) -> Self {
        let factor = block_size(width, height);
        let (width, height) = (width / factor, height / factor);
        let (mut searched, mut means) = (Vec::new(), Vec::new());
        for window in windows {
            let [own, wide, high] = window.reduced_boxes(factor, [width, height]);
            searched.push(own);
            means.extend([wide, high]);
        }
        let [searched, means] = [searched, means].map(|boxes| merge_spans(&boxes, height));
        let has_thick = windows.iter().any(|window| window.may_be_thick(factor));
        Self {
            searched,
            means,
            has_thick,
        }
    }

    /// Copies the known reduced pixels, `width` to a row, and sets the others to 0: with windows, most of a frame is never
    /// accessed.
    pub(super) fn copy_known(&self, from: &[u8], width: usize) -> Vec<u8> {
        let mut out = vec![0; from.len()];
        for (y, span) in &self.means {
            let known = y * width + span.start..y * width + span.end;
            out[known.clone()].copy_from_slice(&from[known]);
        }
        out
    }
}

/// Extends a range by a margin on both sides, within the limits 0 and `most`.
fn widen_range(range: &Range<usize>, margin: usize, most: usize) -> Range<usize> {
    range.start.saturating_sub(margin)..(range.end + margin).min(most)
}

/// Merges boxes into row spans without overlap.
fn merge_spans(boxes: &[ReducedBox], height: usize) -> Vec<RowSpan> {
    let mut out: Vec<RowSpan> = Vec::new();
    let mut row: Vec<&Range<usize>> = Vec::new();
    for y in 0..height {
        row.extend(
            boxes
                .iter()
                .filter(|[_, rows]| rows.contains(&y))
                .map(|[columns, _]| columns),
        );
        row.sort_unstable_by_key(|columns| columns.start);
        for columns in row.drain(..).filter(|columns| columns.start < columns.end) {
            match out.last_mut() {
                Some((last, span)) if *last == y && columns.start <= span.end => {
                    span.end = span.end.max(columns.end)
                }
                _ => out.push((y, columns.clone())),
            }
        }
    }
    out
}
