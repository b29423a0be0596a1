//! Surveyed points that can hardly be right: off the skin that the others lie on.

use super::{Fault, Installation};
use crate::measure::adjust::ground::off_the_skin;

/// What of the survey is to be looked at. It holds nothing up: such a point takes no part where its image says the same.
pub fn doubts(installation: &Installation) -> Vec<Fault> {
    let file = installation.directory.join(&installation.sources[1]);
    let markers = &installation.setup.markers;
    let doubt = |point: crate::measure::adjust::ground::OffTheSkin| {
        let problem = format!(
            "lies {:.3} m {} the smooth skin through the others ({:.0} standard deviations)",
            point.height_m.abs(),
            if point.height_m > 0.0 { "above" } else { "below" },
            point.height_m.abs() / point.sigma_m
        );
        Some(Fault {
            file: file.clone(),
            place: format!("marker \"{}\"", markers.get(point.marker)?.id),
            problem,
            remedy: "compare its coordinates with the survey's protocol".into(),
        })
    };
    let camera = installation.accepted.as_ref().map(|reason| Fault {
        file: installation.directory.join(&installation.sources[0]),
        place: "calibration.accepted".into(),
        problem: format!("the calibration was refused, and taken all the same: {reason}"),
        remedy: "calibrate again with pictures that the verdict asks for".into(),
    });
    camera.into_iter().chain(off_the_skin(&installation.setup).into_iter().filter_map(doubt)).collect()
}
