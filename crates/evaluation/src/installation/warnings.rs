//! Warnings about an installation: surveyed points off the skin of the others, and an accepted calibration.

use super::plausible::{SpanSkew, plan_outlier};
use super::{INSTALLATION_FILE, Installation, ORIENTATION_FILE};
use wingd_base::fault::Fault;
use wingd_measure::adjust::ground::find_skin_outliers;

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
        .chain(length_warning(installation));
    own.chain(
        find_skin_outliers(&installation.setup)
            .into_iter()
            .filter_map(warning),
    )
    .collect()
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
