//! What flight does to wing, cabin and camera, and a laboratory does not, as widths.

/// A vibration that a frame's rows catch at different instants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vibration {
    /// Amplitude: at the tip, m, or of the camera's rotation, rad.
    pub amplitude: f64,
    /// Hertz.
    pub frequency_hz: f64,
}

/// What flight does to wing, cabin and camera and a laboratory does not, as standard deviations
/// (docs/adjustment/installation.md has the reasons). 0: it does not happen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InFlight {
    /// Bend of the wing between survey and ground frame (fuel, jacks, sun), at the tip, m.
    pub ground_bend_m: f64,
    /// The survey's vertical, about each horizontal axis, rad.
    pub vertical_rad: f64,
    /// The skin at each marker, each axis, m.
    pub skin_motion_m: f64,
    /// The wing's root against the cabin since the ground frame, about each axis, rad.
    pub root_turn_rad: f64,
    /// The same, along each axis, m.
    pub root_shift_m: f64,
    /// Bending in the wing's plane, at the tip, m.
    pub in_plane_m: f64,
    /// Camera constant in flight over that on ground, as a share.
    pub scale: f64,
    /// Principal point in flight against that on ground, each coordinate, px.
    pub principal_point_px: f64,
    /// From the exposure of the first row to that of the last, s.
    pub readout_s: f64,
    /// Of the wing.
    pub vibration: Vibration,
    /// Of the camera.
    pub shake: Vibration,
}

impl InFlight {
    /// What an engineer would allow an airliner.
    pub const USUAL: Self = Self {
        ground_bend_m: 0.010,
        vertical_rad: 0.1 * std::f64::consts::PI / 180.0,
        skin_motion_m: 3e-4,
        root_turn_rad: 2e-4,
        root_shift_m: 1e-3,
        in_plane_m: 0.05,
        scale: 2e-4,
        principal_point_px: 0.3,
        readout_s: 0.03,
        vibration: Vibration { amplitude: 0.01, frequency_hz: 3.0 },
        shake: Vibration { amplitude: 3e-5, frequency_hz: 15.0 },
    };

    /// Nothing of it: rendered scenes, and installations that state nothing.
    pub const NONE: Self = Self {
        ground_bend_m: 0.0,
        vertical_rad: 0.0,
        skin_motion_m: 0.0,
        root_turn_rad: 0.0,
        root_shift_m: 0.0,
        in_plane_m: 0.0,
        scale: 0.0,
        principal_point_px: 0.0,
        readout_s: 0.0,
        vibration: Vibration { amplitude: 0.0, frequency_hz: 0.0 },
        shake: Vibration { amplitude: 0.0, frequency_hz: 0.0 },
    };
}
