//! Motion of the true camera.

/// Motion of a camera since the ground frame, each by its size; 0: absent, or as the installation states it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraMotion {
    /// Standard deviation of a remount's rotation about each axis, px.
    pub remount_px: f64,
    /// Size of a remount's shift, m, in a random direction.
    pub remount_m: f64,
    /// Size of a rotation of the mounting, rad, about a random axis.
    pub turn_rad: f64,
    /// Rotation about the pitch axis from a flight's first frame to its last, rad.
    pub sag_rad: f64,
    /// Standard deviation of the image's shift from frame to frame by stabilisation, each axis, px.
    pub stabilised_px: f64,
}
