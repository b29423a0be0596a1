//! Motion of the wing's sections along the bending axis, from the ground into flight, evaluated at a frame's unknowns.

use nalgebra::Vector3;

use super::beam::{BeamGrid, BeamSection, Bending, SectionMotion};
use super::scene::WingScene;
use super::values::UnknownValues;

/// Number of intervals of the curves along the span.
const CURVE_INTERVALS: usize = 40;

/// Bending axis on the ground and in flight.
pub struct AxisCurve<'a> {
    pub scene: &'a WingScene,
    /// Values of the frame's unknowns.
    pub values: &'a UnknownValues,
    /// Arc lengths from the bending root, m.
    pub arcs_m: Vec<f64>,
    /// Sections in flight, one per arc length, without the root's motion.
    pub bent: Vec<BeamSection>,
    /// Sections on the ground.
    pub flat: Vec<BeamSection>,
    /// Bending root, wing frame, m.
    pub root_m: Vector3<f64>,
    /// Motions of the sections by bending, twist, temperature and the motion of the root.
    pub motions: Vec<SectionMotion>,
}

impl<'a> AxisCurve<'a> {
    /// Evaluates the axis at arc lengths (m from the bending root) for a frame's unknowns.
    pub fn new(scene: &'a WingScene, values: &'a UnknownValues, arcs_m: Vec<f64>) -> Self {
        let grid = BeamGrid::new(&scene.ground, &arcs_m);
        let (bent, flat) = bent_and_flat_sections(&grid, values);
        let root_m = grid.root_m() + Vector3::y() * values.raise_m[0];
        let mut curve = Self {
            scene,
            values,
            arcs_m,
            bent,
            flat,
            root_m,
            motions: vec![],
        };
        curve.motions = curve.motions_between(&curve.bent, &curve.flat);
        curve
    }

    /// Arc lengths from the root to the outermost marker at equal distances, m.
    pub fn standard_arcs_m(scene: &WingScene) -> Vec<f64> {
        let reach = scene
            .ground
            .stations
            .iter()
            .fold(0.0, |a: f64, s| a.max(s.arc_m));
        (0..=CURVE_INTERVALS)
            .map(|k| reach * k as f64 / CURVE_INTERVALS as f64)
            .collect()
    }

    /// Motions of the sections of another grid with this wing's bending, and these sections on the ground.
    pub fn motions_on(&self, grid: &BeamGrid) -> (Vec<SectionMotion>, Vec<BeamSection>) {
        let (bent, flat) = bent_and_flat_sections(grid, self.values);
        (self.motions_between(&bent, &flat), flat)
    }

    fn motions_between(&self, bent: &[BeamSection], flat: &[BeamSection]) -> Vec<SectionMotion> {
        let motion = |(bent, flat): (&BeamSection, &BeamSection)| SectionMotion {
            displacement_m: bent.axis_m
                + self
                    .values
                    .root_displacement_m(&(bent.axis_m - self.root_m))
                - flat.axis_m,
            rotation_rad: bent.turned_rad
                + Vector3::z() * (bent.slope_rad - flat.slope_rad)
                + self.values.root_rotation_rad,
            twist_rad: bent.twist_rad,
        };
        bent.iter().zip(flat).map(motion).collect()
    }
}

fn bent_and_flat_sections(
    grid: &BeamGrid,
    values: &UnknownValues,
) -> (Vec<BeamSection>, Vec<BeamSection>) {
    let flat = grid.bend(&Bending {
        raise_m: values.raise_m,
        ..Bending::UNBENT
    });
    (grid.bend(&values.bending()), flat)
}
