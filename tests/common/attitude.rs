//! Attitude of a camera.

use nalgebra::{Matrix3, Rotation3, Vector3};

/// Returns camera_from_wing of a camera that looks outboard.
pub fn camera_from_angles(elevation: f64, azimuth: f64, roll: f64) -> Rotation3<f64> {
    // Camera right is the wing's Z, down is -Y, forward is X.
    let level = Rotation3::from_matrix_unchecked(Matrix3::new(
        0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0,
    ));
    Rotation3::new(Vector3::new(0.0, 0.0, roll))
        * Rotation3::new(Vector3::new(-elevation, 0.0, 0.0))
        * Rotation3::new(Vector3::new(0.0, azimuth, 0.0))
        * level
}
