//! Observations -> deflection: profile, spatial, flight; quality, variance components.

pub mod beam;
mod blocks;
mod budget;
mod common_displacement;
mod curve;
mod estimated;
#[cfg(test)]
mod example;
mod factors;
mod flight;
pub mod flight_prior;
pub mod ground;
mod input;
mod layout;
mod marker_state;
mod outcome;
pub mod profile;
mod scene;
mod shapes;
mod snooping;
mod spatial;
mod term;
mod terms;
mod values;

pub use super::estimation::{GlobalTest, SigmaKind, VarianceComponent};
pub use super::observation::{Estimate, Observation};
pub use flight::{Live, learn, solve as flight};
pub use profile::solve as profile;
pub use spatial::solve as spatial;

use std::sync::Arc;

use nalgebra::{DMatrix, Matrix3, Vector2, Vector3};
use serde::Serialize;

use self::flight_prior::FlightPrior;

use super::estimation::EstimationError;

/// A mounting of the camera: what is between two remounts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Mounting {
    /// That of the ground frames: the camera stayed, so its projection centre is where it was, and its rotation has
    /// drifted at most.
    OfTheGround,
    /// Another one; frames of one number are of one mounting.
    Numbered(usize),
}

/// Choices of an adjustment.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Which standard deviations are reported.
    pub sigma: SigmaKind,
    /// Terms of the curvature, 1 to 10; `None`: chosen by test.
    pub curvature_terms: Option<usize>,
    /// Terms of the twist.
    pub twist_terms: usize,
    /// Estimate variance components of image and survey (Koch 1986).
    pub variance_components: bool,
    /// Level of significance of the global test.
    pub global_alpha: f64,
    /// Level of significance of the w-test; 0 switches data snooping off.
    pub snooping_alpha: f64,
    /// The mounting's rotation against the ground frame's (camera frame, rad) with its covariance,
    /// where earlier frames of the same mounting tell it; `None`: the mount's repeatability.
    pub mount_prior: Option<(Vector3<f64>, Matrix3<f64>)>,
    /// The mounting of each frame, where the user or the recorder knows it; `None`: a flight looks for remounts in
    /// the frames themselves.
    pub mountings: Option<Vec<Mounting>>,
    /// What earlier flights of the installation told of all that lasts; the spatial methods take it.
    pub flight_prior: Option<Arc<FlightPrior>>,
}

impl Options {
    /// Whether the frame of a single adjustment was taken without a remount since the ground frames.
    fn is_of_the_ground(&self) -> bool {
        self.mountings.as_deref() == Some(&[Mounting::OfTheGround])
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
            mount_prior: None,
            mountings: None,
            flight_prior: None,
        }
    }
}

/// The method that gave a solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// The paper's (docs/model.md).
    Profile,
    /// The rigid-section beam .
    Spatial,
    /// Spatial, the frames of a flight together.
    Flight,
}

/// A named parameter of the model, with the unit in the name.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// As in the results, e.g. `a_per_m`, `curvature_per_m`.
    pub name: &'static str,
    /// One entry, or one per term.
    pub values: Vec<Estimate>,
}

/// What the adjustment says of one marker of the survey.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerSolution {
    /// Index in [`Setup::markers`].
    pub marker: usize,
    /// Whether its observation took part; if not, `reason`.
    pub used: bool,
    /// Why not, one sentence.
    pub reason: Option<String>,
    /// Residual (adjusted - observed), px; `None` without an observation.
    pub residual_px: Option<Vector2<f64>>,
    /// Redundancy numbers of u and v, 0 to 1.
    pub redundancy: Option<Vector2<f64>>,
    /// w-test statistic of the marker's observation.
    pub w_test: Option<f64>,
    /// Minimal detectable bias, px, (u, v).
    pub minimal_detectable_bias_px: Option<Vector2<f64>>,
    /// Minimal detectable bias of the surveyed position, m, wing frame's axes (X outboard, Y up);
    /// infinite where a bias cannot be seen at all.
    pub minimal_detectable_bias_m: Option<Vector3<f64>>,
    /// Distance from the projection centre, m (profile: d in the vertical plane).
    pub distance_m: Option<Estimate>,
    /// Survey frame, in flight, m.
    pub position_m: Option<Vector3<f64>>,
    /// Its covariance, m^2.
    pub covariance_m2: Option<Matrix3<f64>>,
    /// Vertical displacement against the survey, positive up, m; `None` for a fixed mark, too.
    pub deflection_m: Option<Estimate>,
    /// The same against the ground frame, m; `None` with the profile method, too.
    pub deflection_ground_m: Option<Estimate>,
    /// The same from the tangent of the root, which may have turned and moved since the ground frame, m.
    pub deflection_root_m: Option<Estimate>,
}

impl MarkerSolution {
    /// A marker without numbers.
    pub fn unused(marker: usize, reason: String) -> Self {
        Self {
            marker,
            used: false,
            reason: Some(reason),
            residual_px: None,
            redundancy: None,
            w_test: None,
            minimal_detectable_bias_px: None,
            minimal_detectable_bias_m: None,
            distance_m: None,
            position_m: None,
            covariance_m2: None,
            deflection_m: None,
            deflection_ground_m: None,
            deflection_root_m: None,
        }
    }
}

/// Against what a deflection is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Reference {
    /// The survey.
    Survey,
    /// The wing in the ground frame, which may have been bent since the survey.
    Ground,
    /// The root's tangent, which may have turned and moved since the ground frame.
    Root,
}

impl MarkerSolution {
    /// Its deflection against one of them, m.
    pub fn deflection_against(&self, reference: Reference) -> Option<Estimate> {
        match reference {
            Reference::Survey => self.deflection_m,
            Reference::Ground => self.deflection_ground_m,
            Reference::Root => self.deflection_root_m,
        }
    }
}

/// A source's part of the variance of the tip's deflection.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BudgetShare {
    /// In the field's words (docs/adjustment/standard-deviations.md).
    pub source: &'static str,
    /// 0 to 1; those of a budget add up to 1.
    pub share: f64,
    /// Standard deviation of the deflection if the source were known without error, m; `None` for observations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_if_known_m: Option<f64>,
}

/// What the variance of the tip's deflection comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct Budget {
    /// Whose deflection: index in [`Setup::markers`] of the outermost used marker.
    pub marker: usize,
    /// Which deflection: the one that is told best.
    pub reference: Reference,
    /// The largest share first.
    pub shares: Vec<BudgetShare>,
}

/// Torsion of one pair.
#[derive(Clone, Debug, PartialEq)]
pub struct Torsion {
    /// The pair's name.
    pub name: String,
    /// Change of the angle of attack as the paper computes it, nose up positive, rad.
    pub angle_rad: Option<Estimate>,
    /// Free of bending, rad; `None` with profile.
    pub twist_rad: Option<Estimate>,
}

/// A point of the deflection or twist curve along the span.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Arc length from the bending root, m.
    pub arc_length_m: f64,
    /// Wing-frame X, in flight, m.
    pub span_m: f64,
    /// Deflection of the bending axis, m.
    pub deflection_m: Estimate,
    /// Twist of the section, nose up positive, rad; `None` with profile.
    pub twist_rad: Option<Estimate>,
}

/// The outcome of an adjustment.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Which model.
    pub method: Method,
    /// A-posteriori variance factor; `None` at redundancy 0.
    pub variance_factor: Option<f64>,
    /// Conditions less parameters.
    pub redundancy: usize,
    /// Verdict on the variance factor.
    pub global_test: GlobalTest,
    /// True: the standard deviations here are a posteriori.
    pub posterior: bool,
    /// The model's parameters.
    pub parameters: Vec<Parameter>,
    /// Correlation of the parameters, in their order.
    pub correlation: DMatrix<f64>,
    /// Correlation of the mount's pitch with the amplitude of bending (spatial).
    pub pitch_bending_correlation: Option<f64>,
    /// One per marker of the survey, in its order.
    pub markers: Vec<MarkerSolution>,
    /// One per pair, in the installation's order.
    pub torsion: Vec<Torsion>,
    /// Curves along the span, root to tip.
    pub curve: Vec<CurvePoint>,
    /// What the variance of the tip's deflection comes from; `None` where no used marker has a deflection.
    pub budget: Option<Budget>,
    /// Where asked for.
    pub variance_components: Vec<VarianceComponent>,
    /// Remarks a person should read (rejected markers, order chosen, weak separation).
    pub remarks: Vec<String>,
    /// Iterations until convergence.
    pub iterations: usize,
}

/// Why no solution was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AdjustError {
    /// Fewer observations than unknowns.
    #[error("{found} markers identified, at least {needed} are needed for this method")]
    TooFewMarkers {
        /// At hand.
        found: usize,
        /// Needed.
        needed: usize,
    },
    /// The observations determine no solution.
    #[error(transparent)]
    Estimation(#[from] EstimationError),
    /// A pixel has no ray, or a number is not finite.
    #[error("{0}")]
    Input(String),
}
