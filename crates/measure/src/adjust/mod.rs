//! Adjustment: estimates the deflection from image observations with the profile, spatial and flight methods; includes
//! quality measures and variance components.

pub mod beam;
mod blocks;
mod budget;
pub(crate) mod causes;
mod common_displacement;
mod curve;
mod estimated_dimensions;
#[cfg(test)]
#[path = "tests/example.rs"]
mod example;
mod flight;
pub mod flight_prior;
pub mod ground;
mod image_line;
mod input;
mod joint_shape;
mod layout;
pub(crate) mod marker_arm;
mod marker_state;
mod outcome;
mod prior_scales;
pub mod profile;
mod scene;
mod shape_mean;
mod shape_solving;
mod shapes;
mod snooping;
mod term;
mod terms;
mod values;

pub use super::estimation::{GlobalTest, SigmaKind, VarianceComponent};
pub use super::observation::{Estimate, Observation};
pub use flight::{LiveAdjustment, learn_from_flight, solve_flight, solve_spatial};
pub use joint_shape::{
    FrameShape, JointShape, STATION_FUNCTIONS, StationChoice, principal_sources,
};
pub use profile::solve_profile;
pub use shape_solving::{solve_flight_shape, solve_frame_shape};

use std::borrow::Cow;
use std::sync::Arc;

use nalgebra::{DMatrix, Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use self::flight_prior::FlightPrior;

use super::estimation::EstimationError;

/// Mounting of the camera: the period between two remounts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Mounting {
    /// Mounting of the ground frames: the camera was not remounted, so the projection centre is unchanged and the rotation
    /// has only drifted.
    Ground,
    /// Another mounting; frames with the same number share it.
    Numbered(usize),
}

/// Options of an adjustment.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Kind of standard deviations to report.
    pub sigma: SigmaKind,
    /// Number of curvature terms, 1 to 10; `None`: 10 in single frames, as a break of the stiffness by 60 % needs for
    /// honest moments, and 8 in flights.
    pub curvature_terms: Option<usize>,
    /// Number of twist terms.
    pub twist_terms: usize,
    /// Estimate variance components of image and survey (Koch 1986).
    pub variance_components: bool,
    /// Level of significance of the global test.
    pub global_alpha: f64,
    /// Level of significance of the w-test; 0 switches data snooping off.
    pub snooping_alpha: f64,
    /// Mounting of each frame, if the user or the recorder knows it; `None`: the flight method detects remounts from the
    /// frames.
    pub mountings: Option<Vec<Mounting>>,
    /// Prior for the flight-invariant parameters from earlier flights of the installation, used by the spatial methods.
    pub flight_prior: Option<Arc<FlightPrior>>,
}

impl Options {
    /// Returns the options for some of the frames.
    fn for_frames(&self, frames: &[usize]) -> Self {
        let chosen =
            |all: &Vec<Mounting>| frames.iter().filter_map(|k| all.get(*k)).copied().collect();
        Self {
            mountings: self.mountings.as_ref().map(chosen),
            ..self.clone()
        }
    }

    /// Returns the number of curvature terms of a single frame or a flight.
    fn count_curvature_terms(&self, is_flight: bool) -> usize {
        let (least, usual) = if is_flight { (2, 8) } else { (1, 10) };
        let terms = self.curvature_terms.unwrap_or(usual);
        terms.clamp(least, beam::MAX_CURVATURE_TERMS)
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            sigma: SigmaKind::ByTest,
            curvature_terms: None,
            twist_terms: 5,
            variance_components: false,
            global_alpha: 0.01,
            snooping_alpha: 0.001,
            mountings: None,
            flight_prior: None,
        }
    }
}

/// Deflection model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AdjustmentMethod {
    /// Method of the paper (docs/model.md): a parabola in the vertical plane.
    Profile,
    /// Beam of rigid sections in space.
    Spatial,
}

/// Kind of a parameter of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterKind {
    /// Coefficient of the parabola, 1/m.
    Parabola,
    /// Curvature, 1/m per term.
    Curvature,
    /// Twist, rad per term.
    Twist,
    /// Rotation of the camera since the ground frames, rad about three axes.
    MountRotation,
    /// Mean height of the bending axis above its nominal position, m.
    AxisRaise,
    /// Departure of the frames' shapes from their mean, as a fraction.
    ShapeDeparture,
    /// Drift of the mount between frames, rad.
    MountDrift,
}

impl ParameterKind {
    /// Returns the name, with the unit.
    pub fn name(self) -> &'static str {
        match self {
            Self::Parabola => "a_per_m",
            Self::Curvature => "curvature_per_m",
            Self::Twist => "twist_rad",
            Self::MountRotation => "mount_rotation_rad",
            Self::AxisRaise => "axis_raise_m",
            Self::ShapeDeparture => "shape_departure",
            Self::MountDrift => "mount_drift_rad",
        }
    }
}

/// Parameter of the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    pub kind: ParameterKind,
    /// Values: one, or one per term.
    pub values: Vec<Estimate>,
}

/// Result of one marker of the survey. One that was not used has the position and the deflections that the adjusted shape
/// predicts, unless its survey was rejected.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MarkerSolution {
    /// Index in [`Setup::markers`].
    pub marker: usize,
    /// True if the marker's observation was used; if not, see `reason`.
    pub used: bool,
    /// Reason for not using the observation, one sentence.
    pub reason: Option<String>,
    /// Residual (adjusted minus observed), px; `None` without an observation.
    pub residual_px: Option<Vector2<f64>>,
    /// Redundancy numbers of u and v, 0 to 1.
    pub redundancy: Option<Vector2<f64>>,
    /// Statistic of the w-test of the marker's observation.
    pub w_test: Option<f64>,
    /// Minimal detectable bias of the image coordinates (u, v), px.
    pub minimal_detectable_bias_px: Option<Vector2<f64>>,
    /// Minimal detectable bias of the surveyed position, m, along the wing frame's axes (X outboard, Y up); infinite if a
    /// bias is not detectable.
    pub minimal_detectable_bias_m: Option<Vector3<f64>>,
    /// Distance from the projection centre, m (profile method: d in the vertical plane).
    pub distance_m: Option<Estimate>,
    /// Position in flight, survey frame, m.
    pub position_m: Option<Vector3<f64>>,
    /// Covariance of the position, survey frame, m^2.
    pub covariance_m2: Option<Matrix3<f64>>,
    /// Vertical displacement relative to the survey, positive up, m; `None` for a fixed target.
    pub deflection_m: Option<Estimate>,
    /// Vertical displacement relative to the ground frame, m; `None` for a fixed target and with the profile method.
    pub deflection_ground_m: Option<Estimate>,
    /// Vertical displacement relative to the root tangent, which may have rotated and moved since the ground frame, m; `None` if
    /// the images ask for a larger rotation of the root, which they do not separate from the root's flexibility.
    pub deflection_root_m: Option<Estimate>,
}

impl MarkerSolution {
    /// Creates the result of a marker that was not used.
    pub fn unused(marker: usize, reason: String) -> Self {
        Self {
            marker,
            reason: Some(reason),
            ..Self::default()
        }
    }
}

/// Reference of a deflection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DeflectionReference {
    /// Surveyed shape.
    #[default]
    Survey,
    /// Shape in the ground frame, which may be bent relative to the survey.
    Ground,
    /// Tangent of the root, which may have rotated and moved since the ground frame.
    Root,
}

/// Ratio of standard deviations below which another reference replaces the survey. A difference below 1 % is invisible in
/// two significant digits.
const PREFERENCE_RATIO: f64 = 0.99;

impl DeflectionReference {
    /// References in order of preference if their standard deviations are equal.
    pub const ALL: [Self; 3] = [Self::Survey, Self::Ground, Self::Root];

    /// Returns the reference in words, for a caption.
    pub fn description(self) -> &'static str {
        match self {
            Self::Survey => "against the survey",
            Self::Ground => "against the ground frame",
            Self::Root => "from the root's tangent",
        }
    }

    /// Selects the reference with the smallest standard deviation. An earlier one of [`Self::ALL`] is preferred unless the
    /// standard deviation of a later one is smaller by more than 1 %.
    pub fn most_precise(sigma: impl Fn(Self) -> Option<f64>) -> Self {
        let better = |best: Self, other: Self| {
            let smaller = sigma(other)
                .zip(sigma(best))
                .is_some_and(|(other, best)| other < PREFERENCE_RATIO * best);
            if smaller { other } else { best }
        };
        Self::ALL.into_iter().reduce(better).unwrap_or_default()
    }
}

impl MarkerSolution {
    /// Deflection of the marker relative to `reference`, m.
    pub fn deflection_against(&self, reference: DeflectionReference) -> Option<Estimate> {
        match reference {
            DeflectionReference::Survey => self.deflection_m,
            DeflectionReference::Ground => self.deflection_ground_m,
            DeflectionReference::Root => self.deflection_root_m,
        }
    }
}

/// Contribution of one source to the variance of the tip deflection.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VarianceShare {
    /// Name of the source (docs/adjustment/standard-deviations.md).
    pub source: Cow<'static, str>,
    /// Fraction of the variance, 0 to 1; the shares of a budget add up to 1.
    pub share: f64,
    /// Standard deviation of the deflection if the source had no error, m; `None` for observations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_if_known_m: Option<f64>,
}

/// Sources of the variance of the tip deflection.
#[derive(Clone, Debug, PartialEq)]
pub struct VarianceBudget {
    /// Index in [`Setup::markers`] of the outermost marker with a deflection, measured or predicted, whose deflection this is.
    pub marker: usize,
    /// Reference of the deflection: the one with the smallest standard deviation.
    pub reference: DeflectionReference,
    /// Shares, the largest first.
    pub shares: Vec<VarianceShare>,
}

/// Torsion measured by one marker pair.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PairTorsion {
    pub name: String,
    /// Change of the angle of attack as defined in the paper, nose up positive, rad.
    pub angle_rad: Option<Estimate>,
    /// Change of the slope along the span, tip up positive, rad; `None` with the profile method.
    pub slope_rad: Option<Estimate>,
    /// Twist without the effect of bending, rad; `None` with the profile method.
    pub twist_rad: Option<Estimate>,
    /// Change of the incidence in the flow's vertical plane, nose up positive, rad; `None` if the direction of the flow or the
    /// side of the wing is unknown.
    pub streamwise_twist_rad: Option<Estimate>,
}

/// A point of the deflection or twist curve along the span.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Arc length from the bending root, m.
    pub arc_length_m: f64,
    /// Wing-frame X in flight, m.
    pub span_m: f64,
    /// Deflection of the bending axis relative to the survey, m.
    pub deflection_m: Estimate,
    /// Deflection relative to the ground frame and to the root's tangent, m; `None` with the profile method.
    pub other_deflections_m: Option<[Option<Estimate>; 2]>,
    /// Change of the slope along the span, tip up positive, rad; `None` with the profile method.
    pub slope_rad: Option<Estimate>,
    /// Twist of the section, nose up positive, rad; `None` with the profile method.
    pub twist_rad: Option<Estimate>,
    /// Change of the incidence in the flow's vertical plane, nose up positive, rad; `None` if the direction of the flow or the
    /// side of the wing is unknown.
    pub streamwise_twist_rad: Option<Estimate>,
}

/// Result of an adjustment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Solution {
    /// A-posteriori variance factor; `None` at redundancy 0.
    pub variance_factor: Option<f64>,
    /// Number of conditions minus number of parameters.
    pub redundancy: usize,
    /// Result of the global test of the variance factor; `None` at redundancy 0.
    pub global_test: Option<GlobalTest>,
    /// True if the standard deviations are a posteriori.
    pub posterior: bool,
    pub parameters: Vec<Parameter>,
    /// Correlation matrix of the parameters, in their order.
    pub correlation: DMatrix<f64>,
    /// Correlation of the mount's pitch with the bending amplitude (spatial methods).
    pub pitch_bending_correlation: Option<f64>,
    /// Results of the markers, one per marker of the survey, in its order.
    pub markers: Vec<MarkerSolution>,
    /// Torsion, one per pair, in the installation's order.
    pub torsion: Vec<PairTorsion>,
    /// Curves along the span, from root to tip.
    pub curve: Vec<CurvePoint>,
    /// Length of the bending axis from the root to the tip of the model, m; 0 with the profile method.
    pub axis_length_m: f64,
    /// Uncertainty budget of the tip deflection; `None` if no used marker has a deflection.
    pub budget: Option<VarianceBudget>,
    /// Variance components, if requested.
    pub variance_components: Vec<VarianceComponent>,
    /// Significant causes that the solution counts with, one sentence each; also among the remarks.
    pub counted_causes: Vec<String>,
    /// Reason why the result may not be used although it is adjusted, one sentence: significant causes leave it open.
    pub doubt: Option<String>,
    /// Remarks for the reader (rejected markers, chosen order, poor separability).
    pub remarks: Vec<String>,
    pub iterations: usize,
}

/// Result of a step of an adjustment.
pub type AdjustResult<T> = Result<T, AdjustError>;

/// Reason for a failed adjustment.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AdjustError {
    /// Fewer observations than unknowns.
    #[error("{found} markers identified, at least {needed} are needed for this method")]
    TooFewMarkers { found: usize, needed: usize },
    /// The observations do not determine a solution.
    #[error(transparent)]
    Estimation(#[from] EstimationError),
    /// A pixel without a ray, or a number that is not finite.
    #[error("{0}")]
    Input(String),
}
