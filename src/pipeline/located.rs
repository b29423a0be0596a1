//! Markers where the installation says to look, and closer looks at them when they have names.

use nalgebra::Vector2;

use crate::measure::detect::{self, Detection, Detections, Expected, Looker, Prediction};
use crate::measure::identify::{self, IdentifyError, Identities};
use crate::measure::raster::Raster;
use crate::measure::setup::{Orientation, Setup, Shape};
use crate::measure::tiles::Tiles;

/// How far aside of its place a missing marker is looked for, px: ten times as far as a simple beam's predictions fail.
const ASIDE_PX: f64 = 100.0;
/// By how much the length of a marker may differ from what the survey and its distance say, as a share: of a disc, and of
/// quadrants, whose white is told less well.
const SAME_SIZE: (f64, f64) = (0.05, 0.15);

/// A picture of which some was decoded.
pub(super) struct Part {
    pub raster: Raster,
    pub read: Tiles,
}

impl Part {
    /// Its markers, from the nearest outwards ([`identify::locate`]); `None` where that leads nowhere, or out of what was decoded.
    pub(super) fn detected(&self, setup: &Setup, orientation: &Orientation) -> Option<Detections> {
        let mut looker = Looker::new(&self.raster);
        let predictions = identify::locate(setup, orientation, |sought| looker.roughly(sought))?;
        self.holds(&predictions).then(|| looker.closely(&predictions))
    }

    /// Whether all was decoded that is looked at where markers are predicted.
    fn holds(&self, predictions: &[Prediction]) -> bool {
        self.read.hold(&detect::tiles_read(predictions, self.raster.width(), self.raster.height()))
    }

    /// What shows aside of the places of markers that are missing and is like them, as far as that was decoded: however the wing is
    /// bent. What the ground frames did not show, no frame need show.
    pub(super) fn aside(
        &self,
        setup: &Setup,
        orientation: &Orientation,
        (found, identities): &(Detections, Identities),
    ) -> Vec<Detection> {
        let mut missing = identify::expect(setup, orientation, &found.markers, identities);
        let on_ground = |e: &Expected| orientation.ground.iter().any(|sight| sight.marker == e.marker);
        missing.retain(|e| e.found.is_none() && on_ground(e));
        let wider = |e: Expected| Prediction { search_px: Vector2::repeat(ASIDE_PX), ..e.prediction };
        let mut missing: Vec<Prediction> = missing.into_iter().map(wider).collect();
        missing.retain(|p| self.holds(std::slice::from_ref(p)));
        let mut looker = Looker::again(&self.raster, found);
        let same =
            |one: &Detection, other: &Detection| (one.centre_px - other.centre_px).norm() < identify::SAME_PX;
        let search_px = Vector2::repeat(identify::SAME_PX);
        let like = |m: &Detection| {
            let like = missing
                .iter()
                .find(|p| is_like(m, p))
                .filter(|_| !found.markers.iter().any(|known| same(known, m)));
            like.map(|p| Prediction { centre_px: m.centre_px, search_px, ..p.clone() })
        };
        let there: Vec<Prediction> = if missing.is_empty() {
            Vec::new()
        } else {
            looker.roughly(&missing).iter().filter_map(like).collect()
        };
        if there.is_empty() { Vec::new() } else { looker.closely(&there).markers }
    }
}

/// Whether something has a marker's shape and size.
fn is_like(found: &Detection, marker: &Prediction) -> bool {
    let most = if found.shape == Shape::Circle { SAME_SIZE.0 } else { SAME_SIZE.1 };
    found.shape == marker.shape && (found.semi_major_px / marker.semi_major_px - 1.0).abs() < most
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
