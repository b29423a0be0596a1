//! A grey picture in memory.

use nalgebra::Vector2;

/// Luma, row by row, 8 bits; (0, 0) is the centre of the top-left pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Raster {
    width: usize,
    height: usize,
    luma: Vec<u8>,
}

impl AsRef<Self> for Raster {
    fn as_ref(&self) -> &Self {
        self
    }
}

impl Raster {
    /// `luma` holds `width * height` values; `None` where it does not, or where a side is 0.
    pub fn new(width: usize, height: usize, luma: Vec<u8>) -> Option<Self> {
        let area = width.checked_mul(height)?;
        (area > 0 && luma.len() == area).then_some(Self { width, height, luma })
    }

    /// Pixels per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All values, row by row.
    pub fn luma(&self) -> &[u8] {
        &self.luma
    }

    /// The same, to be filled in.
    pub(crate) fn luma_mut(&mut self) -> &mut [u8] {
        &mut self.luma
    }

    /// One row of `width` values; empty where `y` is outside.
    pub fn row(&self, y: usize) -> &[u8] {
        let start = y.saturating_mul(self.width);
        self.luma.get(start..start.saturating_add(self.width)).unwrap_or(&[])
    }

    /// Column, row and value of every `step`-th pixel of a box, px, across and down, as far as it lies in the picture; its
    /// far sides are not part of it.
    pub fn part(
        &self,
        low: Vector2<f64>,
        high: Vector2<f64>,
        step: usize,
    ) -> impl Iterator<Item = (usize, usize, u8)> {
        self.rows_of(low, high).step_by(step).flat_map(move |(first, y, row)| {
            let values = row.iter().step_by(step);
            values.zip((first..).step_by(step)).map(move |(&value, x)| (x, y, value))
        })
    }

    /// The rows of a box as far as it lies in the frame: first column, row, values.
    pub fn rows_of(
        &self,
        low: Vector2<f64>,
        high: Vector2<f64>,
    ) -> impl Iterator<Item = (usize, usize, &[u8])> {
        let [x0, y0, x1, y1] = [low.x, low.y, high.x, high.y].map(|v| v.max(0.0) as usize);
        let (first, last) = (x0.min(self.width), x1.clamp(x0.min(self.width), self.width));
        (y0..y1.min(self.height)).map(move |y| (first, y, &self.row(y)[first..last]))
    }

    /// The value nearest to a place, px, clamped to the frame's edge.
    pub fn nearest(&self, x: f64, y: f64) -> u8 {
        self.clamped(x.round() as isize, y.round() as isize)
    }

    /// Whether (`x`, `y`) lies in the frame.
    pub fn holds(&self, x: isize, y: isize) -> bool {
        (0..self.width as isize).contains(&x) && (0..self.height as isize).contains(&y)
    }

    /// The value at (`x`, `y`), clamped to the frame's edge.
    pub fn clamped(&self, x: isize, y: isize) -> u8 {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.luma[y * self.width + x]
    }
}
