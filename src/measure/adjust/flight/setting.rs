//! A flight set up for the engine: shared unknowns, one group per frame, survey and ground frame last.

use std::sync::Arc;

use nalgebra::{DVector, Matrix3};

use super::frames::Flight;
use super::shape::{ShapeColumns, SharedShape};
use crate::measure::adjust::AdjustError;
use crate::measure::adjust::beam::{MAX_CURVATURE_TERMS, MAX_TWIST_TERMS};
use crate::measure::adjust::gauss_helmert::{
    Course, Fit, Group, GroupPoint, Linearised, Problem, solve_from,
};
use crate::measure::adjust::input::Input;
use crate::measure::adjust::layout::{Layout, Own, Rows, Seen, Survey};
use crate::measure::adjust::scene::Scene;
use crate::measure::adjust::snooping::Member;
use crate::measure::adjust::term::{Columns, Placed};
use crate::measure::adjust::terms::{self, Curvature, Rotation, Shared, Twist};
use crate::measure::setup::Thermal;

const MISSING_GROUND: &str = "a marker on ground is not determined";
/// Terms of the curvature where none are given.
const TERMS: usize = 8;

/// A flight set up for the engine.
pub struct Setting {
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
    ground: Option<Layout>,
}

/// What the frames of one mounting have in common.
struct OfMounting {
    rotation: Placed,
    others: Vec<Placed>,
    columns: Own,
}

impl OfMounting {
    fn place(input: &Input, stayed: bool, columns: &mut Columns) -> Self {
        let rotation = columns.place(terms::rotation(input, stayed));
        let first = columns.missing.len() - rotation.term.size();
        let others = terms::of_mounting(input, stayed).into_iter().map(|term| columns.place(term)).collect();
        Self { rotation, others, columns: Own { first, count: columns.missing.len() - first } }
    }
}

/// What a frame has for itself: coefficients of curvature and twist, and a rotation about its mounting's.
struct OfFrame {
    curvature: Placed,
    twist: Placed,
    rotation: Placed,
    local: usize,
}

impl OfFrame {
    fn place(flight: &Flight, terms: usize) -> Self {
        let mut columns = Columns::local();
        let curvature = columns.place(Arc::new(Curvature { terms, amplitude_per_m: None }));
        let twist_terms = flight.input.options.twist_terms.min(MAX_TWIST_TERMS);
        let twist = columns.place(Arc::new(Twist { terms: twist_terms }));
        let rotation = columns.place(Arc::new(Rotation::about_mounting(own_rotation_covariance(flight))));
        Self { curvature, twist, rotation, local: columns.missing.len() }
    }
}

/// Of a frame's rotation about its mounting's. Where the mount's repeatability puts them all is counted once, not once
/// for each.
fn own_rotation_covariance(flight: &Flight) -> Matrix3<f64> {
    match flight.assumed.mountings.are_found() {
        false => Rotation::of_mounting(&flight.input).covariance_rad2,
        true => flight.assumed.drift_covariance(&flight.input.scene.camera_from_wing),
    }
}

/// All unknowns of a flight, placed.
struct Unknowns {
    columns: Columns,
    shared: Shared,
    head: usize,
    shape: ShapeColumns,
    mountings: Vec<OfMounting>,
    survey: usize,
    own: OfFrame,
}

impl Unknowns {
    fn place(flight: &Flight) -> Self {
        let (input, mountings) = (&flight.input, &flight.assumed.mountings);
        let terms = input.options.curvature_terms.map_or(TERMS, |t| t.clamp(2, MAX_CURVATURE_TERMS));
        let mut columns = Columns::default();
        let shared = terms::shared(input, &mut columns);
        let head = columns.missing.len();
        let shape = ShapeColumns::take(&mut columns, terms);
        let place = |mounting| OfMounting::place(input, mountings.stayed(mounting), &mut columns);
        let mountings = (0..mountings.count()).map(place).collect();
        let survey = columns.take(3 * input.setup.markers.len(), MISSING_GROUND);
        let own = OfFrame::place(flight, terms);
        Self { columns, shared, head, shape, mountings, survey, own }
    }

    fn layout(&self, flight: &Flight, frame: usize) -> Layout {
        let (own, mounting) = (&self.own, &self.mountings[flight.assumed.mountings.of(frame)]);
        let placed = [&own.curvature, &own.twist, &own.rotation, &mounting.rotation].map(Clone::clone);
        let terms = placed.iter().chain(&mounting.others).chain(&self.shared.placed).cloned().collect();
        Layout {
            terms,
            curvature: own.curvature.place,
            curvature_terms: own.curvature.term.size(),
            twist: own.twist.place,
            twist_terms: own.twist.term.size(),
            rotation: vec![own.rotation.place, mounting.rotation.place],
            axis_height: self.shared.axis_height,
            expected_scale: flight.input.setup.thermal.as_ref().map_or(1.0, Thermal::scale),
            survey: Survey::Global(self.survey),
            head: self.head,
            own: mounting.columns,
            local: own.local,
        }
    }

    /// Start of the global parameters.
    fn start(&self, flight: &Flight, from: Option<&Fit>) -> DVector<f64> {
        let mut start = DVector::zeros(self.columns.missing.len());
        self.shape.start(&mut start);
        for (k, station) in flight.input.scene.ground.stations.iter().enumerate() {
            start.rows_mut(self.survey + 3 * k, 3).copy_from(&station.surveyed_m);
        }
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

impl Setting {
    /// From an earlier solution, where there is one.
    pub fn new(flight: &Flight, from: Option<&Fit>) -> Self {
        let unknowns = Unknowns::place(flight);
        let layouts: Vec<_> = (0..flight.frames.len()).map(|f| unknowns.layout(flight, f)).collect();
        let frames = layouts.iter().enumerate().map(|(frame, layout)| flight.group(frame, layout, from));
        let (mut groups, members): (Vec<_>, Vec<_>) = frames.unzip();
        let (ground, ground_members) = flight.ground_group();
        groups.push(ground);
        let start = unknowns.start(flight, from);
        let axis = &flight.input.scene.ground.axis;
        let shape = SharedShape::new(unknowns.shape, &flight.assumed, axis, from.is_none());
        let Columns { missing, priors, .. } = unknowns.columns;
        let problem = Problem { start, missing, priors, known: None, groups };
        let ground = layouts.first().map(Layout::on_ground_only);
        Self { layouts, members, ground_members, problem, shape, ground }
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
        Self { layouts, members, ground_members: vec![], problem, shape, ground: None }
    }

    fn linearise(
        &self,
        scene: &Scene,
        at: &GroupPoint,
        blocks: &mut Vec<Linearised>,
    ) -> Result<(), AdjustError> {
        match (self.layouts.get(at.group), &self.ground) {
            (Some(layout), _) => self.frame(scene, layout, at, blocks),
            (None, Some(layout)) => self.ground(scene, layout, at, blocks),
            (None, None) => Ok(()),
        }
    }

    fn frame(
        &self,
        scene: &Scene,
        layout: &Layout,
        at: &GroupPoint,
        blocks: &mut Vec<Linearised>,
    ) -> Result<(), AdjustError> {
        let values = layout.values(at.global, at.local);
        let bent = scene.bend(&values.bending());
        let camera = scene.camera(&values.pose);
        for (block, (member, observed)) in self.members[at.group].iter().zip(at.observed).enumerate() {
            let seen = Seen {
                marker: member.marker,
                bent: &bent,
                values: &values,
                ground_m: layout.on_ground(member.marker, at.global, observed),
                observed,
                observation: 0,
            };
            Rows::new(layout, (blocks, block), member.marker, 2, 2).flight(0, &seen, scene, &camera)?;
        }
        let Some(departure) = at.observed.last() else { return Ok(()) };
        let last = self.members[at.group].len();
        if blocks.len() == last {
            blocks.push(self.shape.empty(layout));
        }
        self.shape.linearise(layout, at, departure, &mut blocks[last]);
        Ok(())
    }

    fn ground(
        &self,
        scene: &Scene,
        layout: &Layout,
        at: &GroupPoint,
        blocks: &mut Vec<Linearised>,
    ) -> Result<(), AdjustError> {
        let values = layout.values(at.global, at.local);
        let flat = scene.bend(&values.bending());
        let camera = scene.ground_camera(&values.pose);
        for (block, (member, observed)) in self.ground_members.iter().zip(at.observed).enumerate() {
            let sights = member.ground.map_or(0, |_| 2);
            let mut rows = Rows::new(layout, (blocks, block), member.marker, 3 + sights, 3 + sights);
            let ground_m = layout.on_ground(member.marker, at.global, observed);
            rows.surveyed(0, &ground_m, observed);
            if let Some(observation) = member.ground {
                let (marker, bent) = (member.marker, &flat);
                let seen = Seen { marker, bent, values: &values, ground_m, observed, observation };
                rows.ground(3, &seen, scene, &camera)?;
            }
        }
        Ok(())
    }

    /// On a course.
    pub fn solve(&self, scene: &Scene, course: &Course) -> Result<Fit, AdjustError> {
        solve_from(&self.problem, course, |at, blocks| self.linearise(scene, at, blocks))
    }
}
