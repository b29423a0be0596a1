//! One frame set up for the engine: its unknowns, its observations, its conditions.

use nalgebra::DVector;

use crate::measure::adjust::beam::MAX_TWIST_TERMS;
use crate::measure::adjust::blocks::survey_block;
use crate::measure::adjust::input::{Input, Sights};
use crate::measure::adjust::layout::{Layout, Member, Own, Survey};
use crate::measure::adjust::scene::Scene;
use crate::measure::adjust::term::Columns;
use crate::measure::adjust::terms;
use crate::measure::estimation::{
    Block, Course, EstimationError, Fit, Group, GroupPoint, Linearised, Problem, solve_from,
};
use crate::measure::setup::Thermal;

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
        let layout = layout(input, single.terms, start.amplitude_per_m, &mut columns);
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
        let start = start_values(&layout, start);
        let problem = Problem { start, missing, priors, known: None, groups: vec![group] };
        Self { scene: input.scene, layout, problem, members }
    }

    /// All blocks of the frame at a point.
    pub fn linearise(&self, at: &GroupPoint, blocks: &mut Vec<Linearised>) -> Result<(), EstimationError> {
        self.layout.linearise(self.scene, &self.members, at, blocks)
    }

    pub fn solve(&self, course: &Course) -> Result<Fit, EstimationError> {
        solve_from(&self.problem, course, |at, blocks| self.linearise(at, blocks))
    }
}

fn layout(input: &Input, curvature_terms: usize, amplitude_per_m: f64, columns: &mut Columns) -> Layout {
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
    let [curvature, twist, rotation] = &first;
    let head = columns.missing.len();
    Layout {
        curvature: curvature.place,
        curvature_terms,
        twist: twist.place,
        twist_terms: twist.term.size,
        rotation: vec![rotation.place],
        axis_height: shared.axis_height,
        terms: [&first, &shared.placed[..], &mounting].concat(),
        expected_scale: input.setup.thermal.as_ref().map_or(1.0, Thermal::scale),
        survey: Survey::Observed,
        head,
        own: Own { first: head, count: 0 },
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

fn start_values(layout: &Layout, start: &Start) -> DVector<f64> {
    let mut values = DVector::zeros(layout.head);
    if let Some((from, solution)) = start.from {
        let (old, new) = (from.curvature_terms, layout.curvature_terms);
        for k in 0..old.min(new) {
            values[k] = solution[k];
        }
        for k in 0..from.head - old {
            values[new + k] = solution[old + k];
        }
    }
    values
}
