//! What is known of a marker's size and edges before it is measured.

/// A disc's semi-axes, px, and direction, rad, each with its standard deviation; minor axis and direction may not be predicted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SizePrior {
    pub major: (f64, f64),
    pub slope: Option<Slope>,
}

/// What of a disc's shape follows the skin's slope: semi-minor axis, px, and direction, rad, each with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slope {
    pub minor: (f64, f64),
    pub angle: (f64, f64),
}

impl SizePrior {
    /// Of the major axis alone, as whole discs about it tell it, px.
    pub fn of_major(major: (f64, f64)) -> Self {
        Self { major, slope: None }
    }
}

/// Usual blur, px, and darkness of a frame's markers, each with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePrior {
    pub blur: (f64, f64),
    pub dark: (f64, f64),
}
