//! From a state of wing and mount to pixels, linearised.

use nalgebra::{Matrix2, Rotation3, SMatrix, Vector2, Vector3};

use super::beam::{Beam, State};
use super::outline::{Disc, Outline};
use crate::detect::Detection;
use crate::environment::Plate;
use crate::geometry::cross_matrix;
use crate::setup::{Orientation, Setup, Shape};

pub(super) type Matrix8 = SMatrix<f64, 8, 8>;
pub(super) type Jacobian = SMatrix<f64, 2, 8>;

/// What the simple beam leaves unexplained at a marker, m.
const MODEL_SIGMA_M: f64 = 0.004;
/// What outline centres and a lens of few terms leave, px.
const PIXEL_FLOOR_PX: f64 = 0.6;
/// The camera may have turned by this at least, standard deviation, px.
const MIN_TURN_PX: f64 = 20.0;
/// And about its axis by this, rad: a mounting repeats it less well.
const MIN_ROLL_RAD: f64 = 5e-3;
/// Differences for the wing's part of the Jacobian: 1/m, rad.
const STEPS: [f64; 5] = [1e-5, 1e-5, 1e-5, 1e-4, 1e-4];

/// A wing, a camera and its attitude.
pub(super) struct Scene<'a> {
    pub(super) setup: &'a Setup,
    pub(super) beam: Beam,
    camera_from_wing: Rotation3<f64>,
    /// What the frame is seen through, camera frame.
    pane: Option<Plate>,
    scale: f64,
}

/// A marker's predicted image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Predicted {
    pub(super) pixel: Vector2<f64>,
    /// By the state.
    pub(super) jacobian: Jacobian,
    /// From survey, projection centre and the model's coarseness, px^2; the detection's not in it.
    pub(super) covariance: Matrix2<f64>,
}

impl<'a> Scene<'a> {
    /// In flight, or on ground (no thermal expansion).
    pub(super) fn new(setup: &'a Setup, orientation: &Orientation, in_flight: bool) -> Self {
        let beam = Beam::new(setup, &orientation.may_shape(setup.markers.len()));
        let camera_from_wing = orientation.camera_from_survey * beam.frame.wing_from_survey.inverse();
        let thermal = setup.thermal.filter(|_| in_flight);
        let pane = Plate::from_window(setup.window.as_ref(), &orientation.camera_from_survey, in_flight);
        Self { setup, beam, camera_from_wing, pane, scale: thermal.map_or(1.0, |t| t.scale()) }
    }

    /// How far the camera may have turned since the ground frames, about its own axes, standard deviations, rad.
    pub(super) fn turn_sigmas(&self) -> [f64; 3] {
        let turn = self.setup.mount_repeatability_px.max(MIN_TURN_PX) / self.setup.lens.focal_px();
        [turn, turn, turn.max(MIN_ROLL_RAD)]
    }

    /// Where the camera sees a point of the wing frame, camera frame.
    fn apparent_point(&self, rotation: &Rotation3<f64>, point_m: &Vector3<f64>) -> Vector3<f64> {
        let p = rotation * point_m;
        self.pane.map_or(p, |pane| pane.apparent_point(&p))
    }

    fn camera_from_wing(&self, state: &State) -> Rotation3<f64> {
        Rotation3::new(Vector3::new(state[5], state[6], state[7])) * self.camera_from_wing
    }

    /// Pixels of all markers; `None` behind the camera.
    pub(super) fn project_markers(&self, state: &State) -> Vec<Option<Vector2<f64>>> {
        let rotation = self.camera_from_wing(state);
        let lens = &self.setup.lens;
        self.beam.marker_positions(state, self.scale).iter().map(|p| lens.project(&self.apparent_point(&rotation, p))).collect()
    }

    /// Pixels of all markers with Jacobians and covariances; `None` behind the camera.
    pub(super) fn linearise(&self, state: &State) -> Vec<Option<Predicted>> {
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
                jacobian.fixed_columns_mut::<3>(5).copy_from(&(by_point * -cross_matrix(&p)));
                let sigma = self.setup.markers[j].sigma_m;
                let covariance = by_point * by_point.transpose() * (sigma * sigma + common)
                    + Matrix2::identity() * (PIXEL_FLOOR_PX * PIXEL_FLOOR_PX);
                Some(Predicted { pixel, jacobian, covariance })
            })
            .collect()
    }

    /// The disc of a marker, camera frame.
    pub(super) fn marker_disc(&self, state: &State, marker: usize) -> Option<Disc> {
        let rotation = self.camera_from_wing(state);
        let surveyed = self.setup.markers.get(marker)?;
        let position = self.beam.marker_positions(state, self.scale).get(marker).copied()?;
        self.disc_at(state, marker, &rotation, &position, surveyed.diameter_m)
    }

    fn disc_at(
        &self,
        state: &State,
        marker: usize,
        rotation: &Rotation3<f64>,
        position: &Vector3<f64>,
        diameter_m: f64,
    ) -> Option<Disc> {
        let (normal, chord) = self.beam.skin_attitude(state, marker)?;
        Some(Disc {
            centre_m: self.apparent_point(rotation, position),
            normal: rotation * normal,
            chord: rotation * chord,
            radius_m: 0.5 * diameter_m * if self.is_fixed(marker) { 1.0 } else { self.scale },
            warp_per_m: 0.0,
        })
    }

    fn is_fixed(&self, marker: usize) -> bool {
        self.setup.markers.get(marker).is_some_and(|m| m.fixed)
    }

    /// The discs' images for all markers.
    pub(super) fn marker_outlines(&self, state: &State) -> Vec<Option<Outline>> {
        let rotation = self.camera_from_wing(state);
        let placed = self.beam.marker_positions(state, self.scale);
        let markers = self.setup.markers.iter().zip(&placed).enumerate();
        markers
            .map(|(j, (marker, position))| {
                self.disc_at(state, j, &rotation, position, marker.diameter_m)?.outline(&self.setup.lens)
            })
            .collect()
    }

    /// Position in flight, survey frame, m.
    pub(super) fn deflection_m(&self, state: &State, marker: usize) -> f64 {
        let placed = self.beam.marker_positions(state, self.scale);
        match (placed.get(marker), self.beam.ground_m.get(marker)) {
            (Some(flight), Some(ground)) => flight.y - ground.y,
            _ => 0.0,
        }
    }

    /// The marker farthest out along the span.
    pub(super) fn outermost_marker(&self) -> usize {
        let span = |j: usize| match self.beam.ground_m.get(j) {
            Some(p) if !self.is_fixed(j) => p.x,
            _ => f64::MIN,
        };
        (0..self.beam.ground_m.len()).max_by(|a, b| span(*a).total_cmp(&span(*b))).unwrap_or(0)
    }
}

/// Whether a detection can be the image of a marker of this kind and major axis, told from its
/// distance on ground alone.
pub(super) fn looks_like(detection: &Detection, shape: Shape, semi_major_px: f64) -> bool {
    let limit = match shape {
        Shape::Circle => 1.35,
        Shape::Quadrant => 1.5,
    };
    detection.shape == shape && is_within_factor(detection.semi_major_px, semi_major_px, limit)
}

fn is_within_factor(a: f64, b: f64, limit: f64) -> bool {
    a < b * limit && b < a * limit
}

/// Whether the whole outline can be the predicted one. The major axis hangs on size and distance,
/// both known to a few per cent; quadrant targets have white fields at their rim and are less
/// sure, and blur takes the thin tips off their black, more of a flatter one. The minor axis of a
/// grazing view hangs on a degree of slope and is given room.
pub(super) fn outline_fits(detection: &Detection, shape: Shape, outline: &Outline) -> bool {
    let minor = detection.semi_minor_px;
    let (longer, shorter) = match shape {
        Shape::Circle => (1.15, 1.15),
        Shape::Quadrant => (1.2, 1.2 + TIPS_PX / minor.max(1.0)),
    };
    let (major, predicted) = (detection.semi_major_px, outline.semi_minor_px);
    detection.shape == shape
        && major < outline.semi_major_px * longer
        && outline.semi_major_px < major * shorter
        && minor < 1.4 * predicted + 2.0
        && minor > predicted / 1.4 - 2.0
}

/// Relative loss of a quadrant target's major axis times its minor axis, at the widest blur (2 px).
const TIPS_PX: f64 = 2.4;

/// A finite detection: what the input may not hold back.
pub(super) fn is_usable(detection: &Detection) -> bool {
    let c = &detection.covariance_px2;
    detection.centre_px.iter().all(|v| v.is_finite())
        && c.iter().all(|v| v.is_finite())
        && c[(0, 0)] > 0.0
        && c.determinant() > 0.0
        && detection.semi_major_px.is_finite()
        && detection.semi_minor_px.is_finite()
}

/// v' S^-1 v; infinite where S is singular.
pub(super) fn mahalanobis_squared(v: &Vector2<f64>, covariance: &Matrix2<f64>) -> f64 {
    covariance.try_inverse().map_or(f64::INFINITY, |inverse| v.dot(&(inverse * v)))
}
