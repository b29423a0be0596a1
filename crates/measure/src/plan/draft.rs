//! A layout of markers for a wing of known main dimensions.

use nalgebra::Vector3;

use super::prediction::SimulatedFlight;
use super::{PlanOptions, fixed_targets, requirement};
use crate::adjust::{AdjustError, AdjustResult};
use crate::geometry::Lens;
use crate::setup::{Setup, Shape, SurveyMarker, TorsionPair, WingSide};

/// Dimensions of a wing and numbers of its markers. The survey frame has its origin in the projection centre, x outboard
/// along the span, z up: the trailing edge of a right wing is at negative y, that of a left one at positive y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayoutDraft {
    /// Side of the wing.
    pub side: WingSide,
    /// Span from the camera to the wing tip, m.
    pub span_m: f64,
    /// Height of the camera above the skin at the root, m; the wing is taken as level.
    pub height_m: f64,
    /// Chord at the root, m.
    pub chord_m: f64,
    /// Interior orientation.
    pub lens: Lens,
    /// Number of markers on the wing, including the pair at the tip.
    pub markers: usize,
    /// Number of fixed targets, rigid to the cabin; 4 at most.
    pub fixed: usize,
}

/// Chord at the tip over that at the root: 0.25 to 0.45 for most transport wings.
const TAPER: f64 = 0.35;
/// Chordwise position of the markers as a fraction of the half chord: on the box, clear of flaps and slats.
const CHORD_FRACTION: f64 = 0.6;
/// Outermost station over the span.
const OUTERMOST_FRACTION: f64 = 0.975;
/// Used fraction of the half image, across the span and along the height.
const USED_FRACTION: f64 = 0.9;
/// Fraction of the span out to which markers are quadrant targets; beyond it they are discs.
const QUADRANT_FRACTION: f64 = 0.45;
/// Smallest image of a disc along the view that is measured well, px; then the smallest and largest size of a print, m.
const MIN_IMAGE_PX: f64 = 6.0;
const PRINT_RANGE_M: (f64, f64) = (0.2, 0.6);
/// Step of the prints' sizes, m.
const PRINT_STEP_M: f64 = 0.05;
/// Standard deviation of a survey by total station, m.
const SURVEY_SIGMA_M: f64 = 0.002;
/// Trial exponents of the stations' spacing: markers dense at the root, even, dense at the tip.
const SPACING_EXPONENTS: [f64; 3] = [1.4, 1.0, 0.7];

/// Creates an installation with the most precise of the trial layouts for this wing; if none gives an adjustment, with the
/// first.
///
/// # Errors
/// Returns an error if the dimensions give no wing.
pub fn best_layout(
    draft: &LayoutDraft,
    installation: &Setup,
    options: &PlanOptions,
    frames: usize,
) -> AdjustResult<Setup> {
    let mut best: Option<(f64, Setup)> = None;
    for crowding in SPACING_EXPONENTS {
        let setup = build_drafted_setup(draft, installation, options, crowding)?;
        let precision = requirement::predict_precision(&setup, None, options, frames, None);
        let sigma_m = precision.map_or(f64::INFINITY, |p| p.sigma_tip_deflection_m);
        if best.as_ref().is_none_or(|(least, _)| sigma_m < *least) {
            best = Some((sigma_m, setup));
        }
    }
    best.map(|(_, setup)| setup)
        .ok_or_else(|| AdjustError::Input("no layout fits these dimensions".into()))
}

fn build_drafted_setup(
    draft: &LayoutDraft,
    installation: &Setup,
    options: &PlanOptions,
    crowding: f64,
) -> AdjustResult<Setup> {
    let mut setup = installation.clone();
    setup.markers = place_markers(draft, options.tip_deflection_m, crowding);
    let count = setup.markers.len();
    setup.torsion = vec![TorsionPair {
        name: "tip".into(),
        leading: count - 2,
        trailing: count - 1,
    }];
    if draft.fixed > 0 {
        let simulation = SimulatedFlight::new(&setup, None, options)?;
        let (attitude, taken) = (&simulation.orientation, simulation.taken_places());
        // Markers of a wide wing may leave room for fewer.
        let add = |count| {
            fixed_targets::add_fixed_targets(
                &setup,
                attitude,
                (0, count, options.pixel_sigma),
                &taken,
            )
        };
        let added = (1..=draft.fixed).rev().find_map(add);
        setup = added.map(|(with_targets, _)| with_targets).unwrap_or(setup);
    }
    Ok(setup)
}

/// Creates a first layout, evenly spaced.
pub fn even_layout(draft: &LayoutDraft, tip_deflection_m: f64) -> Vec<SurveyMarker> {
    place_markers(draft, tip_deflection_m, 1.0)
}

/// Places at least five markers on the wing, alternating between leading and trailing edge.
fn place_markers(draft: &LayoutDraft, tip_deflection_m: f64, crowding: f64) -> Vec<SurveyMarker> {
    let count = draft.markers.max(5);
    let single = count - 2;
    let first = nearest_station_m(draft, tip_deflection_m);
    let last = OUTERMOST_FRACTION * draft.span_m;
    let station =
        |k: usize| first + (last - first) * (k as f64 / (single - 1) as f64).powf(crowding);
    // The pair is clear of the prints on both sides.
    let pair = 0.5 * (station(single - 2) + station(single - 1));
    let position = |k: usize| match k.checked_sub(single) {
        None => (station(k), k.is_multiple_of(2)),
        Some(of_pair) => (pair, of_pair == 0),
    };
    (0..count)
        .map(|k| (k, position(k)))
        .map(|(k, (along, leading))| draft_marker(draft, k, along, leading))
        .collect()
}

fn draft_marker(draft: &LayoutDraft, k: usize, along_m: f64, leading: bool) -> SurveyMarker {
    let half_chord =
        0.5 * draft.chord_m * (1.0 - (1.0 - TAPER) * (along_m / draft.span_m).min(1.0));
    let in_view = USED_FRACTION * 0.5 * f64::from(draft.lens.width) / draft.lens.fx * along_m;
    let offset_m = (CHORD_FRACTION * half_chord).min(in_view);
    let (shape, diameter_m) = choose_print(draft, along_m);
    SurveyMarker {
        id: format!("M{:02}", k + 1),
        shape,
        diameter_m,
        position_m: Vector3::new(
            along_m,
            if leading == (draft.side == WingSide::Right) {
                offset_m
            } else {
                -offset_m
            },
            -draft.height_m,
        ),
        sigma_m: SURVEY_SIGMA_M,
        fixed: false,
        flight_motion_m: 0.0,
        part: None,
    }
}

/// Chooses kind and size of a marker, large enough for its image along the view.
fn choose_print(draft: &LayoutDraft, along_m: f64) -> (Shape, f64) {
    let shape = if along_m < QUADRANT_FRACTION * draft.span_m {
        Shape::Quadrant
    } else {
        Shape::Circle
    };
    let least = MIN_IMAGE_PX * along_m * along_m / (draft.height_m * draft.lens.fy);
    let steps = (least.clamp(PRINT_RANGE_M.0, PRINT_RANGE_M.1) / PRINT_STEP_M - 1e-9).ceil();
    (shape, steps * PRINT_STEP_M)
}

/// Returns the nearest station that the image can show together with the deflected tip, m from the camera.
fn nearest_station_m(draft: &LayoutDraft, tip_deflection_m: f64) -> f64 {
    let top = (tip_deflection_m.max(0.0) - draft.height_m).atan2(draft.span_m);
    let view = 2.0 * USED_FRACTION * (0.5 * f64::from(draft.lens.height) / draft.lens.fy).atan();
    let bottom = (top - view).max(-1.4);
    let nearest = if bottom < 0.0 {
        draft.height_m / (-bottom).tan()
    } else {
        draft.span_m
    };
    nearest.clamp(1.0, 0.5 * draft.span_m)
}
