//! Effect of each uncertain quantity of an installation on the precision: the installation with the quantity known.

use crate::setup::{Setup, Thermal};

/// Name of an uncertain quantity, and a function that makes it known.
type UncertainTerm = (&'static str, fn(&mut Setup));

/// Name for all quantities together.
pub(super) const ALL_TERMS: &str = "all of the above";

/// Uncertain quantities, in the order of `docs/adjustment/installation.md`.
const TERMS: [UncertainTerm; 17] = [
    ("height of the bending axis", |s| s.uncertainty.skin_height_sigma_m = 0.0),
    ("root offset", |s| s.uncertainty.root_offset_m = 0.0),
    ("chord offset of the axis", |s| s.uncertainty.axis_chord_offset_m = 0.0),
    ("span direction", |s| s.uncertainty.span_direction_rad = 0.0),
    ("temperature", fix_temperature),
    ("shift of the mounting", |s| s.uncertainty.mount_shift_m = 0.0),
    ("camera calibration", |s| s.uncertainty.lens = None),
    ("window panes", fix_panes),
    ("bend since the survey", |s| s.uncertainty.in_flight.ground_bend_m = 0.0),
    ("constant bend", |s| s.uncertainty.in_flight.constant_bend_m = 0.0),
    ("motion of the skin", |s| s.uncertainty.in_flight.skin_motion_m = 0.0),
    ("motion of the root", fix_root),
    ("in-plane bending", |s| s.uncertainty.in_flight.in_plane_m = 0.0),
    ("interior orientation in flight", fix_camera_in_flight),
    ("control-surface torque", |s| s.uncertainty.in_flight.torque_rad = 0.0),
    ("rolling shutter", |s| s.uncertainty.in_flight.readout_s = 0.0),
    ("motion of the fixed targets", |s| s.markers.iter_mut().for_each(|m| m.flight_motion_m = 0.0)),
];

fn fix_temperature(setup: &mut Setup) {
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

fn fix_panes(setup: &mut Setup) {
    if let Some(pane) = setup.window.as_mut().and_then(|w| w.pane.as_mut()) {
        (pane.thickness_sigma_m, pane.index_sigma, pane.normal_sigma_rad, pane.bow_sigma) = (0.0, 0.0, 0.0, 0.0);
    }
}

fn fix_root(setup: &mut Setup) {
    let priors = &mut setup.uncertainty.in_flight;
    (priors.root_rotation_rad, priors.root_translation_m) = (0.0, 0.0);
}

fn fix_camera_in_flight(setup: &mut Setup) {
    let priors = &mut setup.uncertainty.in_flight;
    (priors.scale, priors.principal_point_px) = (0.0, 0.0);
}

/// Returns the installation with each uncertain quantity known, and with all of them.
pub(super) fn setups_with_known_terms(setup: &Setup) -> Vec<(&'static str, Setup)> {
    let known = |(name, fix): &UncertainTerm| {
        let mut other = setup.clone();
        fix(&mut other);
        (other != *setup).then_some((*name, other))
    };
    let mut all: Vec<_> = TERMS.iter().filter_map(known).collect();
    if all.len() > 1 {
        let mut all_known = setup.clone();
        TERMS.iter().for_each(|(_, fix)| fix(&mut all_known));
        all.push((ALL_TERMS, all_known));
    }
    all
}
