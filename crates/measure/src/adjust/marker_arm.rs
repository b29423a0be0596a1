//! Markers on their sections: rigid arms, measured on the ground and carried into flight.

use nalgebra::{Matrix3, Vector3};

use super::beam::{BeamGrid, BeamSection, Bending};
use super::ground::{GroundShape, wing_from_section};
use crate::geometry::cross_matrix;

/// Position of a marker relative to its section, measured on the ground and rigid in flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerArm {
    section_from_wing: Matrix3<f64>,
    axis_m: Vector3<f64>,
    nose: f64,
}

/// Position of a marker in flight, with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarriedMarker {
    /// Wing frame, m.
    pub position_m: Vector3<f64>,
    /// d position / d position on the ground.
    pub by_ground: Matrix3<f64>,
}

/// Derivatives of a marker's position with respect to the angles of its section, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngleDerivatives {
    pub by_slope: Vector3<f64>,
    pub by_twist: Vector3<f64>,
    /// Arm in flight, section axes: a small rotation moves the marker by the cross product with it.
    pub arm_m: Vector3<f64>,
}

impl MarkerArm {
    /// Computes the arms of all markers of a survey, which are the points of the grid.
    pub fn all_on_ground(grid: &BeamGrid, ground: &GroundShape) -> Vec<Self> {
        let arm = |section: &BeamSection| Self {
            section_from_wing: wing_from_section(section.slope_rad).transpose(),
            axis_m: section.axis_m,
            nose: ground.nose,
        };
        grid.bend(&Bending::UNBENT).iter().map(arm).collect()
    }

    /// Carries a marker, which is at `ground_m` (wing frame) on the ground, into flight with its section.
    pub fn carry(
        &self,
        section: &BeamSection,
        ground_m: &Vector3<f64>,
        scale: f64,
    ) -> (CarriedMarker, AngleDerivatives) {
        let axis_m = self.axis_m + Vector3::y() * section.raise_m;
        let arm = self.section_from_wing * (ground_m - axis_m);
        let (sin, cos) = (self.nose * section.twist_rad).sin_cos();
        let twist = Matrix3::new(1.0, 0.0, 0.0, 0.0, cos, -sin, 0.0, sin, cos);
        let wing = wing_from_section(section.slope_rad) * scale;
        let turned = wing * twist + cross_matrix(&section.turned_rad) * scale;
        let a = twist * arm;
        let angles = AngleDerivatives {
            by_slope: wing * Vector3::new(-a.y, a.x, 0.0),
            by_twist: wing * Vector3::new(0.0, -a.z, a.y) * self.nose,
            arm_m: arm * scale,
        };
        let position_m = section.axis_m + turned * arm;
        (
            CarriedMarker {
                position_m,
                by_ground: turned * self.section_from_wing,
            },
            angles,
        )
    }
}
