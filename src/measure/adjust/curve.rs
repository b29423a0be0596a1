//! The bending axis along the span, on ground and in flight, at a frame's unknowns.

use nalgebra::Vector3;

use super::beam::{Bending, Grid, Section};
use super::scene::Scene;
use super::values::Values;

/// Intervals of the curves along the span.
const INTERVALS: usize = 40;

/// The axis from the root to the outermost marker.
pub struct Curve<'a> {
    /// The installation.
    pub scene: &'a Scene,
    /// The frame's unknowns.
    pub values: &'a Values,
    /// Arc lengths from the bending root, m.
    pub arcs_m: Vec<f64>,
    /// Sections in flight.
    pub bent: Vec<Section>,
    /// Heights on ground, wing frame, m.
    pub ground_y_m: Vec<f64>,
    /// Where bending starts, wing frame, m.
    pub root_m: Vector3<f64>,
}

impl<'a> Curve<'a> {
    /// Evaluates the model.
    pub fn new(scene: &'a Scene, values: &'a Values) -> Self {
        let reach = scene.ground.stations.iter().fold(0.0, |a: f64, s| a.max(s.arc_m));
        let arcs_m: Vec<f64> = (0..=INTERVALS).map(|k| reach * k as f64 / INTERVALS as f64).collect();
        let grid = Grid::new(&scene.ground, &arcs_m);
        let (bent, ground_y_m) = both(&grid, values);
        let root_m = grid.root_m() + Vector3::y() * values.raise_m[0];
        Self { scene, values, arcs_m, bent, ground_y_m, root_m }
    }

    /// Deflections of the axis, m.
    pub fn deflections_m(&self) -> Vec<f64> {
        let deflection = |(bent, ground): (&Section, &f64)| self.with_root(bent) - ground;
        self.bent.iter().zip(&self.ground_y_m).map(deflection).collect()
    }

    /// Height of the axis in flight with the root's motion, m.
    fn with_root(&self, bent: &Section) -> f64 {
        bent.axis_m.y + self.values.by_root_m(&(bent.axis_m - self.root_m)).y
    }

    /// The same with the bending of this wing on another grid.
    pub fn deflections_on(&self, grid: &Grid) -> Vec<f64> {
        let (bent, ground) = both(grid, self.values);
        bent.iter().zip(ground).map(|(bent, ground)| self.with_root(bent) - ground).collect()
    }
}

fn both(grid: &Grid, values: &Values) -> (Vec<Section>, Vec<f64>) {
    let flat = grid.bend(&Bending { raise_m: values.raise_m, ..Bending::NONE });
    (grid.bend(&values.bending()), flat.iter().map(|section| section.axis_m.y).collect())
}
