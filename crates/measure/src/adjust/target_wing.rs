//! Targets on a bent wing, for stages that need neither estimated dimensions nor compliances.

use nalgebra::Vector3;

use super::beam::{BeamGrid, BeamSection, Bending, Quadrature};
use super::ground::GroundShape;
use super::marker_arm::{CarriedMarker, MarkerArm};
use super::marker_state::MarkerState;
use crate::setup::Setup;

/// Wing with the targets that it carries.
#[derive(Clone, Debug)]
pub struct TargetWing {
    /// The wing on the ground.
    pub ground: GroundShape,
    /// Targets on the ground, wing frame, m, and whether each is fixed to the cabin.
    pub targets: Vec<(Vector3<f64>, bool)>,
    /// Beam at the targets' stations.
    pub grid: BeamGrid,
    arms: Vec<MarkerArm>,
}

impl TargetWing {
    /// Puts targets (wing frame, m, and whether each is fixed to the cabin) on a wing.
    pub fn new(
        ground: GroundShape,
        targets: Vec<(Vector3<f64>, bool)>,
        quadrature: &Quadrature,
    ) -> Self {
        let arc_m = |(p, fixed): &(Vector3<f64>, bool)| match fixed {
            true => 0.0,
            false => ground.section_of(p).0,
        };
        let arcs_m: Vec<f64> = targets.iter().map(arc_m).collect();
        let grid = BeamGrid::with_quadrature(&ground, &arcs_m, quadrature);
        let arms = MarkerArm::all_on_ground(&grid, &ground);
        Self {
            ground,
            targets,
            grid,
            arms,
        }
    }

    /// Puts the markers of a survey on its wing.
    pub fn of_survey(setup: &Setup, ground: GroundShape, quadrature: &Quadrature) -> Self {
        let markers = setup.markers.iter().zip(&ground.stations);
        let targets = markers.map(|(m, s)| (s.surveyed_m, m.fixed)).collect();
        Self::new(ground, targets, quadrature)
    }

    /// Carries the targets into flight.
    pub fn carry(&self, bending: &Bending) -> Vec<CarriedMarker> {
        let sections = self.grid.place(bending);
        let carried = self.targets.iter().zip(&self.arms).zip(&sections);
        carried
            .map(|(((ground_m, fixed), arm), section)| match fixed {
                true => CarriedMarker::fixed(ground_m),
                false => arm.carry(section, ground_m, bending.scale).0,
            })
            .collect()
    }

    /// Carries the targets into flight, with derivatives.
    pub fn carry_with_derivatives(&self, bending: &Bending) -> Vec<MarkerState> {
        let sections = self.grid.bend(bending);
        let state = |(k, section)| self.state(k, section, &self.targets[k].0, bending);
        sections.iter().enumerate().map(state).collect()
    }

    /// Computes the state of a target that is at `ground_m` (wing frame) on the ground.
    pub fn state(
        &self,
        target: usize,
        section: &BeamSection,
        ground_m: &Vector3<f64>,
        bending: &Bending,
    ) -> MarkerState {
        let state = match self.targets[target].1 {
            true => MarkerState::fixed(ground_m),
            false => {
                MarkerState::on_wing(&self.grid, &self.arms[target], section, ground_m, bending)
            }
        };
        MarkerState {
            marker: target,
            ..state
        }
    }
}
