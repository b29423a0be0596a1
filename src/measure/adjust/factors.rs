//! By how much more or less than stated things are taken to move in flight.

/// Factors of standard deviations: 1 until frames show otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factors {
    /// Of the fixed marks' motion.
    pub marks: f64,
    /// Of the skin's.
    pub skin: f64,
    /// Of the wing's vibration while rows are read.
    pub vibration: f64,
    /// Of the camera's shake.
    pub shake: f64,
}

impl Default for Factors {
    fn default() -> Self {
        Self { marks: 1.0, skin: 1.0, vibration: 1.0, shake: 1.0 }
    }
}
