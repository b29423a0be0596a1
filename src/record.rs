//! The result of one image, as written to disk and to standard output (docs/interface.md).
//!
//! The fields stand in the order in which they are written, and their names are the keys. What is new of a marker gets
//! its field in [`MarkerRecord`], of the tip in [`Tip`], a parameter in [`Model`], and what says how good the adjustment
//! is in [`Quality`]; an `Option` that is left out where it is `None` keeps the records of older programs readable.

mod deflection;
mod model;
mod provenance;
mod quality;
mod reason;

use serde::{Deserialize, Serialize};

pub use crate::measure::setup::Shape;
pub use deflection::{BudgetShare, Reference, Tip};
pub use model::{Measured, Model, Term};
pub use provenance::{Parameters, Provenance, Timing};
pub use quality::{CadFit, Correlation, Panes, Quality, VarianceComponent};
pub use reason::Reason;

/// Whether an image could be solved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// All numbers are there.
    Ok,
    /// `reason` says what to do.
    #[default]
    Failed,
}

/// How the deflection is modelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// The published method: a parabola in the vertical plane.
    Profile,
    /// A beam of rigid sections in space.
    Spatial,
    /// The frame never came to be solved; an empty word is written.
    #[default]
    #[serde(rename = "")]
    None,
}

/// Verdict of the global test, where there is redundancy to test.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GlobalTest {
    /// The variance factor is compatible with 1.
    Passed,
    /// It is not.
    Rejected,
}

/// Which standard deviations a result has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SigmaKind {
    /// From the observations' own standard deviations.
    Prior,
    /// Scaled by the root of the variance factor.
    Posterior,
}

/// The word that an enum of unit variants is written as.
pub fn word(value: impl Serialize) -> String {
    serde_json::to_value(value).ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default()
}

/// One image's result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ImageRecord {
    /// File name of the frame.
    pub image: String,
    /// Solved or not.
    pub status: Status,
    /// One sentence that says what to do; with `failed` only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// How it was solved.
    pub method: Method,
    /// True where the frames of a flight were adjusted together.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub flight: bool,
    /// A-posteriori variance factor.
    pub variance_factor: Option<f64>,
    /// Conditions less parameters.
    pub redundancy: Option<usize>,
    /// `None` where there is no redundancy.
    pub global_test: Option<GlobalTest>,
    /// `None` without a solution.
    pub sigma_kind: Option<SigmaKind>,
    /// The model's parameters.
    pub model: Model,
    /// The outermost marker.
    pub tip: Option<Tip>,
    /// What the variance of the tip's deflection comes from (of the one that [`Tip::shown`] names), the largest share first;
    /// empty in results of older programs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub budget: Vec<BudgetShare>,
    /// Every marker of the survey.
    pub markers: Vec<MarkerRecord>,
    /// Every pair of the installation.
    pub torsion: Vec<TorsionRecord>,
    /// Deflection and twist along the span.
    #[serde(default)]
    pub curve: Vec<CurveRecord>,
    /// Correlations, variance components, refraction and the like.
    #[serde(default, skip_serializing_if = "Quality::is_empty")]
    pub quality: Quality,
    /// What a person should read.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
    /// Hashes of frame, camera, survey, orientation; program version; parameters.
    #[serde(default, skip_serializing_if = "Provenance::is_empty")]
    pub provenance: Provenance,
    /// What each stage took, ms.
    pub timing_ms: Timing,
}

impl ImageRecord {
    /// An image without numbers, and the sentence that says what to do.
    pub fn failed(image: &str, method: Method, reason: impl Into<String>) -> Self {
        Self { image: image.into(), method, reason: Some(reason.into()), ..Self::default() }
    }

    /// Whether it has numbers.
    pub fn is_solved(&self) -> bool {
        self.status == Status::Ok
    }

    /// Markers that took part in the adjustment.
    pub fn used(&self) -> usize {
        self.markers.iter().filter(|m| m.used).count()
    }
}

/// One marker of the survey in one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MarkerRecord {
    /// Survey id.
    pub id: String,
    /// Which kind of target.
    pub shape: Shape,
    /// Image of the centre, px.
    pub u_px: Option<f64>,
    /// Image of the centre, px.
    pub v_px: Option<f64>,
    /// px.
    pub sigma_u_px: Option<f64>,
    /// px.
    pub sigma_v_px: Option<f64>,
    /// Took part in the adjustment.
    pub used: bool,
    /// Its place is a person's, not the detector's.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub manual: bool,
    /// Why it did not, one sentence.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Adjusted - observed, px.
    pub residual_u_px: Option<f64>,
    /// Adjusted - observed, px.
    pub residual_v_px: Option<f64>,
    /// Redundancy number of u, 0 to 1.
    pub redundancy_u: Option<f64>,
    /// Redundancy number of v, 0 to 1.
    pub redundancy_v: Option<f64>,
    /// w-test statistic.
    pub w_test: Option<f64>,
    /// Minimal detectable bias of u, px.
    pub mdb_u_px: Option<f64>,
    /// Minimal detectable bias of v, px.
    pub mdb_v_px: Option<f64>,
    /// From the projection centre, m (profile: in the vertical plane).
    pub distance_m: Option<f64>,
    /// m.
    pub sigma_distance_m: Option<f64>,
    /// Survey frame, in flight, m.
    pub position_m: Option<[f64; 3]>,
    /// m.
    pub sigma_position_m: Option<[f64; 3]>,
    /// CAD frame, in flight, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_cad_m: Option<[f64; 3]>,
    /// m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_position_cad_m: Option<[f64; 3]>,
    /// Vertical, against the survey, positive up, m.
    pub deflection_m: Option<f64>,
    /// m.
    pub sigma_deflection_m: Option<f64>,
    /// The same against the ground frame, m; `None` with the profile method and in results of older programs.
    pub deflection_ground_m: Option<f64>,
    /// m.
    pub sigma_deflection_ground_m: Option<f64>,
    /// The same from the root's tangent, m.
    pub deflection_root_m: Option<f64>,
    /// m.
    pub sigma_deflection_root_m: Option<f64>,
}

/// Torsion of one pair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TorsionRecord {
    /// The pair's name.
    pub name: String,
    /// Change of the angle of attack as the paper computes it, nose up positive, degrees.
    pub angle_deg: Option<f64>,
    /// degrees.
    pub sigma_deg: Option<f64>,
    /// Free of bending, degrees.
    pub twist_deg: Option<f64>,
    /// degrees.
    pub sigma_twist_deg: Option<f64>,
}

/// A point of the curves along the span.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurveRecord {
    /// From the bending root, m.
    pub arc_length_m: f64,
    /// Wing-frame X in flight, m.
    pub span_m: f64,
    /// Deflection of the bending axis, m.
    pub deflection_m: f64,
    /// m.
    pub sigma_deflection_m: Option<f64>,
    /// degrees.
    pub twist_deg: Option<f64>,
    /// degrees.
    pub sigma_twist_deg: Option<f64>,
}
