//! What is known of a marker's size and edges before it is measured.

/// A number with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PriorValue {
    pub value: f64,
    /// Infinite where nothing is known.
    pub sigma: f64,
}

impl PriorValue {
    /// Of which nothing is known.
    pub const UNKNOWN: Self = Self::zero(f64::INFINITY);

    /// About 0.
    pub const fn zero(sigma: f64) -> Self {
        Self { value: 0.0, sigma }
    }

    /// With a standard deviation that is a share of it.
    pub fn to_share(value: f64, share: f64) -> Self {
        Self { value, sigma: share * value }
    }
}

/// What is known beforehand: from a twin beside it, from its neighbours, from the orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MarkerPrior {
    /// Whether size, direction and thickness are those of a twin, a disc beside it.
    pub twin: bool,
    /// The size that the discs about it, or the orientation, predict.
    pub size: Option<SizePrior>,
    /// What the frame's other markers tell of its edges, where it is too thin to tell them itself.
    pub edge: Option<EdgePrior>,
    /// The blur, px, of quadrants that were seen by their black and white together.
    pub blur: Option<f64>,
}

impl MarkerPrior {
    /// Whether all of the size is predicted, as only the orientation or a twin can.
    pub fn tells_all_of_size(&self) -> bool {
        self.size.is_some_and(|size| size.slope.is_some())
    }
}

/// A disc's semi-axes, px, and direction, rad; minor axis and direction may not be predicted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SizePrior {
    pub major: PriorValue,
    pub slope: Option<SlopePrior>,
}

/// What of a disc's shape follows the skin's slope: semi-minor axis, px, and direction, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlopePrior {
    pub minor: PriorValue,
    pub angle: PriorValue,
}

/// Usual blur, px, and darkness of a frame's markers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePrior {
    pub blur: PriorValue,
    pub dark: PriorValue,
}
