//! Wings that are built otherwise than the fitted model: breaks of dihedral, plan and chord, winglets, other sizes, other places of
//! the camera; their axis in space, exactly. It shares no code with the fitted model.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::aircraft::{Aircraft, Effects, WingState};
use super::{STEPS, Truth, Wing};

/// Length of the wing that the layout of markers is made for, m.
const USUAL_LENGTH_M: f64 = 32.5;
/// Deflection of an airliner's tip at which effects that go with the load have their size, m.
const USUAL_DEFLECTION_M: f64 = 2.9;
/// Arc length at which a winglet begins, as a fraction of the length.
const WINGLET_BEGINS: f64 = 0.985;
/// Turn of the axis between two steps from which on it is a break, rad.
const SMALLEST_BREAK_RAD: f64 = 1e-3;
/// Markers on a winglet: distance from its foot as a fraction of the length, and position along the chord, m.
pub const WINGLET_MARKERS: [(f64, f64); 3] = [(0.02, 0.3), (0.04, -0.1), (0.06, 0.4)];

/// Deviations from a straight, tapered wing of an airliner; the default has none. Places are fractions of the length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Structure {
    /// Place and change of the dihedral outboard of it, rad.
    pub dihedral_break: (f64, f64),
    /// Place and change of the sweep outboard of it, rad.
    pub plan_break: (f64, f64),
    /// Place of the break of the trailing edge, and chord at the root over that of the straight taper, minus 1.
    pub chord_break: (f64, f64),
    /// Cant of a winglet against the outermost section, rad; 0: none.
    pub winglet_rad: f64,
    /// Size of the wing over that of an airliner.
    pub size: f64,
    /// Distance of the camera ahead of the wing's root, m; 0: it looks along the span.
    pub ahead_m: f64,
}

impl Default for Structure {
    fn default() -> Self {
        let none = (0.35, 0.0);
        let (dihedral_break, plan_break, chord_break) = (none, none, none);
        Self {
            dihedral_break,
            plan_break,
            chord_break,
            winglet_rad: 0.0,
            size: 1.0,
            ahead_m: 0.0,
        }
    }
}

impl Structure {
    /// A wing of this length, m, in proportion to an airliner's.
    pub fn of_length(length_m: f64) -> Self {
        Self {
            size: length_m / USUAL_LENGTH_M,
            ..Self::default()
        }
    }
}

/// Axis in space: points relative to the root, m, and sections (columns tangent, normal, chord), at STEPS + 1 stations.
pub struct SpaceAxis {
    points_m: Vec<Vector3<f64>>,
    sections: Vec<Matrix3<f64>>,
}

impl SpaceAxis {
    /// Point and section at a fraction of the length.
    pub fn at(&self, e: f64) -> (Vector3<f64>, Matrix3<f64>) {
        let p = (e * STEPS as f64).clamp(0.0, STEPS as f64 - 1e-9);
        let (k, t) = (p as usize, p.fract());
        let mean = |a: Vector3<f64>, b: Vector3<f64>| a + (b - a) * t;
        let section = self.sections[k] + (self.sections[k + 1] - self.sections[k]) * t;
        (mean(self.points_m[k], self.points_m[k + 1]), section)
    }
}

impl Wing {
    /// Returns this wing as it is built.
    pub fn built(self, structure: Structure) -> Self {
        Self {
            length_m: self.length_m * structure.size,
            skin_root_m: self.skin_root_m * structure.size,
            skin_tip_m: self.skin_tip_m * structure.size,
            crown_per_m: self.crown_per_m / structure.size,
            structure,
            ..self
        }
    }

    /// Chord at a fraction of the length, relative to that of the straight taper at the root.
    pub fn chord(&self, e: f64) -> f64 {
        let (at, more) = self.structure.chord_break;
        (1.0 - (1.0 - self.taper) * e) * (1.0 + more * (1.0 - e / at).max(0.0))
    }

    /// Twist over the fraction of the length, rad, at a deflection of the tip; it grows faster outboard of a break of the chord.
    pub fn twist_at(self, tip_deflection_m: f64) -> impl Fn(f64) -> f64 {
        let (at, more) = self.structure.chord_break;
        let share = move |e: f64| {
            (e.powf(self.twist_power) + more * (e - at).max(0.0)) / (1.0 + more * (1.0 - at))
        };
        move |e| tip_deflection_m / (2.5 * self.structure.size) * self.twist_tip_rad * share(e)
    }

    /// Place of a section along the axis, and the remaining arc length on a winglet, m.
    pub fn split_at_winglet(&self, e: f64) -> (f64, f64) {
        if self.structure.winglet_rad == 0.0 {
            return (e, 0.0);
        }
        (
            e.min(WINGLET_BEGINS),
            (e - WINGLET_BEGINS).max(0.0) * self.length_m,
        )
    }

    /// Stations of the markers on a winglet, if there is one: fraction of the length, height above the axis, chord, m.
    pub fn winglet_stations(&self) -> Vec<(f64, f64, f64)> {
        let used = WINGLET_MARKERS
            .iter()
            .filter(|_| self.structure.winglet_rad != 0.0);
        used.map(|(along, z)| (WINGLET_BEGINS + along, 0.3 * self.skin_tip_m, z * self.side))
            .collect()
    }

    /// Arm of a marker in its section (tangent, normal, chord), m: on a winglet, along its cant.
    pub fn arm_m(&self, e: f64, n: f64, z: f64) -> Vector3<f64> {
        let (_, along_m) = self.split_at_winglet(e);
        let cant = if along_m > 0.0 {
            self.structure.winglet_rad
        } else {
            0.0
        };
        let (sin, cos) = cant.sin_cos();
        Vector3::new(along_m * cos - n * sin, along_m * sin + n * cos, z)
    }

    /// Section on ground: tangent, normal, chord.
    fn ground_section(&self, e: f64) -> Matrix3<f64> {
        let (at, turn) = self.structure.plan_break;
        let sweep = if e > at { turn * self.side } else { 0.0 };
        let slope = self.ground_slope(e);
        let tangent = Vector3::new(
            slope.cos() * sweep.cos(),
            slope.sin(),
            slope.cos() * sweep.sin(),
        );
        let chord = Vector3::new(-sweep.sin(), 0.0, sweep.cos());
        Matrix3::from_columns(&[tangent, chord.cross(&tangent), chord])
    }

    /// Bends the axis in space by a curvature, 1/m, about the horizontal, and twists it about itself, rad. Twist inboard of a break
    /// turns what lies outboard of it; the dihedral's slight curvature does not, as sections of the smooth wing are unswept.
    pub fn bend_in_space(
        &self,
        curvature: &[f64],
        scale: f64,
        twist: impl Fn(f64) -> f64,
    ) -> SpaceAxis {
        let step_m = self.length_m / STEPS as f64;
        let share = |i: usize| i as f64 / STEPS as f64;
        let mut turn = Matrix3::identity();
        let mut point = Vector3::zeros();
        let mut axis = SpaceAxis {
            points_m: vec![point],
            sections: vec![self.ground_section(0.0)],
        };
        let mut behind = axis.sections[0].column(0).into_owned();
        for i in 0..STEPS {
            let ahead = self
                .ground_section(share(i) + 0.5 / STEPS as f64)
                .column(0)
                .into_owned();
            if (ahead - behind).norm() > SMALLEST_BREAK_RAD {
                let inboard = self.side * twist(share(i));
                turn = turn
                    * Rotation3::new(behind * inboard).matrix()
                    * Rotation3::new(-ahead * inboard).matrix();
            }
            behind = ahead;
            let tangent = turn * ahead;
            let level = Vector3::new(-tangent.z, 0.0, tangent.x).normalize();
            let bent = level * (0.5 * step_m * (curvature[i] + curvature[i + 1]));
            point += Rotation3::new(bent * 0.5) * tangent * (scale * step_m);
            turn = Rotation3::new(bent).matrix() * turn;
            axis.points_m.push(point);
            let section = self.ground_section(share(i + 1));
            let twisted = Rotation3::new(section.column(0) * (self.side * twist(share(i + 1))));
            axis.sections.push(turn * twisted.matrix() * section);
        }
        axis
    }
}

impl Truth {
    /// Bending root, wing frame, m.
    pub fn root_m(&self) -> Vector3<f64> {
        let Structure { size, ahead_m, .. } = self.wing.structure;
        Vector3::new(
            self.setup.root_offset_m,
            -1.85 * size,
            ahead_m * self.wing.side,
        )
    }

    /// Position of the axis along the chord, wing frame, m.
    pub fn axis_z_m(&self) -> f64 {
        0.1 * self.wing.side * self.wing.structure.size + self.root_m().z
    }

    /// Markers on an axis in space, wing frame, m.
    pub fn points_on(&self, axis: &SpaceAxis, scale: f64) -> Vec<Vector3<f64>> {
        let chord_m = self.axis_z_m() - self.root_m().z;
        let one = |&(e, n, z): &(f64, f64, f64)| {
            let (point, section) = axis.at(self.wing.split_at_winglet(e).0);
            let foot = Vector3::z() * chord_m + self.root_m();
            foot + point + section * self.wing.arm_m(e, n, z - chord_m) * scale
        };
        self.stations.iter().map(one).collect()
    }
}

impl Aircraft {
    /// Load in a state, relative to that of the usual deflection.
    pub(super) fn load(&self, when: WingState) -> f64 {
        let WingState::Flight { deflection_m, .. } = when else {
            return 0.0;
        };
        deflection_m / (USUAL_DEFLECTION_M * self.truth.wing.structure.size)
    }

    /// Twist of the section midway between the torsion pair about the axis along the span, rad: its
    /// rotation without the change of its slope.
    pub fn pair_twist_rad(&self, when: WingState) -> f64 {
        let pair = &self.truth.setup.torsion[0];
        let stations = &self.truth.stations;
        let e = 0.5 * (stations[pair.leading].0 + stations[pair.trailing].0);
        let [(_, survey), (_, now)] = [WingState::Survey, when].map(|when| self.axis(when).at(e));
        let about_chord =
            |slope: f64| *Rotation3::from_axis_angle(&Vector3::z_axis(), slope).matrix();
        let carried: Matrix3<f64> = now * survey.transpose() * about_chord((survey[(1, 0)]).asin());
        let turned = about_chord(-carried[(1, 0)].atan2(carried[(0, 0)])) * carried;
        self.truth.wing.side * turned[(2, 1)].atan2(turned[(1, 1)])
    }

    /// Motion of the root that goes with the load: it belongs to bending.
    pub(super) fn give_at_root(&self, point: &Vector3<f64>, when: WingState) -> Vector3<f64> {
        let (root_m, load) = (self.truth.root_m(), self.load(when));
        let turn = |rad: f64, pivot_m: f64, point: Vector3<f64>| {
            let pivot = root_m + Vector3::x() * pivot_m;
            pivot + Rotation3::from_axis_angle(&Vector3::z_axis(), rad) * (point - pivot)
        };
        let Effects {
            inboard_m,
            root_gives: (rad, pivot_m),
            ..
        } = self.effects;
        let inboard_rad = if inboard_m > 0.0 {
            inboard_m * self.bent_curvature(when)[0]
        } else {
            0.0
        };
        turn(
            rad * load,
            pivot_m,
            turn(inboard_rad, -0.5 * inboard_m, *point),
        )
    }
}
