//! Frame prepared for the estimation engine: unknowns, observations, conditions.

use std::sync::Arc;

use nalgebra::DVector;

use crate::adjust::beam::MAX_TWIST_TERMS;
use crate::adjust::blocks::survey_block;
use crate::adjust::causes::WidenedPriors;
use crate::adjust::common_displacement::CommonDisplacement;
use crate::adjust::flight::FlightUsage;
use crate::adjust::input::{AdjustmentInput, FrameObservations};
use crate::adjust::layout::{
    BlockMember, GroundPositions, MarkerMotions, MountingColumns, ParameterLayout,
};
use crate::adjust::prior_scales::PriorScales;
use crate::adjust::scene::WingScene;
use crate::adjust::term::ColumnAllocator;
use crate::adjust::terms;
use crate::estimation::{
    Block, EstimationResult, Group, GroupPoint, Linearised, Minimum, Problem, SolveOptions,
    find_minimum,
};
use crate::setup::Thermal;

/// Observations of one frame, and those in use.
#[derive(Clone)]
pub(super) struct SingleFrame<'a> {
    pub input: AdjustmentInput<'a>,
    pub observations: FrameObservations<'a>,
    pub usage: FlightUsage,
    /// Factors of the prior standard deviations of in-flight motion.
    pub prior_scales: PriorScales,
    /// Stated widths that the frame refutes.
    pub widened: WidenedPriors,
    /// Common displacement of several markers.
    pub common_displacement: Option<CommonDisplacement>,
}

/// A frame prepared for the estimation engine.
pub(super) struct FrameProblem<'a> {
    pub scene: &'a WingScene,
    pub layout: ParameterLayout,
    pub problem: Problem,
    pub members: Vec<BlockMember>,
}

/// Start values of a frame.
pub(super) struct FrameStart<'a> {
    /// Leading curvature coefficient with which the shape ratios are weighted, 1/m.
    pub amplitude_per_m: f64,
    /// Earlier solution with the same layout.
    pub from: Option<&'a DVector<f64>>,
}

impl<'a> FrameProblem<'a> {
    /// Sets up the problem of a single frame at a starting point.
    pub fn new(single: &SingleFrame<'a>, start: &FrameStart) -> Self {
        let input = &single.input;
        let mut columns = ColumnAllocator::global(&single.widened);
        let layout = allocate_frame_layout(single, start.amplitude_per_m, &mut columns);
        let mut members = vec![];
        let mut blocks = vec![];
        for marker in 0..input.setup.markers.len() {
            let mut member = BlockMember {
                marker,
                flight: None,
                ground: None,
            };
            blocks.push(marker_block(single, &mut member));
            members.push(member);
        }
        let group = Group {
            local: DVector::zeros(0),
            priors: vec![],
            blocks,
        };
        let ColumnAllocator {
            missing, priors, ..
        } = columns;
        let first = || {
            let mut values = DVector::zeros(missing.len());
            values[0] = start.amplitude_per_m;
            values
        };
        let problem = Problem {
            start: start.from.map_or_else(first, DVector::clone),
            missing,
            priors,
            known: None,
            groups: vec![group],
        };
        Self {
            scene: input.scene,
            layout,
            problem,
            members,
        }
    }

    /// Fixes the derivatives with respect to the estimated dimensions at those of the start: they hardly change in a
    /// solution.
    pub fn fix_dimension_derivatives(&mut self) {
        let values = self.layout.values(&self.problem.start, &DVector::zeros(0));
        self.layout.dimension_derivatives =
            Some(self.scene.dimension_derivatives(&values.bending()));
    }

    /// Linearises all blocks of the frame at a point.
    pub fn linearise(&self, at: &GroupPoint, blocks: &mut Vec<Linearised>) -> EstimationResult<()> {
        self.layout.linearise(self.scene, &self.members, at, blocks)
    }

    /// Minimises the frame's problem.
    pub fn find_minimum(&self, solve_options: &SolveOptions) -> EstimationResult<Minimum> {
        find_minimum(&self.problem, solve_options, |at, blocks| {
            self.linearise(at, blocks)
        })
    }
}

fn allocate_frame_layout(
    single: &SingleFrame,
    amplitude_per_m: f64,
    columns: &mut ColumnAllocator,
) -> ParameterLayout {
    let input = &single.input;
    let curvature_terms = input.options.count_curvature_terms(false);
    let stayed = input.options.keeps_ground_mounting();
    let first = [
        terms::curvature_term(curvature_terms, Some(amplitude_per_m)),
        terms::twist_term(input.options.twist_terms.min(MAX_TWIST_TERMS)),
        terms::mounting_rotation(input, stayed),
    ];
    let first = first.map(|term| columns.allocate_term(term));
    let shared = terms::allocate_shared_terms(input, columns);
    let mounting = columns.allocate_terms(terms::mounting_terms(input, stayed));
    let (seen, scales) = (&single.observations, &single.prior_scales);
    let others = columns.allocate_terms(terms::frame_terms(input, seen, scales, false));
    let [curvature, twist, rotation] = &first;
    let head = columns.missing.len();
    let motions = Arc::new(MarkerMotions::allocate(
        input,
        &single.prior_scales,
        columns,
    ));
    // After all others, so that a solution without it can be used as the start.
    let first_own = columns.missing.len();
    let displacement = single.common_displacement.iter();
    let displacement = columns.allocate_terms(displacement.map(|one| one.term(input)));
    ParameterLayout {
        curvature: curvature.scope,
        curvature_terms,
        twist: twist.scope,
        twist_terms: twist.term.size,
        rotation: vec![rotation.scope],
        axis_height: shared.axis_height,
        terms: [
            &first,
            &shared.placed[..],
            &mounting,
            &others,
            &displacement,
        ]
        .concat(),
        expected_scale: input.setup.thermal.as_ref().map_or(1.0, Thermal::scale),
        ground_positions: GroundPositions::Observed,
        motions,
        dimension_derivatives: None,
        root: shared.root,
        head,
        mounting: MountingColumns {
            first: first_own,
            count: displacement.len(),
        },
        local: 0,
    }
}

/// Builds a marker's block of survey, flight image and ground-frame image.
fn marker_block(single: &SingleFrame, member: &mut BlockMember) -> Block {
    let (input, usage) = (&single.input, &single.usage);
    let flight = single.observations[member.marker].filter(|_| usage.frames[0][member.marker]);
    let ground = input.scene.ground_observations[member.marker]
        .as_ref()
        .filter(|_| usage.ground[member.marker]);
    member.flight = flight.map(|_| 3);
    member.ground = ground.map(|_| if flight.is_some() { 5 } else { 3 });
    survey_block(input, member.marker, flight.into_iter().chain(ground))
}
