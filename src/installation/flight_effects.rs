//! Priors of the effects of flight on wing, cabin and camera, from `installation.toml` ([`FlightEffectPriors`]).

use std::path::Path;

use super::Reader;
use super::tables::{InstallationDocument, VibrationTable};
use crate::measure::setup::{FlightEffectPriors, Vibration};

/// Largest time between the readout of a sensor's first and last row, s.
const MAX_READOUT_S: f64 = 1.0;

/// Returns the configured priors, or the defaults. Several modes count as one: the squares of their velocities are added.
pub(super) fn flight_effect_priors(document: &InstallationDocument) -> FlightEffectPriors {
    let (survey, camera, wing, defaults) =
        (document.survey.as_ref(), &document.camera, &document.wing, FlightEffectPriors::DEFAULT);
    let milli = |value: Option<f64>, defaults: f64| value.map_or(defaults, |v| 1e-3 * v);
    FlightEffectPriors {
        ground_bend_m: survey.and_then(|s| s.bend_sigma_m).unwrap_or(defaults.ground_bend_m),
        vertical_rad: survey.and_then(|s| s.vertical_sigma_deg).map_or(defaults.vertical_rad, f64::to_radians),
        skin_motion_m: wing.skin_motion_m.unwrap_or(defaults.skin_motion_m),
        skin_scaled_by_frames: wing.skin_motion_m.is_none(),
        root_rotation_rad: milli(wing.root_rotation_sigma_mrad, defaults.root_rotation_rad),
        root_translation_m: wing.root_translation_sigma_m.unwrap_or(defaults.root_translation_m),
        constant_bend_m: wing.constant_bend_sigma_m.unwrap_or(defaults.constant_bend_m),
        in_plane_m: wing.in_plane_sigma_m.unwrap_or(defaults.in_plane_m),
        scale: camera.flight_scale_sigma.unwrap_or(defaults.scale),
        principal_point_px: camera.flight_principal_point_sigma_px.unwrap_or(defaults.principal_point_px),
        torque_rad: wing.torque_sigma_deg.map_or(defaults.torque_rad, f64::to_radians),
        readout_s: camera.readout_s.unwrap_or(defaults.readout_s),
        vibration: wing.vibration.as_deref().map_or(defaults.vibration, combine_modes),
        shake: defaults.shake,
    }
}

fn combine_modes(modes: &[VibrationTable]) -> Vibration {
    let amplitude = modes.iter().map(|m| m.amplitude_m.powi(2)).sum::<f64>().sqrt();
    let velocity = modes.iter().map(|m| (m.amplitude_m * m.frequency_hz).powi(2)).sum::<f64>().sqrt();
    let frequency_hz = if amplitude > 0.0 { velocity / amplitude } else { 0.0 };
    Vibration { amplitude, frequency_hz, scaled_by_frames: false }
}

/// Reports keys that have no effect because of another key.
pub(super) fn check_vibration(reader: &mut Reader, file: &Path, document: &InstallationDocument) {
    if document.wing.vibration.is_some() && document.camera.readout_s == Some(0.0) {
        let remedy = "delete it, or give the time from an image's first row to its last as camera.readout_s";
        let problem = "has no effect: with camera.readout_s = 0 all rows are exposed at once";
        reader.fault(file, "wing.vibration", problem, remedy);
    }
}

/// Key, its value, the largest allowed value, the unit.
pub(super) type BoundedValue = (&'static str, Option<f64>, f64, &'static str);

/// Lists the values that must be between 0 and a bound.
pub(super) fn bounded_values(document: &InstallationDocument) -> Vec<BoundedValue> {
    let (camera, wing) = (&document.camera, &document.wing);
    let survey = document.survey.as_ref();
    let mut list = vec![
        ("survey.bend_sigma_m", survey.and_then(|s| s.bend_sigma_m), 5.0, "m"),
        ("survey.vertical_sigma_deg", survey.and_then(|s| s.vertical_sigma_deg), 20.0, "degrees"),
        ("wing.skin_motion_m", wing.skin_motion_m, 0.1, "m"),
        ("wing.root_rotation_sigma_mrad", wing.root_rotation_sigma_mrad, 100.0, "mrad"),
        ("wing.root_translation_sigma_m", wing.root_translation_sigma_m, 1.0, "m"),
        ("wing.constant_bend_sigma_m", wing.constant_bend_sigma_m, 5.0, "m"),
        ("wing.in_plane_sigma_m", wing.in_plane_sigma_m, 5.0, "m"),
        ("wing.torque_sigma_deg", wing.torque_sigma_deg, 20.0, "degrees"),
        ("camera.flight_scale_sigma", camera.flight_scale_sigma, 0.1, ""),
        ("camera.flight_principal_point_sigma_px", camera.flight_principal_point_sigma_px, 1000.0, "px"),
        ("camera.readout_s", camera.readout_s, MAX_READOUT_S, "s"),
    ];
    for mode in wing.vibration.iter().flatten() {
        list.push(("wing.vibration.frequency_hz", Some(mode.frequency_hz), 1000.0, "Hz"));
        list.push(("wing.vibration.amplitude_m", Some(mode.amplitude_m), 5.0, "m"));
    }
    list
}
