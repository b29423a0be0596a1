//! Result of one image, as written to disk and to standard output (docs/reference/results.md).
//!
//! Fields are declared in the order in which they are written, and their names are the JSON keys. Add a new value of a
//! marker to [`MarkerRecord`], of the tip to [`Tip`], a new parameter to [`Model`], and a quality figure to [`Quality`]; an
//! `Option` that is omitted if it is `None` keeps the records of older programs readable.

mod deflection;
mod model;
mod provenance;
mod quality;
mod reason;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

pub use deflection::Tip;
pub use model::{Model, Term};
pub use provenance::{Parameters, Provenance, Timing};
pub use quality::{CadFit, Correlation, Panes, Quality};
pub use reason::Reason;
pub use wingd_measure::adjust::Estimate;
pub use wingd_measure::adjust::VarianceComponent;
pub use wingd_measure::adjust::{AdjustmentMethod, DeflectionReference, VarianceShare};
pub use wingd_measure::adjust::{GlobalTest, SigmaKind};
pub use wingd_measure::setup::Shape;

/// Status of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RecordStatus {
    /// The image is solved, and the result may be used: all numbers are present.
    Ok,
    /// The image is adjusted, but the result is implausible or a cause leaves it open: `reason` says why.
    Doubtful,
    /// The image is not solved: `reason` says what to do.
    #[default]
    Failed,
}

/// Serialization of a method: an empty string for none.
mod blank_method {
    use serde::de::IntoDeserializer;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use wingd_measure::adjust::AdjustmentMethod;

    /// Writes the method, or an empty string.
    pub fn serialize<S: Serializer>(
        method: &Option<AdjustmentMethod>,
        output: S,
    ) -> Result<S::Ok, S::Error> {
        match method {
            Some(method) => method.serialize(output),
            None => output.serialize_str(""),
        }
    }

    /// Reads a method as written by [`serialize`].
    pub fn deserialize<'de, D: Deserializer<'de>>(
        input: D,
    ) -> Result<Option<AdjustmentMethod>, D::Error> {
        let word = String::deserialize(input)?;
        (!word.is_empty())
            .then(|| AdjustmentMethod::deserialize(word.into_deserializer()))
            .transpose()
    }
}

/// Formats a JSON value; strings without quotes.
pub fn json_text(value: &Value) -> String {
    value
        .as_str()
        .map_or_else(|| value.to_string(), str::to_owned)
}

/// Returns the JSON fields of a part of a record; empty if it is not an object.
pub fn json_fields(part: &impl Serialize) -> Map<String, Value> {
    match serde_json::to_value(part) {
        Ok(Value::Object(map)) => map,
        _ => Map::new(),
    }
}

/// Returns the string that an enum of unit variants is serialized as.
pub fn variant_name(value: impl Serialize) -> String {
    serde_json::to_value(value)
        .ok()
        .and_then(|value| value.as_str().map(str::to_owned))
        .unwrap_or_default()
}

/// Result of one image.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ImageRecord {
    /// File name of the frame.
    pub image: String,
    /// Status: solved, doubtful or failed.
    pub status: RecordStatus,
    /// Sentence that says what to do; not with `ok`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Cause of a failed or doubtful result, and remedy.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause: Option<String>,
    /// A cause counts.
    #[serde(skip)]
    pub counted: bool,
    /// Deflection model that was used; `None` for a frame that was never solved, written as an empty string.
    #[serde(with = "blank_method")]
    pub method: Option<AdjustmentMethod>,
    /// True if the frames of a flight were adjusted jointly.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub flight: bool,
    /// A-posteriori variance factor.
    pub variance_factor: Option<f64>,
    /// Number of conditions minus number of parameters.
    pub redundancy: Option<usize>,
    /// Verdict of the global test; `None` without redundancy.
    pub global_test: Option<GlobalTest>,
    /// Kind of the standard deviations; `None` without a solution.
    pub sigma_kind: Option<SigmaKind>,
    /// Model parameters.
    pub model: Model,
    /// Deflection of the outermost marker, measured or predicted.
    pub tip: Option<Tip>,
    /// Uncertainty budget of the tip's deflection relative to [`Tip::reference`], largest contribution first; empty in results
    /// of older programs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub budget: Vec<VarianceShare>,
    /// Results of the survey's markers.
    pub markers: Vec<MarkerRecord>,
    /// Torsion of the installation's pairs.
    pub torsion: Vec<TorsionRecord>,
    /// Deflection and twist along the span.
    #[serde(default)]
    pub curve: Vec<CurveRecord>,
    /// Bending moments at the sections of `[structure]`; empty without one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub moments: Vec<MomentRecord>,
    /// Correlations, variance components, refraction and the like.
    #[serde(default, skip_serializing_if = "Quality::is_empty")]
    pub quality: Quality,
    /// Remarks for the reader.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub remarks: Vec<String>,
    /// Hashes of frame, camera, survey and orientation; program version; parameters.
    #[serde(default, skip_serializing_if = "Provenance::is_empty")]
    pub provenance: Provenance,
    /// Duration of each stage, ms.
    pub timing_ms: Timing,
}

impl ImageRecord {
    /// Creates the record of an image without numbers, with the sentence that says what to do.
    pub fn failed(image: &str, reason: impl Into<String>) -> Self {
        Self {
            image: image.into(),
            reason: Some(reason.into()),
            ..Self::default()
        }
    }

    /// Returns whether the image is solved and the result may be used.
    pub fn is_solved(&self) -> bool {
        self.status == RecordStatus::Ok
    }

    /// Counts the markers that took part in the adjustment.
    pub fn used_count(&self) -> usize {
        self.markers.iter().filter(|m| m.used).count()
    }
}

/// Result of one survey marker in one image.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MarkerRecord {
    pub id: String,
    /// Kind of target.
    pub shape: Shape,
    /// Image of the centre, px.
    pub u_px: Option<f64>,
    pub v_px: Option<f64>,
    pub sigma_u_px: Option<f64>,
    pub sigma_v_px: Option<f64>,
    /// True if the marker took part in the adjustment.
    pub used: bool,
    /// True if the numbers are predicted by the adjusted shape, since the marker was not used.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub predicted: bool,
    /// True if a person marked the position.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub manual: bool,
    /// Sentence that says why the marker was not used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Adjusted minus observed, px.
    pub residual_u_px: Option<f64>,
    pub residual_v_px: Option<f64>,
    /// Redundancy number of u, 0 to 1.
    pub redundancy_u: Option<f64>,
    pub redundancy_v: Option<f64>,
    /// Statistic of the w-test.
    pub w_test: Option<f64>,
    /// Minimal detectable bias of u, px.
    pub mdb_u_px: Option<f64>,
    pub mdb_v_px: Option<f64>,
    /// Distance from the projection centre, m (profile method: in the vertical plane).
    pub distance_m: Option<f64>,
    pub sigma_distance_m: Option<f64>,
    /// Position in flight in the survey frame, m.
    pub position_m: Option<[f64; 3]>,
    pub sigma_position_m: Option<[f64; 3]>,
    /// Position in flight in the CAD frame, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_cad_m: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_position_cad_m: Option<[f64; 3]>,
    /// Vertical deflection relative to the survey, positive up, m.
    pub deflection_m: Option<f64>,
    pub sigma_deflection_m: Option<f64>,
    /// Vertical deflection relative to the ground frame, m; `None` with the profile method and in results of older
    /// programs.
    pub deflection_ground_m: Option<f64>,
    pub sigma_deflection_ground_m: Option<f64>,
    /// Vertical deflection relative to the root's tangent, m.
    pub deflection_root_m: Option<f64>,
    pub sigma_deflection_root_m: Option<f64>,
}

/// Torsion of one pair of markers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TorsionRecord {
    /// Name of the pair.
    pub name: String,
    /// Change of the angle of attack as defined in the paper, nose up positive, degrees.
    pub angle_deg: Option<f64>,
    pub sigma_deg: Option<f64>,
    /// Twist without the contribution of bending, degrees.
    pub twist_deg: Option<f64>,
    pub sigma_twist_deg: Option<f64>,
    #[serde(flatten)]
    pub incidence: IncidenceRecord,
}

/// Point of the curves along the span.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CurveRecord {
    /// Arc length from the bending root, m.
    pub arc_length_m: f64,
    /// X coordinate of the wing frame in flight, m.
    pub span_m: f64,
    /// Deflection of the bending axis relative to the survey, m.
    pub deflection_m: f64,
    pub sigma_deflection_m: Option<f64>,
    /// Deflection relative to the ground frame, m; `None` with the profile method and in results of older programs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deflection_ground_m: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_deflection_ground_m: Option<f64>,
    /// Deflection relative to the root's tangent, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub deflection_root_m: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_deflection_root_m: Option<f64>,
    /// Twist, degrees.
    pub twist_deg: Option<f64>,
    pub sigma_twist_deg: Option<f64>,
    #[serde(flatten)]
    pub incidence: IncidenceRecord,
}

/// Bending moment at a section, as the change relative to the ground; positive if it bends the tip up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MomentRecord {
    /// Arc length from the bending root, m.
    pub arc_length_m: f64,
    /// Moment, N m; `None` if the curvature has no standard deviation.
    pub bending_moment_nm: Option<f64>,
    pub sigma_bending_moment_nm: Option<f64>,
    /// Part of the standard deviation due to the stiffness, N m; common to all frames.
    pub sigma_stiffness_nm: Option<f64>,
}

/// Rotations of a section against the survey; `None` with the profile method and in results of older programs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct IncidenceRecord {
    /// Change of the slope along the span, tip up positive, degrees.
    pub slope_deg: Option<f64>,
    pub sigma_slope_deg: Option<f64>,
    /// Change of the incidence in the vertical plane of the flow, nose up positive, degrees; `None` without
    /// `wing.flow_direction`.
    pub streamwise_twist_deg: Option<f64>,
    pub sigma_streamwise_twist_deg: Option<f64>,
}
