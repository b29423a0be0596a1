//! What each thing that a user can only estimate costs in precision: the same installation with it known.

use crate::setup::{Setup, Thermal};

/// A term of the model, and how it is made known.
type Term = (&'static str, fn(&mut Setup));

/// Every term known.
pub(super) const ALL: &str = "all of these";

/// In the order of `docs/adjustment/installation.md`.
const TERMS: [Term; 17] = [
    ("height of the bending axis", |s| s.uncertainty.skin_height_sigma_m = 0.0),
    ("root offset", |s| s.uncertainty.root_offset_m = 0.0),
    ("chord offset of the axis", |s| s.uncertainty.axis_chord_offset_m = 0.0),
    ("span direction", |s| s.uncertainty.span_direction_rad = 0.0),
    ("temperature", know_temperature),
    ("shift of the mounting", |s| s.uncertainty.mount_shift_m = 0.0),
    ("camera calibration", |s| s.uncertainty.lens = None),
    ("panes", know_panes),
    ("bend on ground", |s| s.uncertainty.in_flight.ground_bend_m = 0.0),
    ("bend without load", |s| s.uncertainty.in_flight.constant_bend_m = 0.0),
    ("motion of the skin", |s| s.uncertainty.in_flight.skin_motion_m = 0.0),
    ("motion of the root", know_root),
    ("bending in the plane", |s| s.uncertainty.in_flight.in_plane_m = 0.0),
    ("camera in flight", know_camera_in_flight),
    ("torque of control surfaces", |s| s.uncertainty.in_flight.torque_rad = 0.0),
    ("rolling shutter", |s| s.uncertainty.in_flight.readout_s = 0.0),
    ("motion of the fixed marks", |s| s.markers.iter_mut().for_each(|m| m.flight_motion_m = 0.0)),
];

fn know_temperature(setup: &mut Setup) {
    let unchanged = Thermal {
        expansion_per_k: 0.0,
        expansion_sigma_per_k: None,
        ground_temperature_c: 0.0,
        flight_temperature_c: 0.0,
        flight_temperature_sigma_k: None,
    };
    let known = |t: Thermal| Thermal { expansion_sigma_per_k: None, flight_temperature_sigma_k: None, ..t };
    setup.thermal = Some(setup.thermal.map_or(unchanged, known));
}

fn know_panes(setup: &mut Setup) {
    if let Some(pane) = setup.window.as_mut().and_then(|w| w.pane.as_mut()) {
        (pane.thickness_sigma_m, pane.index_sigma, pane.normal_sigma_rad, pane.bow_sigma) =
            (0.0, 0.0, 0.0, 0.0);
    }
}

fn know_root(setup: &mut Setup) {
    let width = &mut setup.uncertainty.in_flight;
    (width.root_rotation_rad, width.root_translation_m) = (0.0, 0.0);
}

fn know_camera_in_flight(setup: &mut Setup) {
    let width = &mut setup.uncertainty.in_flight;
    (width.scale, width.principal_point_px) = (0.0, 0.0);
}

/// The installation with each term known that it leaves open, and with all of them.
pub(super) fn each_known(setup: &Setup) -> Vec<(&'static str, Setup)> {
    let known = |(name, make): &Term| {
        let mut other = setup.clone();
        make(&mut other);
        (other != *setup).then_some((*name, other))
    };
    let mut all: Vec<_> = TERMS.iter().filter_map(known).collect();
    if all.len() > 1 {
        let mut together = setup.clone();
        TERMS.iter().for_each(|(_, make)| make(&mut together));
        all.push((ALL, together));
    }
    all
}
