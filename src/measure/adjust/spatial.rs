//! The rigid-section beam, one frame (docs/model.md).

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::beam::{MAX_CURVATURE_TERMS, MAX_TWIST_TERMS};
use super::gauss_helmert::{Block, Course, Fit, Group, GroupPoint, Linearised, Prior, Problem, solve_from};
use super::layout::{Layout, Place, Rows, Seen, Survey};
use super::model_error::image_covariance;
use super::outcome::{Member, Outcome};
use super::scene::Scene;
use super::snooping::{self, Suspect, Target};
use super::{AdjustError, Method, Observation, Options, Solution, quality};
use crate::measure::setup::{Orientation, Setup, Thermal};

/// Fewest markers in flight.
const FEWEST: usize = 6;
/// Standard deviations of the curvature's coefficients over the leading one, from the second term
/// on: Legendre coefficients of tapered cantilevers (taper 0.2 to 0.45, stiffness with the 2.5th to
/// the 4th power of the chord, lift from triangular to elliptic, fuel relief to 35 % of the lift)
/// against the reference beam, rounded up so that a uniform beam and a parabola stay within three.
const SHAPE_RATIO_SIGMA: [f64; MAX_CURVATURE_TERMS - 1] = [0.5, 0.5, 0.4, 0.3, 0.2, 0.15, 0.1, 0.1, 0.1];
/// Bending below this counts as unbent when the shape ratios are weighed, 1/m (0.1 m at 32 m).
const SMALLEST_CURVATURE_PER_M: f64 = 2e-4;
/// Bending to start with, 1/m.
const USUAL_CURVATURE_PER_M: f64 = 5e-3;
/// Standard deviation of the first two terms of the twist, rad: a few degrees.
const TWIST_SIGMA_RAD: f64 = 0.1;
/// Of the further ones, rad.
const TWIST_DETAIL_SIGMA_RAD: f64 = 0.02;
/// How well the height of the bending axis below the skin is known, m: the stated skin height and the
/// separation of crown from dihedral.
const AXIS_SIGMA_M: f64 = 0.01;
/// Orders of the curvature that are weighed against one another where none is given.
const ORDERS: [usize; 2] = [8, 10];
/// The order that blunders are looked for with.
const USUAL_ORDER: usize = 8;

/// Names of what is missing where the normal equations are singular, in the layout's order.
const MISSING: [&str; 7] = [
    "bending cannot be determined from the markers at hand; markers along the whole span are needed",
    "twist cannot be determined; markers near the leading and the trailing edge are needed",
    "the mounting's rotation cannot be determined; give camera.mount_repeatability_px or more markers near the root",
    "the rotation on ground cannot be determined; more markers in the ground frame are needed",
    "the projection centre cannot be determined; give camera.projection_centre_sigma_m",
    "the thermal scale cannot be determined; give its standard deviation",
    "the height of the bending axis cannot be determined",
];

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

/// What a frame is set up from.
pub(super) struct Input<'a> {
    pub setup: &'a Setup,
    pub orientation: &'a Orientation,
    pub scene: &'a Scene,
    pub options: &'a Options,
    /// Per marker of the survey.
    pub flight: Vec<Option<&'a Observation>>,
}

/// Standard deviation of the thermal scale, where it is known.
pub(super) fn scale_sigma(thermal: &Thermal) -> f64 {
    let difference = thermal.flight_temperature_c - thermal.ground_temperature_c;
    let coefficient = thermal.expansion_sigma_per_k.unwrap_or(0.0) * difference;
    let temperature = thermal.flight_temperature_sigma_k.unwrap_or(0.0) * thermal.expansion_per_k;
    coefficient.hypot(temperature)
}

/// Columns handed out one after the other.
#[derive(Default)]
pub(super) struct Columns {
    pub missing: Vec<&'static str>,
}

impl Columns {
    pub fn take(&mut self, n: usize, missing: &'static str) -> usize {
        let first = self.missing.len();
        self.missing.extend(std::iter::repeat_n(missing, n));
        first
    }
}

/// The unknowns of camera and temperature, with their priors.
pub(super) struct Common {
    pub ground: Option<usize>,
    pub centre: Option<usize>,
    pub scale: Option<usize>,
    pub axis: usize,
    pub priors: Vec<Prior>,
}

/// Takes columns for what all frames share.
pub(super) fn common(input: &Input, columns: &mut Columns) -> Common {
    let setup = input.setup;
    let mut priors = vec![];
    let ground = input.scene.has_ground_sights().then(|| columns.take(3, MISSING[3]));
    let centre_sigma = setup.projection_centre_sigma_m;
    let centre = (centre_sigma > 0.0).then(|| columns.take(3, MISSING[4]));
    priors.extend(
        centre.iter().flat_map(|&first| (0..3).map(move |k| Prior::scalar(first + k, 0.0, centre_sigma))),
    );
    let sigma = setup.thermal.as_ref().map_or(0.0, scale_sigma);
    let scale = (sigma > 0.0).then(|| columns.take(1, MISSING[5]));
    priors.extend(scale.map(|column| Prior::scalar(column, 0.0, sigma)));
    let axis = columns.take(1, MISSING[6]);
    priors.push(Prior::scalar(axis, 0.0, AXIS_SIGMA_M));
    Common { ground, centre, scale, axis, priors }
}

/// What is known of the mounting's rotation before a frame is seen, camera frame, rad.
pub(super) fn mount_prior(input: &Input, first: usize) -> Prior {
    let shift = input.setup.mount_repeatability_px.max(1e-3) / input.setup.lens.focal_px();
    let stated = input.orientation.covariance_rad2.filter(|_| !input.scene.has_ground_sights());
    let own = Matrix3::identity() * (shift * shift) + stated.unwrap_or_else(Matrix3::zeros);
    let (mean, covariance) = input.options.mount_prior.unwrap_or((Vector3::zeros(), own));
    Prior {
        columns: (first..first + 3).collect(),
        mean: DVector::from_column_slice(mean.as_slice()),
        covariance: DMatrix::from_column_slice(3, 3, covariance.as_slice()),
    }
}

/// Priors on shape and twist; `curvature` and `twist` are first columns.
pub(super) fn shape_priors(curvature: usize, n: usize, twist: usize, t: usize, amplitude: f64) -> Vec<Prior> {
    let ratio = |k: usize| Prior::scalar(curvature + k, 0.0, SHAPE_RATIO_SIGMA[k - 1] * amplitude);
    (1..n).map(ratio).chain(twist_priors(twist, t)).collect()
}

/// Loose priors on the twist.
pub(super) fn twist_priors(twist: usize, t: usize) -> impl Iterator<Item = Prior> {
    let sigma = |k: usize| if k < 2 { TWIST_SIGMA_RAD } else { TWIST_DETAIL_SIGMA_RAD };
    (0..t).map(move |k| Prior::scalar(twist + k, 0.0, sigma(k)))
}

/// Ratio priors for methods that share the shape among frames.
pub(super) fn ratio_sigma(term: usize) -> f64 {
    SHAPE_RATIO_SIGMA[term - 1]
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
        let mut priors = shape_priors(curvature, n, twist, t, start.amplitude);
        priors.push(mount_prior(input, mount));
        priors.extend(common.priors);
        let layout = Layout {
            curvature: Place::Global(curvature),
            curvature_terms: n,
            twist: Place::Global(twist),
            twist_terms: t,
            mount: Place::Global(mount),
            ground: common.ground.map(Place::Global),
            centre: common.centre.map(Place::Global),
            scale: common.scale.map(Place::Global),
            axis: Place::Global(common.axis),
            nominal_scale: input.setup.thermal.as_ref().map_or(1.0, Thermal::scale),
            survey: Survey::Observed,
            head: columns.missing.len(),
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
        let problem = Problem { start, missing: columns.missing, priors, groups: vec![group] };
        Self { scene: input.scene, layout, problem, members }
    }

    /// All blocks of the frame at a point.
    pub fn linearise(&self, at: &GroupPoint) -> Result<Vec<Linearised>, AdjustError> {
        let values = self.layout.values(at.global, at.local);
        let sections = self.scene.grid.bend(&values.bending());
        let block = |(member, observed): (&Member, &DVector<f64>)| {
            let conditions =
                2 * (usize::from(member.flight.is_some()) + usize::from(member.ground.is_some()));
            let mut rows = Rows::new(&self.layout, member.marker, conditions, observed.len());
            let ground_m = self.layout.on_ground(member.marker, at.global, observed);
            let seen = |observation| Seen {
                marker: member.marker,
                section: &sections[member.marker],
                values: &values,
                ground_m,
                observed,
                observation,
            };
            if let Some(first) = member.flight {
                rows.flight(0, &seen(first), self.scene)?;
            }
            if let Some(first) = member.ground {
                rows.ground(conditions - 2, &seen(first), self.scene)?;
            }
            Ok(rows.finish())
        };
        self.members.iter().zip(at.observed).map(block).collect()
    }

    pub fn solve(&self, course: &Course) -> Result<Fit, AdjustError> {
        solve_from(&self.problem, course, |at| self.linearise(at))
    }
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

/// A frame with its solution.
struct Solved<'a> {
    frame: Frame<'a>,
    fit: Fit,
    amplitude: f64,
}

impl<'a> Solved<'a> {
    /// Two passes: the first finds the amplitude that the shape ratios are weighed with.
    fn new(
        input: &Input<'a>,
        usage: &Usage,
        terms: usize,
        before: Option<&Solved>,
    ) -> Result<Self, AdjustError> {
        let mut amplitude = before.map_or(USUAL_CURVATURE_PER_M, |b| b.amplitude);
        let mut solved: Option<Self> = None;
        for _ in 0..3 {
            let last = solved.as_ref().or(before);
            let from = last.map(|s| (&s.frame.layout, &s.fit.global));
            let frame = Frame::new(input, usage, &Start { curvature_terms: terms, amplitude, from });
            let fit = frame.solve(&Course { rough: true, residuals: last.map(|s| &s.fit) })?;
            let found = fit.global[0].abs().max(SMALLEST_CURVATURE_PER_M);
            let settled = (found / amplitude).ln().abs() < 0.05;
            solved = Some(Self { frame, fit, amplitude: if settled { amplitude } else { found } });
            if settled {
                break;
            }
            amplitude = found;
        }
        solved.ok_or(AdjustError::NoConvergence { iterations: 0 })
    }

    /// From rough to converged.
    fn finish(&mut self) -> Result<(), AdjustError> {
        self.frame.problem.start = self.fit.global.clone();
        self.fit = self.frame.solve(&Course { rough: false, residuals: Some(&self.fit) })?;
        Ok(())
    }

    /// Minus twice the logarithm of the evidence of this order, but for terms that all orders share.
    fn misfit(&self) -> f64 {
        let shape: f64 = (1..self.frame.layout.curvature_terms)
            .map(|k| 2.0 * (SHAPE_RATIO_SIGMA[k - 1] * self.amplitude).ln())
            .sum();
        let determinant =
            self.fit.covariance.clone().cholesky().map_or(f64::NEG_INFINITY, |c| c.ln_determinant());
        self.fit.omega - determinant + shape
    }
}

/// The most probable order of the curvature, given the data and what beams look like.
fn choose_order<'a>(input: &Input<'a>, usage: &Usage, usual: Solved<'a>) -> Result<Solved<'a>, AdjustError> {
    let amplitude = usual.amplitude;
    let mut best = usual;
    for terms in ORDERS.into_iter().filter(|&t| t != USUAL_ORDER) {
        let from = Some((&best.frame.layout, &best.fit.global));
        let frame = Frame::new(input, usage, &Start { curvature_terms: terms, amplitude, from });
        let fit = frame.solve(&Course { rough: true, residuals: Some(&best.fit) })?;
        let other = Solved { frame, fit, amplitude };
        if other.misfit() < best.misfit() {
            best = other;
        }
    }
    Ok(best)
}

/// Reads observations into the survey's order.
pub(super) fn by_marker<'a>(
    setup: &Setup,
    observations: &'a [Observation],
) -> Result<Vec<Option<&'a Observation>>, AdjustError> {
    let mut list = vec![None; setup.markers.len()];
    for o in observations {
        let finite = o.pixel.iter().chain(o.covariance_px2.iter()).all(|v| v.is_finite());
        if !finite || o.covariance_px2.cholesky().is_none() {
            return Err(AdjustError::Input(
                "an image coordinate or its standard deviation is not a finite, positive number".into(),
            ));
        }
        let slot = list.get_mut(o.marker).ok_or_else(|| {
            AdjustError::Input("an observation names a marker that the survey does not list".into())
        })?;
        *slot = Some(o);
    }
    Ok(list)
}

/// Adjusts, removing blunders one by one, the worst first; a removed one that fits later comes back.
fn adjust<'a>(
    input: &Input<'a>,
    usage: &mut Usage,
    terms: usize,
) -> Result<(Solved<'a>, Vec<Suspect>), AdjustError> {
    let mut removed: Vec<Suspect> = vec![];
    let mut solved = Solved::new(input, usage, terms, None)?;
    let allowed = input.flight.iter().flatten().count() / 3;
    while removed.len() < allowed {
        let Some(suspect) =
            snooping::worst(&solved.frame.problem, &solved.fit, 0, &solved.frame.members, input.options)
        else {
            break;
        };
        apply(&suspect, usage, false);
        if usage.flight.iter().zip(&input.flight).filter(|(u, o)| **u && o.is_some()).count() < FEWEST {
            apply(&suspect, usage, true);
            break;
        }
        removed.push(suspect);
        solved = Solved::new(input, usage, terms, Some(&solved))?;
    }
    readmit(input, usage, terms, solved, removed)
}

fn apply(suspect: &Suspect, usage: &mut Usage, value: bool) {
    if suspect.target != Target::Ground {
        usage.flight[suspect.marker] = value;
    }
    if suspect.target != Target::Flight {
        usage.ground[suspect.marker] = value;
    }
}

/// An early suspect may have been the victim of a later one: each gets a second chance, with all the
/// others out.
fn readmit<'a>(
    input: &Input<'a>,
    usage: &mut Usage,
    terms: usize,
    mut solved: Solved<'a>,
    removed: Vec<Suspect>,
) -> Result<(Solved<'a>, Vec<Suspect>), AdjustError> {
    if removed.len() < 2 {
        return Ok((solved, removed));
    }
    let mut out = vec![];
    for suspect in removed {
        let mut with = usage.clone();
        apply(&suspect, &mut with, true);
        let again = Solved::new(input, &with, terms, Some(&solved));
        match again {
            Ok(again)
                if snooping::worst(
                    &again.frame.problem,
                    &again.fit,
                    0,
                    &again.frame.members,
                    input.options,
                )
                .is_none() =>
            {
                *usage = with;
                solved = again;
            }
            _ => out.push(suspect),
        }
    }
    Ok((solved, out))
}

/// The rigid-section beam, one frame.
pub(super) fn solve(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    options: &Options,
) -> Result<Solution, AdjustError> {
    let scene = Scene::new(setup, orientation)?;
    let flight = by_marker(setup, observations)?;
    let found = flight.iter().flatten().count();
    if found < FEWEST {
        return Err(AdjustError::TooFewMarkers { found, needed: FEWEST });
    }
    let input = Input { setup, orientation, scene: &scene, options, flight };
    let n = setup.markers.len();
    let mut usage = Usage { flight: vec![true; n], ground: vec![true; n] };
    let terms = options.curvature_terms.map_or(USUAL_ORDER, |t| t.clamp(1, MAX_CURVATURE_TERMS));
    let (mut solved, removed) = adjust(&input, &mut usage, terms)?;
    if options.curvature_terms.is_none() {
        solved = choose_order(&input, &usage, solved)?;
    }
    solved.finish()?;
    dress(&input, solved, &removed)
}

fn dress(input: &Input, mut solved: Solved, removed: &[Suspect]) -> Result<Solution, AdjustError> {
    let (setup, options) = (input.setup, input.options);
    let mut components = vec![];
    if options.variance_components {
        let mut problem = solved.frame.problem.clone();
        let image = |_: usize, block: usize| (3..problem_size(&solved.frame, block)).collect();
        let survey = |_: usize, _: usize| vec![0, 1, 2];
        let groups = [
            quality::VarianceGroup { name: "image", members: &image },
            quality::VarianceGroup { name: "survey", members: &survey },
        ];
        let (fit, found) =
            quality::variance_components(&mut problem, &groups, |at| solved.frame.linearise(at))?;
        components = found;
        solved.frame.problem = problem;
        solved.fit = fit;
    }
    let fit = &solved.fit;
    let test = quality::global_test(fit.omega, fit.redundancy, options.global_alpha);
    let posterior = quality::is_posterior(options.sigma, test);
    let factor = fit.variance_factor();
    let scale = if posterior { factor.map_or(1.0, f64::sqrt) } else { 1.0 };
    let frame = &solved.frame;
    let outcome = Outcome::new(
        setup,
        input.scene,
        &frame.layout,
        &frame.problem,
        fit,
        0,
        &frame.members,
        options,
        scale,
    );
    let mut markers = outcome.markers();
    let mut remarks = vec![];
    for suspect in removed {
        let sentence = suspect.sentence(setup, options);
        if suspect.target != Target::Ground {
            markers[suspect.marker].reason = Some(sentence.clone());
        }
        remarks.push(sentence);
    }
    let (curve, parabola, a) = outcome.curve();
    let (parameters, correlation, pitch_bending_correlation) = outcome.parameters(&parabola, a);
    if options.curvature_terms.is_none() {
        remarks.push(format!("curvature of {} terms, chosen by test", frame.layout.curvature_terms));
    }
    remarks.extend(separation(input.scene, pitch_bending_correlation).map(Cow::into_owned));
    Ok(Solution {
        method: Method::Spatial,
        variance_factor: factor,
        redundancy: fit.redundancy,
        global_test: test,
        posterior,
        parameters,
        correlation,
        pitch_bending_correlation,
        markers,
        torsion: outcome.torsion(),
        curve,
        variance_components: components,
        remarks,
        iterations: fit.iterations,
    })
}

fn problem_size(frame: &Frame, block: usize) -> usize {
    frame.problem.groups[0].blocks[block].observed.len()
}

/// Says where pitch and bending can hardly be told apart.
pub(super) fn separation(scene: &Scene, correlation: Option<f64>) -> Option<Cow<'static, str>> {
    let weak = correlation.is_some_and(|c| c.abs() > 0.9);
    (weak && !scene.has_ground_sights()).then_some(Cow::Borrowed(
        "the mounting's pitch and bending are hardly separated in this frame; an orientation written by `wingd orient` \
         (with the ground frame's sights) or several frames with --flight tell them apart",
    ))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::measure::geometry::Lens;
    use crate::measure::setup::{GroundSight, Shape, SkinHeight, SurveyMarker};
    use nalgebra::{Matrix2, Rotation3, Vector2};

    fn setup() -> Setup {
        let marker = |k: usize| SurveyMarker {
            id: format!("M{k}"),
            shape: Shape::Circle,
            diameter_m: 0.3,
            position_m: Vector3::new(
                6.0 + 3.0 * k as f64,
                if k.is_multiple_of(2) { 1.5 } else { -1.2 },
                -1.3 + 0.2 * k as f64,
            ),
            sigma_m: 0.002,
        };
        Setup {
            name: "t".into(),
            lens: Lens {
                k1: -0.05,
                k2: 0.09,
                p1: -3e-4,
                ..Lens::pinhole(4000, 3000, 7800.0, 1986.0, 1513.0)
            },
            projection_centre_m: Vector3::zeros(),
            projection_centre_sigma_m: 0.002,
            mount_repeatability_px: 10.0,
            span_direction: Vector2::new(1.0, 0.0),
            root_offset_m: 0.5,
            axis_chord_offset_m: Some(0.1),
            skin_height: Some(SkinHeight { root_m: 0.5, tip_m: 0.1, tip_span_m: 33.0 }),
            thermal: Some(Thermal {
                expansion_per_k: 23e-6,
                expansion_sigma_per_k: Some(1e-6),
                ground_temperature_c: 15.0,
                flight_temperature_c: -55.0,
                flight_temperature_sigma_k: Some(5.0),
            }),
            torsion: vec![],
            markers: (0..9).map(marker).collect(),
            tie_points: vec![],
            cad_similarity: false,
            window: None,
        }
    }

    fn orientation() -> Orientation {
        let camera_from_survey =
            Rotation3::from_matrix_unchecked(Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0));
        let sight = |marker| GroundSight {
            marker,
            pixel: Vector2::new(1900.0, 1500.0),
            covariance_px2: Matrix2::identity(),
        };
        Orientation { camera_from_survey, covariance_rad2: None, ground: (0..9).map(sight).collect() }
    }

    #[test]
    fn derivatives_match_differences() {
        let (setup, orientation) = (setup(), orientation());
        let scene = Scene::new(&setup, &orientation).unwrap();
        let options = Options::default();
        let observation = |marker| Observation {
            marker,
            pixel: Vector2::new(1900.0, 1500.0),
            covariance_px2: Matrix2::identity(),
        };
        let observations: Vec<_> = (0..9).map(observation).collect();
        let flight = by_marker(&setup, &observations).unwrap();
        let input =
            Input { setup: &setup, orientation: &orientation, scene: &scene, options: &options, flight };
        let usage = Usage { flight: vec![true; 9], ground: vec![true; 9] };
        let frame = Frame::new(&input, &usage, &Start { curvature_terms: 5, amplitude: 0.005, from: None });
        let p = frame.problem.start.len();
        let global = DVector::from_fn(p, |k, _| match k {
            0..5 => 0.004 / (1.0 + k as f64),
            5..8 => 0.03,
            _ => 2e-3 * (1.0 + (k % 3) as f64),
        });
        let local = DVector::zeros(0);
        let observed: Vec<_> = frame.problem.groups[0].blocks.iter().map(|b| b.observed.clone()).collect();
        let at = |global: &DVector<f64>, observed: &[DVector<f64>]| {
            frame.linearise(&GroupPoint { group: 0, global, local: &local, observed }).unwrap()
        };
        let here = at(&global, &observed);
        for column in 0..p {
            let mut step = DVector::zeros(p);
            step[column] = 1e-6;
            let (up, down) = (at(&(&global + &step), &observed), at(&(&global - &step), &observed));
            for (b, block) in here.iter().enumerate() {
                let difference = (&up[b].misclosure - &down[b].misclosure) / 2e-6;
                let error = (&difference - block.global.column(column)).norm();
                assert!(
                    error < 1e-5 * (1.0 + difference.norm()),
                    "column {column} block {b}: {difference} {}",
                    block.global.column(column)
                );
            }
        }
        for k in 0..7 {
            let shifted = |d: f64| {
                let mut list = observed.clone();
                list.iter_mut().for_each(|o| o[k] += d);
                at(&global, &list)
            };
            let (up, down) = (shifted(1e-6), shifted(-1e-6));
            for (b, block) in here.iter().enumerate() {
                let difference = (&up[b].misclosure - &down[b].misclosure) / 2e-6;
                let error = (&difference - block.observations.column(k)).norm();
                assert!(error < 1e-5 * (1.0 + difference.norm()), "observation {k} block {b}");
            }
        }
    }
}
