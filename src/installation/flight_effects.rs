//! What flight does to wing, cabin and camera, as `installation.toml` states it -> [`InFlight`].

use std::path::Path;

use super::Reader;
use super::tables::{Document, Vibrating};
use crate::measure::setup::{FlightEffectPriors, Vibration};

/// From a first row to a last one that any sensor takes, s.
const MAX_READOUT_S: f64 = 1.0;

/// As stated, else as usual. Several modes count as one: their velocities add up in squares.
pub(super) fn widths(document: &Document) -> FlightEffectPriors {
    let (survey, camera, wing, usual) =
        (document.survey.as_ref(), &document.camera, &document.wing, FlightEffectPriors::DEFAULT);
    let milli = |value: Option<f64>, usual: f64| value.map_or(usual, |v| 1e-3 * v);
    FlightEffectPriors {
        ground_bend_m: survey.and_then(|s| s.bend_sigma_m).unwrap_or(usual.ground_bend_m),
        vertical_rad: survey.and_then(|s| s.vertical_sigma_deg).map_or(usual.vertical_rad, f64::to_radians),
        skin_motion_m: wing.skin_motion_m.unwrap_or(usual.skin_motion_m),
        skin_by_frames: wing.skin_motion_m.is_none(),
        root_rotation_rad: milli(wing.root_rotation_sigma_mrad, usual.root_rotation_rad),
        root_translation_m: wing.root_translation_sigma_m.unwrap_or(usual.root_translation_m),
        constant_bend_m: wing.constant_bend_sigma_m.unwrap_or(usual.constant_bend_m),
        in_plane_m: wing.in_plane_sigma_m.unwrap_or(usual.in_plane_m),
        scale: camera.flight_scale_sigma.unwrap_or(usual.scale),
        principal_point_px: camera.flight_principal_point_sigma_px.unwrap_or(usual.principal_point_px),
        torque_rad: wing.torque_sigma_deg.map_or(usual.torque_rad, f64::to_radians),
        readout_s: camera.readout_s.unwrap_or(usual.readout_s),
        vibration: wing.vibration.as_deref().map_or(usual.vibration, together),
        shake: usual.shake,
    }
}

fn together(modes: &[Vibrating]) -> Vibration {
    let amplitude = modes.iter().map(|m| m.amplitude_m.powi(2)).sum::<f64>().sqrt();
    let velocity = modes.iter().map(|m| (m.amplitude_m * m.frequency_hz).powi(2)).sum::<f64>().sqrt();
    let frequency_hz = if amplitude > 0.0 { velocity / amplitude } else { 0.0 };
    Vibration { amplitude, frequency_hz, by_frames: false }
}

/// What says nothing beside another key.
pub(super) fn check(reader: &mut Reader, file: &Path, document: &Document) {
    if document.wing.vibration.is_some() && document.camera.readout_s == Some(0.0) {
        let mend =
            "leave it out, or give the time from a picture's first row to its last as camera.readout_s";
        let problem = "is given, but with camera.readout_s = 0 all rows see one instant";
        reader.fault(file, "wing.vibration", problem, mend);
    }
}

/// A key, its value, the largest that is believed, its unit.
pub(super) type Width = (&'static str, Option<f64>, f64, &'static str);

/// What must lie between 0 and a bound.
pub(super) fn bounded(document: &Document) -> Vec<Width> {
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
