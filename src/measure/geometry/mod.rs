//! Frames, rotations, lens and rigid transforms.

mod lens;
mod transform;
mod wing_frame;

pub use lens::{BROWN, Lens, LensError};
pub use transform::{FitError, PointPair, Similarity, TransformFit};
pub use wing_frame::WingFrame;

use nalgebra::{Matrix3, Vector3};

/// The matrix of the cross product: `skew(a) * b = a x b`.
pub fn skew(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}
