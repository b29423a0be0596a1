//! A grey image in memory.

use nalgebra::Vector2;

/// Grey image of 8-bit luma, row by row; (0, 0) is the centre of the top-left pixel.
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
    /// Creates an image from `width * height` values; `None` if their number differs or a side is 0.
    pub fn new(width: usize, height: usize, luma: Vec<u8>) -> Option<Self> {
        let area = width.checked_mul(height)?;
        (area > 0 && luma.len() == area).then_some(Self {
            width,
            height,
            luma,
        })
    }

    /// Returns the number of pixels per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Returns all values, row by row.
    pub fn luma(&self) -> &[u8] {
        &self.luma
    }

    /// Returns all values, row by row, for writing.
    pub(crate) fn luma_mut(&mut self) -> &mut [u8] {
        &mut self.luma
    }

    /// Returns a row of `width` values; empty if `y` is outside.
    pub fn row(&self, y: usize) -> &[u8] {
        let start = y.saturating_mul(self.width);
        self.luma
            .get(start..start.saturating_add(self.width))
            .unwrap_or(&[])
    }

    /// Returns column, row and value of every `step`-th pixel of a box, px, across and down, clipped to the image; the far
    /// sides of the box are excluded.
    pub fn pixels_in_box(
        &self,
        low: Vector2<f64>,
        high: Vector2<f64>,
        step: usize,
    ) -> impl Iterator<Item = (usize, usize, u8)> {
        self.rows_in_box(low, high)
            .step_by(step)
            .flat_map(move |(first, y, row)| {
                let values = row.iter().step_by(step);
                values
                    .zip((first..).step_by(step))
                    .map(move |(&value, x)| (x, y, value))
            })
    }

    /// Returns the rows of a box, clipped to the image: first column, row, values.
    pub fn rows_in_box(
        &self,
        low: Vector2<f64>,
        high: Vector2<f64>,
    ) -> impl Iterator<Item = (usize, usize, &[u8])> {
        let [x0, y0, x1, y1] = [low.x, low.y, high.x, high.y].map(|v| v.max(0.0) as usize);
        let (first, last) = (x0.min(self.width), x1.clamp(x0.min(self.width), self.width));
        (y0..y1.min(self.height)).map(move |y| (first, y, &self.row(y)[first..last]))
    }

    /// Returns the value of the pixel nearest to a position, px, clamped to the image's edge.
    pub fn nearest_value(&self, x: f64, y: f64) -> u8 {
        self.clamped_value(x.round() as isize, y.round() as isize)
    }

    /// Returns true if (`x`, `y`) is in the image.
    pub fn contains(&self, x: isize, y: isize) -> bool {
        (0..self.width as isize).contains(&x) && (0..self.height as isize).contains(&y)
    }

    /// Returns the value at (`x`, `y`), clamped to the image's edge.
    pub fn clamped_value(&self, x: isize, y: isize) -> u8 {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.luma[y * self.width + x]
    }
}
