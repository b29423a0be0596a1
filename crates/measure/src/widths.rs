//! Registry of the unknowns of the adjustment, and of the widths: prior standard deviations that a key of
//! `installation.toml` states.
//!
//! Reading, checks and writing of a key, its documentation, `wingd plan`, the uncertainty budget and the flight prior follow
//! from the rows of these two tables (docs/recipes.md: "An unknown with a key").

/// Declares [`Unknown`]: variant, name in `flight_prior.json` and messages, source in uncertainty budgets, and `lasting` if
/// all flights of an installation share it.
macro_rules! unknowns {
    (@lasting lasting) => { true };
    (@lasting) => { false };
    ($($unknown:ident = $name:literal, $source:literal $($lasting:ident)?;)+) => {
        /// Kind of unknown of the adjustment.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        pub enum Unknown {
            $(#[doc = $name] #[serde(rename = $name)] $unknown),+
        }

        impl Unknown {
            /// Returns the name in `flight_prior.json` and messages.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$unknown => $name),+ }
            }

            /// Returns the name of its source in an uncertainty budget.
            pub const fn source(self) -> &'static str {
                match self { $(Self::$unknown => $source),+ }
            }

            /// Returns whether all flights of an installation share the unknown, so that the flight prior includes it.
            pub const fn is_lasting(self) -> bool {
                match self { $(Self::$unknown => unknowns!(@lasting $($lasting)?)),+ }
            }
        }
    };
}

unknowns! {
    Bending = "bending", "bending";
    Twist = "twist", "twist";
    Shape = "shape of bending", "shape of bending" lasting;
    FuelBurn = "burning of fuel", "shape of bending";
    VerticalLoad = "load's turning", "shape of bending";
    ConstantBend = "bend that does not go with the load", "constant bend";
    GroundBend = "bend between survey and ground frame", "ground bend" lasting;
    GroundTwist = "twist between survey and ground frame", "ground twist" lasting;
    RootFlexibility = "flexibility of the root", "root flexibility" lasting;
    Joints = "rotation of joints with the load", "joints" lasting;
    InPlane = "bending in the wing's plane", "in-plane";
    Torque = "torque of control surfaces", "torque";
    AxisHeight = "height of the bending axis", "axis" lasting;
    RootOffset = "root offset", "root" lasting;
    ChordOffset = "chord offset of the bending axis", "chord offset" lasting;
    SpanDirection = "direction of the span", "span direction" lasting;
    Sweep = "sweep outboard of breaks", "sweep" lasting;
    ThermalScale = "thermal scale", "temperature";
    Survey = "survey", "survey" lasting;
    Vertical = "vertical of the survey", "vertical" lasting;
    SkinMotion = "motion of the skin", "skin" lasting;
    SkinBulges = "bulges of the skin", "skin";
    FixedTargetMotion = "motion of the fixed targets", "fixed targets" lasting;
    MovingPart = "moving part", "moving parts";
    CommonDisplacement = "common cause", "common cause";
    RootRotation = "rotation of the root", "root motion";
    RootShift = "shift of the root", "root motion";
    WingVibration = "vibration of the wing", "rolling shutter";
    CameraShake = "shake of the camera", "rolling shutter";
    GroundRotation = "rotation on ground", "rotation on ground" lasting;
    MountingRotation = "rotation of the mounting", "mounting";
    MountingShift = "shift of the mounting", "mounting";
    ProjectionCentre = "projection centre", "projection centre" lasting;
    InteriorOrientation = "interior orientation", "lens" lasting;
    FlightScale = "scale of the camera in flight", "camera in flight";
    Aspect = "image aspect", "camera in flight";
    FlightPrincipalPoint = "principal point in flight", "camera in flight";
    RayField = "bend of rays", "bent rays";
    ImageShift = "shift of the image by stabilisation", "camera in flight";
    PaneShift = "panes' shift", "window" lasting;
    PaneBow = "panes' bow", "window";
}

/// Unit of a key, which its name includes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyUnit {
    /// Name in messages and documentation; empty for a ratio.
    pub name: &'static str,
    /// Value of the unit in radians, metres, pixels or seconds, in which values are stored.
    pub factor: f64,
}

const RATIO: KeyUnit = KeyUnit {
    name: "",
    factor: 1.0,
};
const METRE: KeyUnit = KeyUnit {
    name: "m",
    factor: 1.0,
};
const MILLIRADIAN: KeyUnit = KeyUnit {
    name: "mrad",
    factor: 1e-3,
};
const DEGREE: KeyUnit = KeyUnit {
    name: "degrees",
    factor: std::f64::consts::PI / 180.0,
};
const PIXEL: KeyUnit = KeyUnit {
    name: "px",
    factor: 1.0,
};
const SECOND: KeyUnit = KeyUnit {
    name: "s",
    factor: 1.0,
};

/// Row of the registry of widths.
#[derive(Clone, Copy, Debug)]
pub struct WidthRow {
    /// Width that the row describes.
    pub width: Width,
    /// Section of `installation.toml`.
    pub section: &'static str,
    /// Key in the section.
    pub key: &'static str,
    /// Unit of the key.
    pub unit: KeyUnit,
    /// Default, in the unit of the key.
    pub default: f64,
    /// Largest allowed value, in the unit of the key; the smallest is 0.
    pub max: f64,
    /// Whether it belongs to an effect of flight, which a laboratory does not have.
    pub of_flight: bool,
    /// Unknowns whose prior it is after a remount.
    pub unknowns: &'static [Unknown],
    /// Meaning, as in the table of keys.
    pub meaning: &'static str,
}

/// Declares [`Width`]: its meaning, section and key, unit, default, largest value, `flight` or `laboratory`,
/// and the unknowns whose prior it is. The defaults have their reasons in docs/adjustment/installation.md.
macro_rules! widths {
    (@flight flight) => { true };
    (@flight laboratory) => { false };
    ($($(#[doc = $meaning:literal])+ $width:ident = $section:literal $key:literal, $unit:ident, $default:literal,
        max $max:literal, $where:ident, [$($unknown:ident),*];)+) => {
        /// Prior standard deviation that a key of `installation.toml` states. A value of 0 fixes the unknown.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Width {
            $($(#[doc = $meaning])+ $width),+
        }

        impl Width {
            /// Rows of all widths, in the order of the variants.
            pub const ROWS: &[WidthRow] = &[$(WidthRow {
                width: Self::$width,
                section: $section,
                key: $key,
                unit: $unit,
                default: $default,
                max: $max,
                of_flight: widths!(@flight $where),
                unknowns: &[$(Unknown::$unknown),*],
                meaning: concat!($($meaning),+),
            }),+];
        }
    };
}

widths! {
    /// standard deviation of that height, its mean along the span. Markers on the skin move inboard by height times slope
    /// when the wing bends
    SkinHeight = "wing" "skin_height_sigma_m", METRE, 0.1, max 5.0, laboratory, [AxisHeight];
    /// its standard deviation
    RootOffset = "wing" "root_offset_sigma_m", METRE, 0.3, max 5.0, laboratory, [RootOffset];
    /// its standard deviation
    ChordOffset = "wing" "axis_chord_offset_sigma_m", METRE, 0.3, max 5.0, laboratory, [ChordOffset];
    /// its standard deviation
    SpanDirection = "wing" "span_direction_sigma_deg", DEGREE, 1.0, max 20.0, laboratory, [SpanDirection];
    /// standard deviation of the sweep outboard of the breaks with `sweep_deg`
    Sweep = "wing" "sweep_sigma_deg", DEGREE, 1.0, max 20.0, laboratory, [Sweep];
    /// standard deviation of the projection centre's shift between two mountings. The largest contribution to a single
    /// frame's deflection
    MountShift = "camera" "mount_shift_m", METRE, 0.002, max 0.5, laboratory, [MountingShift];
    /// standard deviation of the rotation since the ground frame of a camera whose mounting is called `ground`
    StayTurn = "camera" "stay_turn_mrad", MILLIRADIAN, 0.2, max 100.0, laboratory, [];
    /// standard deviation of its shift. `wingd mount-check` with a ground frame after the flight proves smaller ones
    StayShift = "camera" "stay_shift_m", METRE, 1e-3, max 0.5, laboratory, [];
    /// standard deviation of the bending between survey and ground frame (fuel, jacks, sun), at the tip
    GroundBend = "survey" "bend_sigma_m", METRE, 0.010, max 5.0, flight, [GroundBend];
    /// standard deviation of the twist between survey and ground frame (fuel, jacks, sun), at the tip
    GroundTwist = "survey" "twist_sigma_deg", DEGREE, 0.15, max 20.0, flight, [GroundTwist];
    /// standard deviation of the rotation with the load of root and joints over the curvature of the root: the length inboard
    /// of the root that bends like the root
    RootFlexibility = "wing" "root_flexibility_sigma_m", METRE, 0.25, max 20.0, flight, [RootFlexibility, Joints];
    /// standard deviation of a bending offset common to all frames of a flight, independent of the load, at the tip
    ConstantBend = "wing" "constant_bend_sigma_m", METRE, 0.015, max 5.0, flight, [ConstantBend];
    /// standard deviation of the skin's motion along its normal at each marker in flight, constant over a flight's frames.
    /// The common motion of neighbouring markers is 2.5 times as large. A configured value is not estimated
    SkinMotion = "wing" "skin_motion_m", METRE, 3e-4, max 0.1, flight, [SkinMotion, SkinBulges];
    /// standard deviation of the root's rotation against the cabin since the ground frame, each axis
    RootRotation = "wing" "root_rotation_sigma_mrad", MILLIRADIAN, 0.5, max 100.0, flight, [RootRotation];
    /// standard deviation of the root's shift against the cabin since the ground frame, each axis
    RootTranslation = "wing" "root_translation_sigma_m", METRE, 1e-3, max 1.0, flight, [RootShift];
    /// standard deviation of the bending in the wing's plane, at the tip (0.9 of it common to a flight's frames, 0.436
    /// independent per frame)
    InPlane = "wing" "in_plane_sigma_m", METRE, 0.05, max 5.0, flight, [InPlane];
    /// relative standard deviation of the focal length in flight over the one on the ground: cold and focus
    FlightScale = "camera" "flight_scale_sigma", RATIO, 2e-4, max 0.1, flight, [FlightScale, Aspect];
    /// standard deviation of the principal point in flight against the one on the ground
    PrincipalPoint = "camera" "flight_principal_point_sigma_px", PIXEL, 0.3, max 1000.0, flight, [FlightPrincipalPoint];
    /// root mean square of a smooth field of image shifts along the wing between ground frame and flight: wavy panes, shocks
    /// and shimmer of a camera that was remounted
    RayField = "camera" "ray_field_px", PIXEL, 0.1, max 10.0, flight, [RayField];
    /// standard deviation of the image's shift from frame to frame by stabilisation of lens or sensor, each axis. 0: it has
    /// none, or it is switched off
    Stabilisation = "camera" "stabilised_px", PIXEL, 0.0, max 1000.0, flight, [ImageShift];
    /// standard deviation of the twist caused by a control surface's torque, at its position: four positions from 0.45 to
    /// 0.9 of the length (0.9 of it common to a flight's frames, 0.436 independent per frame)
    Torque = "wing" "torque_sigma_deg", DEGREE, 1.0, max 20.0, flight, [Torque];
    /// from the exposure of the first row to the last row's (rolling shutter), 0 for a global shutter. Positions refer
    /// to the time of the middle row
    Readout = "camera" "readout_s", SECOND, 0.03, max 1.0, flight, [WingVibration, CameraShake];
    /// standard deviation of the camera's rotation between two frames of one mounting
    MountDrift = "camera" "mount_drift_mrad", MILLIRADIAN, 0.05, max 100.0, laboratory, [MountingRotation];
    /// standard deviation of the survey's vertical about each horizontal axis. Deflections are measured along the vertical
    Vertical = "survey" "vertical_sigma_deg", DEGREE, 0.1, max 20.0, flight, [Vertical];
}

/// Length of the wing, from the root to the outermost marker, with an airliner's defaults, m.
const AIRLINER_REACH_M: f64 = 20.0;

impl WidthRow {
    /// Returns the default in radians, metres, pixels or seconds, for a wing of this length, m. Lengths of the wing
    /// itself, not of the camera, are smaller in proportion on wings that are shorter than an airliner's.
    pub fn default_for(&self, reach_m: f64) -> f64 {
        let follows = self.unit == METRE && self.section != "camera";
        let share = if follows {
            (reach_m / AIRLINER_REACH_M).clamp(0.0, 1.0)
        } else {
            1.0
        };
        share * self.unit.factor * self.default
    }
}

impl Width {
    /// Returns the row of the width in the registry.
    pub const fn row(self) -> &'static WidthRow {
        &Self::ROWS[self as usize]
    }

    /// Finds the width of a key in a section of `installation.toml`.
    pub fn from_key(section: &str, key: &str) -> Option<Self> {
        Self::ROWS
            .iter()
            .find(|row| row.section == section && row.key == key)
            .map(|row| row.width)
    }
}
