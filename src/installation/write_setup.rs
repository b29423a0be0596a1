//! Writing of a setup as the files of an installation, which read back identically; default values are omitted.

use std::fmt::Write as _;
use std::io;
use std::path::{Path, PathBuf};

use super::document::{DEFAULT_CENTRE_SIGMA_M, DEFAULT_TEMPERATURE_SIGMA_K};
use super::write_camera;
use crate::measure::setup::{Setup, SetupUncertainty, SurveyMarker, TorsionPair, WingSide, fixed_target};

/// Writes `installation.toml`, `camera.toml` and `survey.csv` of a wing without window, CAD frame and covariance of the
/// lens.
///
/// `head` and `survey_head` are comments, or empty, that begin `installation.toml` and `survey.csv`. Positions are written
/// to 0.1 mm.
///
/// # Errors
/// Returns the file that cannot be written, and the cause.
pub fn write_installation(
    folder: &Path,
    setup: &Setup,
    [head, survey_head]: [&str; 2],
) -> Result<(), (PathBuf, io::Error)> {
    let at = |path: &Path| {
        let path = path.to_owned();
        move |error| (path, error)
    };
    std::fs::create_dir_all(folder).map_err(at(folder))?;
    let camera = folder.join("camera.toml");
    write_camera(&camera, &setup.lens, None).map_err(at(&camera))?;
    let file = folder.join("installation.toml");
    std::fs::write(&file, format!("{head}{}", installation_toml(setup))).map_err(at(&file))?;
    let file = folder.join("survey.csv");
    let survey = survey_csv(&setup.markers).map_err(at(&file))?;
    std::fs::write(&file, [survey_head.as_bytes(), &survey].concat()).map_err(at(&file))
}

/// Key, its value, and its default.
type KeyWithDefault = (&'static str, f64, f64);

fn nondefault_lines(keys: &[KeyWithDefault]) -> String {
    // Conversion from radians to degrees and milliradians is not exact.
    let differs = |(_, value, defaults): &&KeyWithDefault| (value - defaults).abs() > 1e-12 * defaults.abs();
    keys.iter().filter(differs).map(|(key, value, _)| format!("{key} = {value:?}\n")).collect()
}

fn toml_string(text: &str) -> toml::Value {
    text.into()
}

fn installation_toml(setup: &Setup) -> String {
    let (own, defaults) = (&setup.uncertainty, SetupUncertainty::default());
    let survey = survey_priors(own, &defaults);
    let section = if survey.is_empty() { String::new() } else { format!("\n[survey]\n{survey}") };
    let name = toml_string(&setup.name);
    let mut text = format!("name = {name}\n{section}\n[camera]\ncalibration = \"camera.toml\"\n");
    let c = setup.projection_centre_m;
    let _ = writeln!(text, "projection_centre_m = [{:?}, {:?}, {:?}]", c.x, c.y, c.z);
    text +=
        &nondefault_lines(&[("projection_centre_sigma_m", setup.projection_centre_sigma_m, DEFAULT_CENTRE_SIGMA_M)]);
    let _ = writeln!(text, "mount_repeatability_px = {:?}", setup.mount_repeatability_px);
    text += &camera_priors(own, &defaults);
    let span = setup.span_direction;
    let _ = writeln!(text, "\n[wing]\nsurvey = \"survey.csv\"\nspan_direction = [{:?}, {:?}]", span.x, span.y);
    let _ = writeln!(text, "root_offset_m = {:?}", setup.root_offset_m);
    if let Some(side) = setup.configured_side {
        let _ = writeln!(text, "side = {:?}", if side == WingSide::Left { "left" } else { "right" });
    }
    if let Some(z) = setup.axis_chord_offset_m {
        let _ = writeln!(text, "axis_chord_offset_m = {z:?}");
    }
    if let Some(skin) = setup.skin_height {
        let (root, tip, span) = (skin.root_m, skin.tip_m, skin.tip_span_m);
        let _ = writeln!(text, "skin_height_m = {{ root = {root:?}, tip = {tip:?}, tip_span_m = {span:?} }}");
    }
    text += &wing_priors(own, &defaults);
    text + &thermal_section(setup) + &torsion_section(setup)
}

fn survey_priors(own: &SetupUncertainty, defaults: &SetupUncertainty) -> String {
    let (own, defaults) = (own.in_flight, defaults.in_flight);
    nondefault_lines(&[
        ("bend_sigma_m", own.ground_bend_m, defaults.ground_bend_m),
        ("vertical_sigma_deg", own.vertical_rad.to_degrees(), defaults.vertical_rad.to_degrees()),
    ])
}

fn camera_priors(own: &SetupUncertainty, defaults: &SetupUncertainty) -> String {
    let (flight, default_flight) = (own.in_flight, defaults.in_flight);
    nondefault_lines(&[
        ("mount_shift_m", own.mount_shift_m, defaults.mount_shift_m),
        ("mount_drift_mrad", 1e3 * own.mount_drift_rad, 1e3 * defaults.mount_drift_rad),
        ("flight_scale_sigma", flight.scale, default_flight.scale),
        ("flight_principal_point_sigma_px", flight.principal_point_px, default_flight.principal_point_px),
        ("readout_s", flight.readout_s, default_flight.readout_s),
    ])
}

fn wing_priors(own: &SetupUncertainty, defaults: &SetupUncertainty) -> String {
    let (flight, default_flight) = (own.in_flight, defaults.in_flight);
    let degrees = f64::to_degrees;
    let mut text = nondefault_lines(&[
        ("skin_height_sigma_m", own.skin_height_sigma_m, defaults.skin_height_sigma_m),
        ("root_offset_sigma_m", own.root_offset_m, defaults.root_offset_m),
        ("axis_chord_offset_sigma_m", own.axis_chord_offset_m, defaults.axis_chord_offset_m),
        ("span_direction_sigma_deg", degrees(own.span_direction_rad), degrees(defaults.span_direction_rad)),
        ("root_rotation_sigma_mrad", 1e3 * flight.root_rotation_rad, 1e3 * default_flight.root_rotation_rad),
        ("root_translation_sigma_m", flight.root_translation_m, default_flight.root_translation_m),
        ("constant_bend_sigma_m", flight.constant_bend_m, default_flight.constant_bend_m),
        ("in_plane_sigma_m", flight.in_plane_m, default_flight.in_plane_m),
        ("torque_sigma_deg", degrees(flight.torque_rad), degrees(default_flight.torque_rad)),
    ]);
    // Configured values are not scaled by the frames.
    if !flight.skin_scaled_by_frames {
        let _ = writeln!(text, "skin_motion_m = {:?}", flight.skin_motion_m);
    }
    let vibration = flight.vibration;
    if !vibration.scaled_by_frames && flight.readout_s > 0.0 {
        let (amplitude, frequency) = (vibration.amplitude, vibration.frequency_hz);
        let _ = writeln!(text, "vibration = [{{ amplitude_m = {amplitude:?}, frequency_hz = {frequency:?} }}]");
    }
    text
}

fn thermal_section(setup: &Setup) -> String {
    let Some(thermal) = setup.thermal else { return String::new() };
    let mut text = format!(
        "\n[thermal]\nexpansion_per_k = {:e}\nground_temperature_c = {:?}\nflight_temperature_c = {:?}\n",
        thermal.expansion_per_k, thermal.ground_temperature_c, thermal.flight_temperature_c
    );
    if let Some(sigma) = thermal.expansion_sigma_per_k {
        let _ = writeln!(text, "expansion_sigma_per_k = {sigma:e}");
    }
    let sigma = thermal.flight_temperature_sigma_k.unwrap_or(DEFAULT_TEMPERATURE_SIGMA_K);
    text + &nondefault_lines(&[("sigma_k", sigma, DEFAULT_TEMPERATURE_SIGMA_K)])
}

fn torsion_section(setup: &Setup) -> String {
    let id = |i: usize| toml_string(setup.markers.get(i).map_or("", |marker| marker.id.as_str()));
    let pair = |pair: &TorsionPair| {
        let (name, leading, trailing) = (toml_string(&pair.name), id(pair.leading), id(pair.trailing));
        format!("\n[[torsion]]\nname = {name}\nleading = {leading}\ntrailing = {trailing}\n")
    };
    setup.torsion.iter().map(pair).collect()
}

/// Optional column, and the function that returns a marker's cell.
type OptionalColumn = (&'static str, fn(&SurveyMarker) -> String);

/// Returns the default motion of a fixed target, m; 0 for a marker on the wing.
fn default_motion(marker: &SurveyMarker) -> f64 {
    if marker.fixed { fixed_target::FLIGHT_MOTION_M } else { 0.0 }
}

fn survey_csv(markers: &[SurveyMarker]) -> io::Result<Vec<u8>> {
    let any = |is: fn(&SurveyMarker) -> bool| markers.iter().any(is);
    let columns: [(bool, OptionalColumn); 3] = [
        (any(|m| m.fixed), ("fixed", |m| if m.fixed { "yes" } else { "no" }.into())),
        (any(|m| m.part.is_some()), ("part", |m| m.part.clone().unwrap_or_default())),
        (
            any(|m| (m.flight_motion_m - default_motion(m)).abs() > 0.0),
            ("flight_motion_m", |m| if m.fixed { format!("{:?}", m.flight_motion_m) } else { String::new() }),
        ),
    ];
    let columns: Vec<OptionalColumn> = columns.into_iter().filter_map(|(any, column)| any.then_some(column)).collect();
    let own = ["id", "shape", "diameter_m", "x_m", "y_m", "z_m", "sigma_m"].map(str::to_owned);
    let head = own.into_iter().chain(columns.iter().map(|(name, _)| (*name).to_owned()));
    let line = |m: &SurveyMarker| {
        let [x, y, z] = [m.position_m.x, m.position_m.y, m.position_m.z].map(|v| format!("{v:.4}"));
        let (id, shape) = (m.id.clone(), m.shape.name().to_owned());
        let own = [id, shape, m.diameter_m.to_string(), x, y, z, m.sigma_m.to_string()];
        own.into_iter().chain(columns.iter().map(|(_, cell)| cell(m))).collect::<Vec<_>>()
    };
    let mut csv = csv::Writer::from_writer(vec![]);
    csv.write_record(head)?;
    markers.iter().map(line).try_for_each(|line| csv.write_record(line))?;
    csv.into_inner().map_err(|error| io::Error::other(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::installation::load;
    use crate::measure::setup::{FlightEffectPriors, Shape, Thermal, Vibration};

    /// Writes a setup and reads it back.
    fn read_back(setup: &Setup) -> Setup {
        let folder = tempfile::tempdir().unwrap();
        write_installation(folder.path(), setup, ["# a comment\n", "# another\n"]).unwrap();
        load(folder.path()).unwrap().setup
    }

    fn fixture() -> Setup {
        load(Path::new("fixtures/dev/installation")).unwrap().setup
    }

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-12 * b.abs()
    }

    #[test]
    fn an_installation_reads_back_as_written() {
        let setup = fixture();
        assert_eq!(read_back(&setup), setup);
    }

    #[test]
    fn every_prior_sigma_reads_back() {
        let mut setup = fixture();
        let own = &mut setup.uncertainty;
        *own = SetupUncertainty { lens: own.lens, ..SetupUncertainty::from_drawings() };
        own.mount_shift_m = 0.0007;
        own.in_flight = FlightEffectPriors { readout_s: 0.02, scale: 3e-4, ..FlightEffectPriors::NONE };
        own.in_flight.vibration = Vibration { amplitude: 0.02, frequency_hz: 2.5, scaled_by_frames: false };
        own.in_flight.shake = FlightEffectPriors::DEFAULT.shake;
        let back = read_back(&setup);
        assert_eq!(back, setup);
        setup.uncertainty.in_flight.vertical_rad = 0.3f64.to_radians();
        setup.uncertainty.in_flight.torque_rad = 0.7f64.to_radians();
        let back = read_back(&setup).uncertainty.in_flight;
        assert!(near(back.vertical_rad, 0.3f64.to_radians()) && near(back.torque_rad, 0.7f64.to_radians()));
    }

    #[test]
    fn displaced_fixed_targets_and_control_surfaces_read_back() {
        let mut setup = fixture();
        setup.markers[3].part = Some("aileron".into());
        let mut mark = setup.markers[0].clone();
        (mark.id, mark.shape, mark.fixed, mark.flight_motion_m) = ("F \"1\", left".into(), Shape::Circle, true, 2e-4);
        mark.position_m = nalgebra::Vector3::new(36.0, 20.5, 5.0);
        setup.markers.push(mark);
        setup.thermal = Some(Thermal {
            expansion_per_k: 2.2e-5,
            expansion_sigma_per_k: Some(1e-6),
            ground_temperature_c: 12.0,
            flight_temperature_c: -40.0,
            flight_temperature_sigma_k: Some(4.0),
        });
        assert_eq!(read_back(&setup), setup);
    }
}
