//! Serde tables of `installation.toml`, which are read and written. The keys of widths are in the registry
//! ([`Width`](wingd_measure::setup::Width)).

use serde::{Deserialize, Serialize};

use super::section::{Section, SectionTable};
use wingd_measure::plan::Optics;
use wingd_measure::setup::SkinHeight;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct InstallationDocument {
    pub name: Option<String>,
    pub camera: Section<CameraTable>,
    pub wing: Section<WingTable>,
    pub survey: Option<Section<SurveyTable>>,
    pub thermal: Option<ThermalTable>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub torsion: Vec<TorsionTable>,
    pub cad: Option<CadTable>,
    pub window: Option<WindowTable>,
    pub structure: Option<StructureTable>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraTable {
    pub calibration: String,
    #[serde(deserialize_with = "or_blank")]
    pub projection_centre_m: [f64; 3],
    pub projection_centre_sigma_m: Option<f64>,
    pub mount_repeatability_px: Option<f64>,
    pub optics: Option<Optics>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WingTable {
    pub survey: String,
    #[serde(deserialize_with = "or_blank")]
    pub span_direction: [f64; 2],
    pub flow_direction: Option<[f64; 2]>,
    pub side: Option<Side>,
    pub root_offset_m: f64,
    pub breaks: Option<Vec<BreakTable>>,
    pub axis_chord_offset_m: Option<f64>,
    pub skin_height_m: Option<SkinHeight>,
    pub vibration: Option<Vec<VibrationTable>>,
}

/// Table `[survey]`, whose keys are all widths.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SurveyTable {}

impl SectionTable for CameraTable {
    const NAME: &'static str = "camera";
}

impl SectionTable for WingTable {
    const NAME: &'static str = "wing";
}

impl SectionTable for SurveyTable {
    const NAME: &'static str = "survey";
}

/// Entry of `[wing] breaks`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BreakTable {
    pub span_m: f64,
    /// Change of the sweep outboard of it, aft positive.
    pub sweep_deg: Option<f64>,
}

/// Entry of `[wing] vibration`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct VibrationTable {
    pub frequency_hz: f64,
    pub amplitude_m: f64,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Side {
    Left,
    Right,
    /// Empty value of a template.
    #[serde(rename = "")]
    Blank,
}

/// Deserializes an array of numbers; `[]`, as in a template, yields NaN.
fn or_blank<'de, const N: usize, D: serde::Deserializer<'de>>(
    source: D,
) -> Result<[f64; N], D::Error> {
    let all = Vec::<f64>::deserialize(source)?;
    if all.is_empty() {
        return Ok([f64::NAN; N]);
    }
    let count = all.len();
    all.try_into().map_err(|_| {
        serde::de::Error::invalid_length(count, &format!("an array of length {N}").as_str())
    })
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ThermalTable {
    pub expansion_per_k: f64,
    pub expansion_sigma_per_k: Option<f64>,
    pub ground_temperature_c: f64,
    pub flight_temperature_c: f64,
    pub sigma_k: Option<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TorsionTable {
    pub name: String,
    pub leading: String,
    pub trailing: String,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CadTable {
    pub tie_points: String,
    pub unit: Option<String>,
    pub aft: Option<toml::Value>,
    pub up: Option<toml::Value>,
    pub sigma_m: Option<f64>,
    #[serde(default)]
    pub similarity: bool,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StructureTable {
    pub stiffness: String,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WindowTable {
    pub normal: Option<[f64; 3]>,
    pub cabin: Option<AirTable>,
    pub outside: Option<AirTable>,
    pub wavelength_nm: Option<f64>,
    pub thickness_m: Option<f64>,
    pub thickness_sigma_m: Option<f64>,
    pub index: Option<f64>,
    pub index_sigma: Option<f64>,
    pub normal_sigma_deg: Option<f64>,
    pub bow_radius_m: Option<f64>,
    pub bow_sigma: Option<f64>,
    pub distance_m: Option<f64>,
    pub same_on_ground: Option<bool>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AirTable {
    pub temperature_c: f64,
    pub pressure_hpa: f64,
    pub humidity: Option<f64>,
    pub co2_ppm: Option<f64>,
}
