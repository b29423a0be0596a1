//! Motion of the true camera, and what an installation claims about the wing.

use wingd::measure::setup::{Setup, SkinHeight, Width, WingBreak};

use super::Structure;

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

/// What an installation states, each by its value or its error; `None`: as the set-up has it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Claims {
    /// Stated repeatability of the mounting, px.
    pub repeatability_px: Option<f64>,
    /// Error of the height of the bending axis, m, which is stated as exact.
    pub axis_off_m: Option<f64>,
    /// Error of the stated sweep outboard of the wing's break, aft positive, rad.
    pub sweep_off_rad: Option<f64>,
}

impl Claims {
    /// Replaces what the installation states.
    pub fn state_in(&self, setup: &mut Setup, structure: &Structure, length_m: f64) {
        setup.mount_repeatability_px = self
            .repeatability_px
            .unwrap_or(setup.mount_repeatability_px);
        if let Some(off_m) = self.axis_off_m {
            setup.uncertainty[Width::SkinHeight] = 0.0;
            let off = |skin: SkinHeight| SkinHeight {
                root_m: skin.root_m + off_m,
                tip_m: skin.tip_m + off_m,
                ..skin
            };
            setup.skin_height = setup.skin_height.map(off);
        }
        if let Some(off_rad) = self.sweep_off_rad {
            let (at, turn_rad) = structure.plan_break;
            let span_m = setup.root_offset_m + at * length_m;
            setup.breaks.push(WingBreak {
                span_m,
                sweep_rad: Some(turn_rad + off_rad),
            });
        }
    }
}
