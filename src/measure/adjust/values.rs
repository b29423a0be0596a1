//! The unknowns of one frame as the model takes them.

use std::sync::Arc;

use nalgebra::{SVector, Vector2, Vector3};

use super::beam::{Bending, RAISE_TERMS};
use super::marker_state::{Answers, ESTIMATED};
use crate::geometry::BROWN;

/// A frame's unknowns, read from the vectors.
#[derive(Clone, Debug, PartialEq)]
pub struct Values {
    /// 1/m.
    pub curvature_per_m: Vec<f64>,
    /// Of the twist's basis, rad: the terms, and with torques behind them those of all.
    pub twist_rad: Vec<f64>,
    /// Camera.
    pub pose: Pose,
    /// Length in flight over length on ground.
    pub scale: f64,
    /// Height of the bending axis over the surveyed one, coefficients, m.
    pub raise_m: [f64; RAISE_TERMS],
    /// Corrections of what the user can only estimate.
    pub estimated: [f64; ESTIMATED],
    /// Per marker, what flight moves it by, wing frame, m; shorter where it moves none.
    pub moved_m: Vec<Vector3<f64>>,
    /// The same in the ground frame.
    pub moved_on_ground_m: Vec<Vector3<f64>>,
    /// The same at the instant of its row, against the middle row's.
    pub moved_at_row_m: Vec<Vector3<f64>>,
    /// Rotation of the root since the ground frame, about the wing frame's axes, rad.
    pub root_rotation_rad: Vector3<f64>,
    /// Shift of the root since then, m.
    pub root_translation_m: Vector3<f64>,
    /// Rotation about the span of the plane that the wing bends in, which is upright in an upright survey, rad; `None`: held.
    pub plane_rad: Option<f64>,
    /// How markers answer to corrections of what the user can only estimate, where that is taken for granted.
    pub answers: Option<Arc<Answers>>,
}

impl Values {
    /// With every unknown at 0; `scale` as expected.
    pub fn expected(scale: f64) -> Self {
        Self {
            curvature_per_m: vec![],
            twist_rad: vec![],
            pose: Pose::default(),
            scale,
            raise_m: [0.0; RAISE_TERMS],
            estimated: [0.0; ESTIMATED],
            moved_m: vec![],
            moved_on_ground_m: vec![],
            moved_at_row_m: vec![],
            root_rotation_rad: Vector3::zeros(),
            root_translation_m: Vector3::zeros(),
            plane_rad: None,
            answers: None,
        }
    }

    /// What the root's motion moves a point of the wing by, wing frame, m.
    pub fn by_root_m(&self, from_root_m: &Vector3<f64>) -> Vector3<f64> {
        self.root_rotation_rad.cross(from_root_m) + self.root_translation_m
    }

    /// What bends the wing.
    pub fn bending(&self) -> Bending<'_> {
        Bending {
            curvature_per_m: &self.curvature_per_m,
            twist_rad: &self.twist_rad,
            scale: self.scale,
            raise_m: self.raise_m,
        }
    }
}

/// The camera and the temperature: what is the same for all markers of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Pose {
    /// Small rotation of the mounting against the ground frame's, camera frame, rad.
    pub mount_rad: Vector3<f64>,
    /// Correction of the ground frame's rotation, camera frame, rad.
    pub ground_rad: Vector3<f64>,
    /// Correction of the projection centre, wing frame, m.
    pub centre_m: Vector3<f64>,
    /// Shift of the projection centre since the ground frame, wing frame, m.
    pub shift_m: Vector3<f64>,
    /// Correction of the interior orientation, in the order of [`PARAMETERS`](crate::geometry::Lens::PARAMETERS).
    pub lens: SVector<f64, BROWN>,
    /// What the description of the panes leaves unknown of their shift, in flight, wing frame, m.
    pub window_m: Vector3<f64>,
    /// What the curvature of the panes' bow is more than stated, a share of it or of what is usual
    /// ([`Plate::bowed`](crate::environment::Plate::bowed)).
    pub bow: f64,
    /// Camera constant in flight over that on ground, less 1.
    pub flight_scale: f64,
    /// Principal point in flight against that on ground, px.
    pub flight_principal_px: Vector2<f64>,
}

impl Pose {
    /// The same before the camera was remounted.
    pub fn on_ground(&self) -> Self {
        let none = Vector3::zeros();
        let flight_principal_px = Vector2::zeros();
        Self {
            mount_rad: none,
            shift_m: none,
            window_m: none,
            bow: 0.0,
            flight_scale: 0.0,
            flight_principal_px,
            ..*self
        }
    }
}
