//! Dimensions of the wing that the user can only estimate, as unknowns: the bending root, the chordwise position of the
//! bending axis and the direction of the span.
//!
//! The position of a marker in flight is nearly linear in each of them. A root position that is wrong by 0.3 m moves the
//! tip of a wing that bends by 3 m by 5 cm, and the nonlinear part is at most 1 mm. The derivative is therefore the
//! difference from a neighbouring wing, computed once.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::AdjustResult;
use super::beam::{BeamGrid, BeamSection, Bending, SectionMotion};
use super::ground::{GroundShape, wing_from_section};
use super::marker_arm::MarkerArm;
use super::marker_state::{ESTIMATED_DIMENSIONS, MarkerState};
use crate::setup::{Setup, Width};

/// Steps to the neighbouring wings, in the order root offset (m), chord offset (m), span direction (rad), sweep (rad); within
/// typical uncertainties.
const DIMENSION_STEPS: [f64; ESTIMATED_DIMENSIONS] = [0.05, 0.05, 2e-3, 2e-3];

/// Prior standard deviations of the estimated dimensions, in the same order and units as [`DIMENSION_STEPS`]; 0 for those that
/// the wing does not have.
pub fn dimension_sigmas(setup: &Setup) -> [f64; ESTIMATED_DIMENSIONS] {
    let is_swept = setup.sweeps().next().is_some();
    let widths = [
        Width::RootOffset,
        Width::ChordOffset,
        Width::SpanDirection,
        Width::Sweep,
    ];
    widths.map(|width| {
        if width == Width::Sweep && !is_swept {
            0.0
        } else {
            setup.uncertainty[width]
        }
    })
}

/// A wing that differs from the nominal wing in one estimated dimension.
#[derive(Clone, Debug)]
pub struct NeighbourWing {
    /// The neighbouring wing as surveyed.
    pub ground: GroundShape,
    /// Difference from the nominal dimension, in the unit of the unknown.
    pub step: f64,
    /// Beam grid at its markers' stations.
    pub grid: BeamGrid,
    arms: Vec<MarkerArm>,
    wing_from_own: Matrix3<f64>,
    /// Outboard distance of its root from the nominal root, m.
    pub root_m: f64,
}

impl NeighbourWing {
    /// Creates the neighbours of an installation; `None` for a dimension without uncertainty. `trusted` holds one flag per
    /// marker, as in [`GroundShape::new`].
    pub fn all_from_setup(
        setup: &Setup,
        trusted: &[bool],
        nominal: &GroundShape,
    ) -> AdjustResult<[Option<Self>; ESTIMATED_DIMENSIONS]> {
        let sigmas = dimension_sigmas(setup);
        let mut all = [const { None }; ESTIMATED_DIMENSIONS];
        for (k, slot) in all.iter_mut().enumerate().filter(|(k, _)| sigmas[*k] > 0.0) {
            *slot = Some(Self::new(setup, trusted, nominal, k)?);
        }
        Ok(all)
    }

    fn new(
        setup: &Setup,
        trusted: &[bool],
        nominal: &GroundShape,
        which: usize,
    ) -> AdjustResult<Self> {
        let step = DIMENSION_STEPS[which];
        let mut setup = setup.clone();
        match which {
            0 => setup.root_offset_m += step,
            1 => setup.axis_chord_offset_m = Some(nominal.axis.root_m.z + step),
            2 => {
                let (sin, cos) = step.sin_cos();
                setup.span_direction =
                    nalgebra::Matrix2::new(cos, -sin, sin, cos) * setup.span_direction;
            }
            // One unknown for the whole wing outboard of the first break.
            _ => {
                let aft = setup.aft_sign();
                let stated = setup
                    .breaks
                    .iter_mut()
                    .filter_map(|one| Some((one.span_m, one.sweep_rad.as_mut()?)));
                if let Some((_, sweep_rad)) = stated.min_by(|a, b| a.0.total_cmp(&b.0)) {
                    *sweep_rad += aft * step;
                }
            }
        }
        let ground = GroundShape::with_breaks(&setup, trusted, Some(&nominal.breaks_x_m))?;
        let arcs: Vec<f64> = ground.stations.iter().map(|s| s.arc_m).collect();
        let grid = BeamGrid::new(&ground, &arcs);
        let mounts = MarkerArm::all_on_ground(&grid, &ground);
        let wing_from_own = nominal.frame.wing_from_survey.matrix()
            * ground.frame.wing_from_survey.matrix().transpose();
        let root_m = if which == 0 { step } else { 0.0 };
        Ok(Self {
            ground,
            step,
            grid,
            arms: mounts,
            wing_from_own,
            root_m,
        })
    }

    /// Derivative of a section's motion with respect to the dimension, from the motion in this wing, in its own wing frame.
    /// The axis of this wing is elsewhere: its sections carry the points of the nominal axis. The twist belongs to the section.
    /// `nominal` and `own`: the section on the ground in either wing; `scale`: length in flight over length on the ground.
    pub fn motion_derivative(
        &self,
        (here, nominal): (&SectionMotion, &BeamSection),
        (there, own): (&SectionMotion, &BeamSection),
        scale: f64,
    ) -> SectionMotion {
        let arm_m = self.wing_from_own.transpose() * nominal.axis_m - own.axis_m;
        let bent = Rotation3::new(there.rotation_rad);
        let tangent = wing_from_section(own.slope_rad).column(0).into_owned();
        let twist = Rotation3::new(bent * tangent * (self.ground.nose * there.twist_rad));
        let carried_m = there.displacement_m + twist * bent * arm_m * scale - arm_m;
        SectionMotion {
            displacement_m: (self.wing_from_own * carried_m - here.displacement_m) / self.step,
            rotation_rad: (self.wing_from_own * there.rotation_rad - here.rotation_rad) / self.step,
            twist_rad: 0.0,
        }
    }

    /// Computes a marker's state in flight from its position on the ground, both in the nominal wing frame, m.
    pub fn marker_state(
        &self,
        index: usize,
        section: &BeamSection,
        ground_m: &Vector3<f64>,
        bending: &Bending,
    ) -> MarkerState {
        let own = self.wing_from_own.transpose() * ground_m;
        let state = MarkerState::on_wing(&self.grid, &self.arms[index], section, &own, bending);
        state.rotated(&self.wing_from_own)
    }
}
