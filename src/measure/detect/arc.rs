//! A disc that a neighbour's sheet hides in part: the ellipse through the outline that is left.

use nalgebra::{Cholesky, Matrix2, SMatrix, SVector, SymmetricEigen, Vector2};

use super::blob::Blob;
use super::candidate::{Candidate, Outline};

/// How far a neighbour's sheet reaches beyond its print, px.
const SHEET_PX: f64 = 7.0;
/// Share of the outline that must be seen.
const SHARE: f64 = 0.55;

type Conic = SVector<f64, 5>;

/// The candidate with the outline of its whole disc, and the boxes where it may be hidden.
pub fn completed(candidate: &Candidate, blob: &Blob, others: &[Blob]) -> Option<Candidate> {
    let hidden: Vec<[f64; 4]> = (others.iter())
        .filter(|o| *o != blob && o.area > 0.3 * blob.area && o.area < 3.0 * blob.area)
        .map(|o| o.bounds.map(|v| v as f64))
        .map(|[x0, y0, x1, y1]| [x0 - SHEET_PX, y0 - SHEET_PX, x1 + SHEET_PX, y1 + SHEET_PX])
        .collect();
    let covered = |p: &Vector2<f64>| hidden.iter().any(|h| within(h, p));
    let inverse = blob.covariance.try_inverse()?;
    let eigen = SymmetricEigen::new(inverse);
    let whiten = Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()))
        * eigen.eigenvectors.transpose();
    let rim = rim(blob);
    let seen: Vec<Vector2<f64>> =
        rim.iter().filter(|p| !covered(p)).map(|p| whiten * (p - blob.centroid)).collect();
    if seen.len() == rim.len() || (seen.len() as f64) < SHARE * rim.len() as f64 || seen.len() < 30 {
        return None;
    }
    let (centre, moments) = ellipse(&through(&seen)?)?;
    let back = whiten.try_inverse()?;
    let outline =
        Outline::from_moments(blob.centroid + back * centre, back * moments * back.transpose(), 1.0);
    let near = outline.major < 2.0 * candidate.outline.major && outline.minor < 3.0 * candidate.outline.minor;
    near.then(|| Candidate { outline, hidden, ..candidate.clone() })
}

/// Whether a box holds a point.
pub fn within(&[x0, y0, x1, y1]: &[f64; 4], p: &Vector2<f64>) -> bool {
    (x0..=x1).contains(&p.x) && (y0..=y1).contains(&p.y)
}

/// Points half a pixel outside the first and last pixel of each row and column.
fn rim(blob: &Blob) -> Vec<Vector2<f64>> {
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

fn row(p: &Vector2<f64>) -> Conic {
    Conic::new(p.x * p.x, p.x * p.y, p.y * p.y, p.x, p.y)
}

/// Least squares of `a x^2 + b x y + c y^2 + d x + e y = 1`.
fn through(points: &[Vector2<f64>]) -> Option<Conic> {
    let mut normal = SMatrix::<f64, 5, 5>::identity() * 1e-9;
    let mut right = Conic::zeros();
    for p in points {
        let r = row(p);
        normal += r * r.transpose();
        right += r;
    }
    Some(Cholesky::new(normal)?.solve(&right))
}

/// Centre, and the matrix whose unit ellipse it is.
fn ellipse(conic: &Conic) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let form = Matrix2::new(conic[0], 0.5 * conic[1], 0.5 * conic[1], conic[2]);
    if form.determinant() <= 0.0 || form.trace() <= 0.0 {
        return None;
    }
    let centre = -0.5 * (form.try_inverse()? * Vector2::new(conic[3], conic[4]));
    let level = 1.0 + (centre.transpose() * form * centre).x;
    Some((centre, (form / level).try_inverse()?))
}
