//! Surveyed points that can hardly be right: of two markers in one place, and off the skin that the others lie on.

use std::path::PathBuf;

use super::{Fault, Installation};
use crate::measure::adjust::ground::off_the_skin;

/// A fault for every point of the survey that can hardly be right.
pub fn doubtful_points(installation: &Installation) -> Vec<Fault> {
    // Files are listed as they are read: installation, camera, survey.
    let survey = installation.digests.get(2).map_or("survey.csv", |(name, _)| name.as_str());
    let file = installation.directory.join(survey);
    let mut faults = overlapping(installation, &file);
    let markers = &installation.setup.markers;
    for point in off_the_skin(&installation.setup) {
        let Some(marker) = markers.get(point.marker) else { continue };
        let problem = format!(
            "lies {:.3} m {} the smooth skin through the others ({:.0} standard deviations)",
            point.height_m.abs(),
            if point.height_m > 0.0 { "above" } else { "below" },
            point.height_m.abs() / point.sigma_m
        );
        faults.push(fault(&file, &marker.id, problem, "compare its coordinates with the survey's protocol"));
    }
    faults
}

/// Two markers whose prints would lie on each other.
fn overlapping(installation: &Installation, file: &std::path::Path) -> Vec<Fault> {
    let markers = &installation.setup.markers;
    let mut faults = vec![];
    for (k, marker) in markers.iter().enumerate() {
        for other in &markers[..k] {
            let apart_m = (marker.position_m - other.position_m).norm();
            if apart_m < 0.5 * (marker.diameter_m + other.diameter_m) {
                let problem = format!("lies {apart_m:.3} m from {}, so that the two would overlap", other.id);
                faults.push(fault(file, &marker.id, problem, "survey both again, or keep one of them"));
            }
        }
    }
    faults
}

fn fault(file: &std::path::Path, id: &str, problem: String, mend: &str) -> Fault {
    Fault { file: PathBuf::from(file), place: format!("marker \"{id}\""), problem, mend: mend.into() }
}
