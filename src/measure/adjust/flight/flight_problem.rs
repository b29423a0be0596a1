//! A flight set up for the engine: shared unknowns, one group per frame, survey and ground frame last.

use std::sync::Arc;

use nalgebra::{DVector, Matrix3};

use super::frames::Flight;
use super::shape::{ShapeColumns, SharedShape};
use crate::adjust::beam::{Bending, MAX_CURVATURE_TERMS, MAX_TWIST_TERMS};
use crate::adjust::budget::Blocks;
use crate::adjust::flight_prior::{InvariantParameter, LASTING, MARKS, SHAPE, SKIN, SURVEY};
use crate::adjust::input::Input;
use crate::adjust::layout::{Layout, Member, Motions, Own, Survey};
use crate::adjust::marker_state::Answers;
use crate::adjust::scene::Scene;
use crate::adjust::term::{Columns, ParameterScope, Placed};
use crate::adjust::terms::{self, Shared};
use crate::estimation::{
    EstimationError, Fit, Group, GroupPoint, Linearised, Problem, SolveOptions, solve_with_options,
};
use crate::setup::Thermal;

const MISSING_GROUND: &str = "a marker on ground is not determined";
/// Terms of the curvature where none are given.
const TERMS: usize = 8;

/// A flight set up for the engine.
pub struct FlightProblem {
    /// Unknowns of each frame.
    pub layouts: Vec<Layout>,
    /// Whose images each frame's blocks are.
    pub members: Vec<Vec<Member>>,
    /// Whose survey and sight on ground the last group's blocks are.
    pub ground_members: Vec<Member>,
    /// For the engine.
    pub problem: Problem,
    /// What the frames' curvatures have in common.
    pub shape: SharedShape,
    /// What flights have in common, each with its column.
    pub lasting: Vec<(InvariantParameter, usize)>,
    /// What is stated of each global parameter.
    pub stated: DVector<f64>,
    /// Column of what many markers have in common.
    pub cause: Option<usize>,
    ground: Option<Layout>,
}

/// What the frames of one mounting have in common, its rotation first.
struct OfMounting {
    placed: Vec<Placed>,
    columns: Own,
}

impl OfMounting {
    fn place(input: &Input, stayed: bool, columns: &mut Columns) -> Self {
        let first = columns.missing.len();
        let terms = [vec![terms::rotation(input, stayed)], terms::of_mounting(input, stayed)].concat();
        let placed = terms.into_iter().map(|term| columns.place(term)).collect();
        Self { placed, columns: Own { first, count: columns.missing.len() - first } }
    }
}

/// Of a frame's rotation about its mounting's. Where the mount's repeatability puts them all is counted once, not once
/// for each.
fn own_rotation_covariance(flight: &Flight) -> Matrix3<f64> {
    match flight.assumed.mountings.are_found() {
        false => terms::rotation_of_mounting(&flight.input).covariance.fixed_view::<3, 3>(0, 0).into_owned(),
        true => flight.assumed.drift_covariance(&flight.input.scene.camera_from_wing),
    }
}

/// How a frame's markers answer to what the user can only estimate, where other frames tell of its twist; see
/// [`Assumed::usual_bending`](super::assumed::Assumed::usual_bending).
fn answers(flight: &Flight, frame: usize, scale: f64) -> Option<Arc<Answers>> {
    let usual = flight.assumed.usual_bending(frame)?;
    let (curvature_per_m, twist_rad) = (&usual.curvature_per_m[..], &usual.twist_rad[..]);
    let bending = Bending { curvature_per_m, twist_rad, scale, ..Bending::NONE };
    Some(Arc::new(flight.input.scene.answers(&bending)))
}

/// All unknowns of a flight, placed.
struct Unknowns {
    columns: Columns,
    shared: Shared,
    cause: Option<usize>,
    head: usize,
    shape: ShapeColumns,
    mountings: Vec<OfMounting>,
    survey: usize,
    motions: Arc<Motions>,
    curvature_terms: usize,
}

impl Unknowns {
    fn place(flight: &Flight) -> Self {
        let (input, mountings) = (&flight.input, &flight.assumed.mountings);
        let curvature_terms =
            input.options.curvature_terms.map_or(TERMS, |t| t.clamp(2, MAX_CURVATURE_TERMS));
        let mut columns = Columns::default();
        let mut shared = terms::shared(input, &mut columns);
        shared.placed.extend(terms::of_flight(input).into_iter().map(|term| columns.place(term)));
        let cause = flight.cause.as_ref().map(|cause| {
            let first = columns.missing.len();
            shared.placed.push(columns.place(cause.term(input)));
            first
        });
        let head = columns.missing.len();
        let (axis, width) = (&input.scene.ground.axis, &input.setup.uncertainty.in_flight);
        let constant_per_m = width.constant_bend_m / axis.length_m.powi(2);
        let shape = ShapeColumns::take(&mut columns, curvature_terms, constant_per_m);
        let place = |mounting| OfMounting::place(input, mountings.stayed(mounting), &mut columns);
        let mountings = (0..mountings.count()).map(place).collect();
        let survey = columns.take(3 * input.setup.markers.len(), MISSING_GROUND);
        let motions = Arc::new(Motions::place(input, &flight.factors, &mut columns));
        Self { columns, shared, cause, head, shape, mountings, survey, motions, curvature_terms }
    }

    /// A frame's own: coefficients of curvature and twist, a rotation about its mounting's, and what moves it.
    fn own(&self, flight: &Flight, frame: usize) -> Vec<Placed> {
        let input = &flight.input;
        let own = [
            terms::curvature(self.curvature_terms, None),
            terms::twist(input.options.twist_terms.min(MAX_TWIST_TERMS)),
            terms::own_rotation(&own_rotation_covariance(flight)),
        ];
        let others = terms::of_frame(input, &flight.frames[frame], &flight.factors, true);
        let mut local = Columns::local();
        own.into_iter().chain(others).map(|term| local.place(term)).collect()
    }

    fn layout(&self, flight: &Flight, frame: usize) -> Layout {
        let mounting = &self.mountings[flight.assumed.mountings.of(frame)];
        let own = self.own(flight, frame);
        let [curvature, twist, rotation] = [0, 1, 2].map(|k| &own[k]);
        let expected_scale = flight.input.setup.thermal.as_ref().map_or(1.0, Thermal::scale);
        Layout {
            terms: [&own[..], &mounting.placed, &self.shared.placed].concat(),
            curvature: curvature.place,
            curvature_terms: curvature.term.size,
            twist: twist.place,
            twist_terms: twist.term.size,
            rotation: vec![rotation.place, ParameterScope::Global(mounting.columns.first)],
            axis_height: self.shared.axis_height,
            expected_scale,
            survey: Survey::Global(self.survey),
            motions: self.motions.clone(),
            answers: answers(flight, frame, expected_scale),
            root: self.shared.root.clone(),
            head: self.head,
            own: mounting.columns,
            local: own.iter().map(|placed| placed.term.size).sum(),
        }
    }

    /// What flights have in common, each with its column.
    fn lasting(&self, input: &Input) -> Vec<(InvariantParameter, usize)> {
        let mut all = vec![];
        let mut add = |term: &'static str, marker, first: usize, count: usize| {
            all.extend(
                (0..count)
                    .map(|index| (InvariantParameter { term: term.into(), index, marker }, first + index)),
            );
        };
        for Placed { term, place } in &self.shared.placed {
            if let ParameterScope::Global(first) = place
                && LASTING.contains(&term.name)
            {
                add(term.name, None, *first, term.size);
            }
        }
        add(SHAPE, None, self.shape.ratios, self.shape.changes - self.shape.ratios);
        for (marker, surveyed) in input.setup.markers.iter().enumerate() {
            let moves = self.motions.columns(marker);
            add(SURVEY, Some(marker), self.survey + 3 * marker, 3);
            add(if surveyed.fixed { MARKS } else { SKIN }, Some(marker), moves.start, moves.len());
        }
        all
    }

    /// What is stated of the global parameters.
    fn stated(&self, input: &Input) -> DVector<f64> {
        let mut stated = DVector::zeros(self.columns.missing.len());
        self.shape.start(&mut stated);
        for (k, station) in input.scene.ground.stations.iter().enumerate() {
            stated.rows_mut(self.survey + 3 * k, 3).copy_from(&station.surveyed_m);
        }
        stated
    }

    /// Start of the global parameters.
    fn start(&self, flight: &Flight, from: Option<&Fit>) -> DVector<f64> {
        let mut start = self.stated(&flight.input);
        let Some(fit) = from else { return start };
        let (shared, surveyed) = (self.shape.end(), start.len() - self.survey);
        start.rows_mut(0, shared).copy_from(&fit.global.rows(0, shared));
        for (mounting, OfMounting { columns, .. }) in self.mountings.iter().enumerate() {
            let mean = flight.assumed.mean(mounting);
            let known = columns.count.min(mean.len());
            start.rows_mut(columns.first, known).copy_from(&mean.rows(0, known));
        }
        let old = fit.global.rows(fit.global.len() - surveyed, surveyed);
        start.rows_mut(self.survey, surveyed).copy_from(&old);
        start
    }
}

impl FlightProblem {
    /// From an earlier solution, where there is one.
    pub fn new(flight: &Flight, from: Option<&Fit>) -> Self {
        let unknowns = Unknowns::place(flight);
        let layouts: Vec<_> = (0..flight.frames.len()).map(|f| unknowns.layout(flight, f)).collect();
        let frames = layouts.iter().enumerate().map(|(frame, layout)| flight.group(frame, layout, from));
        let (mut groups, members): (Vec<_>, Vec<_>) = frames.unzip();
        let (ground, ground_members) = flight.ground_group();
        groups.push(ground);
        let start = unknowns.start(flight, from);
        let (lasting, stated) = (unknowns.lasting(&flight.input), unknowns.stated(&flight.input));
        let (cause, taught) = (unknowns.cause, flight.input.options.flight_prior.as_deref());
        let known = taught.and_then(|taught| taught.known(&lasting, &stated));
        let axis = &flight.input.scene.ground.axis;
        let shape = SharedShape::new(unknowns.shape, &flight.assumed, axis, from.is_none());
        let Columns { missing, priors, .. } = unknowns.columns;
        let problem = Problem { start, missing, priors, known, groups };
        let ground = layouts.first().map(Layout::on_ground_only);
        Self { layouts, members, ground_members, problem, shape, lasting, stated, cause, ground }
    }

    /// One frame beside what is known of all that frames share; `problem`: without its groups.
    pub fn of_frame(
        layout: Layout,
        shape: SharedShape,
        group: Group,
        members: Vec<Member>,
        problem: Problem,
    ) -> Self {
        let problem = Problem { groups: vec![group], ..problem };
        let (layouts, members) = (vec![layout], vec![members]);
        let (lasting, stated) = (vec![], DVector::zeros(0));
        Self {
            layouts,
            members,
            ground_members: vec![],
            problem,
            shape,
            lasting,
            stated,
            cause: None,
            ground: None,
        }
    }

    /// Whose images the blocks are.
    pub fn blocks(&self) -> Blocks<'_> {
        Blocks { members: &self.members, ground: &self.ground_members }
    }

    fn linearise(
        &self,
        scene: &Scene,
        at: &GroupPoint,
        blocks: &mut Vec<Linearised>,
    ) -> Result<(), EstimationError> {
        let (layout, members) = match (self.layouts.get(at.group), &self.ground) {
            (Some(layout), _) => (layout, &self.members[at.group]),
            (None, Some(layout)) => return layout.linearise(scene, &self.ground_members, at, blocks),
            (None, None) => return Ok(()),
        };
        layout.linearise(scene, members, at, blocks)?;
        let Some(departure) = at.observed.last() else { return Ok(()) };
        if blocks.len() == members.len() {
            blocks.push(self.shape.empty(layout));
        }
        self.shape.linearise(layout, at, departure, &mut blocks[members.len()]);
        Ok(())
    }

    /// On a course.
    pub fn solve(&self, scene: &Scene, course: &SolveOptions) -> Result<Fit, EstimationError> {
        solve_with_options(&self.problem, course, |at, blocks| self.linearise(scene, at, blocks))
    }
}
