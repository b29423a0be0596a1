//! Scale factors of the prior standard deviations of in-flight motion.

/// Factors of the prior standard deviations: 1 until the frames determine other values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PriorScales {
    /// Factor for the motion of the fixed targets.
    pub fixed_targets: f64,
    /// Factor for the motion of the skin.
    pub skin: f64,
    /// Factor for the vibration of the wing during readout.
    pub vibration: f64,
    /// Factor for the shake of the camera during readout.
    pub shake: f64,
    /// Standard deviation of the image's shift from frame to frame if the frames show one, px.
    pub stabilised_px: f64,
}

impl Default for PriorScales {
    fn default() -> Self {
        Self {
            fixed_targets: 1.0,
            skin: 1.0,
            vibration: 1.0,
            shake: 1.0,
            stabilised_px: 0.0,
        }
    }
}
