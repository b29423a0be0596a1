//! One frame set up for the engine: its unknowns, its observations, its conditions.

use std::sync::Arc;

use nalgebra::DVector;

use crate::adjust::beam::MAX_TWIST_TERMS;
use crate::adjust::blocks::survey_block;
use crate::adjust::common_displacement::CommonDisplacement;
use crate::adjust::factors::Factors;
use crate::adjust::input::{Input, Sights};
use crate::adjust::layout::{Layout, Member, Motions, Own, Survey};
use crate::adjust::scene::Scene;
use crate::adjust::term::Columns;
use crate::adjust::terms;
use crate::estimation::{
    Block, EstimationError, Fit, Group, GroupPoint, Linearised, Problem, SolveOptions, solve_with_options,
};
use crate::setup::Thermal;

/// Which observations take part.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Usage {
    /// Per marker of the survey: its image in flight.
    pub flight: Vec<bool>,
    /// Its image on ground.
    pub ground: Vec<bool>,
}

impl Usage {
    /// Everything that there is.
    pub fn all(markers: usize) -> Self {
        Self { flight: vec![true; markers], ground: vec![true; markers] }
    }
}

/// One frame's observations, what of them takes part, and the order that the curvature is sought with.
#[derive(Clone)]
pub(super) struct Single<'a> {
    pub input: Input<'a>,
    pub sights: Sights<'a>,
    pub usage: Usage,
    pub terms: usize,
    /// By how much more than stated marks and skin are taken to move.
    pub factors: Factors,
    /// What many markers have in common.
    pub cause: Option<CommonDisplacement>,
}

/// A frame set up for the engine.
pub(super) struct Frame<'a> {
    pub scene: &'a Scene,
    pub layout: Layout,
    pub problem: Problem,
    pub members: Vec<Member>,
}

/// The values a frame starts from.
pub(super) struct Start<'a> {
    /// Leading coefficient that the shape ratios are weighed with.
    pub amplitude_per_m: f64,
    /// Earlier solution of the same layout but for the number of terms.
    pub from: Option<(&'a Layout, &'a DVector<f64>)>,
}

impl<'a> Frame<'a> {
    pub fn new(single: &Single<'a>, start: &Start) -> Self {
        let input = &single.input;
        let mut columns = Columns::default();
        let layout = layout(single, start.amplitude_per_m, &mut columns);
        let mut members = vec![];
        let mut blocks = vec![];
        for marker in 0..input.setup.markers.len() {
            let mut member = Member { marker, flight: None, ground: None };
            let block = block(single, &mut member);
            if member.flight.is_some() || member.ground.is_some() {
                members.push(member);
                blocks.push(block);
            }
        }
        let group = Group { local: DVector::zeros(0), priors: vec![], blocks };
        let Columns { missing, priors, .. } = columns;
        let start = start_values(&layout, missing.len(), start);
        let problem = Problem { start, missing, priors, known: None, groups: vec![group] };
        Self { scene: input.scene, layout, problem, members }
    }

    /// All blocks of the frame at a point.
    pub fn linearise(&self, at: &GroupPoint, blocks: &mut Vec<Linearised>) -> Result<(), EstimationError> {
        self.layout.linearise(self.scene, &self.members, at, blocks)
    }

    pub fn solve(&self, course: &SolveOptions) -> Result<Fit, EstimationError> {
        solve_with_options(&self.problem, course, |at, blocks| self.linearise(at, blocks))
    }
}

fn layout(single: &Single, amplitude_per_m: f64, columns: &mut Columns) -> Layout {
    let (input, curvature_terms) = (&single.input, single.terms);
    let stayed = input.options.is_of_the_ground();
    let first = [
        terms::curvature(curvature_terms, Some(amplitude_per_m)),
        terms::twist(input.options.twist_terms.min(MAX_TWIST_TERMS)),
        terms::rotation(input, stayed),
    ];
    let first = first.map(|term| columns.place(term));
    let shared = terms::shared(input, columns);
    let mounting = terms::of_mounting(input, stayed).into_iter().map(|term| columns.place(term));
    let mounting: Vec<_> = mounting.collect();
    let others = terms::of_frame(input, &single.sights, &single.factors, false)
        .into_iter()
        .map(|term| columns.place(term));
    let others: Vec<_> = others.collect();
    let [curvature, twist, rotation] = &first;
    let head = columns.missing.len();
    let motions = Arc::new(Motions::place(input, &single.factors, columns));
    // Behind all others, so that a solution without it is one to start from.
    let first_own = columns.missing.len();
    let cause = single.cause.as_ref().map(|cause| columns.place(cause.term(input)));
    let cause: Vec<_> = cause.into_iter().collect();
    Layout {
        curvature: curvature.place,
        curvature_terms,
        twist: twist.place,
        twist_terms: twist.term.size,
        rotation: vec![rotation.place],
        axis_height: shared.axis_height,
        terms: [&first, &shared.placed[..], &mounting, &others, &cause].concat(),
        expected_scale: input.setup.thermal.as_ref().map_or(1.0, Thermal::scale),
        survey: Survey::Observed,
        motions,
        answers: None,
        root: shared.root,
        head,
        own: Own { first: first_own, count: cause.len() },
        local: 0,
    }
}

/// Survey, flight image and ground image of a marker as one block.
fn block(single: &Single, member: &mut Member) -> Block {
    let (input, usage) = (&single.input, &single.usage);
    let flight = single.sights[member.marker].filter(|_| usage.flight[member.marker]);
    let ground = input.scene.ground_sights[member.marker].as_ref().filter(|_| usage.ground[member.marker]);
    member.flight = flight.map(|_| 3);
    member.ground = ground.map(|_| if flight.is_some() { 5 } else { 3 });
    survey_block(input, member.marker, flight.into_iter().chain(ground))
}

fn start_values(layout: &Layout, columns: usize, start: &Start) -> DVector<f64> {
    let mut values = DVector::zeros(columns);
    if let Some((from, solution)) = start.from {
        let (old, new) = (from.curvature_terms, layout.curvature_terms);
        for k in 0..old.min(new) {
            values[k] = solution[k];
        }
        for k in 0..solution.len() - old {
            values[new + k] = solution[old + k];
        }
    }
    values
}
