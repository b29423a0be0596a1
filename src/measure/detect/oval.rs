//! Ellipses and intervals, row by row.

use super::candidate::Outline;

/// Part of the frame about a candidate: first and last column and row.
pub type Box = [usize; 4];

/// An ellipse that is asked row by row.
pub struct Oval<'a> {
    outline: &'a Outline,
    /// Sine and cosine of its direction.
    pub sin: f64,
    pub cos: f64,
}

impl<'a> Oval<'a> {
    /// Of an outline.
    pub fn new(outline: &'a Outline) -> Self {
        let (sin, cos) = outline.angle.sin_cos();
        Self { outline, sin, cos }
    }

    /// Coordinates along and across.
    pub fn local(&self, x: f64, y: f64) -> (f64, f64) {
        let (dx, dy) = (x - self.outline.centre.x, y - self.outline.centre.y);
        (dx * self.cos + dy * self.sin, dy * self.cos - dx * self.sin)
    }

    /// Where a row passes through the ellipse grown by `by` on all sides.
    pub fn row(&self, y: f64, by: f64) -> Option<(f64, f64)> {
        let (a, b) = (self.outline.major + by, self.outline.minor + by);
        if a <= 0.0 || b <= 0.0 {
            return None;
        }
        let dy = y - self.outline.centre.y;
        let (p, q) = (1.0 / (a * a), 1.0 / (b * b));
        let square = self.cos * self.cos * p + self.sin * self.sin * q;
        let mixed = self.sin * self.cos * (p - q) * dy;
        let rest = (self.sin * self.sin * p + self.cos * self.cos * q) * dy * dy - 1.0;
        let root = mixed * mixed - square * rest;
        let middle = self.outline.centre.x - mixed / square;
        (root > 0.0).then(|| (middle - root.sqrt() / square, middle + root.sqrt() / square))
    }
}

/// The columns of an interval that lie in the area.
pub fn columns(from: f64, to: f64, [x0, _, x1, _]: Box) -> std::ops::Range<usize> {
    from.ceil().max(x0 as f64) as usize..(to.floor() + 1.0).min((x1 + 1) as f64).max(0.0) as usize
}
