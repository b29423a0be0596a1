//! The outline of a blob, point by point.

use nalgebra::Vector2;

use super::blob::Blob;

/// Points half a pixel outside the first and last pixel of each row and column.
pub fn contour(blob: &Blob) -> Vec<Vector2<f64>> {
    let [x0, y0, x1, y1] = blob.bounds;
    let mut rows = vec![(u32::MAX, 0); y1 - y0 + 1];
    let mut columns = vec![(u32::MAX, 0); x1 - x0 + 1];
    for &[y, from, to] in &blob.runs {
        let row = &mut rows[y as usize - y0];
        *row = (row.0.min(from), row.1.max(to));
        for column in &mut columns[from as usize - x0..=to as usize - x0] {
            *column = (column.0.min(y), column.1.max(y));
        }
    }
    let mut out = Vec::with_capacity(2 * (rows.len() + columns.len()));
    for (y, &(from, to)) in (y0..).zip(&rows) {
        out.push(Vector2::new(f64::from(from) - 0.5, y as f64));
        out.push(Vector2::new(f64::from(to) + 0.5, y as f64));
    }
    for (x, &(from, to)) in (x0..).zip(&columns) {
        out.push(Vector2::new(x as f64, f64::from(from) - 0.5));
        out.push(Vector2::new(x as f64, f64::from(to) + 0.5));
    }
    out
}
