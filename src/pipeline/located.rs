//! Markers where the installation says to look, and closer looks at them when they have names.

use std::ops::Range;

use nalgebra::Vector2;

use crate::measure::detect::{self, Detection, Detections, Expected, Prediction};
use crate::measure::identify::{self, IdentifyError, Identities};
use crate::measure::raster::Raster;
use crate::measure::setup::{Orientation, Setup, Shape};

/// How far aside of its place a missing marker is looked for, px: ten times as far as a simple beam's predictions fail.
const ASIDE_PX: f64 = 100.0;
/// By how much the length of a marker may differ from what the survey and its distance say, as a share: of a disc, and of
/// quadrants, whose white is told less well.
const SAME_SIZE: (f64, f64) = (0.05, 0.15);

/// The markers of a picture of which some columns of each row were decoded, from the nearest outwards ([`identify::locate`]);
/// `None` where that leads nowhere, or out of what was decoded.
pub(super) fn detected(
    raster: &Raster,
    read: &[Range<usize>],
    setup: &Setup,
    orientation: &Orientation,
) -> Option<Detections> {
    let look = |sought: &[Prediction]| detect::detect_guided(raster, sought).markers;
    let predictions = identify::locate(setup, orientation, look)?;
    let needed = detect::columns_read(&predictions, raster.width(), raster.height());
    holds(read, &needed).then(|| detect::detect_guided(raster, &predictions))
}

/// Whether what is needed of each row is among what was read.
pub(super) fn holds(read: &[Range<usize>], needed: &[Range<usize>]) -> bool {
    let holds =
        |(n, r): (&Range<usize>, &Range<usize>)| n.is_empty() || (r.start <= n.start && n.end <= r.end);
    needed.iter().zip(read).all(holds)
}

/// Whether a marker that is missing shows aside of its place, so that the predictions are not to be trusted. What the ground
/// frames did not show, no frame need show.
pub(super) fn shows_aside(
    raster: &Raster,
    setup: &Setup,
    orientation: &Orientation,
    (found, identities): &(Detections, Identities),
) -> bool {
    let mut missing = identify::expect(setup, orientation, &found.markers, identities);
    missing.retain(|e| e.found.is_none() && orientation.ground.iter().any(|sight| sight.marker == e.marker));
    let wider = |e: Expected| Prediction { search_px: Vector2::repeat(ASIDE_PX), ..e.prediction };
    let missing: Vec<Prediction> = missing.into_iter().map(wider).collect();
    if missing.is_empty() {
        return false;
    }
    let is_known =
        |m: &Detection| found.markers.iter().any(|k| (k.centre_px - m.centre_px).norm() < identify::SAME_PX);
    let is_like = |m: &Detection, p: &Prediction| {
        let most = if m.shape == Shape::Circle { SAME_SIZE.0 } else { SAME_SIZE.1 };
        m.shape == p.shape && (m.semi_major_px / p.semi_major_px - 1.0).abs() < most
    };
    let aside = detect::detect_guided(raster, &missing).markers;
    aside.iter().any(|m| !is_known(m) && missing.iter().any(|p| is_like(m, p)))
}

/// Closer looks at most.
pub(super) const LOOKS: usize = 3;

/// Detections, some of them after closer looks at `raster`, and who is who; perspective bias is not removed.
///
/// # Errors
/// Where no consensus names the markers.
pub fn identified(
    setup: &Setup,
    orientation: &Orientation,
    raster: &Raster,
    found: Detections,
) -> Result<(Detections, Identities), IdentifyError> {
    let identities = identify::identify(setup, orientation, &found.markers)?;
    Ok(looked_closer(setup, orientation, raster, found, identities))
}

pub(super) fn looked_closer(
    setup: &Setup,
    orientation: &Orientation,
    raster: &Raster,
    mut found: Detections,
    mut identities: Identities,
) -> (Detections, Identities) {
    // What is measured better foretells the others better.
    for _ in 0..LOOKS {
        let expected = identify::expect(setup, orientation, &found.markers, &identities);
        let mut closer = found.clone();
        if !detect::look_closer(raster, &mut closer, &expected) {
            return (closer, identities);
        }
        let Ok(again) = identify::identify(setup, orientation, &closer.markers) else { break };
        (found, identities) = (closer, again);
    }
    (found, identities)
}
