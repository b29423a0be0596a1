//! Bending axis along the span, on the ground and in flight, evaluated at a frame's unknowns.

use nalgebra::Vector3;

use super::beam::{BeamGrid, BeamSection, Bending};
use super::scene::WingScene;
use super::values::UnknownValues;

/// Number of intervals of the curves along the span.
const CURVE_INTERVALS: usize = 40;

/// Bending axis from the root to the outermost marker.
pub struct AxisCurve<'a> {
    pub scene: &'a WingScene,
    /// Values of the frame's unknowns.
    pub values: &'a UnknownValues,
    /// Arc lengths from the bending root, m.
    pub arcs_m: Vec<f64>,
    /// Sections in flight, one per arc length.
    pub bent: Vec<BeamSection>,
    /// Heights on the ground, wing frame, m.
    pub ground_y_m: Vec<f64>,
    /// Bending root, wing frame, m.
    pub root_m: Vector3<f64>,
}

impl<'a> AxisCurve<'a> {
    /// Evaluates the axis for a frame's unknowns.
    pub fn new(scene: &'a WingScene, values: &'a UnknownValues) -> Self {
        let reach = scene.ground.stations.iter().fold(0.0, |a: f64, s| a.max(s.arc_m));
        let arcs_m: Vec<f64> = (0..=CURVE_INTERVALS).map(|k| reach * k as f64 / CURVE_INTERVALS as f64).collect();
        let grid = BeamGrid::new(&scene.ground, &arcs_m);
        let (bent, ground_y_m) = bent_sections_and_ground_heights(&grid, values);
        let root_m = grid.root_m() + Vector3::y() * values.raise_m[0];
        Self { scene, values, arcs_m, bent, ground_y_m, root_m }
    }

    /// Deflections of the axis, one per arc length, m.
    pub fn deflections_m(&self) -> Vec<f64> {
        let deflection = |(bent, ground): (&BeamSection, &f64)| self.height_with_root(bent) - ground;
        self.bent.iter().zip(&self.ground_y_m).map(deflection).collect()
    }

    /// Height of the axis in flight including the root's motion, m.
    fn height_with_root(&self, bent: &BeamSection) -> f64 {
        bent.axis_m.y + self.values.root_displacement_m(&(bent.axis_m - self.root_m)).y
    }

    /// Deflections of the axis on another grid with this wing's bending, m.
    pub fn deflections_on(&self, grid: &BeamGrid) -> Vec<f64> {
        let (bent, ground) = bent_sections_and_ground_heights(grid, self.values);
        bent.iter().zip(ground).map(|(bent, ground)| self.height_with_root(bent) - ground).collect()
    }
}

fn bent_sections_and_ground_heights(grid: &BeamGrid, values: &UnknownValues) -> (Vec<BeamSection>, Vec<f64>) {
    let flat = grid.bend(&Bending { raise_m: values.raise_m, ..Bending::UNBENT });
    (grid.bend(&values.bending()), flat.iter().map(|section| section.axis_m.y).collect())
}
