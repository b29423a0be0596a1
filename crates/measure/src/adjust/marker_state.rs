//! A marker in flight, and the derivatives of its position with respect to the unknowns.

use nalgebra::{Matrix3, Vector3};

use super::beam::{
    BENDING_FUNCTIONS, BeamGrid, BeamSection, Bending, RAISE_TERMS, TWIST_FUNCTIONS,
};
use super::marker_arm::{CarriedMarker, MarkerArm};
use crate::geometry::cross_matrix;

/// Number of dimensions that the user can only estimate: root offset (m), chord offset of the axis (m), direction of the
/// span (rad), sweep outboard of stated breaks (rad).
pub const ESTIMATED_DIMENSIONS: usize = 4;

/// d position / d estimated dimensions, per marker.
pub type DimensionDerivatives = std::sync::Arc<[[Vector3<f64>; ESTIMATED_DIMENSIONS]]>;

/// Position of a marker in flight with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerState {
    /// Index in the survey.
    pub marker: usize,
    /// Vector from the root, wing frame, m; `None` for a target fixed to the cabin.
    pub from_root_m: Option<Vector3<f64>>,
    /// Position and its derivative with respect to the position on the ground.
    pub carried: CarriedMarker,
    /// d position / d functions of bending: curvature coefficients, m^2, then compliances.
    pub by_bending: [Vector3<f64>; BENDING_FUNCTIONS],
    /// d position / d twist coefficients, m.
    pub by_twist: [Vector3<f64>; TWIST_FUNCTIONS],
    /// d position / d scale, m.
    pub by_scale: Vector3<f64>,
    /// d position / d coefficients of the axis height.
    pub by_raise: [Vector3<f64>; RAISE_TERMS],
    /// d position / d estimated dimensions; 0 for a dimension without uncertainty.
    pub by_estimated: [Vector3<f64>; ESTIMATED_DIMENSIONS],
    /// d position / d rotation of the bending plane about the span, m/rad.
    pub by_plane: Vector3<f64>,
}

impl MarkerState {
    /// Creates the state of a target fixed to the cabin, which does not move in flight (wing frame, m).
    pub fn fixed(ground_m: &Vector3<f64>) -> Self {
        let none = Vector3::zeros();
        Self {
            marker: 0,
            from_root_m: None,
            carried: CarriedMarker {
                position_m: *ground_m,
                by_ground: Matrix3::identity(),
            },
            by_bending: [none; BENDING_FUNCTIONS],
            by_twist: [none; TWIST_FUNCTIONS],
            by_scale: none,
            by_raise: [none; RAISE_TERMS],
            by_estimated: [none; ESTIMATED_DIMENSIONS],
            by_plane: none,
        }
    }

    /// Computes the state of a marker on one wing, without derivatives with respect to estimated dimensions.
    pub fn on_wing(
        grid: &BeamGrid,
        mount: &MarkerArm,
        section: &BeamSection,
        ground_m: &Vector3<f64>,
        bending: &Bending,
    ) -> Self {
        let (carried, angles) = mount.carry(section, ground_m, bending.scale);
        let by_bending = std::array::from_fn(|k| {
            let twisted = angles.by_twist * section.twist_by_bending[k];
            section.axis_by_bending[k] + angles.by_slope * section.slope_by_bending[k] + twisted
        });
        let by_twist = section.by_twist.map(|by| {
            angles.by_twist * by.twist_rad
                + by.rotation_rad.cross(&angles.arm_m)
                + by.displacement_m
        });
        let root_m = grid.root_m() + Vector3::y() * bending.raise_m[0];
        let by_scale =
            (carried.position_m - root_m - Vector3::y() * bending.root_rise_m()) / bending.scale;
        let up = carried.by_ground * Vector3::y();
        let by_raise =
            std::array::from_fn(|j| section.axis_by_raise[j] - up * section.raise_by_terms[j]);
        let (by_estimated, from_root_m) = (Default::default(), Some(carried.position_m - root_m));
        let by_plane = Vector3::zeros();
        Self {
            marker: 0,
            from_root_m,
            carried,
            by_bending,
            by_twist,
            by_scale,
            by_raise,
            by_estimated,
            by_plane,
        }
    }

    /// Moves position and derivatives by a fraction of the difference between two wings.
    pub fn interpolate_towards(&mut self, from: &Self, to: &Self, share: f64) {
        self.carried.position_m += (to.carried.position_m - from.carried.position_m) * share;
        self.carried.by_ground += (to.carried.by_ground - from.carried.by_ground) * share;
        let ends = from.derivatives().zip(to.derivatives());
        self.derivatives_mut()
            .zip(ends)
            .for_each(|(v, (from, to))| *v += (to - from) * share);
    }

    /// Derivatives with respect to bending, twist, axis height and scale.
    fn derivatives(&self) -> impl Iterator<Item = &Vector3<f64>> {
        self.by_bending
            .iter()
            .chain(&self.by_twist)
            .chain(&self.by_raise)
            .chain([&self.by_scale])
    }

    fn derivatives_mut(&mut self) -> impl Iterator<Item = &mut Vector3<f64>> {
        let vectors = self
            .by_bending
            .iter_mut()
            .chain(&mut self.by_twist)
            .chain(&mut self.by_raise);
        vectors.chain([&mut self.by_scale])
    }

    /// Moves the marker by corrections of the estimated dimensions.
    pub fn apply_dimensions(
        &mut self,
        by_estimated: &[Vector3<f64>; ESTIMATED_DIMENSIONS],
        estimated: &[f64; ESTIMATED_DIMENSIONS],
    ) {
        let moved_m: Vector3<f64> = by_estimated
            .iter()
            .zip(estimated)
            .map(|(by, off)| by * *off)
            .sum();
        self.by_estimated = *by_estimated;
        self.carried.position_m += moved_m;
        self.from_root_m = self.from_root_m.map(|from| from + moved_m);
    }

    /// Rotates the bending plane about the span by a small angle, rad: the wing is rotated back, bent and rotated again.
    /// `nominal`: the marker on the nominal wing; `turned`: the same marker with its ground position rotated about the span
    /// by one radian, to first order.
    pub fn tilt_bending_plane(&mut self, turn_rad: f64, nominal: &Self, turned: &Self) {
        let Some(from_root_m) = &mut self.from_root_m else {
            return;
        };
        let about_span = cross_matrix(&Vector3::x());
        let by = |v: &Vector3<f64>, n: &Vector3<f64>, t: &Vector3<f64>| about_span * v - (t - n);
        let position = |state: &Self| state.carried.position_m;
        self.by_plane = by(from_root_m, &position(nominal), &position(turned));
        *from_root_m += self.by_plane * turn_rad;
        self.carried.position_m += self.by_plane * turn_rad;
        let tilt =
            |v: &mut Vector3<f64>, n: &Vector3<f64>, t: &Vector3<f64>| *v += by(v, n, t) * turn_rad;
        let wings = nominal.derivatives().zip(turned.derivatives());
        self.derivatives_mut()
            .zip(wings)
            .for_each(|(v, (n, t))| tilt(v, n, t));
        self.by_estimated
            .iter_mut()
            .for_each(|v| *v += about_span * *v * turn_rad);
        // The root is the centre of rotation and rises with the axis.
        let by_ground = nominal.carried.by_ground;
        self.by_raise[0] += (by_ground * Vector3::z() - Vector3::z()) * turn_rad;
        self.carried.by_ground +=
            (about_span * self.carried.by_ground - by_ground * about_span) * turn_rad;
    }

    /// Applies a small rotation (rad) and shift (m) of the root. A fixed target does not move.
    pub fn carry_with_root(&mut self, turn_rad: &Vector3<f64>, shift_m: &Vector3<f64>) {
        let Some(from_root_m) = self.from_root_m else {
            return;
        };
        let small = cross_matrix(turn_rad);
        let turn = Matrix3::identity() + small;
        self.carried.position_m += small * from_root_m + shift_m;
        self.carried.by_ground = turn * self.carried.by_ground;
        self.derivatives_mut().for_each(|v| *v = turn * *v);
        self.by_estimated
            .iter_mut()
            .chain([&mut self.by_plane])
            .for_each(|v| *v = turn * *v);
        // The root is the centre of rotation and rises with the axis.
        self.by_raise[0] -= small * Vector3::y();
    }

    /// Rotates the state into another frame.
    pub fn rotated(&self, turn: &Matrix3<f64>) -> Self {
        let CarriedMarker {
            position_m,
            by_ground,
        } = self.carried;
        let carried = CarriedMarker {
            position_m: turn * position_m,
            by_ground: turn * by_ground * turn.transpose(),
        };
        let from_root_m = self.from_root_m.map(|from| turn * from);
        let mut state = Self {
            from_root_m,
            carried,
            by_plane: turn * self.by_plane,
            ..*self
        };
        state.derivatives_mut().for_each(|v| *v = turn * *v);
        state
    }
}
