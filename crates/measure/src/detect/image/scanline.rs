//! Intersections of image rows with ellipses, straight lines and intervals.

use std::ops::Range;

use nalgebra::Vector2;

use super::ellipse::Ellipse;

/// Part of the frame around a hypothesis: first column and row, last column and row.
pub type PixelBox = [usize; 4];

/// Local frame of an ellipse.
pub struct EllipseFrame<'a> {
    ellipse: &'a Ellipse,
    /// Sine of its direction; `cos` is the cosine.
    pub sin: f64,
    pub cos: f64,
}

/// Ellipse enlarged on all sides, for queries by row: factors of its equation for the columns of a row.
pub struct EllipseRows {
    centre: Vector2<f64>,
    square: f64,
    /// Reciprocal of `square`.
    by_square: f64,
    mixed: f64,
    rest: f64,
}

impl<'a> EllipseFrame<'a> {
    /// Creates the frame of an outline.
    pub fn new(ellipse: &'a Ellipse) -> Self {
        let (sin, cos) = ellipse.angle.sin_cos();
        Self { ellipse, sin, cos }
    }

    /// Returns the coordinates along and across, from the centre, px.
    pub fn to_local(&self, x: f64, y: f64) -> (f64, f64) {
        let (dx, dy) = (x - self.ellipse.centre.x, y - self.ellipse.centre.y);
        (dx * self.cos + dy * self.sin, dy * self.cos - dx * self.sin)
    }

    /// Enlarges the ellipse by `margin` px; `None` if nothing is left.
    pub fn enlarged_rows(&self, margin: f64) -> Option<EllipseRows> {
        let (a, b) = (self.ellipse.major + margin, self.ellipse.minor + margin);
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
    /// Returns the interval of columns in which a row crosses the ellipse.
    pub fn interval(&self, y: f64) -> Option<(f64, f64)> {
        let dy = y - self.centre.y;
        let mixed = self.mixed * dy;
        let rest = self.rest * dy * dy - 1.0;
        let root = mixed * mixed - self.square * rest;
        let middle = self.centre.x - mixed * self.by_square;
        let half = root.max(0.0).sqrt() * self.by_square;
        (root > 0.0).then_some((middle - half, middle + half))
    }
}

/// Ring between two ellipses with one centre; the inner one is optional.
pub struct Ring {
    outer: Option<EllipseRows>,
    inner: Option<EllipseRows>,
}

impl Ring {
    /// Creates the ring between an ellipse enlarged by `inner` px and one enlarged by `outer` px.
    pub fn new(frame: &EllipseFrame, inner: f64, outer: f64) -> Self {
        Self {
            outer: frame.enlarged_rows(outer),
            inner: frame.enlarged_rows(inner),
        }
    }

    /// Returns the columns of a row in the ring, before the hole and behind it; `None` if the row misses the ring.
    pub fn columns(&self, y: f64, area: PixelBox) -> Option<[Range<usize>; 2]> {
        let (from, to) = row_interval(&self.outer, y)?;
        let hole = row_interval(&self.inner, y).unwrap_or((to, to));
        Some([
            columns_in_area(from, hole.0, area),
            columns_in_area(hole.1, to, area),
        ])
    }
}

/// Returns the interval of columns in which a row crosses an ellipse, if there is one.
pub fn row_interval(rows: &Option<EllipseRows>, y: f64) -> Option<(f64, f64)> {
    rows.as_ref()?.interval(y)
}

/// Returns the columns of an interval that are in the area.
pub fn columns_in_area(from: f64, to: f64, [x0, _, x1, _]: PixelBox) -> Range<usize> {
    let (from, to) = (from.max(x0 as f64), to.min(x1 as f64));
    let first = from as usize;
    let end = if to < 0.0 { 0 } else { to as usize + 1 };
    first + usize::from((first as f64) < from)..end
}

/// Straight edge between quadrants: a point and the direction across it.
#[derive(Clone, Copy)]
pub struct EdgeLine {
    pub at: Vector2<f64>,
    pub across: Vector2<f64>,
}

impl EdgeLine {
    /// Returns the interval of columns of a row within `reach` px of the edge.
    pub fn row_interval(&self, y: f64, reach: f64) -> (f64, f64) {
        /// Smallest slope, which keeps lines along rows off infinity.
        const LEVEL: f64 = 1e-6;
        let steep = self.across.x.abs().max(LEVEL);
        let middle = self.at.x - (y - self.at.y) * self.across.y * self.across.x.signum() / steep;
        (middle - reach / steep, middle + reach / steep)
    }
}
