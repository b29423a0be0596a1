//! Stage 1: the frame reduced by block means, the local background, and dark regions against it.

use super::super::raster::Raster;

/// Distances, in reduced pixels, at which both sides of a dark pixel are looked at. The longest
/// bounds the thickness of what can be found.
const REACH: [usize; 5] = [2, 4, 8, 16, 24];
/// Farther ones, for thick markers only: between two stretches of sky the whole wing is dark.
const FAR: [usize; 2] = [40, 64];
/// Least thickness, reduced px, of a region that is taken up against the far background.
pub const THICK: usize = 24;

/// Grey over local background below which a reduced pixel is dark, in 1/256, strictest first.
/// Several levels, so that a faint line that touches a marker does not swallow it.
pub const LEVELS: [u16; 4] = [115, 160, 195, 225];

/// The reduced frame.
pub struct Coarse {
    /// Side of a block, px.
    pub factor: usize,
    /// Reduced pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Block means.
    pub mean: Vec<u8>,
    /// Local background: the brightest level that both sides of the pixel reach, along a row or
    /// a column, at one of the distances.
    pub background: Vec<u8>,
}

impl Coarse {
    /// Raises the background to that of the farther distances.
    pub fn look_far(&mut self) {
        raise_by(&FAR, &mut self.background, &self.mean, self.width, self.height);
    }
}

/// A connected set of dark reduced pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    /// First column, reduced px.
    pub x0: usize,
    /// First row, reduced px.
    pub y0: usize,
    /// Last column, reduced px.
    pub x1: usize,
    /// Last row, reduced px.
    pub y1: usize,
    /// Reduced pixels.
    pub area: usize,
    /// Least grey over background, in 1/256.
    pub least: u16,
}

impl Region {
    /// Columns.
    pub fn width(&self) -> usize {
        self.x1 - self.x0 + 1
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.y1 - self.y0 + 1
    }

    /// Whether `other`, of a laxer level, is the same thing with a fringe.
    pub fn stands_for(&self, other: &Self) -> bool {
        let fringe = |a: usize, b: usize| a.abs_diff(b) <= 2;
        self.least == other.least
            && fringe(self.x0, other.x0)
            && fringe(self.y0, other.y0)
            && fringe(self.x1, other.x1)
            && fringe(self.y1, other.y1)
    }
}

/// Side of a block that suits a frame's size, px.
pub fn factor(image: &Raster) -> usize {
    if image.width() * image.height() > 3_000_000 { 4 } else { 2 }
}

/// Block means of `image`; an incomplete block at the right or lower edge is left out.
pub fn reduce(image: &Raster, factor: usize) -> Coarse {
    let (width, height) = (image.width() / factor, image.height() / factor);
    let mut mean = vec![0u8; width * height];
    let mut columns = vec![0u16; width * factor];
    for (y, out) in mean.chunks_exact_mut(width.max(1)).enumerate() {
        columns.fill(0);
        for row in 0..factor {
            for (sum, &v) in columns.iter_mut().zip(image.row(y * factor + row)) {
                *sum += u16::from(v);
            }
        }
        let half = (factor * factor / 2) as u16;
        let shift = (factor * factor).trailing_zeros();
        for (o, block) in out.iter_mut().zip(columns.chunks_exact(factor)) {
            *o = ((block.iter().sum::<u16>() + half) >> shift) as u8;
        }
    }
    let mut background = mean.clone();
    raise_by(&REACH, &mut background, &mean, width, height);
    Coarse { factor, width, height, mean, background }
}

/// For every pixel the greatest, over distances and directions, of the lesser of both sides.
fn raise_by(reach: &[usize], out: &mut [u8], mean: &[u8], width: usize, height: usize) {
    for &d in reach {
        if width > 2 * d {
            for (row, o) in mean.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
                raise(&mut o[d..width - d], &row[..width - 2 * d], &row[2 * d..]);
            }
        }
        if height > 2 * d {
            let (shift, end) = (d * width, (height - d) * width);
            raise(&mut out[shift..end], &mean[..end - shift], &mean[2 * shift..]);
        }
    }
}

fn raise(out: &mut [u8], one: &[u8], other: &[u8]) {
    for ((o, &a), &b) in out.iter_mut().zip(one).zip(other) {
        *o = (*o).max(a.min(b));
    }
}

impl Coarse {
    /// Dark regions at one level, in the order of their first pixel.
    pub fn regions(&self, level: u16) -> Vec<Region> {
        let mut mask: Vec<u8> = (self.mean.iter().zip(&self.background))
            .map(|(&v, &b)| u8::from(u16::from(v) * 256 < u16::from(b).saturating_sub(2) * level))
            .collect();
        let mut out = Vec::new();
        let mut stack = Vec::new();
        for start in 0..mask.len() {
            if mask[start] != 0 {
                out.push(self.fill(&mut mask, start, &mut stack));
            }
        }
        out
    }

    /// Takes the 8-connected region around `start` out of the mask.
    fn fill(&self, mask: &mut [u8], start: usize, stack: &mut Vec<usize>) -> Region {
        let (sx, sy) = (start % self.width, start / self.width);
        let mut region = Region { x0: sx, y0: sy, x1: sx, y1: sy, area: 0, least: 256 };
        mask[start] = 0;
        stack.push(start);
        while let Some(i) = stack.pop() {
            let (x, y) = (i % self.width, i / self.width);
            let ratio = u16::from(self.mean[i]) * 255 / u16::from(self.background[i]).max(1);
            region.least = region.least.min(ratio);
            region.area += 1;
            region.x0 = region.x0.min(x);
            region.x1 = region.x1.max(x);
            region.y0 = region.y0.min(y);
            region.y1 = region.y1.max(y);
            for ny in y.saturating_sub(1)..=(y + 1).min(self.height - 1) {
                for nx in x.saturating_sub(1)..=(x + 1).min(self.width - 1) {
                    let n = ny * self.width + nx;
                    if mask[n] != 0 {
                        mask[n] = 0;
                        stack.push(n);
                    }
                }
            }
        }
        region
    }
}
