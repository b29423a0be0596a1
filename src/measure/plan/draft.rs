//! A layout of markers for a wing of which only its main dimensions are known.

use nalgebra::Vector3;

use super::{PlanOptions, fixed_marks, want};
use crate::adjust::AdjustError;
use crate::geometry::Lens;
use crate::setup::{Setup, Shape, SurveyMarker, TorsionPair};

/// A wing and what is to be glued on it. The survey frame has its origin in the projection centre, x outboard along the span,
/// z up; a right wing, whose trailing edge is at negative y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Draft {
    /// From the camera to the wing tip along the span, m.
    pub span_m: f64,
    /// Camera above the skin at the root, m; the wing is taken to lie level.
    pub height_m: f64,
    /// Chord at the root, m.
    pub chord_m: f64,
    /// Interior orientation.
    pub lens: Lens,
    /// Markers on the wing, the pair at the tip included.
    pub markers: usize,
    /// Marks that are rigid to the cabin, 4 at most.
    pub fixed: usize,
}

/// Chord at the tip over that at the root: of most transport wings 0.25 to 0.45.
const TAPER: f64 = 0.35;
/// Share of the half chord at which markers stand: on the box, clear of flaps and slats.
const CHORD_SHARE: f64 = 0.6;
/// Outermost station over the span.
const OUTERMOST: f64 = 0.975;
/// Share of the half picture that is used across the span and along the height.
const USED: f64 = 0.9;
/// Quadrants out to this share of the span, discs beyond.
const QUADRANTS: f64 = 0.45;
/// Least image of a disc along the view that is measured well, px; and what a print may measure, m.
const MIN_IMAGE_PX: f64 = 6.0;
const PRINTS_M: (f64, f64) = (0.2, 0.6);
/// Prints come in steps, m.
const PRINT_STEP_M: f64 = 0.05;
/// Standard deviation of a survey by total station, m.
const SURVEY_SIGMA_M: f64 = 0.002;
/// Exponents of the stations' spacing that are tried: markers crowded at the root, even, crowded at the tip.
const CROWDING: [f64; 3] = [1.4, 1.0, 0.7];

/// Of the spacings that are tried the one that is worth most, put into an installation of the same wing.
///
/// # Errors
/// Where none of them gives an adjustment.
pub fn best(
    draft: &Draft,
    installation: &Setup,
    options: &PlanOptions,
    frames: usize,
) -> Result<Setup, AdjustError> {
    let mut best: Option<(f64, Setup)> = None;
    let mut failure = AdjustError::Input("no layout can be made of these numbers".into());
    for crowding in CROWDING {
        let setup = laid_out(draft, installation, options, crowding)?;
        match want::predict_precision(&setup, None, options, frames, None) {
            Ok(worth) if best.as_ref().is_none_or(|(sigma, _)| worth.sigma_tip_deflection_m < *sigma) => {
                best = Some((worth.sigma_tip_deflection_m, setup));
            }
            Ok(_) => {}
            Err(error) => failure = error,
        }
    }
    best.map(|(_, setup)| setup).ok_or(failure)
}

fn laid_out(
    draft: &Draft,
    installation: &Setup,
    options: &PlanOptions,
    crowding: f64,
) -> Result<Setup, AdjustError> {
    let mut setup = installation.clone();
    setup.markers = markers(draft, options.tip_deflection_m, crowding);
    let count = setup.markers.len();
    setup.torsion = vec![TorsionPair { name: "tip".into(), leading: count - 2, trailing: count - 1 }];
    if draft.fixed > 0 {
        let attitude = super::prediction::SimulatedFlight::new(&setup, None, options)?.orientation;
        let wanted = (0, draft.fixed, options.pixel_sigma);
        if let Some((with, _)) = fixed_marks::with_marks(&setup, &attitude, wanted) {
            setup = with;
        }
    }
    Ok(setup)
}

/// A first layout, evenly spaced.
pub fn layout(draft: &Draft, tip_deflection_m: f64) -> Vec<SurveyMarker> {
    markers(draft, tip_deflection_m, 1.0)
}

/// The markers on the wing, leading and trailing edge in turn, at least five of them.
fn markers(draft: &Draft, tip_deflection_m: f64, crowding: f64) -> Vec<SurveyMarker> {
    let count = draft.markers.max(5);
    let single = count - 2;
    let first = nearest_m(draft, tip_deflection_m);
    let last = OUTERMOST * draft.span_m;
    let station = |k: usize| first + (last - first) * (k as f64 / (single - 1) as f64).powf(crowding);
    // Clear of the prints on both sides.
    let pair = 0.5 * (station(single - 2) + station(single - 1));
    let place = |k: usize| match k.checked_sub(single) {
        None => (station(k), k.is_multiple_of(2)),
        Some(of_pair) => (pair, of_pair == 0),
    };
    (0..count).map(|k| (k, place(k))).map(|(k, (along, leading))| marker(draft, k, along, leading)).collect()
}

fn marker(draft: &Draft, k: usize, along_m: f64, leading: bool) -> SurveyMarker {
    let half_chord = 0.5 * draft.chord_m * (1.0 - (1.0 - TAPER) * (along_m / draft.span_m).min(1.0));
    let in_view = USED * 0.5 * f64::from(draft.lens.width) / draft.lens.fx * along_m;
    let aside = (CHORD_SHARE * half_chord).min(in_view);
    let (shape, diameter_m) = print(draft, along_m);
    SurveyMarker {
        id: format!("M{:02}", k + 1),
        shape,
        diameter_m,
        position_m: Vector3::new(along_m, if leading { aside } else { -aside }, -draft.height_m),
        sigma_m: SURVEY_SIGMA_M,
        fixed: false,
        flight_motion_m: 0.0,
        part: None,
    }
}

/// Kind and size of a marker: large enough for its image along the view.
fn print(draft: &Draft, along_m: f64) -> (Shape, f64) {
    let shape = if along_m < QUADRANTS * draft.span_m { Shape::Quadrant } else { Shape::Circle };
    let least = MIN_IMAGE_PX * along_m * along_m / (draft.height_m * draft.lens.fy);
    let steps = (least.clamp(PRINTS_M.0, PRINTS_M.1) / PRINT_STEP_M - 1e-9).ceil();
    (shape, steps * PRINT_STEP_M)
}

/// The nearest station that the picture shows together with the deflected tip, m from the camera.
fn nearest_m(draft: &Draft, tip_deflection_m: f64) -> f64 {
    let top = (tip_deflection_m.max(0.0) - draft.height_m).atan2(draft.span_m);
    let view = 2.0 * USED * (0.5 * f64::from(draft.lens.height) / draft.lens.fy).atan();
    let bottom = (top - view).max(-1.4);
    let nearest = if bottom < 0.0 { draft.height_m / (-bottom).tan() } else { draft.span_m };
    nearest.clamp(1.0, 0.5 * draft.span_m)
}
