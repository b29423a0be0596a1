//! The rigid-section beam, one frame (docs/model.md).

mod frame;

use std::borrow::Cow;

use nalgebra::DMatrix;

use self::frame::{Frame, Single, Start, Usage};
use super::beam::MAX_CURVATURE_TERMS;
use super::budget::{Blocks, with_sources};
use super::common_displacement::causes;
use super::factors::Factors;
use super::flight;
use super::input::{Input, by_marker, on_the_wing};
use super::outcome::Outcome;
use super::scene::Scene;
use super::shapes::shape_covariance;
use super::snooping::{self, Removable, ResidualSum, Snooped, Suspect, Target};
use super::{AdjustError, Method, Observation, Options, Solution, VarianceComponent};
use crate::estimation::{EstimationError, Fit, SolveOptions, VarianceGroup, quality, variance_components};
use crate::setup::{Orientation, Setup};

/// Fewest markers on the wing, in flight.
const MIN_MARKERS: usize = 6;
/// Of a frame's observations, no more than one in so many are left out.
const LEFT_OUT: usize = 3;
/// Bending below this counts as unbent when the shape ratios are weighed, 1/m (0.1 m at 32 m).
const MIN_CURVATURE_PER_M: f64 = 2e-4;
/// Bending to start with, 1/m.
const USUAL_CURVATURE_PER_M: f64 = 5e-3;
/// Passes in which the amplitude settles that the shape ratios are weighed with.
const AMPLITUDE_PASSES: usize = 3;
/// Change of the amplitude's logarithm that no longer matters.
const AMPLITUDE_SETTLED: f64 = 0.05;

/// Orders of the curvature that are weighed against one another where none is given.
const ORDERS: [usize; 2] = [8, 10];
/// The order that blunders are looked for with.
const USUAL_ORDER: usize = 8;

/// A frame with its solution.
struct Solved<'a> {
    frame: Frame<'a>,
    fit: Fit,
    amplitude: f64,
}

impl<'a> Solved<'a> {
    /// Two passes: the first finds the amplitude that the shape ratios are weighed with.
    fn new(single: &Single<'a>, before: Option<&Solved>) -> Result<Self, AdjustError> {
        let mut amplitude = before.map_or(USUAL_CURVATURE_PER_M, |b| b.amplitude);
        let mut solved: Option<Self> = None;
        for _ in 0..AMPLITUDE_PASSES {
            let last = solved.as_ref().or(before);
            let (frame, fit) = rough(single, amplitude, last)?;
            let found = fit.global[0].abs().max(MIN_CURVATURE_PER_M);
            let settled = (found / amplitude).ln().abs() < AMPLITUDE_SETTLED;
            solved = Some(Self { frame, fit, amplitude: if settled { amplitude } else { found } });
            if settled {
                break;
            }
            amplitude = found;
        }
        solved.ok_or(EstimationError::NoConvergence { iterations: 0 }.into())
    }

    /// From rough to converged.
    fn finish(&mut self) -> Result<(), AdjustError> {
        self.frame.problem.start = self.fit.global.clone();
        self.fit = self.frame.solve(&SolveOptions { rough: false, residuals: Some(&self.fit) })?;
        Ok(())
    }

    /// Minus twice the logarithm of the evidence of this order, but for terms that all orders share.
    fn misfit(&self) -> f64 {
        let terms = self.frame.layout.curvature_terms;
        let log = |m: DMatrix<f64>| m.cholesky().map_or(f64::NEG_INFINITY, |c| c.ln_determinant());
        let shape =
            log(shape_covariance(terms)) + 2.0 * (terms.saturating_sub(1) as f64) * self.amplitude.ln();
        self.fit.omega - log(self.fit.covariance.clone()) + shape
    }

    /// Variance components of images and survey, with what a person should read; the solution becomes theirs.
    fn weigh(&mut self) -> Result<(Vec<VarianceComponent>, Vec<String>), AdjustError> {
        let (frame, mut problem) = (&self.frame, self.frame.problem.clone());
        let size = |block: usize| frame.problem.groups[0].blocks[block].observed.len();
        let image = |_: usize, block: usize| (3..size(block)).collect();
        let survey = |_: usize, _: usize| vec![0, 1, 2];
        let groups = [
            VarianceGroup { name: "image", members: &image },
            VarianceGroup { name: "survey", members: &survey },
        ];
        let found = variance_components(&mut problem, &groups, |at, blocks| frame.linearise(at, blocks))?;
        (self.fit, self.frame.problem) = (found.fit, problem);
        Ok((found.components, found.remarks))
    }
}

/// From where an earlier solution left off.
fn rough<'a>(
    single: &Single<'a>,
    amplitude_per_m: f64,
    last: Option<&Solved>,
) -> Result<(Frame<'a>, Fit), AdjustError> {
    let from = last.map(|s| (&s.frame.layout, &s.fit.global));
    let frame = Frame::new(single, &Start { amplitude_per_m, from });
    let fit = frame.solve(&SolveOptions { rough: true, residuals: last.map(|s| &s.fit) })?;
    Ok((frame, fit))
}

impl<'a> Single<'a> {
    fn marks_contradict(&self, Solved { frame, fit, .. }: &Solved<'a>) -> bool {
        snooping::marks_contradict(&self.input, &frame.problem, fit, 0, &frame.members, 1)
    }
}

impl<'a> Removable for Single<'a> {
    type Solved = Solved<'a>;

    fn worst(&self, solved: &Solved<'a>) -> Option<Suspect> {
        let Solved { frame, fit, .. } = solved;
        snooping::worst(&self.input, &frame.problem, fit, 0, &frame.members)
    }

    fn judged(solved: &Solved<'a>) -> ResidualSum {
        ResidualSum::of(&solved.fit)
    }

    fn use_marker(&mut self, suspect: &Suspect, used: bool) {
        if suspect.target != Target::Ground {
            self.usage.flight[suspect.marker] = used;
        }
        if suspect.target != Target::Flight {
            self.usage.ground[suspect.marker] = used;
        }
    }

    fn is_enough(&self, _: &Solved<'a>) -> bool {
        let left = self.usage.flight.iter().zip(&self.sights).map(|(used, seen)| seen.filter(|_| *used));
        on_the_wing(self.input.setup, &left.collect::<Vec<_>>()) >= MIN_MARKERS
    }

    fn solve(&self, before: Option<&Solved<'a>>) -> Result<Solved<'a>, AdjustError> {
        Solved::new(self, before)
    }
}

/// A solution without blunders; fixed marks that contradict each other are widened together.
fn without_blunders(mut single: Single, allowed: usize) -> Result<Snooped<Single>, AdjustError> {
    let mut all = single.solve(None)?;
    while single.factors.marks < snooping::MAX_FIXED_TARGET_SCALE && single.marks_contradict(&all) {
        single.factors.marks *= 2.0;
        all = single.solve(Some(&all))?;
    }
    snooping::one_by_one(single, all, allowed)
}

/// The same with the cause that leaves the least over, where one leaves but few markers out.
fn caused<'a>(single: &Single<'a>, allowed: usize) -> Option<Snooped<Single<'a>>> {
    let with = |cause| without_blunders(Single { cause: Some(cause), ..single.clone() }, allowed).ok();
    let tried = causes(&single.input, &single.sights).into_iter().filter_map(with);
    let cost = |s: &Snooped<Single<'a>>| {
        let limit = quality::critical_w(single.input.options.snooping_alpha);
        s.solved.fit.omega + s.removed.len() as f64 * limit * limit
    };
    tried.filter(|s| s.judged.is_none()).min_by(|a, b| cost(a).total_cmp(&cost(b)))
}

/// The most probable order of the curvature, given the data and what beams look like.
fn choose_order<'a>(single: &Single<'a>, usual: Solved<'a>) -> Result<Solved<'a>, AdjustError> {
    let amplitude = usual.amplitude;
    let mut best = usual;
    for terms in ORDERS.into_iter().filter(|&t| t != USUAL_ORDER) {
        let (frame, fit) = rough(&Single { terms, ..single.clone() }, amplitude, Some(&best))?;
        let other = Solved { frame, fit, amplitude };
        if other.misfit() < best.misfit() {
            best = other;
        }
    }
    Ok(best)
}

/// The rigid-section beam, one frame.
pub fn solve(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    options: &Options,
) -> Result<Solution, AdjustError> {
    let scene = Scene::new(setup, orientation)?;
    let sights = by_marker(setup, observations)?;
    let found = on_the_wing(setup, &sights);
    if found < MIN_MARKERS {
        return Err(AdjustError::TooFewMarkers { found, needed: MIN_MARKERS });
    }
    let input = Input { setup, orientation, scene: &scene, options };
    if options.flight_prior.is_some() && !options.variance_components {
        return flight::one(&input, observations);
    }
    let allowed = sights.iter().flatten().count() / LEFT_OUT;
    let terms = options.curvature_terms.map_or(USUAL_ORDER, |t| t.clamp(1, MAX_CURVATURE_TERMS));
    let usage = Usage::all(setup.markers.len());
    let single = Single { input, sights, usage, terms, factors: Factors::default(), cause: None };
    let mut clean = without_blunders(single.clone(), allowed)?;
    if clean.judged.is_some() {
        clean = caused(&single, allowed).unwrap_or(clean);
    }
    let Snooped { model: single, mut solved, removed, judged } = clean;
    if options.curvature_terms.is_none() {
        solved = choose_order(&single, solved)?;
    }
    solved.finish()?;
    let (components, mut remarks) =
        if options.variance_components { solved.weigh()? } else { Default::default() };
    let Solved { frame, fit, .. } = &solved;
    let outcome = Outcome::new(&input, &frame.layout, &frame.problem, fit, 0, &frame.members).judged(judged);
    let blocks = Blocks { members: std::slice::from_ref(&frame.members), ground: &[] };
    let solution = with_sources(blocks, &frame.problem, fit, None, |sources| {
        outcome.solution(Method::Spatial, removed.iter(), sources)
    });
    remarks.extend(solution.remarks);
    remarks.extend(snooping::widened_marks(single.factors.marks));
    remarks.extend(single.cause.as_ref().map(|cause| cause.sentence(fit.global[frame.layout.own.first])));
    if options.curvature_terms.is_none() {
        remarks.push(format!("curvature of {} terms, chosen by test", frame.layout.curvature_terms));
    }
    remarks.extend(separation(&scene, solution.pitch_bending_correlation).map(Cow::into_owned));
    Ok(Solution { variance_components: components, remarks, ..solution })
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
mod tests;
