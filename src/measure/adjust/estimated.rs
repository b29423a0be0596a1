//! What a user can only estimate of the wing's geometry, as unknowns: where bending starts, where along the
//! chord the bending axis lies, in which direction the span runs.
//!
//! A marker's place in flight changes with each of them nearly linearly: a root 0.3 m off moves the tip of a wing
//! that bends by 3 m by 5 cm, and what is not linear in that by a millimetre at most. So the derivative is the
//! difference to a neighbouring wing, prepared once.

use nalgebra::{Matrix3, Vector3};

use super::AdjustError;
use super::beam::{Bending, Grid, Mount, Section};
use super::ground::GroundShape;
use super::marker_state::{ESTIMATED, MarkerState};
use crate::setup::{Setup, Uncertainty};

/// Differences to the neighbouring wings, in the same order: within what users state.
const STEPS: [f64; ESTIMATED] = [0.05, 0.05, 2e-3];

/// Their standard deviations.
pub fn sigmas(uncertainty: &Uncertainty) -> [f64; ESTIMATED] {
    [uncertainty.root_offset_m, uncertainty.axis_chord_offset_m, uncertainty.span_direction_rad]
}

/// A wing that differs in one of them.
#[derive(Clone, Debug)]
pub struct Neighbour {
    /// As surveyed.
    pub ground: GroundShape,
    /// The difference, in the unknown's unit.
    pub step: f64,
    grid: Grid,
    mounts: Vec<Mount>,
    wing_from_own: Matrix3<f64>,
    /// How far its root lies farther outboard, m.
    pub root_m: f64,
}

impl Neighbour {
    /// The neighbours of an installation; `None` for what is held. `trusted`: per marker, as for
    /// [`GroundShape::new`].
    pub fn all(setup: &Setup, trusted: &[bool]) -> Result<[Option<Self>; ESTIMATED], AdjustError> {
        let nominal = GroundShape::new(setup, trusted)?;
        let sigmas = sigmas(&setup.uncertainty);
        let mut all = [None, None, None];
        for (k, slot) in all.iter_mut().enumerate().filter(|(k, _)| sigmas[*k] > 0.0) {
            *slot = Some(Self::new(setup, trusted, &nominal, k)?);
        }
        Ok(all)
    }

    fn new(
        setup: &Setup,
        trusted: &[bool],
        nominal: &GroundShape,
        which: usize,
    ) -> Result<Self, AdjustError> {
        let step = STEPS[which];
        let mut setup = setup.clone();
        match which {
            0 => setup.root_offset_m += step,
            1 => setup.axis_chord_offset_m = Some(nominal.axis.root_m.z + step),
            _ => {
                let (sin, cos) = step.sin_cos();
                setup.span_direction = nalgebra::Matrix2::new(cos, -sin, sin, cos) * setup.span_direction;
            }
        }
        let ground = GroundShape::new(&setup, trusted)?;
        let arcs: Vec<f64> = ground.stations.iter().map(|s| s.arc_m).collect();
        let grid = Grid::new(&ground, &arcs);
        let mounts = grid.mounts(&ground.stations);
        let wing_from_own =
            nominal.frame.wing_from_survey.matrix() * ground.frame.wing_from_survey.matrix().transpose();
        let root_m = if which == 0 { step } else { 0.0 };
        Ok(Self { ground, step, grid, mounts, wing_from_own, root_m })
    }

    /// Its sections in flight, per marker.
    pub fn bend(&self, bending: &Bending) -> Vec<Section> {
        self.grid.bend(bending)
    }

    /// A marker in flight, from its place on ground, both in the nominal wing frame, m.
    pub fn marker(
        &self,
        index: usize,
        section: &Section,
        ground_m: &Vector3<f64>,
        bending: &Bending,
    ) -> MarkerState {
        let own = self.wing_from_own.transpose() * ground_m;
        let state = MarkerState::of(&self.grid, &self.mounts[index], section, &own, bending);
        state.turned(&self.wing_from_own)
    }
}
