//! Configuration of an aircraft as numbers: camera, survey, wing. The installation reads it from disk.

use nalgebra::{Rotation3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::geometry::{Lens, WingFrame};
use super::observation::Observation;
use super::raster::Raster;
pub use super::uncertainty::{SetupUncertainty, Vibration};
pub use super::widths::Width;
use crate::ordering::sort_by_value;

/// Kind of marker (docs/detection.md).
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    Hash,
    PartialOrd,
    Ord,
    serde::Serialize,
    serde::Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Shape {
    /// Four alternating quadrants, near the fuselage.
    #[default]
    Quadrant,
    /// Black disc, seen as a flat ellipse near the tip.
    Circle,
    /// Salient structure without a decal, such as the corner of a panel: found by matching a patch of the ground frame.
    Point,
}

impl Shape {
    /// Returns the word for this kind in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quadrant => "quadrant",
            Self::Circle => "circle",
            Self::Point => "point",
        }
    }
}

/// A marker as surveyed on the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct SurveyMarker {
    /// Identifier, unique in the survey.
    pub id: String,
    /// Kind of marker.
    pub shape: Shape,
    /// Outer diameter, m; of a point [`POINT_EXTENT_M`].
    pub diameter_m: f64,
    /// Centre on the ground, survey frame, m.
    pub position_m: Vector3<f64>,
    /// Standard deviation of each coordinate, m.
    pub sigma_m: f64,
    /// Whether it is a fixed target, rigid to the cabin instead of the wing: it determines the camera's rotation and shift
    /// in every frame.
    pub fixed: bool,
    /// Standard deviation of a fixed target's motion in flight by cabin pressure and cold, each coordinate, m.
    pub flight_motion_m: f64,
    /// Control surface or other moving part that carries the marker (`aileron`, `flap`); `None`: the wing itself.
    pub part: Option<String>,
}

/// Diameter of the neighbourhood that stands for a point in drawings and predicted outlines, m. It is not measured: chosen
/// as the length of a typical salient structure.
pub const POINT_EXTENT_M: f64 = 0.1;

/// Patch of a ground frame around a point, which is searched for in frames in flight.
#[derive(Clone, Debug, PartialEq)]
pub struct PointTemplate {
    /// Index in [`Setup::markers`].
    pub marker: usize,
    /// Grey values of the patch.
    pub patch: Raster,
    /// Column and row of the patch's first pixel in the ground frame, px.
    pub origin_px: [usize; 2],
    /// Image of the point in the ground frame, px. It defines the point: [`Orientation::ground`] has its covariance.
    pub place_px: Vector2<f64>,
}

impl PointTemplate {
    /// Returns whether the point is at the middle of the patch, to a pixel.
    pub fn is_centred(&self) -> bool {
        let origin = Vector2::new(self.origin_px[0] as f64, self.origin_px[1] as f64);
        let middle = Vector2::new(self.patch.width() as f64, self.patch.height() as f64)
            .add_scalar(-1.0)
            * 0.5;
        (self.place_px - origin - middle).amax() <= 0.5
    }
}

/// Typical fixed target, for planning and rendering.
pub mod fixed_target {
    /// Positions in the frame, over its width and height: the corners, clear of most wings.
    pub const POSITIONS: [(f64, f64); 4] = [(0.07, 0.09), (0.93, 0.09), (0.07, 0.91), (0.93, 0.91)];
    /// Distance from the camera, m: a fairing or the fuselage next to the window is rarely farther.
    pub const DISTANCE_M: f64 = 3.0;
    /// Diameter, m: about 150 px at that distance.
    pub const DIAMETER_M: f64 = 0.06;
    /// Standard deviation of the motion in flight at that distance, each axis, m: cabin pressure and cold move a cabin by
    /// tenths of a millimetre over metres.
    pub const FLIGHT_MOTION_M: f64 = 5e-4;

    /// Returns the standard deviation of the motion in flight, each axis, m, of a target at this distance from the camera, m:
    /// a strained cabin moves in proportion to the distance.
    pub fn flight_motion_m(distance_m: f64) -> f64 {
        FLIGHT_MOTION_M * (distance_m / DISTANCE_M).max(1.0)
    }
}

/// Height of the skin above the bending axis, linear along the span, as in `wing.skin_height_m`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkinHeight {
    /// Height at the bending root, m.
    #[serde(rename = "root")]
    pub root_m: f64,
    /// Height at `tip_span_m`, m.
    #[serde(rename = "tip")]
    pub tip_m: f64,
    /// Span from the bending root to the point of `tip_m`, m.
    pub tip_span_m: f64,
}

/// Uniform thermal expansion between ground and flight.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Thermal {
    /// Linear coefficient of expansion, 1/K.
    pub expansion_per_k: f64,
    pub expansion_sigma_per_k: Option<f64>,
    /// Temperature of the wing at the survey, degrees Celsius.
    pub ground_temperature_c: f64,
    /// Temperature of the wing in flight, degrees Celsius.
    pub flight_temperature_c: f64,
    pub flight_temperature_sigma_k: Option<f64>,
}

impl Thermal {
    /// Returns the length in flight over the length on the ground.
    pub fn scale(&self) -> f64 {
        1.0 + self.expansion_per_k * (self.flight_temperature_c - self.ground_temperature_c)
    }

    /// Returns the standard deviation of [`Self::scale`].
    pub fn scale_sigma(&self) -> f64 {
        let difference = self.flight_temperature_c - self.ground_temperature_c;
        let coefficient = self.expansion_sigma_per_k.unwrap_or(0.0) * difference;
        let temperature = self.flight_temperature_sigma_k.unwrap_or(0.0) * self.expansion_per_k;
        coefficient.hypot(temperature)
    }
}

/// Largest number of breaks of the dihedral: a gull wing with a winglet has two, one more remains.
pub const MAX_BREAKS: usize = 3;

/// Place at which the bending axis breaks: the survey decides by how much in elevation, the user in plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WingBreak {
    /// Span from the projection centre, m.
    pub span_m: f64,
    /// Change of the sweep outboard of it, positive aft, rad; `None`: not configured.
    pub sweep_rad: Option<f64>,
}

/// Default standard deviation of the image shift between two mountings, px (paper, section 3.1.3).
pub const DEFAULT_REPEATABILITY_PX: f64 = 10.0;

/// Standard deviation of the length in flight over that on the ground if nothing is configured: the effect of 70 K on
/// aluminium.
pub const DEFAULT_SCALE_SIGMA: f64 = 23.1e-6 * 70.0;

/// Two markers whose deflections give the change of the angle of attack (paper, section 4.3).
#[derive(Clone, Debug, PartialEq)]
pub struct TorsionPair {
    /// Name given by the user.
    pub name: String,
    /// Index in [`Setup::markers`] of the marker near the leading edge.
    pub leading: usize,
    /// Index in [`Setup::markers`] of the marker near the trailing edge.
    pub trailing: usize,
}

/// State of the air on one side of the window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Air {
    /// Temperature, degrees Celsius.
    pub temperature_c: f64,
    pub pressure_hpa: f64,
    /// Relative humidity, 0 to 1.
    pub humidity: f64,
    /// Carbon dioxide, micromole per mole.
    pub co2_ppm: f64,
}

/// The window's panes as one plate (docs/model.md), with the normal of the window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pane {
    /// Thickness of all panes together, without the air between them, m.
    pub thickness_m: f64,
    pub thickness_sigma_m: f64,
    /// Refractive index relative to air.
    pub index: f64,
    pub index_sigma: f64,
    /// Standard deviation of the normal about each of two axes, rad.
    pub normal_sigma_rad: f64,
    /// Radius of the inner face under pressure, in flight only, positive if it bulges outwards, m; `None`: plane.
    pub bow_radius_m: Option<f64>,
    /// Relative standard deviation of the bow's curvature; for panes taken as plane, relative to the default (1/30 m).
    pub bow_sigma: f64,
    /// Distance from the projection centre to the inner face, m; used only with a bow.
    pub distance_m: f64,
    /// Whether the ground frames were taken through the same panes.
    pub same_on_ground: bool,
}

/// The cabin window (docs/model.md).
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// Outward normal, survey frame, unit length; refraction is applied only if it is given.
    pub normal: Option<Vector3<f64>>,
    /// Air in the cabin in flight.
    pub cabin: Air,
    /// Air outside in flight.
    pub outside: Air,
    /// Wavelength in vacuum, nm.
    pub wavelength_nm: f64,
    /// Panes, if `normal` is given; `None`: part of the calibration.
    pub pane: Option<Pane>,
}

/// Section of the wing with known stiffness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StiffnessSection {
    /// Position along the bending axis from the bending root, m.
    pub s_m: f64,
    /// Bending stiffness, N m^2.
    pub ei_n_m2: f64,
    /// Standard deviation of the stiffness, N m^2.
    pub sigma_ei_n_m2: f64,
}

/// Configuration of an aircraft: everything known before the flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Name of the installation.
    pub name: String,
    /// Interior orientation.
    pub lens: Lens,
    /// Projection centre, survey frame, m.
    pub projection_centre_m: Vector3<f64>,
    /// Standard deviation of each coordinate of the projection centre, m.
    pub projection_centre_sigma_m: f64,
    /// Standard deviation of the image shift between two mountings, px.
    pub mount_repeatability_px: f64,
    /// Horizontal span direction, survey frame, outboard; any length.
    pub span_direction: Vector2<f64>,
    /// Horizontal direction of the flow (aft), survey frame, any length; `None` if unknown.
    pub flow_direction: Option<Vector2<f64>>,
    /// Configured side of the wing; see [`Setup::side`].
    pub configured_side: Option<WingSide>,
    /// Span from the projection centre to the start of the bending, m.
    pub root_offset_m: f64,
    /// Configured breaks of the bending axis; the survey finds further ones of the dihedral.
    pub breaks: Vec<WingBreak>,
    /// Z of the bending axis in the wing frame, m; the markers' mean if not given.
    pub axis_chord_offset_m: Option<f64>,
    /// Height of the skin above the bending axis; 0 if not given.
    pub skin_height: Option<SkinHeight>,
    /// Prior standard deviations.
    pub uncertainty: SetupUncertainty,
    pub thermal: Option<Thermal>,
    /// Pairs of markers for torsion.
    pub torsion: Vec<TorsionPair>,
    /// Surveyed markers, in the file's order.
    pub markers: Vec<SurveyMarker>,
    /// Window, for refraction and the panes' shift.
    pub window: Option<Window>,
}

/// Side of the wing: the wing frame's Z points aft on a right wing and forward on a left one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WingSide {
    /// Port.
    Left,
    /// Starboard.
    Right,
}

/// Sine of the smallest angle from the window's normal to the span that identifies a wing as swept back: 5 degrees, more
/// than the likely errors of both directions.
const MIN_SWEEP_SINE: f64 = 0.087;

impl Setup {
    /// Returns the side of the wing, on which a twist's sign depends: as configured, or else from the first torsion pair,
    /// or else from the sweep of the span relative to the window's normal. Returns `None` if none is available: a wing's
    /// shape alone equals that of its mirror image.
    pub fn side(&self) -> Option<WingSide> {
        self.configured_side
            .or_else(|| self.side_from_pair(self.torsion.first()?))
            .or_else(|| self.side_from_sweep())
    }

    /// Returns the side of the wing from the leading and trailing markers of a pair.
    pub fn side_from_pair(&self, pair: &TorsionPair) -> Option<WingSide> {
        let z = |k: usize| {
            Some(
                self.wing_frame()
                    .wing_point(&self.markers.get(k)?.position_m)
                    .z,
            )
        };
        let aft = z(pair.trailing)? - z(pair.leading)?;
        (aft != 0.0).then_some(if aft > 0.0 {
            WingSide::Right
        } else {
            WingSide::Left
        })
    }

    /// Returns the sign of Z of the wing frame towards the tail: 1 on a right wing, and if the side is unknown.
    pub fn aft_sign(&self) -> f64 {
        if self.side() == Some(WingSide::Left) {
            -1.0
        } else {
            1.0
        }
    }

    /// Returns the configured changes of the sweep: span from the projection centre, m, and angle towards Z of the wing frame, rad.
    pub fn sweeps(&self) -> impl Iterator<Item = (f64, f64)> {
        let aft = self.aft_sign();
        self.breaks
            .iter()
            .filter_map(move |one| Some((one.span_m, aft * one.sweep_rad?)))
    }

    /// Returns the distance of the swept axis at a span from that inboard of all configured breaks, along Z of the wing frame, m.
    pub fn swept_m(&self, span_m: f64) -> f64 {
        self.sweeps()
            .map(|(from_m, sweep_rad)| sweep_rad.tan() * (span_m - from_m).max(0.0))
            .sum()
    }

    fn side_from_sweep(&self) -> Option<WingSide> {
        let normal = self.window.as_ref()?.normal?.xy().try_normalize(1e-6)?;
        let span = self.span_direction.try_normalize(0.0)?;
        // Seen from above, a right wing's sweep turns clockwise.
        let turn = normal.perp(&span);
        (turn.abs() > MIN_SWEEP_SINE && normal.dot(&span) > 0.0).then_some(if turn < 0.0 {
            WingSide::Right
        } else {
            WingSide::Left
        })
    }

    /// Returns the markers on the wing, in the survey's order: index in [`Setup::markers`] and position in the wing frame,
    /// m.
    pub fn wing_markers(&self) -> Vec<(usize, Vector3<f64>)> {
        let frame = self.wing_frame();
        let wing = self.markers.iter().enumerate().filter(|(_, m)| !m.fixed);
        wing.map(|(k, m)| (k, frame.wing_point(&m.position_m)))
            .collect()
    }

    /// Returns whether a marker of the survey is a point without a decal.
    pub fn is_point(&self, marker: usize) -> bool {
        self.markers
            .get(marker)
            .is_some_and(|m| m.shape == Shape::Point)
    }

    /// Returns the span from the bending root to the outermost marker on the wing, m; 0 without one.
    pub fn reach_m(&self) -> f64 {
        self.wing_markers()
            .iter()
            .fold(0.0, |reach: f64, (_, point)| {
                reach.max(point.x - self.root_offset_m)
            })
    }

    /// Returns whether the lens is below the inner third of the markers on the wing, as on a high wing or in a survey whose
    /// z points down.
    pub fn is_lens_below_wing(&self) -> bool {
        let mut points: Vec<Vector3<f64>> = self
            .wing_markers()
            .into_iter()
            .map(|(_, point)| point)
            .collect();
        sort_by_value(&mut points, |one| one.x);
        points
            .iter()
            .take(points.len().div_ceil(3))
            .map(|p| p.y)
            .sum::<f64>()
            > 0.0
    }

    /// Returns the frame of the adjustment: X outboard, Y up, Z = X x Y, origin in the projection centre.
    pub fn wing_frame(&self) -> WingFrame {
        WingFrame::new(self.projection_centre_m, self.span_direction)
    }
}

/// Attitude of the camera from ground frames, with its covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct Orientation {
    /// Rotation from the survey frame to the camera frame.
    pub camera_from_survey: Rotation3<f64>,
    /// Covariance of the small rotation in the **camera** frame, rad^2 (left perturbation: `exp([e]x) *
    /// camera_from_survey`); `None` if the file has none.
    pub covariance_rad2: Option<nalgebra::Matrix3<f64>>,
    /// Observations of the ground frames. They determine the errors of the survey and the image of the unbent wing to a
    /// fraction of a pixel, which separates the mount's pitch from bending. Empty if only the rotation is known.
    pub ground: Vec<Observation>,
    /// Patches of the ground frames around points, which frames in flight are matched to.
    pub templates: Vec<PointTemplate>,
}

/// Minimum number of points for a wing's surface: two for each of the seven coefficients of its cubic along the span,
/// chordwise slopes and crown.
const MIN_SURFACE_POINTS: usize = 14;

impl Orientation {
    /// Creates an orientation of which only the rotation is known.
    pub fn from_rotation(camera_from_survey: Rotation3<f64>) -> Self {
        Self {
            camera_from_survey,
            covariance_rad2: None,
            ground: Vec::new(),
            templates: Vec::new(),
        }
    }

    /// Returns for each marker of the survey whether it may shape the wing's surface: the markers that ground frames
    /// showed. Other points cannot be checked; if hardly any marker was observed, all may.
    pub fn shaping_markers(&self, markers: usize) -> Vec<bool> {
        let mut seen = vec![false; markers];
        self.ground.iter().for_each(|observation| {
            seen.get_mut(observation.marker)
                .into_iter()
                .for_each(|s| *s = true)
        });
        if seen.iter().filter(|s| **s).count() < MIN_SURFACE_POINTS {
            seen.fill(true);
        }
        seen
    }
}
