//! The rigid-section beam, one frame (docs/model.md).

mod frame;

use std::borrow::Cow;

use nalgebra::DMatrix;

use self::frame::{Frame, Start, Usage};
use super::beam::MAX_CURVATURE_TERMS;
use super::components::{VarianceGroup, variance_components};
use super::gauss_helmert::{Course, Fit};
use super::outcome::Outcome;
use super::scene::Scene;
use super::snooping::{self, Suspect, Target};
use super::unknowns::{Input, by_marker, on_the_wing, shape_covariance};
use super::{AdjustError, Method, Observation, Options, Solution, quality};
use crate::measure::setup::{Orientation, Setup};

/// Fewest markers on the wing, in flight.
const FEWEST: usize = 6;
/// Bending below this counts as unbent when the shape ratios are weighed, 1/m (0.1 m at 32 m).
const SMALLEST_CURVATURE_PER_M: f64 = 2e-4;
/// Bending to start with, 1/m.
const USUAL_CURVATURE_PER_M: f64 = 5e-3;

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
        let terms = self.frame.layout.curvature_terms;
        let log = |m: DMatrix<f64>| m.cholesky().map_or(f64::NEG_INFINITY, |c| c.ln_determinant());
        let shape =
            log(shape_covariance(terms)) + 2.0 * (terms.saturating_sub(1) as f64) * self.amplitude.ln();
        self.fit.omega - log(self.fit.covariance.clone()) + shape
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
        let left = usage.flight.iter().zip(&input.flight).map(|(used, seen)| seen.filter(|_| *used));
        if on_the_wing(input.setup, &left.collect::<Vec<_>>()) < FEWEST {
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
    let found = on_the_wing(setup, &flight);
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
    let (mut components, mut remarks) = (vec![], vec![]);
    if options.variance_components {
        let mut problem = solved.frame.problem.clone();
        let image = |_: usize, block: usize| (3..problem_size(&solved.frame, block)).collect();
        let survey = |_: usize, _: usize| vec![0, 1, 2];
        let groups = [
            VarianceGroup { name: "image", members: &image },
            VarianceGroup { name: "survey", members: &survey },
        ];
        let found =
            variance_components(&mut problem, &groups, |at, blocks| solved.frame.linearise(at, blocks))?;
        (solved.fit, components, remarks) = (found.fit, found.components, found.remarks);
        solved.frame.problem = problem;
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
    for suspect in removed {
        let sentence = suspect.sentence(setup, options);
        if suspect.target != Target::Ground {
            markers[suspect.marker].reason = Some(sentence.clone());
        }
        remarks.push(sentence);
    }
    let (curve, parabola, a) = outcome.curve();
    let (mut parameters, correlation, pitch_bending_correlation) = outcome.parameters(&parabola, a);
    parameters.push(outcome.axis_raise());
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
mod tests;
