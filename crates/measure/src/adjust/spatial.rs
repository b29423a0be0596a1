//! Adjustment of one frame with the rigid-section beam (docs/adjustment.md).

mod frame;

use nalgebra::DMatrix;

use self::frame::{FrameProblem, FrameStart, SingleFrame};
use super::beam::MAX_CURVATURE_TERMS;
use super::budget::{BlockMembers, with_variance_sources};
use super::causes::{
    FREEING_PASSES, WidenedPriors, asked_causes, asked_image_causes, cause_remarks, find_spread,
    inseparable_image,
};
use super::common_displacement::candidate_displacements;
use super::decisive_widths::decisive_width_remarks;
use super::flight;
use super::input::{AdjustmentInput, count_wing_markers, order_by_marker};
use super::outcome::FrameOutcome;
use super::prior_scales::PriorScales;
use super::scene::WingScene;
use super::shapes::{TYPICAL_CURVATURE_PER_M, bounded_amplitude, shape_covariance};
use super::snooping::{
    self, ResidualSum, SnoopingModel, SnoopingResult, SolvedGroup, Suspect, SuspectTarget,
};
use super::{
    AdjustError, AdjustResult, GlobalTest, Observation, Options, Solution, VarianceBudget,
    VarianceComponent,
};
use crate::estimation::{Fit, SolveOptions, VarianceGroup, quality, variance_components};
use crate::setup::{Orientation, Setup};
use crate::widths::Unknown;

/// Minimum number of wing markers in flight.
const MIN_MARKERS: usize = 6;
/// Maximum number of passes for the amplitude with which the shape ratios are weighted.
const AMPLITUDE_PASSES: usize = 3;
/// Change of the logarithm of the amplitude below which it has settled.
const AMPLITUDE_SETTLED: f64 = 0.05;

/// Candidate numbers of curvature terms, compared if none is given.
const CANDIDATE_ORDERS: [usize; 2] = [8, 10];
/// Number of curvature terms during data snooping.
const DEFAULT_ORDER: usize = 8;

/// Remark for a frame in which pitch and bending are poorly separable.
const SEPARATION_REMARK: &str = "the mounting's pitch and bending are poorly separable in this frame; to separate them, use an \
    orientation written by `wingd orient` (with the observations of the ground frame) or several frames with --flight";

/// A frame with its solution.
struct SolvedFrame<'a> {
    frame: FrameProblem<'a>,
    fit: Fit,
    amplitude: f64,
}

impl<'a> SolvedFrame<'a> {
    /// Solves in several passes that also find the amplitude with which the shape ratios are weighted.
    fn new(single: &SingleFrame<'a>, before: Option<&SolvedFrame>) -> AdjustResult<Self> {
        let amplitude = before.map_or(TYPICAL_CURVATURE_PER_M, |b| b.amplitude);
        let mut solved = Self::roughly(single, amplitude, before)?;
        for pass in 1.. {
            let found = bounded_amplitude(solved.fit.global[0]);
            let ratio = found / solved.amplitude;
            if ratio.ln().abs() < AMPLITUDE_SETTLED {
                break;
            }
            solved.amplitude = found;
            if pass == AMPLITUDE_PASSES {
                break;
            }
            for prior in &mut solved.frame.problem.priors {
                if prior.name.unknown == Unknown::Shape.name() {
                    prior.covariance *= ratio * ratio;
                }
            }
            solved.solve_again(true)?;
        }
        Ok(solved)
    }

    /// Computes a rough solution, starting from an earlier one.
    fn roughly(
        single: &SingleFrame<'a>,
        amplitude: f64,
        last: Option<&SolvedFrame>,
    ) -> AdjustResult<Self> {
        let start = FrameStart {
            amplitude_per_m: amplitude,
            from: last.map(|s| (&s.frame.layout, &s.fit.global)),
        };
        let mut frame = FrameProblem::new(single, &start);
        frame.fix_dimension_derivatives();
        let fit = frame.solve(&SolveOptions {
            rough: true,
            residuals: last.map(|s| &s.fit),
        })?;
        Ok(Self {
            frame,
            fit,
            amplitude,
        })
    }

    fn solve_again(&mut self, rough: bool) -> AdjustResult<()> {
        self.frame.problem.start = self.fit.global.clone();
        self.frame.fix_dimension_derivatives();
        self.fit = self.frame.solve(&SolveOptions {
            rough,
            residuals: Some(&self.fit),
        })?;
        Ok(())
    }

    fn as_solved_group<'s>(&'s self, input: &'s AdjustmentInput) -> SolvedGroup<'s> {
        let FrameProblem {
            problem, members, ..
        } = &self.frame;
        SolvedGroup {
            input,
            problem,
            fit: &self.fit,
            group: 0,
            members,
        }
    }

    /// Twice the negative logarithm of the evidence for this number of terms, without contributions common to all
    /// candidates.
    fn negative_log_evidence(&self) -> f64 {
        let terms = self.frame.layout.curvature_terms;
        let log = |m: DMatrix<f64>| {
            m.cholesky()
                .map_or(f64::NEG_INFINITY, |c| c.ln_determinant())
        };
        let shape = log(shape_covariance(terms))
            + 2.0 * (terms.saturating_sub(1) as f64) * self.amplitude.ln();
        self.fit.omega - log(self.fit.covariance.clone()) + shape
    }

    /// Estimates variance components of images and survey, with remarks; updates the solution.
    fn estimate_variance_components(
        &mut self,
    ) -> AdjustResult<(Vec<VarianceComponent>, Vec<String>)> {
        let (frame, mut problem) = (&self.frame, self.frame.problem.clone());
        let size = |block: usize| frame.problem.groups[0].blocks[block].observed.len();
        let image = |_: usize, block: usize| (3..size(block)).collect();
        let survey = |_: usize, _: usize| vec![0, 1, 2];
        let groups = [
            VarianceGroup {
                name: "image",
                members: &image,
            },
            VarianceGroup {
                name: "survey",
                members: &survey,
            },
        ];
        let found = variance_components(&mut problem, &groups, |at, blocks| {
            frame.linearise(at, blocks)
        })?;
        (self.fit, self.frame.problem) = (found.fit, problem);
        Ok((found.components, found.remarks))
    }
}

impl<'a> SnoopingModel for SingleFrame<'a> {
    type SolvedModel = SolvedFrame<'a>;

    fn solved_group<'s>(&'s self, solved: &'s SolvedFrame<'a>) -> SolvedGroup<'s> {
        solved.as_solved_group(&self.input)
    }

    fn set_used(&mut self, suspect: &Suspect, used: bool) {
        if suspect.target != SuspectTarget::Ground {
            self.usage.frames[0][suspect.marker] = used;
        }
        if suspect.target != SuspectTarget::Flight {
            self.usage.ground[suspect.marker] = used;
        }
    }

    fn is_sufficient(&self, _: &SolvedFrame<'a>) -> bool {
        let left = self.usage.frames[0]
            .iter()
            .zip(&self.observations)
            .map(|(used, seen)| seen.filter(|_| *used));
        count_wing_markers(self.input.setup, &left.collect::<Vec<_>>()) >= MIN_MARKERS
    }

    fn solve_from(&self, before: Option<&SolvedFrame<'a>>) -> AdjustResult<SolvedFrame<'a>> {
        SolvedFrame::new(self, before)
    }
}

/// Solves and removes outliers. If fixed targets contradict each other, the motion of all of them is increased.
fn remove_outliers(mut single: SingleFrame) -> AdjustResult<SnoopingResult<SingleFrame>> {
    let input = single.input;
    let mut all = match single.solve_from(None) {
        // An image of another scale may be so far off that there is no solution.
        Err(_) if single.tests_image() => {
            single.widened = WidenedPriors::free_image();
            single.solve_from(None)?
        }
        all => all?,
    };
    if single.tests_image() {
        single.widened = asked_image_causes(&all.frame.problem, &all.fit);
        if !single.widened.is_empty() {
            all = single.solve_from(Some(&all))?;
        }
    }
    let conflict = |all: &SolvedFrame| all.as_solved_group(&input).fixed_targets_conflict(1);
    while single.prior_scales.fixed_targets < snooping::MAX_FIXED_TARGET_SCALE && conflict(&all) {
        single.prior_scales.fixed_targets *= 2.0;
        all = single.solve_from(Some(&all))?;
    }
    let observations = single.observations.iter().flatten().count();
    snooping::snoop_one_by_one(single, all, observations)
}

/// Removes outliers, and frees the causes that the remaining observations ask for, as long as there is a solution. A cause
/// counts if the global test passes without it or with it; scale and aspect of the image also if other errors remain.
fn remove_outliers_and_free_causes(
    single: SingleFrame,
) -> AdjustResult<SnoopingResult<SingleFrame>> {
    let alpha = single.input.options.global_alpha;
    let mut clean = remove_outliers(single)?;
    let sum = |clean: &SnoopingResult<SingleFrame>| {
        let fit = &clean.solved.fit;
        clean.tested_sum.unwrap_or(ResidualSum::from_fit(fit))
    };
    let passes = |sum: ResidualSum| {
        quality::global_test(sum.omega, sum.redundancy, alpha) == Some(GlobalTest::Passed)
    };
    for _ in 0..FREEING_PASSES {
        let SolvedFrame { frame, fit, .. } = &clean.solved;
        let (before, tested) = (&clean.model.widened, sum(&clean));
        let factor = if passes(tested) {
            1.0
        } else {
            tested.factor().max(1.0)
        };
        let asked = asked_causes(&frame.problem, fit, before, factor);
        // Level 0: nothing is tested.
        if alpha <= 0.0 || !asked.differs_from(before) {
            break;
        }
        let is_of_image = asked.has_image_cause() != before.has_image_cause();
        let Ok(wider) = with_causes(&clean.model, asked) else {
            break;
        };
        if !passes(tested) && !is_of_image && !passes(sum(&wider)) {
            break;
        }
        clean = wider;
    }
    Ok(clean)
}

/// Solves with these causes free, and removes outliers again.
fn with_causes<'a>(
    model: &SingleFrame<'a>,
    widened: WidenedPriors,
) -> AdjustResult<SnoopingResult<SingleFrame<'a>>> {
    let usage = flight::FlightUsage::all_used(1, model.input.setup.markers.len());
    let mut wider = remove_outliers(SingleFrame {
        widened,
        usage,
        ..model.clone()
    })?;
    wider.solved.solve_again(false)?;
    Ok(wider)
}

/// Tries all common displacements and returns the result that fits best, if it removes only few markers.
fn explain_by_displacement<'a>(
    single: &SingleFrame<'a>,
) -> Option<SnoopingResult<SingleFrame<'a>>> {
    let with = |displacement| {
        remove_outliers(SingleFrame {
            common_displacement: Some(displacement),
            ..single.clone()
        })
        .ok()
    };
    let tried = candidate_displacements(&single.input, &single.observations)
        .into_iter()
        .filter_map(with);
    let cost = |s: &SnoopingResult<SingleFrame<'a>>| {
        let limit = quality::critical_w(single.input.options.snooping_alpha);
        s.solved.fit.omega + s.removed.len() as f64 * limit * limit
    };
    tried
        .filter(|s| s.tested_sum.is_none())
        .min_by(|a, b| cost(a).total_cmp(&cost(b)))
}

/// Chooses the most probable number of curvature terms, given the data and the prior of beam shapes.
fn choose_curvature_order<'a>(
    single: &SingleFrame<'a>,
    default: SolvedFrame<'a>,
) -> AdjustResult<SolvedFrame<'a>> {
    let mut best = default;
    for terms in CANDIDATE_ORDERS.into_iter().filter(|&t| t != DEFAULT_ORDER) {
        let candidate = SingleFrame {
            terms,
            ..single.clone()
        };
        let other = SolvedFrame::roughly(&candidate, best.amplitude, Some(&best))?;
        if other.negative_log_evidence() < best.negative_log_evidence() {
            best = other;
        }
    }
    Ok(best)
}

/// Remarks on priors, number of terms and separability.
fn model_remarks(single: &SingleFrame, outcome: &FrameOutcome, solution: &Solution) -> Vec<String> {
    let options = outcome.solved.input.options;
    let (layout, fit) = (outcome.layout, outcome.solved.fit);
    let (budget, widened) = (solution.budget.as_ref(), &single.widened);
    let stayed = options.keeps_ground_mounting();
    let mut remarks = decisive_width_remarks(outcome, budget, stayed, widened);
    remarks.extend_from_slice(&solution.counted_causes);
    remarks.extend(snooping::fixed_target_remark(
        single.prior_scales.fixed_targets,
    ));
    let displacement = single.common_displacement.as_ref();
    remarks.extend(displacement.map(|one| one.remark(fit.global[layout.mounting.first])));
    if options.curvature_terms.is_none() {
        let terms = layout.curvature_terms;
        remarks.push(format!("curvature of {terms} terms, chosen by test"));
    }
    let is_weak = solution
        .pitch_bending_correlation
        .is_some_and(|c| c.abs() > 0.9);
    let remark = is_weak && !single.input.scene.has_ground_observations();
    remarks.extend(remark.then(|| SEPARATION_REMARK.into()));
    remarks
}

/// Returns why the significant causes leave the deflection open; `None` if the data separate them from it.
fn find_doubt(
    single: &SingleFrame,
    outcome: &FrameOutcome,
    budget: Option<&VarianceBudget>,
) -> Option<String> {
    let (free, budget) = (&single.widened, budget?);
    let other = |widened: &WidenedPriors| {
        let SnoopingResult { solved, model, .. } = with_causes(single, widened.clone()).ok()?;
        let group = solved.as_solved_group(&model.input);
        let (other, _) = FrameOutcome::new(group, &solved.frame.layout).tip_deflection(budget);
        find_spread((free, widened), outcome.tip_deflection(budget), other)
    };
    inseparable_image(free, budget).or_else(|| free.alternatives.iter().find_map(other))
}

/// Adjusts one frame with the rigid-section beam.
///
/// # Errors
/// Returns an error if the input is invalid or the observations do not determine a solution.
pub fn solve_spatial(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    options: &Options,
) -> AdjustResult<Solution> {
    solve_spatial_with(setup, orientation, observations, options, &|_| ())
        .map(|(solution, ())| solution)
}

/// Adjusts one frame and derives something else from the outcome.
pub fn solve_spatial_with<T>(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    options: &Options,
    derive: &dyn Fn(&FrameOutcome) -> T,
) -> AdjustResult<(Solution, T)> {
    let scene = WingScene::new(setup, orientation)?;
    let frame_observations = order_by_marker(setup, observations)?;
    let found = count_wing_markers(setup, &frame_observations);
    if found < MIN_MARKERS {
        return Err(AdjustError::TooFewMarkers {
            found,
            needed: MIN_MARKERS,
        });
    }
    let input = AdjustmentInput {
        setup,
        orientation,
        scene: &scene,
        options,
    };
    if options.flight_prior.is_some() && !options.variance_components {
        return flight::solve_frame_with_prior(&input, observations, derive);
    }
    let terms = options
        .curvature_terms
        .map_or(DEFAULT_ORDER, |t| t.clamp(1, MAX_CURVATURE_TERMS));
    let usage = flight::FlightUsage::all_used(1, setup.markers.len());
    let single = SingleFrame {
        input,
        observations: frame_observations,
        usage,
        terms,
        prior_scales: PriorScales::default(),
        widened: WidenedPriors::default(),
        common_displacement: None,
    };
    let mut clean = remove_outliers_and_free_causes(single.clone())?;
    if clean.tested_sum.is_some() {
        clean = explain_by_displacement(&single).unwrap_or(clean);
    }
    let SnoopingResult {
        model: single,
        mut solved,
        removed,
        tested_sum,
    } = clean;
    if options.curvature_terms.is_none() {
        solved = choose_curvature_order(&single, solved)?;
    }
    solved.solve_again(false)?;
    solved.frame.layout.dimension_derivatives = None;
    let (components, mut remarks) = if options.variance_components {
        solved.estimate_variance_components()?
    } else {
        Default::default()
    };
    let SolvedFrame { frame, fit, .. } = &solved;
    let outcome = FrameOutcome::new(solved.as_solved_group(&input), &frame.layout)
        .judged_before_removal(tested_sum)
        .with_causes(&single.widened);
    let blocks = BlockMembers {
        members: std::slice::from_ref(&frame.members),
        ground: &[],
    };
    let solution = with_variance_sources(blocks, &frame.problem, fit, None, |sources| {
        outcome.solution(removed.iter(), sources)
    });
    let derived = derive(&outcome);
    remarks.extend_from_slice(&solution.remarks);
    let stayed = options.keeps_ground_mounting();
    let solution = Solution {
        counted_causes: cause_remarks(setup, stayed, (&frame.problem, fit), &single.widened),
        ..solution
    };
    remarks.extend(model_remarks(&single, &outcome, &solution));
    let doubt = find_doubt(&single, &outcome, solution.budget.as_ref());
    Ok((
        Solution {
            variance_components: components,
            doubt,
            remarks,
            ..solution
        },
        derived,
    ))
}

#[cfg(test)]
mod tests;
