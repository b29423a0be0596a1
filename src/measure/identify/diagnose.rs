//! Why a frame's markers fit nothing: other readings of the picture, each of which names a cause.

use nalgebra::{Matrix2, Rotation3, Vector2, Vector3};

use super::Identities;
use super::beam::State;
use super::consensus::find_consensus;
use super::flight::identify_frame;
use super::scan::FAMILY;
use super::scene::{Scene, is_usable};
use super::wing_state::fit_state;
use crate::detect::Detection;
use crate::geometry::Lens;
use crate::setup::{Orientation, Setup};

/// What the markers fit after all.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Cause {
    /// As the mirror image.
    #[error(
        "the picture fits the survey as its mirror image only: it was mirrored, it shows the other wing, or an axis of \
         the survey points the wrong way"
    )]
    Mirrored,
    /// Turned by half a turn.
    #[error(
        "the picture stands on its head against the ground frames: turn it by 180 degrees, or mount the camera as then"
    )]
    UpsideDown,
    /// Turned by more than a mounting's repeatability.
    #[error(
        "the camera is turned by {shift_px:.0} px ({turn_deg:.1} degrees) against the ground frames, where \
         mount_repeatability_px is {expected_px}: take a ground frame with this mounting (`wingd orient`)"
    )]
    Turned {
        /// Shift of the image by the rotation about its axes, px.
        shift_px: f64,
        /// Whole rotation, degrees.
        turn_deg: f64,
        /// What the installation states, px.
        expected_px: f64,
    },
    /// A wing that is not as surveyed.
    #[error(
        "the wing is bent by {deflection_m:.1} m at the tip against the survey: the frame is of a flight"
    )]
    Bent {
        /// Deflection of the outermost marker, m.
        deflection_m: f64,
    },
}

/// Half of a window that the scan in flight takes in, px: three standard deviations of a mounting's repeatability of 90 px.
const WINDOW_PX: f64 = 270.0;
/// Step between such windows, px: less than a whole one, so that they overlap.
const STEP_PX: f64 = 450.0;
/// Deflection of the outermost marker over span from which on a wing is not as on ground: jacks and fuel move it by less.
const MIN_BEND: f64 = 0.01;
/// Deflections tried of a wing whose camera's attitude is unknown, over span: from taxiing with full tanks to the strongest
/// gust of a slender wing.
const DEFLECTION_RANGE: (f64, f64) = (-0.04, 0.16);
/// Step between them, over span: half of it is within what a consensus allows a marker.
const DEFLECTION_STEP: f64 = 0.02;

/// Detections over markers from which on a frame is clutter: nothing is told from it, and looking takes seconds.
const CLUTTER_RATIO: usize = 3;

fn is_clutter(setup: &Setup, detections: &[Detection]) -> bool {
    detections.len() > CLUTTER_RATIO * setup.markers.len()
}

/// Of a frame in flight that fits nothing under `orientation`.
pub(super) fn diagnose_flight_frame(setup: &Setup, orientation: &Orientation, detections: &[Detection]) -> Option<Cause> {
    if is_clutter(setup, detections) {
        return None;
    }
    diagnose_turn(setup, orientation, detections)
        .or_else(|| {
            let turned = rotate_half_turn(&setup.lens, detections);
            identify_most(setup, orientation, &turned).map(|_| Cause::UpsideDown)
        })
        .or_else(|| {
            let across = mirror_detections(&setup.lens, detections);
            let along = rotate_half_turn(&setup.lens, &across);
            let fit = identify_most(setup, orientation, &across).or_else(|| identify_most(setup, orientation, &along));
            fit.map(|_| Cause::Mirrored)
        })
}

/// Of a frame on ground that fits nothing, the camera's attitude unknown.
pub(super) fn diagnose_ground_frame(setup: &Setup, detections: &[Detection]) -> Option<Cause> {
    if is_clutter(setup, detections) {
        return None;
    }
    let mirrored = mirror_detections(&setup.lens, detections);
    let is_mirrored = find_consensus(setup, &mirrored)
        .is_ok_and(|c| is_convincing(setup, detections, c.pairs.iter().map(|p| p.1).collect()));
    if is_mirrored { Some(Cause::Mirrored) } else { diagnose_bend(setup, detections) }
}

/// Of a ground frame that does not fit the others' orientation.
pub(super) fn diagnose_misfit(
    setup: &Setup,
    orientation: &Orientation,
    detections: &[Detection],
) -> Option<Cause> {
    let bent =
        identify_most(setup, orientation, detections).filter(|i| i.tip_deflection_m.abs() > MIN_BEND * span_m(setup));
    bent.map(|i| Cause::Bent { deflection_m: i.tip_deflection_m })
        .or_else(|| diagnose_flight_frame(setup, orientation, detections))
}

/// Identities, where they are of most of the frame.
fn identify_most(setup: &Setup, orientation: &Orientation, detections: &[Detection]) -> Option<Identities> {
    let found = identify_frame(&Scene::new(setup, orientation, true), detections).ok()?;
    is_convincing(setup, detections, found.marker_of.iter().flatten().copied().collect()).then_some(found)
}

/// Another reading is believed where it explains two thirds of the markers or of the detections.
fn is_convincing(setup: &Setup, detections: &[Detection], named: Vec<usize>) -> bool {
    let possible = detections.iter().filter(|d| is_usable(d)).count().min(setup.markers.len());
    3 * named.len() >= 2 * possible
}

/// Under an orientation that is off by more than a mounting.
fn diagnose_turn(setup: &Setup, orientation: &Orientation, detections: &[Detection]) -> Option<Cause> {
    let wide = Setup { mount_repeatability_px: WINDOW_PX / 3.0, ..setup.clone() };
    let focal_px = setup.lens.focal_px();
    let steps = [0.0, -STEP_PX, STEP_PX];
    let starts =
        steps.iter().flat_map(|u| steps.iter().map(move |v| Vector3::new(-v / focal_px, u / focal_px, 0.0)));
    starts.map(Rotation3::new).find_map(|start| {
        let camera_from_survey = start * orientation.camera_from_survey;
        let near = Orientation { camera_from_survey, ..orientation.clone() };
        let identities = identify_most(&wide, &near, detections)?;
        let state = fit_state(&Scene::new(&wide, &near, true), detections, &identities)?;
        let turn = Rotation3::new(Vector3::new(state[5], state[6], state[7])) * start;
        let by = turn.scaled_axis();
        Some(Cause::Turned {
            shift_px: focal_px * by.xy().norm(),
            turn_deg: by.norm().to_degrees(),
            expected_px: setup.mount_repeatability_px,
        })
    })
}

/// A bent wing under any attitude: a rigid consensus on wings bent by steps, then the identification in flight.
fn diagnose_bend(setup: &Setup, detections: &[Detection]) -> Option<Cause> {
    let level =
        Orientation { camera_from_survey: Rotation3::identity(), covariance_rad2: None, ground: vec![] };
    let beam = &Scene::new(setup, &level, false).beam;
    let span_m = span_m(setup);
    let steps = ((DEFLECTION_RANGE.1 - DEFLECTION_RANGE.0) / DEFLECTION_STEP).round() as usize;
    let deflections = (0..=steps).map(|k| span_m * (DEFLECTION_RANGE.0 + DEFLECTION_STEP * k as f64));
    deflections.filter(|deflection_m| deflection_m.abs() > MIN_BEND * span_m).find_map(|deflection_m| {
        FAMILY.iter().find_map(|(shape, unit)| {
            let mut state = State::zeros();
            for (k, s) in shape.iter().enumerate() {
                state[k] = s * unit * deflection_m / (span_m * span_m);
            }
            let mut as_bent = setup.clone();
            for (marker, place) in as_bent.markers.iter_mut().zip(beam.marker_positions(&state, 1.0)) {
                // Half a step at the tip, and by the square of the way there.
                let half_step_m = 0.5 * DEFLECTION_STEP * span_m * (place.x / span_m).powi(2);
                marker.position_m = beam.frame.survey_point(&place);
                marker.sigma_m = marker.sigma_m.hypot(half_step_m);
            }
            let rough = find_consensus(&as_bent, detections).ok()?;
            let near = Orientation { camera_from_survey: rough.camera_from_survey, ..level.clone() };
            let wide = Setup { mount_repeatability_px: WINDOW_PX / 3.0, ..setup.clone() };
            let deflection_m = identify_most(&wide, &near, detections)?.tip_deflection_m;
            (deflection_m.abs() > MIN_BEND * span_m).then_some(Cause::Bent { deflection_m })
        })
    })
}

/// From the projection centre to the outermost marker along the span.
fn span_m(setup: &Setup) -> f64 {
    let frame = setup.wing_frame();
    setup.markers.iter().map(|m| frame.wing_point(&m.position_m).x).fold(1.0, f64::max)
}

/// As they would lie in the picture turned by 180 degrees.
fn rotate_half_turn(lens: &Lens, detections: &[Detection]) -> Vec<Detection> {
    let corner = Vector2::new(f64::from(lens.width) - 1.0, f64::from(lens.height) - 1.0);
    detections.iter().map(|d| Detection { centre_px: corner - d.centre_px, ..d.clone() }).collect()
}

/// As they would lie in the picture mirrored left to right.
fn mirror_detections(lens: &Lens, detections: &[Detection]) -> Vec<Detection> {
    let last = f64::from(lens.width) - 1.0;
    let mirror = |d: &Detection| {
        let mut next = d.clone();
        next.centre_px.x = last - d.centre_px.x;
        let [uu, uv, vv] = [(0, 0), (0, 1), (1, 1)].map(|k| d.covariance_px2[k]);
        next.covariance_px2 = Matrix2::new(uu, -uv, -uv, vv).into();
        next.angle_rad = -d.angle_rad;
        next
    };
    detections.iter().map(mirror).collect()
}
