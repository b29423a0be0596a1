//! Priors of a marker's size and edges.

/// Prior value with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PriorValue {
    pub value: f64,
    /// Standard deviation; infinite if nothing is known.
    pub sigma: f64,
}

impl PriorValue {
    /// Value of which nothing is known.
    pub const UNKNOWN: Self = Self::zero(f64::INFINITY);

    /// Creates a prior value of 0.
    pub const fn zero(sigma: f64) -> Self {
        Self { value: 0.0, sigma }
    }

    /// Creates a value with a relative standard deviation.
    pub fn with_relative_sigma(value: f64, relative: f64) -> Self {
        Self {
            value,
            sigma: relative * value,
        }
    }
}

/// Prior of a marker, from its neighbours or the orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MarkerPrior {
    /// Size predicted by the neighbouring discs or the orientation.
    pub size: Option<SizePrior>,
    /// Edges as those of the frame's other markers, for a marker too thin to determine them itself.
    pub edge: Option<EdgePrior>,
    /// Blur, px, of quadrants that were segmented by black and white together.
    pub blur: Option<f64>,
}

impl MarkerPrior {
    /// Returns whether all of the size is predicted, as only the orientation or a neighbour can.
    pub fn has_full_size(&self) -> bool {
        self.size.is_some_and(|size| size.slope.is_some())
    }
}

/// Predicted semi-axes, px, and direction, rad, of a disc; minor axis and direction are optional.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SizePrior {
    pub major: PriorValue,
    pub slope: Option<SlopePrior>,
}

/// Part of a disc's shape that depends on the skin's slope: semi-minor axis, px, and direction, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlopePrior {
    pub minor: PriorValue,
    pub angle: PriorValue,
}

/// Prior of blur, px, and darkness from a frame's markers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePrior {
    pub blur: PriorValue,
    pub dark: PriorValue,
}
