//! The unknowns of one frame as the model takes them.

use super::beam::{Bending, RAISE_TERMS};
use super::marker_state::ESTIMATED;
use super::scene::Pose;

/// A frame's unknowns, read from the vectors.
#[derive(Clone, Debug, PartialEq)]
pub struct Values {
    /// 1/m.
    pub curvature_per_m: Vec<f64>,
    /// rad.
    pub twist_rad: Vec<f64>,
    /// Camera.
    pub pose: Pose,
    /// Length in flight over length on ground.
    pub scale: f64,
    /// Height of the bending axis over the surveyed one, coefficients, m.
    pub raise_m: [f64; RAISE_TERMS],
    /// Corrections of what the user can only estimate.
    pub estimated: [f64; ESTIMATED],
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
        }
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
