//! Motion of the true camera, and what an installation claims too surely.

use wingd::measure::setup::{Setup, SkinHeight, Width};

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

/// Quantities that an installation states too surely.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Claims {
    /// Stated repeatability of the mounting, px.
    pub repeatability_px: Option<f64>,
    /// Error of the height of the bending axis, m, which is stated as exact.
    pub axis_off_m: Option<f64>,
}

impl Claims {
    /// Replaces what the installation states.
    pub fn state_in(&self, setup: &mut Setup) {
        setup.mount_repeatability_px = self.repeatability_px.unwrap_or(setup.mount_repeatability_px);
        if let Some(off_m) = self.axis_off_m {
            setup.uncertainty[Width::SkinHeight] = 0.0;
            let off = |skin: SkinHeight| SkinHeight { root_m: skin.root_m + off_m, tip_m: skin.tip_m + off_m, ..skin };
            setup.skin_height = setup.skin_height.map(off);
        }
    }
}
