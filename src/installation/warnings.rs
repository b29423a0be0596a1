//! Warnings about an installation: surveyed points off the skin of the others, and an accepted calibration.

use nalgebra::Vector3;

use super::plausible::{SpanSkew, principal_axes};
use super::{Fault, INSTALLATION_FILE, Installation, ORIENTATION_FILE};
use crate::measure::adjust::ground::find_skin_outliers;

/// Returns warnings about the survey and the calibration.
///
/// They do not stop anything: such a point is excluded if its image confirms the error.
pub fn find_warnings(installation: &Installation) -> Vec<Fault> {
    let file = installation.directory.join(&installation.sources[1]);
    let markers = &installation.setup.markers;
    let warning = |point: crate::measure::adjust::ground::SkinOutlier| {
        let problem = format!(
            "is {:.3} m {} the smooth skin through the others ({:.0} standard deviations)",
            point.height_m.abs(),
            if point.height_m > 0.0 { "above" } else { "below" },
            point.height_m.abs() / point.sigma_m
        );
        Some(Fault {
            file: file.clone(),
            place: format!("marker \"{}\"", markers.get(point.marker)?.id),
            problem,
            remedy: "check its coordinates against the survey's records".into(),
        })
    };
    let accepted = |reason: &Option<String>, name: &str, what: &str, remedy: &str| {
        let problem = format!("a refused {what} was accepted: {}", reason.as_ref()?);
        Some(Fault::new(installation.directory.join(name), "accepted", problem, remedy))
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
    let cad = cad_warnings(installation);
    let own = camera.into_iter().chain(orientation).chain(span).chain(length_warning(installation)).chain(cad);
    own.chain(find_skin_outliers(&installation.setup).into_iter().filter_map(warning)).collect()
}

/// Distance of the outermost marker from the lens beyond which metres are doubtful, m: wings of flying aircraft end at 60.
const MAX_USUAL_DISTANCE_M: f64 = 70.0;

/// Warns of lengths that are more likely feet.
fn length_warning(installation: &Installation) -> Option<Fault> {
    let setup = &installation.setup;
    let distances = setup.markers.iter().map(|m| (m.position_m - setup.projection_centre_m).norm());
    let (last_m, largest_m) =
        (distances.fold(0.0, f64::max), setup.markers.iter().map(|m| m.diameter_m).fold(0.0, f64::max));
    let problem =
        format!("the outermost marker is {last_m:.0} m from the lens, and the largest is {largest_m:.2} m wide");
    let remedy = "if these are feet, convert all lengths to metres";
    let file = installation.directory.join(&installation.sources[1]);
    (last_m > MAX_USUAL_DISTANCE_M).then(|| Fault::new(file, "columns x_m, y_m, z_m", problem, remedy))
}

/// Ratio of the extents of the tie points, smallest to next, below which they are in one plane.
const FLAT_RATIO: f64 = 0.02;
/// Significance level of the test of the CAD transform, as in results.
const CAD_ALPHA: f64 = 0.01;

/// Warns of tie points that contradict each other or do not show a mirrored axis.
fn cad_warnings(installation: &Installation) -> Vec<Fault> {
    let (Some(fit), points) = (&installation.cad, &installation.setup.tie_points) else { return vec![] };
    let fault = |problem: String, remedy: &str| {
        Fault::new(installation.directory.join(INSTALLATION_FILE), "cad.tie_points", problem, remedy)
    };
    let mut all = vec![];
    if fit.passes_test(CAD_ALPHA) == Some(false) {
        let worst = points.iter().zip(&fit.residuals_m).max_by(|a, b| a.1.norm().total_cmp(&b.1.norm()));
        let (id, off_m) = worst.map_or(("", 0.0), |(point, off)| (point.id.as_str(), off.norm()));
        let factor = fit.variance_factor.unwrap_or(f64::NAN);
        let problem =
            format!("contradict each other (variance factor {factor:.1}): {id} is {off_m:.3} m off the fit of all");
        all.push(fault(problem, "check this point first; standard deviations in the CAD frame are scaled"));
    }
    let axes = principal_axes(points.iter().map(|p| p.survey_m));
    let mut extents: Vec<f64> = axes.eigenvalues.iter().map(|v| v.max(0.0).sqrt()).collect();
    extents.sort_by(f64::total_cmp);
    let up = fit.transform.rotation * Vector3::z();
    if let [flat, next, _] = extents[..]
        && flat < FLAT_RATIO * next
    {
        let axis = ["x", "y", "z"][up.iamax()];
        let sign = if up[up.iamax()] < 0.0 { "-" } else { "+" };
        let problem =
            format!("are in one plane, so that a mirrored axis fits too; upwards is {sign}{axis} of the CAD frame");
        all.push(fault(problem, "check this direction, or add a point off the plane"));
    }
    all
}
