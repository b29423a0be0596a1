//! One frame set up for the engine: its unknowns, its observations, its conditions.

use nalgebra::{DMatrix, DVector};

use crate::measure::adjust::beam::MAX_TWIST_TERMS;
use crate::measure::adjust::gauss_helmert::{
    Block, Course, Fit, Group, GroupPoint, Linearised, Problem, solve_from,
};
use crate::measure::adjust::layout::{Layout, Place, Rows, Seen, Survey};
use crate::measure::adjust::model_error::image_covariance;
use crate::measure::adjust::outcome::Member;
use crate::measure::adjust::scene::Scene;
use crate::measure::adjust::unknowns::{
    Columns, Input, MISSING, common, mount_prior, shape_prior, shift_columns, stayed_prior, twist_priors,
};
use crate::measure::adjust::{AdjustError, Observation};
use crate::measure::setup::Thermal;

/// Which observations take part.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Usage {
    /// Per marker of the survey: its image in flight.
    pub flight: Vec<bool>,
    /// Its image on ground.
    pub ground: Vec<bool>,
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
    pub curvature_terms: usize,
    /// Leading coefficient that the shape ratios are weighed with, 1/m.
    pub amplitude: f64,
    /// Earlier solution of the same layout but for the number of terms.
    pub from: Option<(&'a Layout, &'a DVector<f64>)>,
}

impl<'a> Frame<'a> {
    pub fn new(input: &Input<'a>, usage: &Usage, start: &Start) -> Self {
        let mut columns = Columns::default();
        let (n, t) = (start.curvature_terms, input.options.twist_terms.min(MAX_TWIST_TERMS));
        let curvature = columns.take(n, MISSING[0]);
        let twist = columns.take(t, MISSING[1]);
        let mount = columns.take(3, MISSING[2]);
        let common = common(input, &mut columns);
        let mut priors: Vec<_> = shape_prior(curvature + 1, n, start.amplitude).into_iter().collect();
        priors.extend(twist_priors(twist, t));
        let stayed = input.options.is_of_the_ground();
        priors.push(if stayed { stayed_prior(input, mount) } else { mount_prior(input, mount) });
        priors.extend(common.priors);
        let shift = if stayed { None } else { shift_columns(input, &mut columns, &mut priors) };
        let shift = shift.map(Place::Global);
        let layout = Layout {
            curvature: Place::Global(curvature),
            curvature_terms: n,
            twist: Place::Global(twist),
            twist_terms: t,
            mount: Place::Global(mount),
            common_mount: None,
            shift,
            lens: common.lens.map(Place::Global),
            estimated: common.estimated.map(|e| e.map(Place::Global)),
            ground: common.ground.map(Place::Global),
            centre: common.centre.map(Place::Global),
            window: common.window.map(Place::Global),
            bow: common.bow.map(Place::Global),
            scale: common.scale.map(Place::Global),
            raise: Place::Global(common.raise),
            nominal_scale: input.setup.thermal.as_ref().map_or(1.0, Thermal::scale),
            survey: Survey::Observed,
            head: columns.missing.len(),
            own: (columns.missing.len(), 0),
            local: 0,
        };
        let mut members = vec![];
        let mut blocks = vec![];
        for marker in 0..input.setup.markers.len() {
            let mut member = Member { marker, flight: None, ground: None };
            let block = block(input, &mut member, usage.flight[marker], usage.ground[marker]);
            if member.flight.is_some() || member.ground.is_some() {
                members.push(member);
                blocks.push(block);
            }
        }
        let group = Group { local: DVector::zeros(0), priors: vec![], blocks };
        let start = start_values(&layout, start);
        let problem = Problem { start, missing: columns.missing, priors, known: None, groups: vec![group] };
        Self { scene: input.scene, layout, problem, members }
    }

    /// All blocks of the frame at a point.
    pub fn linearise(&self, at: &GroupPoint, blocks: &mut Vec<Linearised>) -> Result<(), AdjustError> {
        let values = self.layout.values(at.global, at.local);
        let bent = self.scene.bend(&values.bending());
        let camera = self.scene.camera(&values.pose);
        let on_ground = self.scene.ground_camera(&values.pose);
        for (block, (member, observed)) in self.members.iter().zip(at.observed).enumerate() {
            let conditions =
                2 * (usize::from(member.flight.is_some()) + usize::from(member.ground.is_some()));
            let mut rows =
                Rows::new(&self.layout, (blocks, block), member.marker, conditions, observed.len());
            let ground_m = self.layout.on_ground(member.marker, at.global, observed);
            let seen = |observation| Seen {
                marker: member.marker,
                bent: &bent,
                values: &values,
                ground_m,
                observed,
                observation,
            };
            if let Some(first) = member.flight {
                rows.flight(0, &seen(first), self.scene, &camera)?;
            }
            if let Some(first) = member.ground {
                rows.ground(conditions - 2, &seen(first), self.scene, &on_ground)?;
            }
        }
        Ok(())
    }

    pub fn solve(&self, course: &Course) -> Result<Fit, AdjustError> {
        solve_from(&self.problem, course, |at, blocks| self.linearise(at, blocks))
    }
}

/// Survey, flight image and ground image of a marker as one block.
fn block(input: &Input, member: &mut Member, with_flight: bool, with_ground: bool) -> Block {
    let marker = &input.setup.markers[member.marker];
    let mut observed = input.scene.ground.stations[member.marker].surveyed_m.as_slice().to_vec();
    let flight = input.flight[member.marker].filter(|_| with_flight);
    let ground = input.scene.ground_sights[member.marker].as_ref().filter(|_| with_ground);
    member.flight = flight.map(|_| 3);
    member.ground = ground.map(|_| if flight.is_some() { 5 } else { 3 });
    let images: Vec<&Observation> = flight.into_iter().chain(ground).collect();
    observed.extend(images.iter().flat_map(|o| [o.pixel.x, o.pixel.y]));
    let n = observed.len();
    let mut covariance = DMatrix::zeros(n, n);
    for k in 0..3 {
        covariance[(k, k)] = marker.sigma_m * marker.sigma_m;
    }
    for (k, image) in images.iter().enumerate() {
        covariance
            .fixed_view_mut::<2, 2>(3 + 2 * k, 3 + 2 * k)
            .copy_from(&image_covariance(&image.covariance_px2));
    }
    Block { observed: DVector::from_vec(observed), covariance }
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
