//! Writing of a setup as the files of an installation, which read back identically; default values are omitted.

use std::io;
use std::path::{Path, PathBuf};

use super::document::{DEFAULT_CENTRE_SIGMA_M, DEFAULT_TEMPERATURE_SIGMA_K};
use super::section::{GivenWidths, Section, SectionTable};
use super::tables::{
    BreakTable, CameraTable, InstallationDocument, Side, SurveyTable, ThermalTable, TorsionTable,
    VibrationTable, WingTable,
};
use super::{INSTALLATION_FILE, write_camera};
use wingd_measure::setup::Vibration;
use wingd_measure::setup::Width;
use wingd_measure::setup::{Setup, Shape, SurveyMarker, Thermal, TorsionPair, WingBreak, WingSide};
use wingd_measure::widths::WidthRow;

/// Names of the written camera file and survey.
const CAMERA_FILE: &str = "camera.toml";
const SURVEY_FILE: &str = "survey.csv";

/// Writes `installation.toml`, `camera.toml` and `survey.csv` of a wing without window, CAD frame and covariance of the
/// lens.
///
/// `head` and `survey_head` are comments, or empty, that begin `installation.toml` and `survey.csv`. Positions are written
/// to 0.1 mm. Values of `installation.toml` that differ from those of `facts`, if given, are written as comments.
///
/// # Errors
/// Returns the file that cannot be written, and the cause.
pub fn write_installation(
    folder: &Path,
    setup: &Setup,
    facts: Option<&Setup>,
    [head, survey_head]: [&str; 2],
) -> Result<(), (PathBuf, io::Error)> {
    let at = |path: &Path| {
        let path = path.to_owned();
        move |error| (path, error)
    };
    std::fs::create_dir_all(folder).map_err(at(folder))?;
    let camera = folder.join(CAMERA_FILE);
    write_camera(&camera, &setup.lens, None).map_err(at(&camera))?;
    let file = folder.join(INSTALLATION_FILE);
    let document = |setup: &Setup| {
        toml::to_string(&installation_document(setup))
            .map_err(|error| at(&file)(io::Error::other(error)))
    };
    let mut text = document(setup)?;
    if let Some(facts) = facts {
        text = comment_assumptions(&text, &document(facts)?);
    }
    std::fs::write(&file, format!("{head}{text}")).map_err(at(&file))?;
    let file = folder.join(SURVEY_FILE);
    let survey = survey_csv(&setup.markers).map_err(at(&file))?;
    std::fs::write(&file, [survey_head.as_bytes(), &survey].concat()).map_err(at(&file))
}

/// Turns the lines of a document that are not in another one, which has the known values, into comments.
fn comment_assumptions(text: &str, facts: &str) -> String {
    let with_sections = |text: &str| {
        let mut section = String::new();
        let one = |line: &str| {
            if line.starts_with('[') {
                section = line.to_owned();
            }
            (section.clone(), line.to_owned())
        };
        text.lines().map(one).collect::<Vec<_>>()
    };
    let known = with_sections(facts);
    let line = |(section, line): (String, String)| {
        let fact = line.is_empty() || known.contains(&(section, line.clone()));
        if fact {
            format!("{line}\n")
        } else {
            format!("# {line} # assumed\n")
        }
    };
    with_sections(text).into_iter().map(line).collect()
}

/// Returns a value that differs from its default.
fn nondefault(value: f64, default: f64) -> Option<f64> {
    // Conversion from radians to degrees and milliradians is not exact.
    ((value - default).abs() > 1e-12 * default.abs()).then_some(value)
}

fn installation_document(setup: &Setup) -> InstallationDocument {
    let thermal = |thermal: Thermal| ThermalTable {
        expansion_per_k: thermal.expansion_per_k,
        expansion_sigma_per_k: thermal.expansion_sigma_per_k,
        ground_temperature_c: thermal.ground_temperature_c,
        flight_temperature_c: thermal.flight_temperature_c,
        sigma_k: thermal
            .flight_temperature_sigma_k
            .and_then(|sigma| nondefault(sigma, DEFAULT_TEMPERATURE_SIGMA_K)),
    };
    let id = |i: usize| {
        setup
            .markers
            .get(i)
            .map_or(String::new(), |marker| marker.id.clone())
    };
    let torsion = |pair: &TorsionPair| TorsionTable {
        name: pair.name.clone(),
        leading: id(pair.leading),
        trailing: id(pair.trailing),
    };
    let survey = section(setup, SurveyTable {});
    InstallationDocument {
        name: Some(setup.name.clone()),
        survey: Some(survey).filter(|section| !section.widths.0.is_empty()),
        camera: section(setup, camera_table(setup)),
        wing: section(setup, wing_table(setup)),
        thermal: setup.thermal.map(thermal),
        torsion: setup.torsion.iter().map(torsion).collect(),
        cad: None,
        window: None,
        structure: None,
    }
}

/// Adds to a section's table the widths that are not default.
fn section<T: SectionTable>(setup: &Setup, table: T) -> Section<T> {
    let (uncertainty, reach_m) = (&setup.uncertainty, setup.reach_m());
    let given = |row: &WidthRow| match row.width {
        // A configured motion of the skin is not estimated from the frames.
        Width::SkinMotion => {
            Some(uncertainty[row.width]).filter(|_| !uncertainty.skin_scaled_by_frames)
        }
        width => nondefault(uncertainty[width], row.default_for(reach_m))
            .map(|value| value / row.unit.factor),
    };
    let rows = Width::ROWS.iter().filter(|row| row.section == T::NAME);
    Section {
        table,
        widths: GivenWidths(
            rows.filter_map(|row| Some((row.width, given(row)?)))
                .collect(),
        ),
    }
}

fn camera_table(setup: &Setup) -> CameraTable {
    CameraTable {
        calibration: CAMERA_FILE.into(),
        projection_centre_m: setup.projection_centre_m.into(),
        projection_centre_sigma_m: nondefault(
            setup.projection_centre_sigma_m,
            DEFAULT_CENTRE_SIGMA_M,
        ),
        mount_repeatability_px: Some(setup.mount_repeatability_px),
        optics: None,
    }
}

fn wing_table(setup: &Setup) -> WingTable {
    let Vibration {
        amplitude,
        frequency_hz,
        scaled_by_frames,
    } = setup.uncertainty.vibration;
    let vibrates = !scaled_by_frames && setup.uncertainty[Width::Readout] > 0.0;
    let break_table = |one: &WingBreak| BreakTable {
        span_m: one.span_m,
        sweep_deg: one.sweep_rad.map(f64::to_degrees),
    };
    WingTable {
        survey: SURVEY_FILE.into(),
        span_direction: setup.span_direction.into(),
        flow_direction: setup.flow_direction.map(Into::into),
        side: setup.configured_side.map(|side| {
            if side == WingSide::Left {
                Side::Left
            } else {
                Side::Right
            }
        }),
        root_offset_m: setup.root_offset_m,
        breaks: Some(setup.breaks.iter().map(break_table).collect())
            .filter(|all: &Vec<_>| !all.is_empty()),
        axis_chord_offset_m: setup.axis_chord_offset_m,
        skin_height_m: setup.skin_height,
        vibration: vibrates.then(|| {
            vec![VibrationTable {
                frequency_hz,
                amplitude_m: amplitude,
            }]
        }),
    }
}

/// Optional column, and the function that returns a marker's cell.
type OptionalColumn = (&'static str, fn(&SurveyMarker) -> String);

fn survey_csv(markers: &[SurveyMarker]) -> io::Result<Vec<u8>> {
    let any = |is: fn(&SurveyMarker) -> bool| markers.iter().any(is);
    let columns: [(bool, OptionalColumn); 3] = [
        (
            any(|m| m.fixed),
            ("fixed", |m| if m.fixed { "yes" } else { "no" }.into()),
        ),
        (
            any(|m| m.part.is_some()),
            ("part", |m| m.part.clone().unwrap_or_default()),
        ),
        (
            any(|m| m.fixed),
            ("flight_motion_m", |m| {
                if m.fixed {
                    format!("{:?}", m.flight_motion_m)
                } else {
                    String::new()
                }
            }),
        ),
    ];
    let columns: Vec<OptionalColumn> = columns
        .into_iter()
        .filter_map(|(any, column)| any.then_some(column))
        .collect();
    let own = ["id", "shape", "diameter_m", "x_m", "y_m", "z_m", "sigma_m"].map(str::to_owned);
    let head = own
        .into_iter()
        .chain(columns.iter().map(|(name, _)| (*name).to_owned()));
    let line = |m: &SurveyMarker| {
        let [x, y, z] = [m.position_m.x, m.position_m.y, m.position_m.z].map(|v| format!("{v:.4}"));
        let (id, shape) = (m.id.clone(), m.shape.name().to_owned());
        let diameter = if m.shape == Shape::Point {
            String::new()
        } else {
            m.diameter_m.to_string()
        };
        let own = [id, shape, diameter, x, y, z, m.sigma_m.to_string()];
        own.into_iter()
            .chain(columns.iter().map(|(_, cell)| cell(m)))
            .collect::<Vec<_>>()
    };
    let mut csv = csv::Writer::from_writer(vec![]);
    csv.write_record(head)?;
    markers
        .iter()
        .map(line)
        .try_for_each(|line| csv.write_record(line))?;
    csv.into_inner()
        .map_err(|error| io::Error::other(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::installation::load;
    use wingd_measure::setup::SetupUncertainty;
    use wingd_measure::setup::Shape;

    /// Writes a setup and reads it back.
    fn read_back(setup: &Setup) -> Setup {
        let folder = tempfile::tempdir().unwrap();
        write_installation(folder.path(), setup, None, ["# a comment\n", "# another\n"]).unwrap();
        load(folder.path()).unwrap().setup
    }

    fn fixture() -> Setup {
        load(Path::new("../../fixtures/dev/installation"))
            .unwrap()
            .setup
    }

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-12 * b.abs()
    }

    #[test]
    fn an_installation_reads_back_as_written() {
        let setup = Setup {
            breaks: vec![WingBreak {
                span_m: 12.5,
                sweep_rad: Some(0.015625),
            }],
            ..fixture()
        };
        assert_eq!(read_back(&setup), setup);
    }

    #[test]
    fn assumptions_are_comments_beside_the_known_values() {
        let text = "a = 1\n\n[camera]\nx = 0\nshift = 0.0\n\n[thermal]\nt = 15.0\n";
        let written = comment_assumptions(text, "a = 1\n\n[camera]\nx = 0\n");
        assert_eq!(
            written,
            "a = 1\n\n[camera]\nx = 0\n# shift = 0.0 # assumed\n\n# [thermal] # assumed\n# t = 15.0 # assumed\n"
        );
    }

    #[test]
    fn every_prior_sigma_reads_back() {
        let mut setup = fixture();
        let own = &mut setup.uncertainty;
        *own = SetupUncertainty {
            lens: own.lens,
            ..SetupUncertainty::from_drawings()
        };
        (
            own[Width::MountShift],
            own[Width::Readout],
            own[Width::FlightScale],
        ) = (0.0007, 0.02, 3e-4);
        own.vibration = Vibration {
            amplitude: 0.02,
            frequency_hz: 2.5,
            scaled_by_frames: false,
        };
        own.shake = SetupUncertainty::DEFAULT.shake;
        let back = read_back(&setup);
        assert_eq!(back, setup);
        for row in Width::ROWS {
            setup.uncertainty[row.width] = row.unit.factor * 0.3 * row.max;
        }
        let back = read_back(&setup).uncertainty;
        assert!(
            Width::ROWS
                .iter()
                .all(|row| near(back[row.width], setup.uncertainty[row.width])),
            "{back:?}"
        );
    }

    #[test]
    fn displaced_fixed_targets_and_control_surfaces_read_back() {
        let mut setup = fixture();
        setup.markers[3].part = Some("aileron".into());
        let mut mark = setup.markers[0].clone();
        (mark.id, mark.shape, mark.fixed, mark.flight_motion_m) =
            ("F \"1\", left".into(), Shape::Circle, true, 2e-4);
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
