//! The wing of the adjustment with the few terms that identification needs.

use nalgebra::{SVector, Vector3};

use crate::adjust::beam::{Bending, MIDDLE};
use crate::adjust::ground::GroundShape;
use crate::adjust::marker_arm::CarriedMarker;
use crate::adjust::marker_state::MarkerState;
use crate::adjust::shapes::TIP_DEFLECTIONS;
use crate::adjust::target_wing::TargetWing;
use crate::geometry::WingFrame;
use crate::setup::Setup;

/// State of wing and camera: [`CURVATURE_TERMS`] of the curvature, 1/m, [`TWIST_TERMS`] of the twist, rad, camera mount (3
/// small rotations, camera frame, rad).
pub(super) type WingState = SVector<f64, 8>;
/// Number of terms of the curvature.
pub(super) const CURVATURE_TERMS: usize = 3;
/// Number of terms of the twist.
pub(super) const TWIST_TERMS: usize = 2;
/// Number of terms of curvature and twist.
pub(super) const WING_TERMS: usize = CURVATURE_TERMS + TWIST_TERMS;

/// A wing that a state bends, with targets on it.
#[derive(Clone, Debug)]
pub(super) struct StateWing {
    /// Wing frame of all coordinates.
    pub(super) frame: WingFrame,
    /// Targets on the ground, wing frame, m, and whether each is fixed to the cabin.
    pub(super) targets: Vec<(Vector3<f64>, bool)>,
    /// Arc length of the axis, m.
    pub(super) length_m: f64,
    /// `None`: the survey defines no bending axis, and nothing moves.
    wing: Option<TargetWing>,
}

fn bending(state: &WingState, scale: f64) -> Bending<'_> {
    let (curvature_per_m, rest) = state.as_slice().split_at(CURVATURE_TERMS);
    Bending {
        curvature_per_m,
        twist_rad: &rest[..TWIST_TERMS],
        scale,
        ..Bending::UNBENT
    }
}

impl StateWing {
    /// Creates the wing of a survey; `may_shape`: for each marker, whether it may shape the skin. Of breaks, the configured
    /// ones count: a search for others costs more than they matter here.
    pub(super) fn new(setup: &Setup, may_shape: &[bool]) -> Self {
        let frame = setup.wing_frame();
        let markers = setup.markers.iter();
        let targets: Vec<_> = markers
            .map(|m| (frame.wing_point(&m.position_m), m.fixed))
            .collect();
        let breaks_x_m: Vec<f64> = setup.breaks.iter().map(|one| one.span_m).collect();
        let ground = GroundShape::with_breaks(setup, may_shape, Some(&breaks_x_m)).ok();
        let reach_m = targets.iter().fold(1.0_f64, |reach, (p, _)| reach.max(p.x));
        Self {
            frame,
            targets,
            length_m: ground.as_ref().map_or(reach_m, |g| g.axis.length_m),
            wing: ground.map(|ground| TargetWing::of_survey(setup, ground, MIDDLE)),
        }
    }

    /// Returns the wing with other targets.
    pub(super) fn with_targets(&self, targets: Vec<(Vector3<f64>, bool)>) -> Self {
        let wing = self.wing.as_ref();
        Self {
            wing: wing.map(|wing| TargetWing::new(wing.ground.clone(), targets.clone(), MIDDLE)),
            targets,
            ..*self
        }
    }

    /// Returns the targets in flight. `scale`: thermal expansion.
    pub(super) fn carry(&self, state: &WingState, scale: f64) -> Vec<CarriedMarker> {
        match &self.wing {
            Some(wing) => wing.carry(&bending(state, scale)),
            None => self
                .targets
                .iter()
                .map(|t| CarriedMarker::fixed(&t.0))
                .collect(),
        }
    }

    /// Returns the targets in flight, with derivatives.
    pub(super) fn carry_with_derivatives(&self, state: &WingState, scale: f64) -> Vec<MarkerState> {
        match &self.wing {
            Some(wing) => wing.carry_with_derivatives(&bending(state, scale)),
            None => self
                .targets
                .iter()
                .map(|t| MarkerState::fixed(&t.0))
                .collect(),
        }
    }

    /// Returns the first term of the curvature that deflects the tip by a length, to first order.
    pub(super) fn curvature_per_m(&self, deflection_m: f64) -> f64 {
        deflection_m / (TIP_DEFLECTIONS[0] * self.length_m.powi(2))
    }

    /// Returns height, m, and normal of the skin on the ground at X and Z of a point, wing frame.
    pub(super) fn skin_at(&self, point_m: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let wing = self.wing.as_ref();
        wing.map_or((point_m.y, Vector3::y()), |wing| {
            wing.ground.skin_at(point_m)
        })
    }

    /// Returns normal and chordwise direction of the skin at a target on the ground, wing frame.
    pub(super) fn skin_attitude(&self, target: usize) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let (point_m, fixed) = self.targets.get(target)?;
        if *fixed {
            return facing_attitude(point_m);
        }
        let (_, normal) = self.skin_at(point_m);
        Some((normal, (Vector3::z() - normal * normal.z).normalize()))
    }
}

/// Returns the normal of a target that faces the camera, as fixed targets do, and a direction across it.
pub(super) fn facing_attitude(point_m: &Vector3<f64>) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let normal = -point_m.try_normalize(1e-6)?;
    let across = (Vector3::y() - normal * normal.y)
        .try_normalize(1e-6)
        .unwrap_or_else(Vector3::x);
    Some((normal, across))
}
