//! The result of one image, as written to disk and to standard output (docs/interface.md).

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

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

/// A value with its standard deviation, in the unit that the field's name bears.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// `null` for a parameter that was held fixed.
    pub sigma: Option<f64>,
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
    /// `profile` or `spatial`.
    pub method: String,
    /// True where the frames of a flight were adjusted together.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub flight: bool,
    /// A-posteriori variance factor.
    pub variance_factor: Option<f64>,
    /// Conditions less parameters.
    pub redundancy: Option<usize>,
    /// `passed`, `rejected` or `null`.
    pub global_test: Option<String>,
    /// `prior` or `posterior`.
    pub sigma_kind: Option<String>,
    /// The model's parameters; name -> value with sigma, or a list of them.
    pub model: Map<String, Value>,
    /// The outermost marker.
    pub tip: Option<Tip>,
    /// Every marker of the survey.
    pub markers: Vec<MarkerRecord>,
    /// Every pair of the installation.
    pub torsion: Vec<TorsionRecord>,
    /// Deflection and twist along the span.
    #[serde(default)]
    pub curve: Vec<CurveRecord>,
    /// Correlations, variance components, refraction and the like.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub quality: Map<String, Value>,
    /// What a person should read.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
    /// Hashes of frame, camera, survey, orientation; program version; parameters.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub provenance: Map<String, Value>,
    /// Stages and their durations, ms.
    pub timing_ms: Map<String, Value>,
}

impl ImageRecord {
    /// An image without numbers, and the sentence that says what to do.
    pub fn failed(image: &str, method: &str, reason: impl Into<String>) -> Self {
        Self { image: image.into(), method: method.into(), reason: Some(reason.into()), ..Self::default() }
    }
}

/// Lift of the outermost used marker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tip {
    /// Its id.
    pub marker: String,
    /// m, positive up.
    pub lift_m: f64,
    /// m.
    pub sigma_lift_m: Option<f64>,
}

/// One marker of the survey in one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MarkerRecord {
    /// Survey id.
    pub id: String,
    /// `quadrant` or `circle`.
    pub shape: String,
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
    pub lift_m: Option<f64>,
    /// m.
    pub sigma_lift_m: Option<f64>,
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
    /// Lift of the bending axis, m.
    pub lift_m: f64,
    /// m.
    pub sigma_lift_m: Option<f64>,
    /// degrees.
    pub twist_deg: Option<f64>,
    /// degrees.
    pub sigma_twist_deg: Option<f64>,
}
