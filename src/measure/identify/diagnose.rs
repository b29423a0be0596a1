//! Diagnosis of a frame that fits nothing: other interpretations of the image, each with a cause.

use nalgebra::{Matrix2, Rotation3, Vector2, Vector3};

use super::Identities;
use super::beam::WingState;
use super::consensus::find_consensus;
use super::scan::FAMILY;
use super::scene::{WingView, is_usable};
use crate::detect::Detection;
use crate::geometry::Lens;
use crate::setup::{Orientation, Setup};

/// Cause of a mismatch between a frame and the survey.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MismatchCause {
    /// The image fits as its mirror image.
    #[error(
        "the image fits the survey as its mirror image only: it was mirrored, it shows the other wing, or an axis of \
         the survey points the wrong way"
    )]
    Mirrored,
    /// The image is turned by 180 degrees.
    #[error(
        "the image is upside down relative to the ground frames: turn it by 180 degrees, or mount the camera as before"
    )]
    UpsideDown,
    /// The camera is turned by more than a mounting's repeatability.
    #[error(
        "the camera is turned by {shift_px:.0} px ({turn_deg:.1} degrees) relative to the ground frames, but \
         mount_repeatability_px is {expected_px}: take a ground frame with this mounting (`wingd orient`)"
    )]
    Turned {
        /// Shift of the image by the rotation about its axes, px.
        shift_px: f64,
        /// Total rotation, degrees.
        turn_deg: f64,
        /// Configured repeatability of the mounting, px.
        expected_px: f64,
    },
    /// The wing is bent, so the frame is from a flight.
    #[error("the wing is bent by {deflection_m:.1} m at the tip relative to the survey: the frame is from a flight")]
    Bent {
        /// Deflection of the outermost marker, m.
        deflection_m: f64,
    },
}

/// Half width of a window that the scan in flight covers, px: three standard deviations of a mounting's repeatability of 90
/// px.
const WINDOW_PX: f64 = 270.0;
/// Step between such windows, px: less than a window, so that they overlap.
const STEP_PX: f64 = 450.0;
/// Smallest deflection of the outermost marker over span that counts as bent: jacks and fuel move it by less.
const MIN_BEND: f64 = 0.01;
/// Range of trial deflections over span if the camera's attitude is unknown: from taxiing with full tanks to the strongest
/// gust on a slender wing.
const DEFLECTION_RANGE: (f64, f64) = (-0.04, 0.16);
/// Step of trial deflections over span: half a step is within the tolerance of a consensus.
const DEFLECTION_STEP: f64 = 0.02;

/// Ratio of detections to markers above which a frame is clutter: a diagnosis would mean nothing and take seconds.
const CLUTTER_RATIO: usize = 3;

fn is_mostly_clutter(setup: &Setup, detections: &[Detection]) -> bool {
    detections.len() > CLUTTER_RATIO * setup.markers.len()
}

impl WingView<'_> {
    /// Diagnoses a frame in flight that [`WingView::identify_markers`] rejected. Returns `None` if no cause is found.
    pub fn diagnose_frame(&self, detections: &[Detection]) -> Option<MismatchCause> {
        let lens = &self.setup.lens;
        if is_mostly_clutter(self.setup, detections) {
            return None;
        }
        diagnose_turn(self.setup, self.orientation, detections)
            .or_else(|| {
                let turned = rotate_half_turn(lens, detections);
                self.identify_most(&turned).map(|_| MismatchCause::UpsideDown)
            })
            .or_else(|| {
                let across = mirror_detections(lens, detections);
                let along = rotate_half_turn(lens, &across);
                let fit = self.identify_most(&across).or_else(|| self.identify_most(&along));
                fit.map(|_| MismatchCause::Mirrored)
            })
    }

    /// Diagnoses a ground frame that does not fit the orientation of the other frames.
    pub(super) fn diagnose_misfit(&self, detections: &[Detection]) -> Option<MismatchCause> {
        let is_bent = |i: &Identities| i.tip_deflection_m.abs() > MIN_BEND * span_m(self.setup);
        let bent = self.identify_most(detections).filter(is_bent);
        bent.map(|i| MismatchCause::Bent { deflection_m: i.tip_deflection_m })
            .or_else(|| self.diagnose_frame(detections))
    }

    /// Identifies the frame; `None` if less than most of it is identified.
    fn identify_most(&self, detections: &[Detection]) -> Option<Identities> {
        let found = self.identify_markers(detections).ok()?;
        is_convincing(self.setup, detections, found.marker_of.iter().flatten().copied().collect()).then_some(found)
    }
}

/// Diagnoses ground frames that [`super::estimate_orientation`] rejected. Returns the index of a frame and its cause, or
/// `None` if no cause is found.
pub fn diagnose_ground_frames(setup: &Setup, frames: &[Vec<Detection>]) -> Option<(usize, MismatchCause)> {
    frames.iter().enumerate().find_map(|(k, frame)| Some((k, diagnose_ground_frame(setup, frame)?)))
}

/// Diagnoses a ground frame that fits nothing, with unknown attitude of the camera.
fn diagnose_ground_frame(setup: &Setup, detections: &[Detection]) -> Option<MismatchCause> {
    if is_mostly_clutter(setup, detections) {
        return None;
    }
    let mirrored = mirror_detections(&setup.lens, detections);
    let is_mirrored = find_consensus(setup, &mirrored)
        .is_ok_and(|c| is_convincing(setup, detections, c.pairs.iter().map(|p| p.1).collect()));
    if is_mirrored { Some(MismatchCause::Mirrored) } else { diagnose_bend(setup, detections) }
}

/// Returns true if the identified markers are at least two thirds of the markers or of the detections.
fn is_convincing(setup: &Setup, detections: &[Detection], named: Vec<usize>) -> bool {
    let possible = detections.iter().filter(|d| is_usable(d)).count().min(setup.markers.len());
    3 * named.len() >= 2 * possible
}

/// Searches for an orientation that is off by more than a mounting.
fn diagnose_turn(setup: &Setup, orientation: &Orientation, detections: &[Detection]) -> Option<MismatchCause> {
    let wide = Setup { mount_repeatability_px: WINDOW_PX / 3.0, ..setup.clone() };
    let focal_px = setup.lens.focal_px();
    let steps = [0.0, -STEP_PX, STEP_PX];
    let starts = steps.iter().flat_map(|u| steps.iter().map(move |v| Vector3::new(-v / focal_px, u / focal_px, 0.0)));
    starts.map(Rotation3::new).find_map(|start| {
        let camera_from_survey = start * orientation.camera_from_survey;
        let near = Orientation { camera_from_survey, ..orientation.clone() };
        let view = WingView::in_flight(&wide, &near);
        let state = view.fit_state(detections, &view.identify_most(detections)?)?;
        let turn = Rotation3::new(Vector3::new(state[5], state[6], state[7])) * start;
        let axis_rad = turn.scaled_axis();
        Some(MismatchCause::Turned {
            shift_px: focal_px * axis_rad.xy().norm(),
            turn_deg: axis_rad.norm().to_degrees(),
            expected_px: setup.mount_repeatability_px,
        })
    })
}

/// Searches for a bent wing with any attitude: a rigid consensus on wings bent in steps, then the identification in flight.
fn diagnose_bend(setup: &Setup, detections: &[Detection]) -> Option<MismatchCause> {
    let level = Orientation { camera_from_survey: Rotation3::identity(), covariance_rad2: None, ground: vec![] };
    let beam = &WingView::on_ground(setup, &level).beam;
    let span_m = span_m(setup);
    let steps = ((DEFLECTION_RANGE.1 - DEFLECTION_RANGE.0) / DEFLECTION_STEP).round() as usize;
    let deflections = (0..=steps).map(|k| span_m * (DEFLECTION_RANGE.0 + DEFLECTION_STEP * k as f64));
    deflections.filter(|deflection_m| deflection_m.abs() > MIN_BEND * span_m).find_map(|deflection_m| {
        FAMILY.iter().find_map(|(shape, unit)| {
            let mut state = WingState::zeros();
            for (k, s) in shape.iter().enumerate() {
                state[k] = s * unit * deflection_m / (span_m * span_m);
            }
            let mut as_bent = setup.clone();
            for (marker, place) in as_bent.markers.iter_mut().zip(beam.marker_positions(&state, 1.0)) {
                // Half a step at the tip, decreasing with the square of the span.
                let half_step_m = 0.5 * DEFLECTION_STEP * span_m * (place.x / span_m).powi(2);
                marker.position_m = beam.frame.survey_point(&place);
                marker.sigma_m = marker.sigma_m.hypot(half_step_m);
            }
            let rough = find_consensus(&as_bent, detections).ok()?;
            let near = Orientation { camera_from_survey: rough.camera_from_survey, ..level.clone() };
            let wide = Setup { mount_repeatability_px: WINDOW_PX / 3.0, ..setup.clone() };
            let deflection_m = WingView::in_flight(&wide, &near).identify_most(detections)?.tip_deflection_m;
            (deflection_m.abs() > MIN_BEND * span_m).then_some(MismatchCause::Bent { deflection_m })
        })
    })
}

/// Returns the span from the projection centre to the outermost marker, m.
fn span_m(setup: &Setup) -> f64 {
    let frame = setup.wing_frame();
    setup.markers.iter().map(|m| frame.wing_point(&m.position_m).x).fold(1.0, f64::max)
}

/// Turns detections as if the image were turned by 180 degrees.
fn rotate_half_turn(lens: &Lens, detections: &[Detection]) -> Vec<Detection> {
    let corner = Vector2::new(f64::from(lens.width) - 1.0, f64::from(lens.height) - 1.0);
    detections.iter().map(|d| Detection { centre_px: corner - d.centre_px, ..d.clone() }).collect()
}

/// Mirrors detections as if the image were mirrored left to right.
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
