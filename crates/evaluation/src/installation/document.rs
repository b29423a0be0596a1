//! Reading of `installation.toml` and the files it names into a [`Setup`].

use std::path::Path;

use nalgebra::{Vector2, Vector3};

use super::plausible::SpanSkew;
use super::tables::{self, BreakTable, InstallationDocument, VibrationTable};
use super::ties::CadModel;
use super::{
    INSTALLATION_FILE, Reader, camera, plausible, ranges, structure, survey, ties, window,
};
use wingd_measure::plan::Optics;
use wingd_measure::setup::Width;
use wingd_measure::setup::{
    DEFAULT_REPEATABILITY_PX, Setup, StiffnessSection, SurveyMarker, Thermal, TorsionPair,
    WingBreak, WingSide,
};
use wingd_measure::setup::{SetupUncertainty, Vibration};

/// Default standard deviation of the projection centre, each axis, m: a tape measure held at the lens.
pub const DEFAULT_CENTRE_SIGMA_M: f64 = 0.010;

/// Contents of `installation.toml` and the files that it names.
pub(super) struct InstallationParts {
    pub setup: Setup,
    /// Tie points of a CAD model; `None` without one, or with errors.
    pub cad: Option<CadModel>,
    pub optics: Option<Optics>,
    pub structure: Option<Vec<StiffnessSection>>,
    /// Names of the camera file and the survey file.
    pub sources: [String; 2],
    /// Reason for accepting a refused calibration of the camera.
    pub accepted: Option<String>,
}

pub(super) fn read_document(reader: &mut Reader) -> Option<InstallationParts> {
    let remedy =
        "an installation is a directory with installation.toml; see docs/reference/files.md";
    let (file, text) = reader.read_text(INSTALLATION_FILE, remedy)?;
    let document: InstallationDocument = reader.parse_toml(&file, &text)?;
    let lens = camera::read_camera(reader, &document.camera.calibration);
    let centre_m = Vector3::from(document.camera.projection_centre_m);
    let markers = survey::read_survey(reader, &document.wing.survey, &centre_m);
    let cad = document
        .cad
        .as_ref()
        .and_then(|cad| ties::read_cad(reader, cad));
    let before = reader.faults.len();
    check_numbers(reader, &file, &document);
    let in_range = reader.faults.len() == before;
    let torsion = resolve_torsion_pairs(reader, &file, &document, markers.as_deref());
    let window = window::read_window(reader, &file, document.window.as_ref());
    let structure = structure::read_structure(reader, document.structure.as_ref());
    let camera = lens?;
    let mut setup = Setup {
        name: document.name.clone().unwrap_or_else(|| "unnamed".into()),
        lens: camera.lens,
        projection_centre_m: centre_m,
        projection_centre_sigma_m: document
            .camera
            .projection_centre_sigma_m
            .unwrap_or(DEFAULT_CENTRE_SIGMA_M),
        mount_repeatability_px: document
            .camera
            .mount_repeatability_px
            .unwrap_or(DEFAULT_REPEATABILITY_PX),
        span_direction: Vector2::from(document.wing.span_direction),
        flow_direction: document.wing.flow_direction.map(Vector2::from),
        configured_side: document.wing.side.and_then(|side| match side {
            tables::Side::Left => Some(WingSide::Left),
            tables::Side::Right => Some(WingSide::Right),
            tables::Side::Blank => None,
        }),
        root_offset_m: document.wing.root_offset_m,
        breaks: document
            .wing
            .breaks
            .iter()
            .flatten()
            .map(wing_break)
            .collect(),
        axis_chord_offset_m: document.wing.axis_chord_offset_m,
        skin_height: document.wing.skin_height_m,
        uncertainty: SetupUncertainty::DEFAULT,
        thermal: document.thermal.as_ref().map(thermal_from_table),
        torsion,
        markers: markers?,
        window,
    };
    setup.uncertainty = SetupUncertainty {
        lens: camera.covariance,
        ..uncertainty_of(&setup, &document)
    };
    if document.configured_width(Width::SpanDirection).is_none() {
        // A direction that the line of the markers contradicts is not known to the default.
        let skew_deg = SpanSkew::of_setup(&setup).map_or(0.0, |skew| {
            skew.angle_deg.min(Width::SpanDirection.row().max)
        });
        let sigma = &mut setup.uncertainty[Width::SpanDirection];
        *sigma = sigma.max(skew_deg.to_radians());
    }
    // Numbers outside their ranges cannot be checked against each other.
    if in_range {
        plausible::check_plausibility(reader, &setup, &document.wing.survey);
    }
    let (own, accepted) = (document.camera.table, camera.accepted);
    let sources = [own.calibration, document.wing.table.survey];
    Some(InstallationParts {
        setup,
        cad,
        optics: own.optics,
        structure,
        sources,
        accepted,
    })
}

/// Default standard deviation of the wing's temperature in flight, K: between the temperatures of still and stagnant air,
/// and of parts warmed by fuel.
pub(super) const DEFAULT_TEMPERATURE_SIGMA_K: f64 = 15.0;

impl InstallationDocument {
    /// Iterates over the widths of all sections, in the units of their keys.
    fn widths(&self) -> impl Iterator<Item = (Width, f64)> {
        let survey = self.survey.iter().flat_map(|section| &section.widths.0);
        self.camera
            .widths
            .0
            .iter()
            .chain(&self.wing.widths.0)
            .chain(survey)
            .copied()
    }

    fn configured_width(&self, width: Width) -> Option<f64> {
        self.widths()
            .find(|(other, _)| *other == width)
            .map(|(_, value)| value)
    }
}

fn uncertainty_of(setup: &Setup, document: &InstallationDocument) -> SetupUncertainty {
    let mut uncertainty = SetupUncertainty::default_for(setup.reach_m());
    document
        .widths()
        .for_each(|(width, value)| uncertainty[width] = width.row().unit.factor * value);
    uncertainty.skin_scaled_by_frames = document.configured_width(Width::SkinMotion).is_none();
    uncertainty.vibration = document
        .wing
        .vibration
        .as_deref()
        .map_or(uncertainty.vibration, combine_modes);
    uncertainty
}

/// Combines several vibration modes into one: the squares of their velocities are added.
fn combine_modes(modes: &[VibrationTable]) -> Vibration {
    let norm = |of: fn(&VibrationTable) -> f64| {
        let squares = modes.iter().map(|m| of(m).powi(2));
        squares.sum::<f64>().sqrt()
    };
    let amplitude = norm(|m| m.amplitude_m);
    let velocity = norm(|m| m.amplitude_m * m.frequency_hz);
    let frequency_hz = if amplitude > 0.0 {
        velocity / amplitude
    } else {
        0.0
    };
    Vibration {
        amplitude,
        frequency_hz,
        scaled_by_frames: false,
    }
}

fn wing_break(table: &BreakTable) -> WingBreak {
    WingBreak {
        span_m: table.span_m,
        sweep_rad: table.sweep_deg.map(f64::to_radians),
    }
}

fn thermal_from_table(t: &tables::ThermalTable) -> Thermal {
    Thermal {
        expansion_per_k: t.expansion_per_k,
        expansion_sigma_per_k: t.expansion_sigma_per_k,
        ground_temperature_c: t.ground_temperature_c,
        flight_temperature_c: t.flight_temperature_c,
        flight_temperature_sigma_k: Some(t.sigma_k.unwrap_or(DEFAULT_TEMPERATURE_SIGMA_K)),
    }
}

/// Reports keys that a template leaves blank, each with the value it needs; returns these keys.
fn check_blanks(
    reader: &mut Reader,
    file: &Path,
    document: &InstallationDocument,
) -> Vec<&'static str> {
    let (camera, wing) = (&document.camera, &document.wing);
    let blank = |all: &[f64]| all.iter().all(|v| v.is_nan());
    let lens = blank(&camera.projection_centre_m);
    let span = blank(&wing.span_direction);
    let side = matches!(wing.side, Some(tables::Side::Blank));
    let root = blank(&[wing.root_offset_m]);
    let all = [
        (
            "name",
            document.name.as_deref() == Some(""),
            "give the name of aircraft and wing",
        ),
        (
            CENTRE_KEY,
            lens,
            "give the surveyed position of the lens: [x, y, z]",
        ),
        (
            SPAN_KEY,
            span,
            "give the horizontal direction from the root to the tip: [dx, dy]",
        ),
        ("wing.side", side, "write \"left\" or \"right\""),
        (
            ROOT_KEY,
            root,
            "give the distance along the span from the lens to the bending root",
        ),
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
    let wing = &document.wing;
    ranges::check_ranges(reader, file, document, &blanks);
    if wing.vibration.is_some() && document.configured_width(Width::Readout) == Some(0.0) {
        let remedy =
            "delete it, or give the time from an image's first row to its last as camera.readout_s";
        let problem = "has no effect: with camera.readout_s = 0 all rows are exposed at once";
        reader.fault(file, "wing.vibration", problem, remedy);
    }
    let mut check_direction = |key, [dx, dy]: [f64; 2], remedy| {
        let points = dx.is_finite() && dy.is_finite() && dx.hypot(dy) > 1e-6;
        if !points && !blanks.contains(&key) {
            reader.fault(file, key, format!("is [{dx}, {dy}]"), remedy);
        }
    };
    let remedy = "give the horizontal direction from the root to the tip in the survey frame";
    check_direction(SPAN_KEY, wing.span_direction, remedy);
    let remedy =
        "give the horizontal direction from nose to tail in the survey frame, or delete it";
    wing.flow_direction
        .into_iter()
        .for_each(|flow| check_direction("wing.flow_direction", flow, remedy));
}

fn resolve_torsion_pairs(
    reader: &mut Reader,
    file: &Path,
    document: &InstallationDocument,
    markers: Option<&[SurveyMarker]>,
) -> Vec<TorsionPair> {
    let Some(markers) = markers else {
        return vec![];
    };
    let mut pairs = vec![];
    for (k, pair) in document.torsion.iter().enumerate() {
        let mut find = |key: &str, id: &str| {
            let found = markers.iter().position(|m| m.id == id);
            let place = format!("torsion[{k}].{key}");
            if found.is_none() {
                let remedy = format!("name a marker of {}", document.wing.survey);
                reader.fault(
                    file,
                    &place,
                    format!("marker \"{id}\" is not in the survey"),
                    remedy,
                );
            } else if found.is_some_and(|m| markers[m].fixed) {
                let problem = format!("marker \"{id}\" is fixed to the cabin");
                reader.fault(file, &place, problem, "name a marker on the wing");
                return None;
            }
            found
        };
        let (leading, trailing) = (
            find("leading", &pair.leading),
            find("trailing", &pair.trailing),
        );
        if document.torsion[..k]
            .iter()
            .any(|other| other.name == pair.name)
        {
            let place = format!("torsion[{k}].name");
            let problem = format!("\"{}\" is already the name of another pair", pair.name);
            reader.fault(file, &place, problem, "give every pair a unique name");
        }
        if let (Some(leading), Some(trailing)) = (leading, trailing) {
            if leading == trailing {
                let place = format!("torsion[{k}]");
                reader.fault(
                    file,
                    &place,
                    "leading and trailing are the same marker",
                    "name two markers",
                );
                continue;
            }
            pairs.push(TorsionPair {
                name: pair.name.clone(),
                leading,
                trailing,
            });
        }
    }
    pairs
}
