//! Warnings about an installation: surveyed points off the skin of the others, and an accepted calibration.

use super::plausible::{SpanSkew, plan_outlier};
use super::{INSTALLATION_FILE, Installation, ORIENTATION_FILE};
use std::path::Path;

use wingd_base::fault::Fault;
use wingd_measure::adjust::ground::find_skin_outliers;
use wingd_measure::setup::Setup;

/// Returns warnings about the survey and the calibration.
///
/// They do not stop anything: such a point is excluded if its image confirms the error.
pub fn find_warnings(installation: &Installation) -> Vec<Fault> {
    let file = installation.directory.join(&installation.sources[1]);
    let markers = &installation.setup.markers;
    let warning = |point: wingd_measure::adjust::ground::SkinOutlier| {
        let problem = format!(
            "is {:.3} m {} the smooth skin through the others ({:.0} standard deviations)",
            point.height_m.abs(),
            if point.height_m > 0.0 {
                "above"
            } else {
                "below"
            },
            point.height_m.abs() / point.sigma_m
        );
        let id = &markers.get(point.marker)?.id;
        let remedy = "check its coordinates against the survey's records";
        Some(Fault::of_marker(&file, id, problem, remedy))
    };
    let accepted = |reason: &Option<String>, name: &str, what: &str, remedy: &str| {
        let problem = format!("a refused {what} was accepted: {}", reason.as_ref()?);
        Some(Fault::new(
            installation.directory.join(name),
            "accepted",
            problem,
            remedy,
        ))
    };
    let camera = accepted(
        &installation.accepted,
        &installation.sources[0],
        "calibration",
        "calibrate again with the images that the verdict asks for",
    );
    let orientation = accepted(
        &installation.accepted_orientation,
        ORIENTATION_FILE,
        "orientation",
        "remove the cause (`wingd diagnose`), and run `wingd orient` again",
    );
    let setup_file = installation.directory.join(INSTALLATION_FILE);
    let span = SpanSkew::warning(&installation.setup, &setup_file);
    let notes = installation.notes.iter().cloned();
    let own = notes
        .chain(camera)
        .chain(orientation)
        .chain(span)
        .chain(plan_outlier(&installation.setup, &file))
        .chain(find_contradictions(&installation.setup, &setup_file))
        .chain(length_warning(installation));
    own.chain(
        find_skin_outliers(&installation.setup)
            .into_iter()
            .filter_map(warning),
    )
    .collect()
}

/// Ranges of the skin's heights (default ± 3 sigma) and of the span of the tip's height, fractions of the markers' length.
const SKIN_RANGES: [(f64, f64); 3] = [(-0.006, 0.036), (-0.017, 0.025), (0.7, 1.5)];
/// Distance of the bending axis from markers on one line, m: three standard deviations of its default.
const AXIS_ROOM_M: f64 = 0.9;
/// Largest warming from ground to flight, K: by the sun.
const MAX_WARMING_K: f64 = 20.0;

/// Warns of values that the survey contradicts, or the ground temperature.
fn find_contradictions(setup: &Setup, file: &Path) -> Vec<Fault> {
    let reach_m = setup.reach_m();
    let (mut span_m, mut chord) = (f64::INFINITY, (f64::INFINITY, f64::NEG_INFINITY));
    for (_, p) in setup.wing_markers() {
        let z_m = p.z - setup.swept_m(p.x);
        (span_m, chord) = (span_m.min(p.x), (chord.0.min(z_m), chord.1.max(z_m)));
    }
    let middle_m = 0.5 * (chord.0 + chord.1);
    chord.0 = chord.0.min(middle_m - AXIS_ROOM_M);
    chord.1 = chord.1.max(middle_m + AXIS_ROOM_M);
    let any = f64::NEG_INFINITY;
    let mut all = vec![(
        "wing.root_offset_m",
        setup.root_offset_m,
        (any, span_m),
        "the innermost marker",
    )];
    all.extend(
        setup
            .axis_chord_offset_m
            .map(|z_m| ("wing.axis_chord_offset_m", z_m, chord, "the markers")),
    );
    if let Some(skin) = &setup.skin_height {
        let values = [
            ("wing.skin_height_m.root", skin.root_m),
            ("wing.skin_height_m.tip", skin.tip_m),
            ("wing.skin_height_m.tip_span_m", skin.tip_span_m),
        ];
        for ((key, value_m), (low, high)) in values.into_iter().zip(SKIN_RANGES) {
            all.push((
                key,
                value_m,
                (low * reach_m, high * reach_m),
                "the markers' length",
            ));
        }
    }
    all.extend(setup.thermal.as_ref().map(|t| {
        (
            "thermal.flight_temperature_c",
            t.flight_temperature_c,
            (any, t.ground_temperature_c + MAX_WARMING_K),
            "ground_temperature_c",
        )
    }));
    let fault = |(key, value, (low, high), by): (&str, f64, (f64, f64), &str)| {
        let from = if low > any {
            format!("{low:.2} to")
        } else {
            "at most".to_owned()
        };
        let problem = format!("is {value}, but {from} {high:.2} by {by}");
        (value < low || value > high).then(|| {
            Fault::new(
                file,
                key,
                problem,
                "is it of another wing or another flight?",
            )
        })
    };
    all.into_iter().filter_map(fault).collect()
}

/// Distance of the outermost marker from the lens beyond which metres are doubtful, m: wings of flying aircraft end at 60.
const MAX_USUAL_DISTANCE_M: f64 = 70.0;

/// Warns of lengths that are more likely feet.
fn length_warning(installation: &Installation) -> Option<Fault> {
    let setup = &installation.setup;
    let distances = setup
        .markers
        .iter()
        .map(|m| (m.position_m - setup.projection_centre_m).norm());
    let (last_m, largest_m) = (
        distances.fold(0.0, f64::max),
        setup
            .markers
            .iter()
            .map(|m| m.diameter_m)
            .fold(0.0, f64::max),
    );
    let problem = format!(
        "the outermost marker is {last_m:.0} m from the lens, and the largest is {largest_m:.2} m wide"
    );
    let remedy = "if these are feet, convert all lengths to metres";
    let file = installation.directory.join(&installation.sources[1]);
    (last_m > MAX_USUAL_DISTANCE_M)
        .then(|| Fault::new(file, "columns x_m, y_m, z_m", problem, remedy))
}
