//! Frames, rotations, lens and rigid transforms.

mod lens;
mod transform;
mod wing_frame;

pub use lens::{Lens, LensError};
pub use transform::{FitError, PointPair, Similarity, TransformFit};
pub use wing_frame::WingFrame;

use nalgebra::{DMatrix, Matrix3, Vector3};

/// The matrix of the cross product: `skew(a) * b = a x b`.
pub fn skew(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}

/// Singular value decomposition `u * diag(values) * v_t`, values in descending order. The general
/// algorithm: the library's special one for 3 x 3 loses half of the digits for equal values.
pub fn singular_values(m: &Matrix3<f64>) -> Option<(Matrix3<f64>, Vector3<f64>, Matrix3<f64>)> {
    let svd = DMatrix::from_column_slice(3, 3, m.as_slice()).try_svd(true, true, 5.0 * f64::EPSILON, 1000)?;
    let square = |d: DMatrix<f64>| Matrix3::from_column_slice(d.as_slice());
    Some((square(svd.u?), Vector3::from_column_slice(svd.singular_values.as_slice()), square(svd.v_t?)))
}
