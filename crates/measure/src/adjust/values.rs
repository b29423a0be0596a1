//! Values of one frame's unknowns as used by the model.

use nalgebra::{Matrix2x3, SVector, Vector2, Vector3};

use super::beam::{Bending, COMPLIANCES, RAISE_TERMS};
use super::marker_state::{DimensionDerivatives, ESTIMATED_DIMENSIONS};
use crate::geometry::BROWN;

/// Values of one frame's unknowns.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct UnknownValues {
    pub curvature_per_m: Vec<f64>,
    /// Rotations (m) and rise (m^2) of root and joints over the curvature of the root.
    pub compliances: [f64; COMPLIANCES],
    /// Coefficients of the twist basis, rad: the polynomial terms and, if there are torques, those of all torques.
    pub twist_rad: Vec<f64>,
    pub pose: CameraPose,
    /// Length in flight over length on the ground.
    pub scale: f64,
    /// Height of the bending axis above the surveyed axis, coefficients, m.
    pub raise_m: [f64; RAISE_TERMS],
    /// Corrections of the estimated dimensions.
    pub estimated: [f64; ESTIMATED_DIMENSIONS],
    /// Displacement in flight per marker, wing frame, m; the list may be shorter than the survey.
    pub moved_m: Vec<Vector3<f64>>,
    /// Displacement in the ground frame per marker, wing frame, m.
    pub moved_on_ground_m: Vec<Vector3<f64>>,
    /// Displacement at the time of the marker's image row relative to the middle row, per marker, wing frame, m.
    pub moved_at_row_m: Vec<Vector3<f64>>,
    /// Rotation of the root since the ground frame, about the wing frame's axes, rad.
    pub root_rotation_rad: Vector3<f64>,
    /// Shift of the root since the ground frame, m.
    pub root_translation_m: Vector3<f64>,
    /// Rotation of the bending plane about the span, rad; in an upright survey the plane is vertical. `None`: fixed.
    pub plane_rad: Option<f64>,
    /// Derivatives of marker positions with respect to the estimated dimensions, if they are fixed.
    pub dimension_derivatives: Option<DimensionDerivatives>,
}

impl UnknownValues {
    /// Creates the values with all unknowns at 0 and the given scale.
    pub fn nominal(scale: f64) -> Self {
        Self {
            scale,
            ..Self::default()
        }
    }

    /// Displacement of a wing point by the root's motion, wing frame, m.
    pub fn root_displacement_m(&self, from_root_m: &Vector3<f64>) -> Vector3<f64> {
        self.root_rotation_rad.cross(from_root_m) + self.root_translation_m
    }

    /// Bending, twist and scale of the wing.
    pub fn bending(&self) -> Bending<'_> {
        Bending {
            curvature_per_m: &self.curvature_per_m,
            compliances: self.compliances,
            twist_rad: &self.twist_rad,
            scale: self.scale,
            raise_m: self.raise_m,
        }
    }
}

/// Camera pose and temperature effects that all markers of a frame share.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct CameraPose {
    /// Small rotation of the mounting relative to that of the ground frame, camera frame, rad.
    pub mount_rad: Vector3<f64>,
    /// Correction of the ground frame's rotation, camera frame, rad.
    pub ground_rad: Vector3<f64>,
    /// Correction of the projection centre, wing frame, m.
    pub centre_m: Vector3<f64>,
    /// Shift of the projection centre since the ground frame, wing frame, m.
    pub shift_m: Vector3<f64>,
    /// Correction of the interior orientation, in the order of [`PARAMETERS`](crate::geometry::Lens::PARAMETERS).
    pub lens: SVector<f64, BROWN>,
    /// Shift of the panes in flight that their description leaves uncertain, wing frame, m.
    pub window_m: Vector3<f64>,
    /// Change of the curvature of the panes' bow, as a fraction of its nominal value or of the default
    /// ([`Plate::with_bow_change`](crate::environment::Plate::with_bow_change)).
    pub bow: f64,
    /// Focal length in flight over that on the ground, minus 1.
    pub flight_scale: f64,
    /// Ratio of height to width of the image in flight over that on the ground, minus 1.
    pub flight_aspect: f64,
    /// Principal point in flight minus that on the ground, px.
    pub flight_principal_px: Vector2<f64>,
    /// Coefficients of the field of bent rays in flight, along u and along v ([`ImageLine::modes`](super::image_line::ImageLine::modes)), px.
    pub ray_field_px: Matrix2x3<f64>,
}

impl CameraPose {
    /// Returns the pose on the ground, before the camera was remounted.
    pub fn on_ground(&self) -> Self {
        let none = Vector3::zeros();
        let flight_principal_px = Vector2::zeros();
        Self {
            mount_rad: none,
            shift_m: none,
            window_m: none,
            bow: 0.0,
            flight_scale: 0.0,
            flight_aspect: 0.0,
            flight_principal_px,
            ..*self
        }
    }
}
