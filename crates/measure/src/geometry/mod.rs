//! Frames, rotations, lens and rigid transforms.

mod conic;
mod lens;
mod transform;
mod wing_frame;

pub use conic::fit_conic;
pub use lens::{BROWN, Lens, LensError};
pub use transform::{FitError, PointPair, Similarity, TransformFit};
pub use wing_frame::WingFrame;

use nalgebra::{Matrix3, Vector3};

/// Returns the matrix of the cross product: `cross_matrix(a) * b = a x b`.
pub fn cross_matrix(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}

/// Returns the left Jacobian J of a rotation vector w: `exp(w + dw) = exp(J dw) exp(w)` to first order.
pub fn left_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = w.norm_squared();
    let k = cross_matrix(w);
    let (a, b) = if angle2 < 1e-6 {
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        let angle = angle2.sqrt();
        (
            (1.0 - angle.cos()) / angle2,
            (angle - angle.sin()) / (angle2 * angle),
        )
    };
    Matrix3::identity() + k * a + k * k * b
}
