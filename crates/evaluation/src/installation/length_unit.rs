//! Units of length in which files of other programs are given.

/// Unit of length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LengthUnit {
    /// Symbol, as in names of columns and in `--unit`.
    pub name: &'static str,
    /// Length in metres.
    pub metres: f64,
}

/// Units in which surfaces and CAD models are given; the inch and the foot are the international ones.
pub const LENGTH_UNITS: [LengthUnit; 5] = [
    LengthUnit {
        name: "m",
        metres: 1.0,
    },
    LengthUnit {
        name: "cm",
        metres: 0.01,
    },
    LengthUnit {
        name: "mm",
        metres: 0.001,
    },
    LengthUnit {
        name: "in",
        metres: 0.0254,
    },
    LengthUnit {
        name: "ft",
        metres: 0.3048,
    },
];
