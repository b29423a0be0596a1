//! Projection of the markers for a state of wing and mount, linearised.

use nalgebra::{Matrix2, Rotation3, SMatrix, Vector2, Vector3};

use super::beam::{CoarseBeam, WingState};
use super::outline::{DiscOutline, SkinDisc};
use crate::detect::Detection;
use crate::environment::Plate;
use crate::geometry::cross_matrix;
use crate::observation::Observation;
use crate::setup::{Orientation, Setup, Shape};

pub(super) type Matrix8 = SMatrix<f64, 8, 8>;
pub(super) type Jacobian = SMatrix<f64, 2, 8>;

/// Standard deviation of the simple beam at a marker, m.
pub(super) const MODEL_SIGMA_M: f64 = 0.004;
/// Standard deviation of outline centres and of a lens of few terms, px.
pub(super) const PIXEL_FLOOR_PX: f64 = 0.6;
/// Smallest standard deviation of the camera's rotation across its axis, px.
const MIN_TURN_PX: f64 = 20.0;
/// Smallest standard deviation of the camera's rotation about its axis, rad: a mounting repeats it less well.
const MIN_ROLL_RAD: f64 = 5e-3;
/// Smallest share of the markers on the ground frames that the guided search must name, unless one is near the tip.
const MIN_NAMED_SHARE: f64 = 2.0 / 3.0;
/// Fraction of the span from which on a marker is near the tip, where only a state that is right along the wing names it.
const NEAR_TIP: f64 = 0.75;
/// Steps of the differences for the wing's part of the Jacobian: 1/m, rad.
const STEPS: [f64; 5] = [1e-5, 1e-5, 1e-5, 1e-4, 1e-4];

/// A wing seen by a camera of known attitude: identifies its markers, and predicts their images.
pub struct WingView<'a> {
    /// Survey, camera and priors.
    pub setup: &'a Setup,
    /// Attitude of the camera, with the observations of the ground frames.
    pub orientation: &'a Orientation,
    pub(super) beam: CoarseBeam,
    camera_from_wing: Rotation3<f64>,
    /// Window pane, camera frame.
    pane: Option<Plate>,
    scale: f64,
}

/// Predicted image of a marker.
#[derive(Clone, Copy, Debug)]
pub(super) struct PredictedImage {
    pub(super) pixel: Vector2<f64>,
    /// Derivative with respect to the state.
    pub(super) jacobian: Jacobian,
    /// Covariance from survey, projection centre and the coarse model, px^2, without the detection's.
    pub(super) covariance: Matrix2<f64>,
}

impl PredictedImage {
    /// Returns the covariance of the position, px^2, given the `covariance` of the state.
    pub(super) fn spread_px2(&self, covariance: &Matrix8) -> Matrix2<f64> {
        self.jacobian * covariance * self.jacobian.transpose() + self.covariance
    }

    /// Returns the standard deviations of the position along u and v, px, given the `covariance` of the state.
    pub(super) fn sigma_px(&self, covariance: &Matrix8) -> Vector2<f64> {
        let spread = self.spread_px2(covariance);
        Vector2::new(spread[(0, 0)], spread[(1, 1)]).map(|variance| variance.max(0.0).sqrt())
    }
}

impl<'a> WingView<'a> {
    /// Creates the view of a wing in flight.
    pub fn in_flight(setup: &'a Setup, orientation: &'a Orientation) -> Self {
        Self::new(setup, orientation, true)
    }

    /// Creates the view of a wing as surveyed: without thermal expansion, and through the panes of a ground frame.
    pub fn on_ground(setup: &'a Setup, orientation: &'a Orientation) -> Self {
        Self::new(setup, orientation, false)
    }

    fn new(setup: &'a Setup, orientation: &'a Orientation, in_flight: bool) -> Self {
        let beam = CoarseBeam::new(setup, &orientation.shaping_markers(setup.markers.len()));
        Self::with_beam(setup, orientation, in_flight, beam)
    }

    /// Creates the view of a wing whose beam is known.
    pub(super) fn with_beam(
        setup: &'a Setup,
        orientation: &'a Orientation,
        in_flight: bool,
        beam: CoarseBeam,
    ) -> Self {
        let camera_from_wing =
            orientation.camera_from_survey * beam.frame.wing_from_survey.inverse();
        let thermal = setup.thermal.filter(|_| in_flight);
        let pane = Plate::from_window(
            setup.window.as_ref(),
            &orientation.camera_from_survey,
            in_flight,
        );
        Self {
            setup,
            orientation,
            beam,
            camera_from_wing,
            pane,
            scale: thermal.map_or(1.0, |t| t.scale()),
        }
    }

    /// Returns standard deviations of the camera's rotation since the ground frames, about its own axes, rad.
    pub(super) fn turn_sigmas(&self) -> [f64; 3] {
        let turn = self.setup.mount_repeatability_px.max(MIN_TURN_PX) / self.setup.lens.focal_px();
        [turn, turn, turn.max(MIN_ROLL_RAD)]
    }

    /// Returns the point at which the camera sees a point of the wing frame, camera frame, m.
    fn apparent_point(&self, rotation: &Rotation3<f64>, point_m: &Vector3<f64>) -> Vector3<f64> {
        let p = rotation * point_m;
        self.pane.map_or(p, |pane| pane.apparent_point(&p))
    }

    fn camera_from_wing(&self, state: &WingState) -> Rotation3<f64> {
        Rotation3::new(Vector3::new(state[5], state[6], state[7])) * self.camera_from_wing
    }

    /// Returns the pixels of all markers; `None` behind the camera.
    pub(super) fn project_markers(&self, state: &WingState) -> Vec<Option<Vector2<f64>>> {
        self.project_points(&self.beam, state)
    }

    /// Returns the pixels of the points of a beam; `None` behind the camera.
    pub(super) fn project_points(
        &self,
        beam: &CoarseBeam,
        state: &WingState,
    ) -> Vec<Option<Vector2<f64>>> {
        let rotation = self.camera_from_wing(state);
        let lens = &self.setup.lens;
        beam.marker_positions(state, self.scale)
            .iter()
            .map(|p| lens.project(&self.apparent_point(&rotation, p)))
            .collect()
    }

    /// Returns the pixel of a point, wing frame, m, whose place does not depend on the state; `None` behind the camera.
    pub(super) fn project_on_ground(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.setup
            .lens
            .project(&self.apparent_point(&self.camera_from_wing(&WingState::zeros()), point))
    }

    /// Returns the predicted images of all markers, with Jacobians and covariances; `None` behind the camera.
    pub(super) fn linearise(&self, state: &WingState) -> Vec<Option<PredictedImage>> {
        let rotation = self.camera_from_wing(state);
        let placed = self.beam.marker_positions(state, self.scale);
        let stepped: [Vec<Vector3<f64>>; 5] = std::array::from_fn(|k| {
            let mut next = *state;
            next[k] += STEPS[k];
            self.beam.marker_positions(&next, self.scale)
        });
        let centre = self.setup.projection_centre_sigma_m;
        let common = centre * centre + MODEL_SIGMA_M * MODEL_SIGMA_M;
        (0..placed.len())
            .map(|j| {
                let p = self.apparent_point(&rotation, &placed[j]);
                let (pixel, by_point) = self.setup.lens.project_with_jacobian(&p)?;
                let mut jacobian = Jacobian::zeros();
                for k in 0..5 {
                    let motion = rotation * (stepped[k][j] - placed[j]) / STEPS[k];
                    jacobian.set_column(k, &(by_point * motion));
                }
                jacobian
                    .fixed_columns_mut::<3>(5)
                    .copy_from(&(by_point * -cross_matrix(&p)));
                let sigma = self.setup.markers[j].sigma_m;
                let covariance = by_point * by_point.transpose() * (sigma * sigma + common)
                    + Matrix2::identity() * (PIXEL_FLOOR_PX * PIXEL_FLOOR_PX);
                Some(PredictedImage {
                    pixel,
                    jacobian,
                    covariance,
                })
            })
            .collect()
    }

    /// Returns the disc of a marker, camera frame.
    pub(super) fn marker_disc(&self, state: &WingState, marker: usize) -> Option<SkinDisc> {
        let rotation = self.camera_from_wing(state);
        let surveyed = self.setup.markers.get(marker)?;
        let position = self
            .beam
            .marker_positions(state, self.scale)
            .get(marker)
            .copied()?;
        self.disc_in_camera(state, marker, &rotation, &position, surveyed.diameter_m)
    }

    /// Returns the disc of a marker at a position of the wing, camera frame.
    fn disc_in_camera(
        &self,
        state: &WingState,
        marker: usize,
        rotation: &Rotation3<f64>,
        position: &Vector3<f64>,
        diameter_m: f64,
    ) -> Option<SkinDisc> {
        let (normal, chord) = self.beam.skin_attitude(state, marker)?;
        Some(SkinDisc {
            centre_m: self.apparent_point(rotation, position),
            normal: rotation * normal,
            chord: rotation * chord,
            radius_m: 0.5
                * diameter_m
                * if self.is_fixed(marker) {
                    1.0
                } else {
                    self.scale
                },
            warp_per_m: 0.0,
        })
    }

    fn is_fixed(&self, marker: usize) -> bool {
        self.setup.markers.get(marker).is_some_and(|m| m.fixed)
    }

    pub(super) fn marker_outlines(&self, state: &WingState) -> Vec<Option<DiscOutline>> {
        let rotation = self.camera_from_wing(state);
        let placed = self.beam.marker_positions(state, self.scale);
        let markers = self.setup.markers.iter().zip(&placed).enumerate();
        markers
            .map(|(j, (marker, position))| {
                self.disc_in_camera(state, j, &rotation, position, marker.diameter_m)?
                    .outline(&self.setup.lens)
            })
            .collect()
    }

    /// Returns the number of markers with a decal that the ground frames show; of all, if their observations are not known.
    pub fn count_shown(&self) -> usize {
        let has_decal = |k: &usize| !self.setup.is_point(*k);
        let ground = &self.orientation.ground;
        if ground.is_empty() {
            (0..self.setup.markers.len()).filter(has_decal).count()
        } else {
            ground.iter().map(|o| o.marker).filter(has_decal).count()
        }
    }

    /// Returns whether a guided search that named these markers followed the wing: they are most of those shown, or reach the
    /// tip. Where it lost the wing, it names only markers inboard.
    pub fn is_followed(&self, named: &[Observation]) -> bool {
        let span_m = |marker: usize| self.beam.ground_m[marker].x;
        let near_tip_m = NEAR_TIP * span_m(self.outermost_marker());
        named.len() as f64 >= MIN_NAMED_SHARE * self.count_shown() as f64
            || named.iter().any(|o| span_m(o.marker) >= near_tip_m)
    }

    /// Returns whether the ground frames show points only: nothing that the detector could find.
    pub fn has_points_alone(&self) -> bool {
        self.count_shown() == 0 && !self.orientation.templates.is_empty()
    }

    /// Returns the vertical deflection of a marker relative to the ground, wing frame, m.
    pub(super) fn deflection_m(&self, state: &WingState, marker: usize) -> f64 {
        let placed = self.beam.marker_positions(state, self.scale);
        match (placed.get(marker), self.beam.ground_m.get(marker)) {
            (Some(flight), Some(ground)) => flight.y - ground.y,
            _ => 0.0,
        }
    }

    /// Returns the index of the outermost marker along the span.
    pub(super) fn outermost_marker(&self) -> usize {
        let span = |j: usize| match self.beam.ground_m.get(j) {
            Some(p) if !self.is_fixed(j) => p.x,
            _ => f64::MIN,
        };
        (0..self.beam.ground_m.len())
            .max_by(|a, b| span(*a).total_cmp(&span(*b)))
            .unwrap_or(0)
    }
}

/// Returns true if a detection may show the marker with an index in the survey: by its known name, or if its kind and
/// major axis fit the marker at its distance on the ground.
pub(super) fn looks_like(
    detection: &Detection,
    setup: &Setup,
    marker: usize,
    semi_major_px: f64,
) -> bool {
    let Some(shape) = setup.markers.get(marker).map(|m| m.shape) else {
        return false;
    };
    let limit = if shape == Shape::Quadrant { 1.5 } else { 1.35 };
    let similar = || {
        detection.shape == shape && is_within_factor(detection.semi_major_px, semi_major_px, limit)
    };
    detection
        .marker
        .map_or_else(similar, |known| known == marker)
}

fn is_within_factor(a: f64, b: f64, limit: f64) -> bool {
    a < b * limit && b < a * limit
}

/// Returns true if the whole outline fits the predicted one. The major axis depends on size and distance, both known to a
/// few per cent. Quadrant targets have white fields at their rim and are less certain, and blur removes the thin tips of
/// their black fields, more from a flatter one. The minor axis at grazing incidence depends on a degree of slope and has a
/// wider tolerance.
pub(super) fn outline_fits(detection: &Detection, shape: Shape, outline: &DiscOutline) -> bool {
    let minor = detection.semi_minor_px;
    let (longer, shorter) = match shape {
        Shape::Circle => (1.15, 1.15),
        Shape::Quadrant => (1.2, 1.2 + TIPS_PX / minor.max(1.0)),
        Shape::Point => return detection.shape == shape,
    };
    let (major, predicted) = (detection.semi_major_px, outline.semi_minor_px);
    detection.shape == shape
        && major < outline.semi_major_px * longer
        && outline.semi_major_px < major * shorter
        && minor < 1.4 * predicted + 2.0
        && minor > predicted / 1.4 - 2.0
}

/// Relative loss of a quadrant target's major axis times its minor axis, at the widest blur (2 px), px.
const TIPS_PX: f64 = 2.4;

/// Returns true if the numbers of a detection are finite and its covariance is positive definite; the detections are not
/// checked otherwise.
pub(super) fn is_usable(detection: &Detection) -> bool {
    let c = &detection.covariance_px2;
    detection.centre_px.iter().all(|v| v.is_finite())
        && c.iter().all(|v| v.is_finite())
        && c[(0, 0)] > 0.0
        && c.determinant() > 0.0
        && detection.semi_major_px.is_finite()
        && detection.semi_minor_px.is_finite()
}

/// Returns `v' S^-1 v`; infinite if S is singular.
pub(super) fn mahalanobis_squared(v: &Vector2<f64>, covariance: &Matrix2<f64>) -> f64 {
    covariance
        .try_inverse()
        .map_or(f64::INFINITY, |inverse| v.dot(&(inverse * v)))
}
