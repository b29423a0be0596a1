//! What flight does to wing, cabin and camera, and a laboratory does not, as widths.

/// A vibration that a frame's rows catch at different instants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vibration {
    /// Amplitude: at the tip, m, or of the camera's rotation, rad.
    pub amplitude: f64,
    /// Hertz.
    pub frequency_hz: f64,
    /// Whether nobody stated it: how large it is, a flight's frames may tell.
    pub by_frames: bool,
}

/// What flight does to wing, cabin and camera and a laboratory does not, as standard deviations
/// (docs/adjustment/installation.md has the reasons). 0: it does not happen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlightEffectPriors {
    /// Bend of the wing between survey and ground frame (fuel, jacks, sun), at the tip, m.
    pub ground_bend_m: f64,
    /// Bend of the wing that is the same in all frames of a flight whatever the load, at the tip, m.
    pub constant_bend_m: f64,
    /// The survey's vertical, about each horizontal axis, rad.
    pub vertical_rad: f64,
    /// The skin at each marker, each axis, m.
    pub skin_motion_m: f64,
    /// Whether nobody stated it: how large it is, a flight's frames may tell.
    pub skin_by_frames: bool,
    /// The wing's root against the cabin since the ground frame, about each axis, rad.
    pub root_rotation_rad: f64,
    /// The same, along each axis, m.
    pub root_translation_m: f64,
    /// Bending in the wing's plane, at the tip, m.
    pub in_plane_m: f64,
    /// What the torque of a control surface twists the wing by, at its place, rad.
    pub torque_rad: f64,
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

impl FlightEffectPriors {
    /// What an engineer would allow an airliner, and what holds where an installation says nothing.
    pub const DEFAULT: Self = Self {
        // Fuel, jacks and sun between survey and ground frame: a tip stands some centimetres higher or lower for tonnes.
        ground_bend_m: 0.010,
        // Lower skin warmed by fuel: three kelvin between the skins of a box of half a metre bend 15 m of it by 15 mm.
        constant_bend_m: 0.015,
        // A level's tripod on an apron.
        vertical_rad: 0.1 * std::f64::consts::PI / 180.0,
        // Pressure, fuel and suction on a panel between two stringers.
        skin_motion_m: 3e-4,
        skin_by_frames: true,
        // A wing box in a fuselage that bends under pressure and load: half a millimetre over a metre.
        root_rotation_rad: 5e-4,
        root_translation_m: 1e-3,
        // Drag, and deflection on a swept wing.
        in_plane_m: 0.05,
        // An aileron in a turn; what keeps a wing below reversal.
        torque_rad: std::f64::consts::PI / 180.0,
        // Cold and focus, and refraction at a window that nobody describes.
        scale: 2e-4,
        // A lens that cools in its mount, in pixels of some micrometres.
        principal_point_px: 0.3,
        // Sensors of many pixels without a global shutter take 5 to 30 ms.
        readout_s: 0.03,
        // An airliner's first mode in light turbulence.
        vibration: Vibration { amplitude: 0.01, frequency_hz: 3.0, by_frames: true },
        // A camera on a seat rail, by engines and floor: 0.2 px.
        shake: Vibration { amplitude: 3e-5, frequency_hz: 15.0, by_frames: true },
    };

    /// Nothing of it: rendered scenes.
    pub const NONE: Self = Self {
        ground_bend_m: 0.0,
        constant_bend_m: 0.0,
        vertical_rad: 0.0,
        skin_motion_m: 0.0,
        skin_by_frames: false,
        root_rotation_rad: 0.0,
        root_translation_m: 0.0,
        in_plane_m: 0.0,
        torque_rad: 0.0,
        scale: 0.0,
        principal_point_px: 0.0,
        readout_s: 0.0,
        vibration: Vibration { amplitude: 0.0, frequency_hz: 0.0, by_frames: false },
        shake: Vibration { amplitude: 0.0, frequency_hz: 0.0, by_frames: false },
    };

    /// The same widths, and no frames change them.
    pub fn held(mut self) -> Self {
        (self.skin_by_frames, self.vibration.by_frames, self.shake.by_frames) = (false, false, false);
        self
    }
}
