//! Stage 2: dark regions taken up again at full resolution, with their moments.

use nalgebra::{Matrix2, Vector2};

use super::super::raster::Raster;
use super::coarse::{Coarse, Region};

/// A connected set of full-resolution pixels darker than half way to the background.
#[derive(Clone, Debug, PartialEq)]
pub struct Blob {
    /// Bounding box, px, inclusive: x0, y0, x1, y1.
    pub bounds: [usize; 4],
    /// Runs of the blob: row, first column, last column.
    pub runs: Vec<[u32; 3]>,
    /// Pixels.
    pub area: f64,
    /// Centroid, px.
    pub centroid: Vector2<f64>,
    /// Second central moments, px^2.
    pub covariance: Matrix2<f64>,
    /// Whether it reaches the frame's edge.
    pub at_edge: bool,
}

/// A window's pixels, with what is below the threshold.
struct Window {
    x0: usize,
    y0: usize,
    width: usize,
    height: usize,
    below: Vec<u8>,
}

/// The blobs of one region, and whether one of them goes on outside its window.
pub fn blobs(image: &Raster, coarse: &Coarse, region: &Region) -> (Vec<Blob>, bool) {
    let mut window = threshold(image, coarse, region);
    let mut out = Vec::new();
    let mut stack = Vec::new();
    let mut cut = false;
    for start in 0..window.below.len() {
        if window.below[start] == DARK {
            let (bounds, area) = window.fill(start, &mut stack);
            let cuts = window.cuts(image, bounds);
            cut |= cuts;
            let blob = window.blob(image, bounds);
            if area >= 6 && !cuts {
                out.push(blob);
            }
        }
    }
    (out, cut)
}

/// Marks in a window: dark, and of the set at hand.
const DARK: u8 = 1;
const TAKEN: u8 = 2;

/// Marks the pixels below half way between the region's darkest and the local background.
fn threshold(image: &Raster, coarse: &Coarse, region: &Region) -> Window {
    let f = coarse.factor;
    let pad = 2 * f;
    let x0 = (region.x0 * f).saturating_sub(pad);
    let y0 = (region.y0 * f).saturating_sub(pad);
    let x1 = ((region.x1 + 1) * f + pad).min(image.width());
    let y1 = ((region.y1 + 1) * f + pad).min(image.height());
    let least = f64::from(region.least) / 256.0;
    let half = ((0.5 * (1.0 + least)) * 256.0) as u32;
    let width = x1 - x0;
    let mut below = vec![0u8; width * (y1 - y0)];
    for (y, out) in (y0..y1).zip(below.chunks_exact_mut(width)) {
        let row = &image.row(y)[x0..x1];
        let background = &coarse.background[(y / f).min(coarse.height - 1) * coarse.width..][..coarse.width];
        for (x, (o, &v)) in (x0..).zip(out.iter_mut().zip(row)) {
            let b = u32::from(background[(x / f).min(coarse.width - 1)]);
            *o = u8::from(u32::from(v) * 256 < b * half);
        }
    }
    Window { x0, y0, width, height: y1 - y0, below }
}

impl Window {
    /// Marks the 8-connected set around `start` as taken; its bounds in the window and its size.
    fn fill(&mut self, start: usize, stack: &mut Vec<usize>) -> ([usize; 4], usize) {
        let mut bounds = [usize::MAX, usize::MAX, 0, 0];
        let mut area = 0;
        self.below[start] = TAKEN;
        stack.push(start);
        while let Some(i) = stack.pop() {
            area += 1;
            let (x, y) = (i % self.width, i / self.width);
            bounds = [bounds[0].min(x), bounds[1].min(y), bounds[2].max(x), bounds[3].max(y)];
            for ny in y.saturating_sub(1)..=(y + 1).min(self.height - 1) {
                for nx in x.saturating_sub(1)..=(x + 1).min(self.width - 1) {
                    let n = ny * self.width + nx;
                    if self.below[n] == DARK {
                        self.below[n] = TAKEN;
                        stack.push(n);
                    }
                }
            }
        }
        (bounds, area)
    }

    /// Whether the set goes on outside the window; a laxer level then has it whole.
    fn cuts(&self, image: &Raster, [x0, y0, x1, y1]: [usize; 4]) -> bool {
        let (right, low) = (self.x0 + self.width < image.width(), self.y0 + self.height < image.height());
        (x0 == 0 && self.x0 > 0)
            || (y0 == 0 && self.y0 > 0)
            || (x1 + 1 == self.width && right)
            || (y1 + 1 == self.height && low)
    }

    /// The taken set within `bounds`, which is wiped, as a blob.
    fn blob(&mut self, image: &Raster, [x0, y0, x1, y1]: [usize; 4]) -> Blob {
        let mut runs: Vec<[u32; 3]> = Vec::new();
        for y in y0..=y1 {
            let row = &mut self.below[y * self.width..][..self.width];
            let mut open: Option<usize> = None;
            for x in x0..=x1 + 1 {
                let taken = x <= x1 && row[x] == TAKEN;
                match (taken, open) {
                    (true, None) => open = Some(x),
                    (false, Some(from)) => {
                        row[from..x].fill(0);
                        runs.push([self.y0 + y, self.x0 + from, self.x0 + x - 1].map(|v| v as u32));
                        open = None;
                    }
                    _ => {}
                }
            }
        }
        let mut blob = Blob {
            bounds: [0; 4],
            area: 0.0,
            centroid: Vector2::zeros(),
            covariance: Matrix2::zeros(),
            at_edge: false,
            runs,
        };
        blob.measure();
        let b = blob.bounds;
        blob.at_edge = b[0] == 0 || b[1] == 0 || b[2] + 1 >= image.width() || b[3] + 1 >= image.height();
        blob
    }
}

impl Blob {
    /// Centres of its pixels.
    pub fn points(&self) -> impl Iterator<Item = Vector2<f64>> + '_ {
        (self.runs.iter())
            .flat_map(|r| (r[1]..=r[2]).map(move |x| Vector2::new(f64::from(x), f64::from(r[0]))))
    }

    /// Bounds and moments from the runs, each run integrated in closed form.
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

    /// Pixels over those of the ellipse with the same second moments: 1 for an ellipse.
    pub fn fill(&self) -> f64 {
        let det = self.covariance.determinant().max(1e-9);
        self.area / (4.0 * std::f64::consts::PI * det.sqrt())
    }
}
