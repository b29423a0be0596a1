//! Effect of each uncertain quantity of an installation on the precision: the installation with the quantity known.

use crate::setup::{Setup, Thermal, Width};

/// Name of an uncertain quantity, and a function that makes it known.
type UncertainTerm = (&'static str, Box<dyn Fn(&mut Setup)>);

/// Width, and a quantity that is listed after that of the width.
type OtherTerm = (Width, &'static str, fn(&mut Setup));

/// Name for all quantities together.
pub(super) const ALL_TERMS: &str = "all of the above";

/// Uncertain quantities that are not widths.
const OTHER_TERMS: [OtherTerm; 4] = [
    (
        Width::SpanDirection,
        "temperature",
        remove_temperature_uncertainty,
    ),
    (Width::MountShift, "camera calibration", |s| {
        s.uncertainty.lens = None
    }),
    (Width::MountShift, "window panes", remove_pane_uncertainty),
    (Width::Readout, "motion of the fixed targets", |s| {
        s.markers.iter_mut().for_each(|m| m.flight_motion_m = 0.0)
    }),
];

/// Returns the uncertain quantities: those of widths, which the registry names, and the others.
fn uncertain_terms() -> Vec<UncertainTerm> {
    let mut terms: Vec<UncertainTerm> = vec![];
    for row in Width::ROWS {
        let Some(name) = row.known_name else { continue };
        if terms.last().is_none_or(|(last, _)| *last != name) {
            let fix = move |setup: &mut Setup| {
                let together = Width::ROWS
                    .iter()
                    .filter(|row| row.known_name == Some(name));
                together.for_each(|row| setup.uncertainty[row.width] = 0.0);
            };
            terms.push((name, Box::new(fix)));
        }
        let others = OTHER_TERMS.iter().filter(|(after, ..)| *after == row.width);
        terms.extend(others.map(|(_, name, fix)| -> UncertainTerm { (*name, Box::new(fix)) }));
    }
    terms
}

fn remove_temperature_uncertainty(setup: &mut Setup) {
    let known = |t: Thermal| Thermal {
        expansion_sigma_per_k: None,
        flight_temperature_sigma_k: None,
        ..t
    };
    setup.thermal = Some(setup.thermal.map_or_else(Thermal::default, known));
}

fn remove_pane_uncertainty(setup: &mut Setup) {
    if let Some(pane) = setup.window.as_mut().and_then(|w| w.pane.as_mut()) {
        (
            pane.thickness_sigma_m,
            pane.index_sigma,
            pane.normal_sigma_rad,
            pane.bow_sigma,
        ) = (0.0, 0.0, 0.0, 0.0);
    }
}

/// Returns the installation with each uncertain quantity known, and with all of them.
pub(super) fn setups_with_known_terms(setup: &Setup) -> Vec<(&'static str, Setup)> {
    let terms = uncertain_terms();
    let known = |(name, fix): &UncertainTerm| {
        let mut other = setup.clone();
        fix(&mut other);
        (other != *setup).then_some((*name, other))
    };
    let mut all: Vec<_> = terms.iter().filter_map(known).collect();
    if all.len() > 1 {
        let mut all_known = setup.clone();
        terms.iter().for_each(|(_, fix)| fix(&mut all_known));
        all.push((ALL_TERMS, all_known));
    }
    all
}
