//! Positions of the markers on the ground and in flight, in the wing frame.

use nalgebra::Vector3;

use wingd_evaluation::record::ImageRecord;
use wingd_evaluation::results::{GroundMarker, ReportSite};

pub(super) const GROUND_COLOUR: &str = "#6d737d";

/// Marker positions in the wing frame, m.
pub(super) struct PlacedMarker {
    pub(super) id: String,
    pub(super) ground: Option<Vector3<f64>>,
    pub(super) flight: Option<Vector3<f64>>,
}

/// Returns the positions of the surveyed markers.
pub(super) fn place_markers(record: &ImageRecord, site: &ReportSite) -> Vec<PlacedMarker> {
    let in_wing = |position_m: [f64; 3]| {
        let placed = site.wing.wing_point(&Vector3::from(position_m));
        placed.iter().all(|v| v.is_finite()).then_some(placed)
    };
    let place = |g: &GroundMarker| {
        let marker = record.markers.iter().find(|m| m.id == g.id);
        PlacedMarker {
            id: g.id.clone(),
            ground: in_wing(g.position_m),
            flight: marker.and_then(|m| in_wing(m.position_m?)),
        }
    };
    site.ground.iter().map(place).collect()
}
