//! Ellipses, straight lines and intervals, row by row.

use std::ops::Range;

use nalgebra::Vector2;

use super::ellipse::Ellipse;

/// Part of the frame about a hypothesis: first and last column and row.
pub type PixelBox = [usize; 4];

/// An ellipse's frame.
pub struct EllipseFrame<'a> {
    ellipse: &'a Ellipse,
    /// Sine and cosine of its direction.
    pub sin: f64,
    pub cos: f64,
}

/// An ellipse grown on all sides that is asked row by row: the factors of its equation for the columns of a row.
pub struct EllipseRows {
    centre: Vector2<f64>,
    square: f64,
    /// One over that.
    by_square: f64,
    mixed: f64,
    rest: f64,
}

impl<'a> EllipseFrame<'a> {
    /// Of an outline.
    pub fn new(ellipse: &'a Ellipse) -> Self {
        let (sin, cos) = ellipse.angle.sin_cos();
        Self { ellipse, sin, cos }
    }

    /// Coordinates along and across.
    pub fn local(&self, x: f64, y: f64) -> (f64, f64) {
        let (dx, dy) = (x - self.ellipse.centre.x, y - self.ellipse.centre.y);
        (dx * self.cos + dy * self.sin, dy * self.cos - dx * self.sin)
    }

    /// The ellipse grown by `by`; `None` where nothing is left.
    pub fn grown(&self, by: f64) -> Option<EllipseRows> {
        let (a, b) = (self.ellipse.major + by, self.ellipse.minor + by);
        if a <= 0.0 || b <= 0.0 {
            return None;
        }
        let (p, q) = (1.0 / (a * a), 1.0 / (b * b));
        let square = self.cos * self.cos * p + self.sin * self.sin * q;
        Some(EllipseRows {
            centre: self.ellipse.centre,
            square,
            by_square: 1.0 / square,
            mixed: self.sin * self.cos * (p - q),
            rest: self.sin * self.sin * p + self.cos * self.cos * q,
        })
    }
}

impl EllipseRows {
    /// Where a row passes through it.
    pub fn at(&self, y: f64) -> Option<(f64, f64)> {
        let dy = y - self.centre.y;
        let mixed = self.mixed * dy;
        let rest = self.rest * dy * dy - 1.0;
        let root = mixed * mixed - self.square * rest;
        let middle = self.centre.x - mixed * self.by_square;
        let half = root.max(0.0).sqrt() * self.by_square;
        (root > 0.0).then_some((middle - half, middle + half))
    }
}

/// What lies between two ellipses about one centre, the inner of which may be none.
pub struct Ring {
    outer: Option<EllipseRows>,
    inner: Option<EllipseRows>,
}

impl Ring {
    /// From an ellipse grown by so much to one grown by so much more, px.
    pub fn new(frame: &EllipseFrame, inner: f64, outer: f64) -> Self {
        Self { outer: frame.grown(outer), inner: frame.grown(inner) }
    }

    /// The columns of a row in it, before the hole and behind it; `None` where it is not met.
    pub fn columns(&self, y: f64, area: PixelBox) -> Option<[Range<usize>; 2]> {
        let (from, to) = row_of(&self.outer, y)?;
        let hole = row_of(&self.inner, y).unwrap_or((to, to));
        Some([columns(from, hole.0, area), columns(hole.1, to, area)])
    }
}

/// Where a row passes through an ellipse of which something is left.
pub fn row_of(rows: &Option<EllipseRows>, y: f64) -> Option<(f64, f64)> {
    rows.as_ref()?.at(y)
}

/// The columns of an interval that lie in the area.
pub fn columns(from: f64, to: f64, [x0, _, x1, _]: PixelBox) -> Range<usize> {
    let (from, to) = (from.max(x0 as f64), to.min(x1 as f64));
    let first = from as usize;
    let end = if to < 0.0 { 0 } else { to as usize + 1 };
    first + usize::from((first as f64) < from)..end
}

/// A straight edge between quadrants: a point, and the direction across it.
#[derive(Clone, Copy)]
pub struct EdgeLine {
    pub at: Vector2<f64>,
    pub across: Vector2<f64>,
}

impl EdgeLine {
    /// The part of a row that is within `reach`.
    pub fn row(&self, y: f64, reach: f64) -> (f64, f64) {
        /// Keeps lines along rows off infinity.
        const LEVEL: f64 = 1e-6;
        let steep = self.across.x.abs().max(LEVEL);
        let middle = self.at.x - (y - self.at.y) * self.across.y * self.across.x.signum() / steep;
        (middle - reach / steep, middle + reach / steep)
    }
}
