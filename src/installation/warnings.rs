//! Warnings about an installation: surveyed points off the skin of the others, and an accepted calibration.

use super::{Fault, Installation};
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
    let camera = installation.accepted.as_ref().map(|reason| Fault {
        file: installation.directory.join(&installation.sources[0]),
        place: "calibration.accepted".into(),
        problem: format!("a refused calibration was accepted: {reason}"),
        remedy: "calibrate again with the images that the verdict asks for".into(),
    });
    camera.into_iter().chain(find_skin_outliers(&installation.setup).into_iter().filter_map(warning)).collect()
}
