//! What of a frame is searched, and what of it is read for that.

use std::ops::Range;

use super::options::BACKGROUND;
use crate::tiles::Tiles;

/// Side of a block that suits a frame's size, px.
pub fn block_size(width: usize, height: usize) -> usize {
    if width * height > 3_000_000 { 4 } else { 2 }
}

/// A row, and some of its columns.
type RowSpan = (usize, Range<usize>);

/// The part of a frame that is searched, in reduced pixels: of which the background is wanted, and of which that takes
/// the means; row by row, none twice.
#[derive(Clone)]
pub struct SearchArea {
    pub(super) wanted: Vec<RowSpan>,
    pub(super) means: Vec<RowSpan>,
    /// Whether something thick may lie in it, which is seen against the far background.
    pub(super) has_thick: bool,
}

/// A box about what is sought: first and last column and row, and how thick that shows at most, px.
pub struct SearchWindow {
    pub low: [f64; 2],
    pub high: [f64; 2],
    pub thick: f64,
}

/// Some columns and rows, reduced pixels.
type ReducedBox = [Range<usize>; 2];

impl SearchWindow {
    /// Whether what is sought may be so thick that it is seen against the far background.
    fn may_be_thick(&self, factor: usize) -> bool {
        // Both rims may cover a part of a reduced pixel.
        self.thick / factor as f64 + 2.0 >= BACKGROUND.thick as f64
    }

    /// What it holds of a frame of `width` x `height` reduced pixels, and what its background is told by: the same, wider and
    /// higher. As far as what is thick needs it only where something may be thick.
    fn reduced_boxes(&self, factor: usize, [width, height]: [usize; 2]) -> [ReducedBox; 3] {
        let Self { low, high, .. } = self;
        let reduced = |v: f64, most: usize| ((v / factor as f64).max(0.0) as usize).min(most);
        let columns = reduced(low[0], width)..reduced(high[0] + factor as f64, width);
        let rows = reduced(low[1], height)..reduced(high[1] + factor as f64, height);
        let (near, far) = (BACKGROUND.reach.last(), BACKGROUND.far.last());
        let reach = *if self.may_be_thick(factor) { far } else { near }.unwrap_or(&0);
        let (wider, higher) = (widen_range(&columns, reach, width), widen_range(&rows, reach, height));
        [[columns.clone(), rows.clone()], [wider, rows], [columns, higher]]
    }
}

/// What is read of a frame of `width` x `height` px where windows are searched, and about what is wanted a margin, px.
pub fn required_tiles(windows: &[SearchWindow], width: usize, height: usize, margin: usize) -> Tiles {
    let factor = block_size(width, height);
    let mut tiles = Tiles::none(width, height);
    for window in windows {
        // A smoothed frame is smoothed from one pixel more than the means take.
        let margins = [margin, 1, 1];
        for ([columns, rows], margin) in
            window.reduced_boxes(factor, [width, height].map(|v| v / factor)).into_iter().zip(margins)
        {
            if columns.is_empty() || rows.is_empty() {
                continue;
            }
            let [columns, rows] =
                [columns, rows].map(|r| (r.start * factor).saturating_sub(margin)..r.end * factor + margin);
            tiles.mark(columns, rows);
        }
    }
    tiles
}

impl SearchArea {
    /// All of a frame of `width` x `height` px.
    pub fn full_frame(width: usize, height: usize) -> Self {
        let factor = block_size(width, height);
        let rows: Vec<RowSpan> = (0..height / factor).map(|y| (y, 0..width / factor)).collect();
        Self { wanted: rows.clone(), means: rows, has_thick: true }
    }

    /// What the windows hold of a frame of `width` x `height` px.
    pub fn from_windows(windows: &[SearchWindow], width: usize, height: usize) -> Self {
        let factor = block_size(width, height);
        let (width, height) = (width / factor, height / factor);
        let (mut wanted, mut means) = (Vec::new(), Vec::new());
        for window in windows {
            let [own, wide, high] = window.reduced_boxes(factor, [width, height]);
            wanted.push(own);
            means.extend([wide, high]);
        }
        let [wanted, means] = [wanted, means].map(|boxes| merge_spans(&boxes, height));
        let has_thick = windows.iter().any(|window| window.may_be_thick(factor));
        Self { wanted, means, has_thick }
    }

    /// What is known of reduced pixels, `width` to a row, 0 elsewhere: of windows most of a frame is never touched.
    pub(super) fn copy_known(&self, from: &[u8], width: usize) -> Vec<u8> {
        let mut out = vec![0; from.len()];
        for (y, span) in &self.means {
            let known = y * width + span.start..y * width + span.end;
            out[known.clone()].copy_from_slice(&from[known]);
        }
        out
    }
}

/// A range with a margin on both sides, as far as there is something.
fn widen_range(range: &Range<usize>, margin: usize, most: usize) -> Range<usize> {
    range.start.saturating_sub(margin)..(range.end + margin).min(most)
}

/// What boxes hold, row by row, none twice.
fn merge_spans(boxes: &[ReducedBox], height: usize) -> Vec<RowSpan> {
    let mut out: Vec<RowSpan> = Vec::new();
    let mut row: Vec<&Range<usize>> = Vec::new();
    for y in 0..height {
        row.extend(boxes.iter().filter(|[_, rows]| rows.contains(&y)).map(|[columns, _]| columns));
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
