//! What a user prepares once per aircraft, as numbers: camera, survey, wing. Read from disk by
//! the installation.

use nalgebra::{Rotation3, SMatrix, Vector2, Vector3};

pub use super::flight_effects::{FlightEffectPriors, Vibration};
use super::geometry::{Lens, WingFrame};

/// The two kinds of marker (docs/model.md).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shape {
    /// Four alternating quadrants, near the fuselage.
    Quadrant,
    /// A black disc, seen as a flat ellipse near the tip.
    Circle,
}

impl Shape {
    /// The word used in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quadrant => "quadrant",
            Self::Circle => "circle",
        }
    }
}

/// A marker as the tachymeter found it on ground.
#[derive(Clone, Debug, PartialEq)]
pub struct SurveyMarker {
    /// Unique in the survey.
    pub id: String,
    /// Kind of target.
    pub shape: Shape,
    /// Outer diameter, m.
    pub diameter_m: f64,
    /// Centre on ground, survey frame, m.
    pub position_m: Vector3<f64>,
    /// Standard deviation of each coordinate, m.
    pub sigma_m: f64,
    /// Rigid to the cabin, not to the wing: tells the camera's rotation and shift in every frame.
    pub fixed: bool,
    /// How far a fixed mark moves in flight, standard deviation of each coordinate, m: cabin pressure and cold.
    pub flight_motion_m: f64,
    /// Moving part of the wing that it sits on (`aileron`, `flap`); `None`: the wing itself.
    pub part: Option<String>,
}

/// A usual fixed mark, where nobody has put one up yet: planned and drawn.
pub mod fixed_mark {
    /// Places in the frame, over its width and height: the corners, clear of most wings.
    pub const PLACES: [(f64, f64); 4] = [(0.07, 0.09), (0.93, 0.09), (0.07, 0.91), (0.93, 0.91)];
    /// From the camera, m: a fairing or the fuselage beside the window is rarely farther.
    pub const DISTANCE_M: f64 = 3.0;
    /// Some 150 px at that distance, m.
    pub const DIAMETER_M: f64 = 0.06;
    /// How far it moves in flight, each axis, m: a cabin under pressure and cold moves by tenths of a millimetre over metres.
    pub const FLIGHT_MOTION_M: f64 = 5e-4;
}

/// Height of the skin above the bending axis, linear along the span.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkinHeight {
    /// At the bending root, m.
    pub root_m: f64,
    /// At `tip_span_m`, m.
    pub tip_m: f64,
    /// Span from the bending root to where `tip_m` holds, m.
    pub tip_span_m: f64,
}

/// Uniform expansion between ground and flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thermal {
    /// Linear coefficient of expansion, 1/K.
    pub expansion_per_k: f64,
    /// Standard deviation of the coefficient, 1/K.
    pub expansion_sigma_per_k: Option<f64>,
    /// Wing's temperature at the survey, degrees Celsius.
    pub ground_temperature_c: f64,
    /// Wing's temperature in flight, degrees Celsius.
    pub flight_temperature_c: f64,
    /// Standard deviation of the flight temperature, K.
    pub flight_temperature_sigma_k: Option<f64>,
}

impl Thermal {
    /// Length in flight over length on ground.
    pub fn scale(&self) -> f64 {
        1.0 + self.expansion_per_k * (self.flight_temperature_c - self.ground_temperature_c)
    }

    /// Its standard deviation.
    pub fn scale_sigma(&self) -> f64 {
        let difference = self.flight_temperature_c - self.ground_temperature_c;
        let coefficient = self.expansion_sigma_per_k.unwrap_or(0.0) * difference;
        let temperature = self.flight_temperature_sigma_k.unwrap_or(0.0) * self.expansion_per_k;
        coefficient.hypot(temperature)
    }
}

/// Standard deviation of the length in flight over that on ground where nothing is stated: all of what 70 K do to aluminium.
pub const UNSTATED_SCALE_SIGMA: f64 = 23.1e-6 * 70.0;

/// Two markers whose deflections give the change of the angle of attack (paper, section 4.3).
#[derive(Clone, Debug, PartialEq)]
pub struct TorsionPair {
    /// The user's word for it.
    pub name: String,
    /// Index in [`Setup::markers`] of the one near the leading edge.
    pub leading: usize,
    /// Index in [`Setup::markers`] of the one near the trailing edge.
    pub trailing: usize,
}

/// A point known in the survey frame and in the CAD model's.
#[derive(Clone, Debug, PartialEq)]
pub struct TiePoint {
    /// Unique among the tie points.
    pub id: String,
    /// Survey frame, m.
    pub survey_m: Vector3<f64>,
    /// Aircraft (CAD) frame, m.
    pub cad_m: Vector3<f64>,
    /// Standard deviation of each survey coordinate, m.
    pub sigma_m: f64,
}

/// State of the air on one side of the window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Air {
    /// Degrees Celsius.
    pub temperature_c: f64,
    /// Hectopascal.
    pub pressure_hpa: f64,
    /// Relative humidity, 0 to 1.
    pub humidity: f64,
    /// Carbon dioxide, micromole per mole.
    pub co2_ppm: f64,
}

/// The window's panes as one plate (docs/model.md); its normal is the window's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pane {
    /// Of all panes together, without the air between them, m.
    pub thickness_m: f64,
    /// Standard deviation, m.
    pub thickness_sigma_m: f64,
    /// Refractive index against air.
    pub index: f64,
    /// Standard deviation.
    pub index_sigma: f64,
    /// Standard deviation of the normal about each of two axes, rad.
    pub normal_sigma_rad: f64,
    /// Radius of the inner face under pressure, in flight only, positive where it bulges outwards, m; `None`: plane.
    pub bow_radius_m: Option<f64>,
    /// Standard deviation of the bow's curvature as a share of it; of panes taken as plane, of the usual one (1/30 m).
    pub bow_sigma: f64,
    /// From the projection centre to the inner face, m; only a bow asks for it.
    pub distance_m: f64,
    /// Whether the ground frames were seen through it too.
    pub same_on_ground: bool,
}

/// The cabin window (docs/model.md).
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// Outward normal, survey frame, unit length; refraction is applied only where it is given.
    pub normal: Option<Vector3<f64>>,
    /// Air in the cabin in flight.
    pub cabin: Air,
    /// Air outside in flight.
    pub outside: Air,
    /// Wavelength in vacuum, nm.
    pub wavelength_nm: f64,
    /// Its panes, with `normal` given; `None`: part of the calibration.
    pub pane: Option<Pane>,
}

/// How far off may be what a user can only estimate, as standard deviations. 0: held as stated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uncertainty {
    /// Shift of the projection centre between two mountings, each axis, m.
    pub mount_shift_m: f64,
    /// Rotation of the camera between two frames of one mounting, each axis, rad.
    pub mount_drift_rad: f64,
    /// Height of the skin above the bending axis, along the span, m.
    pub skin_height_sigma_m: f64,
    /// Where bending starts, along the span, m.
    pub root_offset_m: f64,
    /// Place of the bending axis along the chord, m.
    pub axis_chord_offset_m: f64,
    /// Direction of the span about the vertical, rad.
    pub span_direction_rad: f64,
    /// What an aircraft in flight does to wing, cabin and camera.
    pub in_flight: FlightEffectPriors,
    /// Covariance of fx, fy, cx, cy, k1, k2, k3, p1, p2 as the calibration states it; `None`: held.
    pub lens: Option<SMatrix<f64, 9, 9>>,
}

impl Default for Uncertainty {
    /// What holds where an installation says nothing (docs/adjustment/installation.md has the reasons).
    fn default() -> Self {
        Self {
            mount_shift_m: 0.002,
            mount_drift_rad: 5e-5,
            skin_height_sigma_m: 0.1,
            root_offset_m: 0.3,
            axis_chord_offset_m: 0.3,
            span_direction_rad: 1f64.to_radians(),
            in_flight: FlightEffectPriors::DEFAULT,
            lens: None,
        }
    }
}

impl Uncertainty {
    /// Drawings that are right to some millimetres, a mount that neither shifts nor creeps: rendered scenes.
    pub const fn of_drawings() -> Self {
        Self {
            mount_shift_m: 0.0,
            mount_drift_rad: 0.0,
            skin_height_sigma_m: 0.003,
            root_offset_m: 0.0,
            axis_chord_offset_m: 0.0,
            span_direction_rad: 0.0,
            in_flight: FlightEffectPriors::NONE,
            lens: None,
        }
    }
}

/// Everything known before the flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// The user's name of the installation.
    pub name: String,
    /// Interior orientation.
    pub lens: Lens,
    /// Projection centre, survey frame, m.
    pub projection_centre_m: Vector3<f64>,
    /// Standard deviation of each of its coordinates, m.
    pub projection_centre_sigma_m: f64,
    /// Shift of the image between two mountings, standard deviation, px.
    pub mount_repeatability_px: f64,
    /// Horizontal span direction, survey frame, outboard; any length.
    pub span_direction: Vector2<f64>,
    /// Which wing, where the user says it; see [`Setup::side`].
    pub stated_side: Option<Side>,
    /// Along the span from the projection centre to where bending starts, m.
    pub root_offset_m: f64,
    /// Z of the bending axis in the wing frame, m; the markers' mean where not given.
    pub axis_chord_offset_m: Option<f64>,
    /// Skin above the bending axis; 0 where not given.
    pub skin_height: Option<SkinHeight>,
    /// How far off what the user states may be.
    pub uncertainty: Uncertainty,
    /// Thermal expansion.
    pub thermal: Option<Thermal>,
    /// Pairs for torsion.
    pub torsion: Vec<TorsionPair>,
    /// The survey, in the file's order.
    pub markers: Vec<SurveyMarker>,
    /// CAD tie points; empty where there is no CAD model.
    pub tie_points: Vec<TiePoint>,
    /// Whether the CAD transform may scale.
    pub cad_similarity: bool,
    /// The window, for refraction and the panes' shift.
    pub window: Option<Window>,
}

/// Which wing is looked at: on a right one the wing frame's Z points aft, on a left one forward.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Port.
    Left,
    /// Starboard.
    Right,
}

/// Least angle from the window's normal to the span for a wing that is swept back, sine: 5 degrees, beyond which
/// neither direction is likely to be off.
const SWEPT: f64 = 0.087;

impl Setup {
    /// Which wing, which is what a twist's sign hangs on: as stated, else by the first torsion pair, else by the sweep
    /// of the span against the window's normal. `None` where nothing tells: a wing's shape alone looks like its mirror
    /// image.
    pub fn side(&self) -> Option<Side> {
        self.stated_side.or_else(|| self.side_of_pair(self.torsion.first()?)).or_else(|| self.side_by_sweep())
    }

    /// Which wing a pair is on, by its names.
    pub fn side_of_pair(&self, pair: &TorsionPair) -> Option<Side> {
        let z = |k: usize| Some(self.wing_frame().wing_point(&self.markers.get(k)?.position_m).z);
        let aft = z(pair.trailing)? - z(pair.leading)?;
        (aft != 0.0).then_some(if aft > 0.0 { Side::Right } else { Side::Left })
    }

    fn side_by_sweep(&self) -> Option<Side> {
        let normal = self.window.as_ref()?.normal?.xy().try_normalize(1e-6)?;
        let span = self.span_direction.try_normalize(0.0)?;
        // Seen from above, a right wing's sweep turns clockwise.
        let turn = normal.perp(&span);
        (turn.abs() > SWEPT && normal.dot(&span) > 0.0).then_some(if turn < 0.0 {
            Side::Right
        } else {
            Side::Left
        })
    }

    /// The markers on the wing, in the survey's order: wing frame, m, with their indices in [`Setup::markers`].
    pub fn on_the_wing(&self) -> Vec<(usize, Vector3<f64>)> {
        let frame = self.wing_frame();
        let wing = self.markers.iter().enumerate().filter(|(_, m)| !m.fixed);
        wing.map(|(k, m)| (k, frame.wing_point(&m.position_m))).collect()
    }

    /// The frame of the adjustment: X outboard, Y up, Z = X x Y, origin in the projection centre.
    pub fn wing_frame(&self) -> WingFrame {
        WingFrame::new(self.projection_centre_m, self.span_direction)
    }
}

/// The camera's attitude, from a ground frame; `camera_from_survey` with its standard deviations.
#[derive(Clone, Debug, PartialEq)]
pub struct Orientation {
    /// Rotates survey-frame directions into the camera frame.
    pub camera_from_survey: Rotation3<f64>,
    /// Covariance of the small rotation in the **camera** frame, rad^2 (left perturbation:
    /// `exp([e]x) * camera_from_survey`); `None` where the file states none.
    pub covariance_rad2: Option<nalgebra::Matrix3<f64>>,
    /// Where the ground frames showed the markers. The survey's errors and the wing's unbent image
    /// are then known to a fraction of a pixel, which parts the mount's pitch from bending; empty
    /// where only the rotation is known.
    pub ground: Vec<GroundObservation>,
}

/// Fewer points than this leave a wing's surface open, whose cubic along the span, chordwise slopes and crown have seven
/// coefficients: two for each.
const SURFACE_POINTS: usize = 14;

impl Orientation {
    /// Per marker of the survey, whether it may shape the wing's surface: one that the ground frames showed. A point
    /// that nobody saw has nothing to check it; where hardly any was seen, all may.
    pub fn may_shape(&self, markers: usize) -> Vec<bool> {
        let mut seen = vec![false; markers];
        self.ground.iter().for_each(|sight| seen.get_mut(sight.marker).into_iter().for_each(|s| *s = true));
        if seen.iter().filter(|s| **s).count() < SURFACE_POINTS {
            seen.fill(true);
        }
        seen
    }
}

/// The image of one marker's centre on ground, perspective bias removed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundObservation {
    /// Index in [`Setup::markers`].
    pub marker: usize,
    /// px, the mean where there are several frames.
    pub pixel: Vector2<f64>,
    /// Its covariance, px^2.
    pub covariance_px2: nalgebra::Matrix2<f64>,
}

impl GroundObservation {
    /// One per marker that was seen, of those below `markers`: the mean of its sights, weighted by their covariances.
    pub fn means(markers: usize, sights: impl IntoIterator<Item = Self>) -> Vec<Self> {
        let mut sums = vec![(nalgebra::Matrix2::zeros(), Vector2::zeros()); markers];
        for sight in sights {
            let weight = sight.covariance_px2.try_inverse();
            if let (Some(weight), Some(sum)) = (weight, sums.get_mut(sight.marker)) {
                sum.0 += weight;
                sum.1 += weight * sight.pixel;
            }
        }
        let mean = |(marker, (weight, sum)): (usize, (nalgebra::Matrix2<f64>, Vector2<f64>))| {
            let covariance_px2 = weight.try_inverse()?;
            Some(Self { marker, pixel: covariance_px2 * sum, covariance_px2 })
        };
        sums.into_iter().enumerate().filter_map(mean).collect()
    }
}
