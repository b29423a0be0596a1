//! `installation.toml` as serde sees it.

use serde::Deserialize;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Document {
    pub name: Option<String>,
    pub camera: Camera,
    pub wing: Wing,
    pub survey: Option<Survey>,
    pub thermal: Option<Thermal>,
    #[serde(default)]
    pub torsion: Vec<Torsion>,
    pub cad: Option<Cad>,
    pub window: Option<Window>,
    pub structure: Option<Structure>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Camera {
    pub calibration: String,
    #[serde(deserialize_with = "or_blank")]
    pub projection_centre_m: [f64; 3],
    pub projection_centre_sigma_m: Option<f64>,
    pub mount_repeatability_px: Option<f64>,
    pub mount_shift_m: Option<f64>,
    pub mount_drift_mrad: Option<f64>,
    pub flight_scale_sigma: Option<f64>,
    pub flight_principal_point_sigma_px: Option<f64>,
    pub readout_s: Option<f64>,
    pub optics: Option<Optics>,
}

/// The lens and sensor as bought, for depth of field and diffraction.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optics {
    /// Focal length, mm.
    pub focal_length_mm: f64,
    /// Aperture number.
    pub f_number: f64,
    /// Distance of pixel centres, micrometres.
    pub pixel_pitch_um: f64,
    /// Circle of confusion, micrometres; two pixels where not given.
    pub circle_of_confusion_um: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Wing {
    pub survey: String,
    #[serde(deserialize_with = "or_blank")]
    pub span_direction: [f64; 2],
    pub side: Option<Side>,
    pub root_offset_m: f64,
    pub root_offset_sigma_m: Option<f64>,
    pub axis_chord_offset_m: Option<f64>,
    pub axis_chord_offset_sigma_m: Option<f64>,
    pub span_direction_sigma_deg: Option<f64>,
    pub skin_height_m: Option<Skin>,
    pub skin_height_sigma_m: Option<f64>,
    pub skin_motion_m: Option<f64>,
    pub root_rotation_sigma_mrad: Option<f64>,
    pub root_translation_sigma_m: Option<f64>,
    pub constant_bend_sigma_m: Option<f64>,
    pub in_plane_sigma_m: Option<f64>,
    pub torque_sigma_deg: Option<f64>,
    pub vibration: Option<Vec<Vibrating>>,
}

/// `[survey]`.
#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(super) struct Survey {
    pub bend_sigma_m: Option<f64>,
    pub vertical_sigma_deg: Option<f64>,
}

/// One of `[wing] vibration`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Vibrating {
    pub frequency_hz: f64,
    pub amplitude_m: f64,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Side {
    Left,
    Right,
    /// As in a template that is to be filled in.
    #[serde(rename = "")]
    Blank,
}

/// Numbers, or `[]` as in a template that is to be filled in: then none is a number.
fn or_blank<'de, const N: usize, D: serde::Deserializer<'de>>(source: D) -> Result<[f64; N], D::Error> {
    let all = Vec::<f64>::deserialize(source)?;
    if all.is_empty() {
        return Ok([f64::NAN; N]);
    }
    let count = all.len();
    all.try_into()
        .map_err(|_| serde::de::Error::invalid_length(count, &format!("an array of length {N}").as_str()))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Skin {
    pub root: f64,
    pub tip: f64,
    pub tip_span_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Thermal {
    pub expansion_per_k: f64,
    pub expansion_sigma_per_k: Option<f64>,
    pub ground_temperature_c: f64,
    pub flight_temperature_c: f64,
    pub flight_temperature_sigma_k: Option<f64>,
    pub sigma_k: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Torsion {
    pub name: String,
    pub leading: String,
    pub trailing: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Cad {
    pub tie_points: String,
    pub sigma_m: Option<f64>,
    #[serde(default)]
    pub similarity: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Structure {
    pub stiffness: String,
    pub bending_hz: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Window {
    pub normal: Option<[f64; 3]>,
    pub cabin: Option<Air>,
    pub outside: Option<Air>,
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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Air {
    pub temperature_c: f64,
    pub pressure_hpa: f64,
    pub humidity: Option<f64>,
    pub co2_ppm: Option<f64>,
}
