//! A marker in flight and how its place answers to every unknown that moves it.

use nalgebra::{Matrix3, Vector3};

use super::beam::{Bending, Carried, Grid, MAX_CURVATURE_TERMS, Mount, RAISE_TERMS, Section, TWIST_BASIS};
use crate::geometry::cross_matrix;

/// Number of quantities that the user can only estimate: root offset (m), chord offset of the axis (m), direction of
/// the span (rad).
pub const ESTIMATED: usize = 3;

/// Per marker: d position / d each of these.
pub type Answers = Vec<[Vector3<f64>; ESTIMATED]>;

/// A marker in flight with the derivatives of its position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerState {
    /// Index in the survey.
    pub marker: usize,
    /// From the root, wing frame, m; `None` for a mark that is rigid to the cabin.
    pub from_root_m: Option<Vector3<f64>>,
    /// Position and its answer to slope, twist and ground position.
    pub carried: Carried,
    /// d position / d curvature coefficients, m^2.
    pub by_curvature: [Vector3<f64>; MAX_CURVATURE_TERMS],
    /// d position / d twist coefficients, m.
    pub by_twist: [Vector3<f64>; TWIST_BASIS],
    /// d position / d scale, m.
    pub by_scale: Vector3<f64>,
    /// d position / d coefficients of the axis' height.
    pub by_raise: [Vector3<f64>; RAISE_TERMS],
    /// d position / d what the user can only estimate; 0 for what is held.
    pub by_estimated: [Vector3<f64>; ESTIMATED],
    /// d position / d rotation about the span of the plane that the wing bends in, m/rad.
    pub by_plane: Vector3<f64>,
}

impl MarkerState {
    /// Rigid to the cabin: in flight where it is on ground (wing frame, m).
    pub fn fixed(ground_m: &Vector3<f64>) -> Self {
        let none = Vector3::zeros();
        Self {
            marker: 0,
            from_root_m: None,
            carried: Carried {
                position_m: *ground_m,
                by_slope: none,
                by_twist: none,
                by_ground: Matrix3::identity(),
            },
            by_curvature: [none; MAX_CURVATURE_TERMS],
            by_twist: [none; TWIST_BASIS],
            by_scale: none,
            by_raise: [none; RAISE_TERMS],
            by_estimated: [none; ESTIMATED],
            by_plane: none,
        }
    }

    /// On one wing, with nothing that is only estimated.
    pub fn of(
        grid: &Grid,
        mount: &Mount,
        section: &Section,
        ground_m: &Vector3<f64>,
        bending: &Bending,
    ) -> Self {
        let carried = mount.carry(section, ground_m, bending.scale);
        let by_curvature = std::array::from_fn(|k| {
            section.axis_by_curvature[k] + carried.by_slope * section.slope_by_curvature[k]
        });
        let by_twist = section.twist_by_terms.map(|t| carried.by_twist * t);
        let root_m = grid.root_m() + Vector3::y() * bending.raise_m[0];
        let by_scale = (carried.position_m - root_m) / bending.scale;
        let up = carried.by_ground * Vector3::y();
        let by_raise = std::array::from_fn(|j| section.axis_by_raise[j] - up * section.raise_by_terms[j]);
        let (by_estimated, from_root_m) = (Default::default(), Some(carried.position_m - root_m));
        let by_plane = Vector3::zeros();
        Self {
            marker: 0,
            from_root_m,
            carried,
            by_curvature,
            by_twist,
            by_scale,
            by_raise,
            by_estimated,
            by_plane,
        }
    }

    /// Moves position and derivatives by a share of the way from one wing to another.
    pub fn towards(&mut self, from: &Self, to: &Self, share: f64) {
        self.carried.position_m += (to.carried.position_m - from.carried.position_m) * share;
        self.carried.by_ground += (to.carried.by_ground - from.carried.by_ground) * share;
        self.by_scale += (to.by_scale - from.by_scale) * share;
        for k in 0..MAX_CURVATURE_TERMS {
            self.by_curvature[k] += (to.by_curvature[k] - from.by_curvature[k]) * share;
        }
        for k in 0..TWIST_BASIS {
            self.by_twist[k] += (to.by_twist[k] - from.by_twist[k]) * share;
        }
        for k in 0..RAISE_TERMS {
            self.by_raise[k] += (to.by_raise[k] - from.by_raise[k]) * share;
        }
    }

    /// Moves it by what is off of what the user can only estimate.
    pub fn answer(&mut self, by_estimated: &[Vector3<f64>; ESTIMATED], estimated: &[f64; ESTIMATED]) {
        let moved_m: Vector3<f64> = by_estimated.iter().zip(estimated).map(|(by, off)| by * *off).sum();
        self.by_estimated = *by_estimated;
        self.carried.position_m += moved_m;
        self.from_root_m = self.from_root_m.map(|from| from + moved_m);
    }

    /// Turns the plane that the wing bends in about the span by a small rotation, rad: bent is a wing that is turned back, and
    /// turned then. `nominal`: the marker on the wing as it is stated; `turned`: the same with its place on ground turned about
    /// the span by one radian, to first order.
    pub fn lean(&mut self, turn_rad: f64, nominal: &Self, turned: &Self) {
        let Some(from_root_m) = &mut self.from_root_m else { return };
        let about_span = cross_matrix(&Vector3::x());
        let by = |v: &Vector3<f64>, n: &Vector3<f64>, t: &Vector3<f64>| about_span * v - (t - n);
        let place = |state: &Self| state.carried.position_m;
        self.by_plane = by(from_root_m, &place(nominal), &place(turned));
        *from_root_m += self.by_plane * turn_rad;
        self.carried.position_m += self.by_plane * turn_rad;
        let lean = |v: &mut Vector3<f64>, n: &Vector3<f64>, t: &Vector3<f64>| *v += by(v, n, t) * turn_rad;
        lean(&mut self.carried.by_slope, &nominal.carried.by_slope, &turned.carried.by_slope);
        lean(&mut self.carried.by_twist, &nominal.carried.by_twist, &turned.carried.by_twist);
        lean(&mut self.by_scale, &nominal.by_scale, &turned.by_scale);
        (0..MAX_CURVATURE_TERMS).for_each(|k| {
            lean(&mut self.by_curvature[k], &nominal.by_curvature[k], &turned.by_curvature[k]);
        });
        (0..TWIST_BASIS).for_each(|k| lean(&mut self.by_twist[k], &nominal.by_twist[k], &turned.by_twist[k]));
        (0..RAISE_TERMS).for_each(|k| lean(&mut self.by_raise[k], &nominal.by_raise[k], &turned.by_raise[k]));
        self.by_estimated.iter_mut().for_each(|v| *v += about_span * *v * turn_rad);
        // The root, about which it turns, rises with the axis.
        let by_ground = nominal.carried.by_ground;
        self.by_raise[0] += (by_ground * Vector3::z() - Vector3::z()) * turn_rad;
        self.carried.by_ground += (about_span * self.carried.by_ground - by_ground * about_span) * turn_rad;
    }

    /// Carries it with a root that has turned by a small rotation, rad, and moved, m; a fixed mark stays.
    pub fn carry_with_root(&mut self, turn_rad: &Vector3<f64>, shift_m: &Vector3<f64>) {
        let Some(from_root_m) = self.from_root_m else { return };
        let small = cross_matrix(turn_rad);
        let turn = Matrix3::identity() + small;
        self.carried.position_m += small * from_root_m + shift_m;
        self.carried.by_slope = turn * self.carried.by_slope;
        self.carried.by_twist = turn * self.carried.by_twist;
        self.carried.by_ground = turn * self.carried.by_ground;
        self.by_scale = turn * self.by_scale;
        let vectors = self.by_curvature.iter_mut().chain(&mut self.by_twist).chain(&mut self.by_raise);
        vectors.chain(&mut self.by_estimated).chain([&mut self.by_plane]).for_each(|v| *v = turn * *v);
        // The root rises with the axis, about which it turns.
        self.by_raise[0] -= small * Vector3::y();
    }

    /// In another frame that is turned against its own.
    pub fn turned(&self, turn: &Matrix3<f64>) -> Self {
        let carried = Carried {
            position_m: turn * self.carried.position_m,
            by_slope: turn * self.carried.by_slope,
            by_twist: turn * self.carried.by_twist,
            by_ground: turn * self.carried.by_ground * turn.transpose(),
        };
        Self {
            marker: self.marker,
            from_root_m: self.from_root_m.map(|from| turn * from),
            carried,
            by_curvature: self.by_curvature.map(|v| turn * v),
            by_twist: self.by_twist.map(|v| turn * v),
            by_scale: turn * self.by_scale,
            by_raise: self.by_raise.map(|v| turn * v),
            by_estimated: self.by_estimated,
            by_plane: turn * self.by_plane,
        }
    }
}
