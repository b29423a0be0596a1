//! Adjustment of one frame with the rigid-section beam (docs/adjustment.md).

mod frame;

use self::frame::{FrameProblem, FrameStart, SingleFrame};
use super::budget::{BlockMembers, with_variance_sources};
use super::causes::{CauseModel, WidenedPriors, free_causes, solve_with_image_causes};
use super::common_displacement::candidate_displacements;
use super::flight;
use super::input::{AdjustmentInput, count_wing_markers, order_by_marker};
use super::outcome::FrameOutcome;
use super::prior_scales::PriorScales;
use super::scene::WingScene;
use super::shapes::{TYPICAL_CURVATURE_PER_M, bounded_amplitude};
use super::snooping::{
    self, ResidualSum, SnoopingModel, SnoopingResult, SolvedGroup, Suspect, SuspectTarget,
};
use super::{AdjustError, AdjustResult, Observation, Options, Solution, VarianceComponent};
use crate::estimation::{
    Fit, Minimum, Problem, SolveOptions, VarianceGroup, quality, variance_components,
};
use crate::setup::{Orientation, Setup};
use crate::widths::Unknown;

/// Minimum number of wing markers in flight.
const MIN_MARKERS: usize = 6;
/// Maximum number of passes for the amplitude with which the shape ratios are weighted.
const AMPLITUDE_PASSES: usize = 3;
/// Change of the logarithm of the amplitude below which it has settled.
const AMPLITUDE_SETTLED: f64 = 0.05;

/// A frame at its minimum, found roughly.
struct RoughFrame<'a> {
    frame: FrameProblem<'a>,
    minimum: Minimum,
    amplitude: f64,
}

impl<'a> RoughFrame<'a> {
    /// Finds the minimum, starting from an earlier solution.
    fn new(
        single: &SingleFrame<'a>,
        amplitude: f64,
        last: Option<&SolvedFrame>,
    ) -> AdjustResult<Self> {
        let start = FrameStart {
            amplitude_per_m: amplitude,
            from: last.map(|solved| &solved.fit.global),
        };
        let mut frame = FrameProblem::new(single, &start);
        frame.fix_dimension_derivatives();
        let minimum = frame.find_minimum(&SolveOptions {
            rough: true,
            residuals: last.map_or(vec![], |s| s.fit.residuals()),
        })?;
        Ok(Self {
            frame,
            minimum,
            amplitude,
        })
    }

    /// Weights the shape ratios with another amplitude.
    fn change_amplitude(&mut self, amplitude: f64) -> AdjustResult<()> {
        let ratio = amplitude / self.amplitude;
        self.amplitude = amplitude;
        for prior in &mut self.frame.problem.priors {
            if prior.name.unknown == Unknown::Shape.name() {
                prior.covariance *= ratio * ratio;
            }
        }
        self.frame.problem.start = self.minimum.global().clone();
        self.frame.fix_dimension_derivatives();
        self.minimum = self.frame.find_minimum(&SolveOptions {
            rough: true,
            residuals: self.minimum.residuals().to_vec(),
        })?;
        Ok(())
    }

    fn into_solved(self) -> AdjustResult<SolvedFrame<'a>> {
        let fit = self.minimum.into_fit(&self.frame.problem)?;
        Ok(SolvedFrame {
            frame: self.frame,
            fit,
            amplitude: self.amplitude,
        })
    }
}

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
        let mut rough = RoughFrame::new(single, amplitude, before)?;
        for pass in 1.. {
            let found = bounded_amplitude(rough.minimum.global()[0]);
            if (found / rough.amplitude).ln().abs() < AMPLITUDE_SETTLED {
                break;
            }
            if pass == AMPLITUDE_PASSES {
                rough.amplitude = found;
                break;
            }
            rough.change_amplitude(found)?;
        }
        rough.into_solved()
    }

    /// Solves exactly, from this solution.
    fn solve_exactly(&mut self) -> AdjustResult<()> {
        self.frame.problem.start = self.fit.global.clone();
        self.frame.fix_dimension_derivatives();
        let options = SolveOptions {
            rough: false,
            residuals: self.fit.residuals(),
        };
        self.fit = self
            .frame
            .find_minimum(&options)?
            .into_fit(&self.frame.problem)?;
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

    /// Estimates variance components of images and survey, with remarks; updates the solution.
    fn estimate_variance_components(
        &mut self,
    ) -> AdjustResult<(Vec<VarianceComponent>, Vec<String>)> {
        let (frame, mut problem) = (&self.frame, self.frame.problem.clone());
        let size = |block: usize| frame.problem.groups[0].blocks[block].observed.len();
        let image = |_: usize, block: usize| (3..size(block)).collect();
        let survey = |_: usize, _: usize| vec![0, 1, 2];
        let group = |name, members| VarianceGroup { name, members };
        let groups = [group("image", &image as _), group("survey", &survey)];
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

/// Solves with all observations, and with the causes in the image that they ask for, and removes outliers.
fn solve_and_remove_outliers<'a>(
    mut single: SingleFrame<'a>,
) -> AdjustResult<SnoopingResult<SingleFrame<'a>>> {
    let alpha = single.input.options.global_alpha;
    let solve = |widened, from: Option<&SolvedFrame<'a>>| {
        single.widened = widened;
        single.solve_from(from)
    };
    let all = solve_with_image_causes(alpha, solve, |all| (&all.frame.problem, &all.fit))?;
    remove_outliers(single, all)
}

/// Removes outliers. If fixed targets contradict each other, the motion of all of them is increased.
fn remove_outliers<'a>(
    mut single: SingleFrame<'a>,
    mut all: SolvedFrame<'a>,
) -> AdjustResult<SnoopingResult<SingleFrame<'a>>> {
    let input = single.input;
    let conflict = |all: &SolvedFrame| all.as_solved_group(&input).fixed_targets_conflict(1);
    while single.prior_scales.fixed_targets < snooping::MAX_FIXED_TARGET_SCALE && conflict(&all) {
        single.prior_scales.fixed_targets *= 2.0;
        all = single.solve_from(Some(&all))?;
    }
    let observations = single.observations.iter().flatten().count();
    snooping::snoop_one_by_one(single, all, observations)
}

impl<'a> CauseModel for SnoopingResult<SingleFrame<'a>> {
    fn solved(&self) -> (&Problem, &Fit, &WidenedPriors, (f64, usize)) {
        let SolvedFrame { frame, fit, .. } = &self.solved;
        let sum = ResidualSum::tested(self.tested_sum, fit);
        (&frame.problem, fit, &self.model.widened, sum)
    }

    fn with_causes(&self, widened: WidenedPriors) -> AdjustResult<Self> {
        let single = SingleFrame {
            widened,
            usage: flight::FlightUsage::all_used(1, self.model.input.setup.markers.len()),
            ..self.model.clone()
        };
        let all = single.solve_from(None)?;
        let mut wider = remove_outliers(single, all)?;
        wider.solved.solve_exactly()?;
        Ok(wider)
    }
}

/// Tries all common displacements and returns the result that fits best, if it removes only few markers.
fn explain_by_displacement<'a>(
    single: &SingleFrame<'a>,
) -> Option<SnoopingResult<SingleFrame<'a>>> {
    let with = |displacement| {
        solve_and_remove_outliers(SingleFrame {
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
    let usage = flight::FlightUsage::all_used(1, setup.markers.len());
    let single = SingleFrame {
        input,
        observations: frame_observations,
        usage,
        prior_scales: PriorScales::default(),
        widened: WidenedPriors::default(),
        common_displacement: None,
    };
    let clean = solve_and_remove_outliers(single.clone())?;
    let mut clean = free_causes(clean, options.global_alpha);
    if clean.tested_sum.is_some() {
        clean = explain_by_displacement(&single).unwrap_or(clean);
    }
    let SnoopingResult {
        model: single,
        mut solved,
        removed,
        tested_sum,
    } = clean;
    solved.solve_exactly()?;
    solved.frame.layout.dimension_derivatives = None;
    let (components, mut remarks) = if options.variance_components {
        solved.estimate_variance_components()?
    } else {
        Default::default()
    };
    let SolvedFrame { frame, fit, .. } = &solved;
    let outcome = FrameOutcome::new(solved.as_solved_group(&input), &frame.layout)
        .judged_before_removal(tested_sum)
        .with_causes(&single.widened, options.keeps_ground_mounting());
    let blocks = BlockMembers {
        members: std::slice::from_ref(&frame.members),
        ground: &[],
    };
    let solution = with_variance_sources(blocks, &frame.problem, fit, None, |sources| {
        outcome.solution(removed.iter(), sources)
    });
    let derived = derive(&outcome);
    remarks.extend_from_slice(&solution.remarks);
    let scale = single.prior_scales.fixed_targets;
    remarks.extend(snooping::fixed_target_remark(scale));
    let (displacement, column) = (
        single.common_displacement.as_ref(),
        frame.layout.mounting.first,
    );
    remarks.extend(displacement.map(|one| one.remark(fit.global[column])));
    Ok((
        Solution {
            variance_components: components,
            remarks,
            ..solution
        },
        derived,
    ))
}

#[cfg(test)]
mod tests;
