//! Ellipse through points of the image.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Fits a conic to points. Returns its centre c and its shape matrix, positive definite for an ellipse:
/// (p - c)' shape^-1 (p - c) = 1.
pub fn fit_conic(points: &[Vector2<f64>]) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector2<f64>>() / count;
    let scatter = points
        .iter()
        .map(|p| (p - mean) * (p - mean).transpose())
        .sum::<Matrix2<f64>>()
        / count;
    // Whitened, the flattest ellipse is a circle and the equations are well conditioned.
    let root = scatter.cholesky()?.l();
    let whiten = root.try_inverse()?;
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    let mut right = SVector::<f64, 5>::zeros();
    for p in points {
        let q = whiten * (p - mean);
        let row = SVector::<f64, 5>::new(q.x * q.x, q.x * q.y, q.y * q.y, q.x, q.y);
        normal += row * row.transpose();
        right += row;
    }
    let c = normal.cholesky()?.solve(&right);
    let quadratic = Matrix2::new(c[0], 0.5 * c[1], 0.5 * c[1], c[2]);
    let centre = quadratic.try_inverse()? * Vector2::new(c[3], c[4]) * -0.5;
    let level = 1.0 + centre.dot(&(quadratic * centre));
    let shape = root * (quadratic.try_inverse()? * level) * root.transpose();
    Some((mean + root * centre, shape))
}
