//! In-flight effects on wing, cabin and camera, which a laboratory does not have, with their prior standard deviations.

/// A vibration that the rows of a frame sample at different times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vibration {
    /// Amplitude at the tip, m, or of the camera's rotation, rad.
    pub amplitude: f64,
    pub frequency_hz: f64,
    /// Whether the frames of a flight may estimate the amplitude: it is a default, not configured.
    pub scaled_by_frames: bool,
}

/// Prior standard deviations of in-flight effects on wing, cabin and camera (reasons in docs/adjustment/installation.md). A
/// standard deviation of 0 excludes an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlightEffectPriors {
    /// Bend of the wing between survey and ground frame (fuel, jacks, sun), at the tip, m.
    pub ground_bend_m: f64,
    /// Bend of the wing that is equal in all frames of a flight and independent of the load, at the tip, m.
    pub constant_bend_m: f64,
    /// Error of the survey's vertical, about each horizontal axis, rad.
    pub vertical_rad: f64,
    /// Motion of the skin at each marker, each axis, m.
    pub skin_motion_m: f64,
    /// Whether the frames of a flight may estimate the motion of the skin: it is a default, not configured.
    pub skin_scaled_by_frames: bool,
    /// Rotation of the wing's root relative to the cabin since the ground frame, about each axis, rad.
    pub root_rotation_rad: f64,
    /// Translation of the wing's root relative to the cabin since the ground frame, along each axis, m.
    pub root_translation_m: f64,
    /// Bending in the wing's plane, at the tip, m.
    pub in_plane_m: f64,
    /// Twist by the torque of a control surface, at its position, rad.
    pub torque_rad: f64,
    /// Relative change of the camera constant between ground and flight.
    pub scale: f64,
    /// Change of the principal point between ground and flight, each coordinate, px.
    pub principal_point_px: f64,
    /// Time from the exposure of the first row to that of the last, s.
    pub readout_s: f64,
    /// Vibration of the wing.
    pub vibration: Vibration,
    /// Vibration of the camera.
    pub shake: Vibration,
}

impl FlightEffectPriors {
    /// Default priors, for an airliner.
    pub const DEFAULT: Self = Self {
        // Fuel, jacks and sun between survey and ground frame: tonnes of fuel move a tip by some centimetres.
        ground_bend_m: 0.010,
        // Lower skin warmed by fuel: 3 K between the skins of a box of 0.5 m height bend 15 m of it by 15 mm.
        constant_bend_m: 0.015,
        // A levelling instrument on an apron.
        vertical_rad: 0.1 * std::f64::consts::PI / 180.0,
        // Pressure, fuel and suction on a panel between two stringers.
        skin_motion_m: 3e-4,
        skin_scaled_by_frames: true,
        // A wing box in a fuselage that bends under pressure and load: 0.5 mm over 1 m.
        root_rotation_rad: 5e-4,
        root_translation_m: 1e-3,
        // Drag, and lift on a swept wing.
        in_plane_m: 0.05,
        // An aileron in a turn, below the speed of aileron reversal.
        torque_rad: std::f64::consts::PI / 180.0,
        // Cold and focus, and refraction at a window that is not configured.
        scale: 2e-4,
        // A lens that cools in its mount, in pixels of some micrometres.
        principal_point_px: 0.3,
        // Sensors of many pixels without a global shutter take 5 to 30 ms.
        readout_s: 0.03,
        // An airliner's first mode in light turbulence.
        vibration: Vibration { amplitude: 0.01, frequency_hz: 3.0, scaled_by_frames: true },
        // A camera on a seat rail, by engines and floor: 0.2 px.
        shake: Vibration { amplitude: 3e-5, frequency_hz: 15.0, scaled_by_frames: true },
    };

    /// Priors without any in-flight effect, for rendered scenes.
    pub const NONE: Self = Self {
        ground_bend_m: 0.0,
        constant_bend_m: 0.0,
        vertical_rad: 0.0,
        skin_motion_m: 0.0,
        skin_scaled_by_frames: false,
        root_rotation_rad: 0.0,
        root_translation_m: 0.0,
        in_plane_m: 0.0,
        torque_rad: 0.0,
        scale: 0.0,
        principal_point_px: 0.0,
        readout_s: 0.0,
        vibration: Vibration { amplitude: 0.0, frequency_hz: 0.0, scaled_by_frames: false },
        shake: Vibration { amplitude: 0.0, frequency_hz: 0.0, scaled_by_frames: false },
    };

    /// Returns these priors as fixed ones that the frames of a flight do not scale.
    pub fn without_frame_scaling(mut self) -> Self {
        (self.skin_scaled_by_frames, self.vibration.scaled_by_frames, self.shake.scaled_by_frames) =
            (false, false, false);
        self
    }
}
