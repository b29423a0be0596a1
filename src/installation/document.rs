//! Reading of `installation.toml` and the files it names into a [`Setup`].

use std::path::Path;

use nalgebra::{Vector2, Vector3};

use super::structure::{self, Structure};
use super::tables::{self, InstallationDocument, OpticsTable};
use super::toml_file::{INSTALLATION_FILE, parse_toml};
use super::{Reader, camera, flight_effects, plausible, survey, ties, window};
use crate::measure::setup::{Setup, SetupUncertainty, SkinHeight, SurveyMarker, Thermal, TorsionPair, WingSide};

/// Default shift between two mountings, px (paper, section 3.1.3).
const DEFAULT_REPEATABILITY_PX: f64 = 10.0;
/// Default standard deviation of the projection centre, each axis, m: a tape measure held at the lens.
pub(super) const DEFAULT_CENTRE_SIGMA_M: f64 = 0.010;

/// Contents of `installation.toml` and the files that it names.
pub(super) struct InstallationParts {
    pub setup: Setup,
    pub optics: Option<OpticsTable>,
    pub structure: Option<Structure>,
    /// Names of the camera file and the survey file.
    pub sources: [String; 2],
    /// Reason for accepting a refused calibration of the camera.
    pub accepted: Option<String>,
}

pub(super) fn read_document(reader: &mut Reader) -> Option<InstallationParts> {
    let remedy = "an installation is a directory with installation.toml; see docs/interface.md";
    let (file, text) = reader.read_text(INSTALLATION_FILE, remedy)?;
    let document: InstallationDocument = parse_toml(reader, &file, &text)?;
    let lens = camera::read_camera(reader, &document.camera.calibration);
    let markers = survey::read_survey(reader, &document.wing.survey);
    let tie_points = match &document.cad {
        Some(cad) => ties::read_tie_points(reader, cad),
        None => Some(vec![]),
    };
    let before = reader.faults.len();
    check_numbers(reader, &file, &document);
    let in_range = reader.faults.len() == before;
    let torsion = torsion_pairs(reader, &file, &document, markers.as_deref());
    let window = window::read_window(reader, &file, document.window.as_ref());
    let structure = structure::read_structure(reader, &file, document.structure.as_ref());
    let skin = document.wing.skin_height_m.as_ref();
    let camera = lens?;
    let setup = Setup {
        name: document.name.clone().unwrap_or_else(|| "unnamed".into()),
        lens: camera.lens,
        projection_centre_m: Vector3::from(document.camera.projection_centre_m),
        projection_centre_sigma_m: document.camera.projection_centre_sigma_m.unwrap_or(DEFAULT_CENTRE_SIGMA_M),
        mount_repeatability_px: document.camera.mount_repeatability_px.unwrap_or(DEFAULT_REPEATABILITY_PX),
        span_direction: Vector2::from(document.wing.span_direction),
        configured_side: document.wing.side.and_then(|side| match side {
            tables::Side::Left => Some(WingSide::Left),
            tables::Side::Right => Some(WingSide::Right),
            tables::Side::Blank => None,
        }),
        root_offset_m: document.wing.root_offset_m,
        axis_chord_offset_m: document.wing.axis_chord_offset_m,
        skin_height: skin.map(|s| SkinHeight { root_m: s.root, tip_m: s.tip, tip_span_m: s.tip_span_m }),
        uncertainty: SetupUncertainty { lens: camera.covariance, ..setup_uncertainty(&document) },
        thermal: document.thermal.as_ref().map(thermal_from_table),
        torsion,
        markers: markers?,
        tie_points: tie_points?,
        cad_similarity: document.cad.is_some_and(|c| c.similarity),
        window,
    };
    // Numbers outside their ranges cannot be checked against each other.
    if in_range {
        plausible::check_plausibility(reader, &setup, &document.wing.survey);
    }
    let sources = [document.camera.calibration, document.wing.survey];
    let accepted = camera.accepted;
    Some(InstallationParts { setup, optics: document.camera.optics, structure, sources, accepted })
}

/// Default standard deviation of the wing's temperature in flight, K: between the temperatures of still and stagnant air,
/// and of parts warmed by fuel.
pub(super) const DEFAULT_TEMPERATURE_SIGMA_K: f64 = 15.0;

fn setup_uncertainty(document: &InstallationDocument) -> SetupUncertainty {
    let (camera, wing, defaults) = (&document.camera, &document.wing, SetupUncertainty::default());
    SetupUncertainty {
        mount_shift_m: camera.mount_shift_m.unwrap_or(defaults.mount_shift_m),
        mount_drift_rad: camera.mount_drift_mrad.map_or(defaults.mount_drift_rad, |v| 1e-3 * v),
        skin_height_sigma_m: wing.skin_height_sigma_m.unwrap_or(defaults.skin_height_sigma_m),
        root_offset_m: wing.root_offset_sigma_m.unwrap_or(defaults.root_offset_m),
        axis_chord_offset_m: wing.axis_chord_offset_sigma_m.unwrap_or(defaults.axis_chord_offset_m),
        span_direction_rad: wing.span_direction_sigma_deg.map_or(defaults.span_direction_rad, f64::to_radians),
        in_flight: flight_effects::flight_effect_priors(document),
        lens: None,
    }
}

fn thermal_from_table(t: &tables::ThermalTable) -> Thermal {
    Thermal {
        expansion_per_k: t.expansion_per_k,
        expansion_sigma_per_k: t.expansion_sigma_per_k,
        ground_temperature_c: t.ground_temperature_c,
        flight_temperature_c: t.flight_temperature_c,
        flight_temperature_sigma_k: Some(
            t.sigma_k.or(t.flight_temperature_sigma_k).unwrap_or(DEFAULT_TEMPERATURE_SIGMA_K),
        ),
    }
}

/// Number of the document with its allowed range.
struct RangeCheck {
    place: &'static str,
    value: f64,
    low: f64,
    high: f64,
    unit: &'static str,
}

/// Reports keys that a template leaves blank, each with the value it needs; returns these keys.
fn check_blanks(reader: &mut Reader, file: &Path, document: &InstallationDocument) -> Vec<&'static str> {
    let (camera, wing) = (&document.camera, &document.wing);
    let blank = |all: &[f64]| all.iter().all(|v| v.is_nan());
    let lens = blank(&camera.projection_centre_m);
    let span = blank(&wing.span_direction);
    let side = matches!(wing.side, Some(tables::Side::Blank));
    let root = blank(&[wing.root_offset_m]);
    let all = [
        ("name", document.name.as_deref() == Some(""), "give the name of aircraft and wing"),
        (CENTRE_KEY, lens, "give the surveyed position of the lens: [x, y, z]"),
        (SPAN_KEY, span, "give the horizontal direction from the root to the tip: [dx, dy]"),
        ("wing.side", side, "write \"left\" or \"right\""),
        (ROOT_KEY, root, "give the distance along the span from the lens to the bending root"),
    ];
    let blanks = all.into_iter().filter(|(_, blank, _)| *blank);
    let name = |(place, _, remedy): (&'static str, bool, &str)| {
        reader.fault(file, place, "is blank", remedy);
        place
    };
    blanks.map(name).collect()
}

const CENTRE_KEY: &str = "camera.projection_centre_m";
const SPAN_KEY: &str = "wing.span_direction";
const ROOT_KEY: &str = "wing.root_offset_m";

fn check_numbers(reader: &mut Reader, file: &Path, document: &InstallationDocument) {
    let blanks = check_blanks(reader, file, document);
    let (camera, wing) = (&document.camera, &document.wing);
    let check = |place, value, low, high, unit| RangeCheck { place, value, low, high, unit };
    let mut checks = vec![check(ROOT_KEY, wing.root_offset_m, -50.0, 50.0, "m")];
    checks.extend(camera.projection_centre_m.map(|v| check(CENTRE_KEY, v, -1e6, 1e6, "m")));
    checks.extend(camera.mount_repeatability_px.map(|v| check("camera.mount_repeatability_px", v, 0.0, 1000.0, "px")));
    let sigmas = [
        ("camera.projection_centre_sigma_m", camera.projection_centre_sigma_m, 1.0, "m"),
        ("camera.mount_shift_m", camera.mount_shift_m, 0.5, "m"),
        ("camera.mount_drift_mrad", camera.mount_drift_mrad, 100.0, "mrad"),
        ("wing.skin_height_sigma_m", wing.skin_height_sigma_m, 5.0, "m"),
        ("wing.root_offset_sigma_m", wing.root_offset_sigma_m, 5.0, "m"),
        ("wing.axis_chord_offset_sigma_m", wing.axis_chord_offset_sigma_m, 5.0, "m"),
        ("wing.span_direction_sigma_deg", wing.span_direction_sigma_deg, 20.0, "degrees"),
        ("thermal.sigma_k", document.thermal.as_ref().and_then(|t| t.sigma_k), 100.0, "K"),
    ];
    for (place, value, high, unit) in sigmas.into_iter().chain(flight_effects::bounded_values(document)) {
        checks.extend(value.map(|v| check(place, v, 0.0, high, unit)));
    }
    checks.extend(wing.axis_chord_offset_m.map(|v| check("wing.axis_chord_offset_m", v, -20.0, 20.0, "m")));
    if let Some(skin) = &wing.skin_height_m {
        checks.push(check("wing.skin_height_m.root", skin.root, -5.0, 5.0, "m"));
        checks.push(check("wing.skin_height_m.tip", skin.tip, -5.0, 5.0, "m"));
        checks.push(check("wing.skin_height_m.tip_span_m", skin.tip_span_m, 0.1, 200.0, "m"));
    }
    if let Some(thermal) = &document.thermal {
        checks.push(check("thermal.expansion_per_k", thermal.expansion_per_k, -1e-3, 1e-3, "1/K"));
        checks.push(check("thermal.ground_temperature_c", thermal.ground_temperature_c, -100.0, 100.0, "C"));
        checks.push(check("thermal.flight_temperature_c", thermal.flight_temperature_c, -100.0, 100.0, "C"));
        let sigma = thermal.expansion_sigma_per_k.unwrap_or(0.0);
        checks.push(check("thermal.expansion_sigma_per_k", sigma, 0.0, 1e-3, "1/K"));
        let sigma = thermal.flight_temperature_sigma_k.unwrap_or(0.0);
        checks.push(check("thermal.flight_temperature_sigma_k", sigma, 0.0, 100.0, "K"));
    }
    if let Some(optics) = &camera.optics {
        checks.push(check("camera.optics.focal_length_mm", optics.focal_length_mm, 0.1, 5000.0, "mm"));
        checks.push(check("camera.optics.f_number", optics.f_number, 0.5, 128.0, ""));
        checks.push(check("camera.optics.pixel_pitch_um", optics.pixel_pitch_um, 0.1, 100.0, "um"));
        let confusion = optics.circle_of_confusion_um.unwrap_or(1.0);
        checks.push(check("camera.optics.circle_of_confusion_um", confusion, 0.1, 1000.0, "um"));
    }
    for c in checks.into_iter().filter(|c| !blanks.contains(&c.place)) {
        if !(c.low..=c.high).contains(&c.value) {
            let problem = format!("is {:?} {}", c.value, c.unit);
            let remedy = format!("give a number from {} to {} {}", c.low, c.high, c.unit);
            reader.fault(file, c.place, problem.trim_end(), remedy.trim_end());
        }
    }
    flight_effects::check_vibration(reader, file, document);
    let [dx, dy] = wing.span_direction;
    let points = dx.is_finite() && dy.is_finite() && dx.hypot(dy) > 1e-6;
    if !points && !blanks.contains(&SPAN_KEY) {
        let remedy = "give the horizontal direction from the root to the tip in the survey frame";
        reader.fault(file, SPAN_KEY, format!("is [{dx}, {dy}]"), remedy);
    }
}

fn torsion_pairs(
    reader: &mut Reader,
    file: &Path,
    document: &InstallationDocument,
    markers: Option<&[SurveyMarker]>,
) -> Vec<TorsionPair> {
    let Some(markers) = markers else { return vec![] };
    let mut pairs = vec![];
    for (k, pair) in document.torsion.iter().enumerate() {
        let mut find = |key: &str, id: &str| {
            let found = markers.iter().position(|m| m.id == id);
            let place = format!("torsion[{k}].{key}");
            if found.is_none() {
                let remedy = format!("name a marker of {}", document.wing.survey);
                reader.fault(file, &place, format!("marker \"{id}\" is not in the survey"), remedy);
            } else if found.is_some_and(|m| markers[m].fixed) {
                let problem = format!("marker \"{id}\" is fixed to the cabin");
                reader.fault(file, &place, problem, "name a marker on the wing");
                return None;
            }
            found
        };
        let (leading, trailing) = (find("leading", &pair.leading), find("trailing", &pair.trailing));
        if document.torsion[..k].iter().any(|other| other.name == pair.name) {
            let place = format!("torsion[{k}].name");
            let problem = format!("\"{}\" is already the name of another pair", pair.name);
            reader.fault(file, &place, problem, "give every pair a unique name");
        }
        if let (Some(leading), Some(trailing)) = (leading, trailing) {
            if leading == trailing {
                let place = format!("torsion[{k}]");
                reader.fault(file, &place, "leading and trailing are the same marker", "name two markers");
                continue;
            }
            pairs.push(TorsionPair { name: pair.name.clone(), leading, trailing });
        }
    }
    pairs
}
