//! Solution of one live frame under one hypothesis, with the prior from earlier frames.

use nalgebra::DVector;

use super::load_twist::LoadTwist;
use crate::adjust::flight::flight_problem::FlightProblem;
use crate::adjust::flight::frames::{Flight, MIN_MARKERS};
use crate::adjust::flight::shape::SharedShape;
use crate::adjust::flight::solving::SolvedFlight;
use crate::adjust::flight::usage::RemovedObservation;
use crate::adjust::layout::ParameterLayout;
use crate::adjust::snooping::{
    SnoopingModel, SnoopingResult, SolvedGroup, Suspect, snoop_one_by_one,
};
use crate::adjust::{AdjustResult, GlobalTest};
use crate::estimation::quality::{self, chi_square_limit};
use crate::estimation::{InformationPrior, Problem, SolveOptions};

/// Significance level of a mount disturbance and of a removed marker: each must reduce the sum of squares by the
/// corresponding chi-square quantile.
pub const DISTURBANCE_ALPHA: f64 = 1e-6;

/// Model shared by all frames, fixed at the first frame so that the unknowns keep their meaning.
#[derive(Clone, Debug)]
pub struct LiveModel {
    /// Columns of the unknowns.
    pub layout: ParameterLayout,
    /// Text per global parameter for the case that it cannot be determined.
    pub missing: Vec<&'static str>,
    /// Shape of bending that the frames share.
    pub shape: SharedShape,
    /// Markers with a wrong surveyed position.
    pub wrong: Vec<Suspect>,
}

/// A frame solved under one hypothesis.
pub struct FrameAttempt {
    /// Solution with the remaining observations.
    pub solved: SolvedFlight,
    /// Observations removed by data snooping.
    pub removed: Vec<RemovedObservation>,
    /// True if all markers together passed the global test.
    pub passed: bool,
}

impl FrameAttempt {
    /// Solves the frame and removes its worst marker as long as one exceeds the limit; a marker that fits later is used
    /// again. `local`: start values of the frame's own unknowns; `twist`: that of earlier frames.
    ///
    /// # Errors
    /// Returns an error if the frame has no solution.
    pub fn new(
        model: &LiveModel,
        (local, twist): (&DVector<f64>, &LoadTwist),
        flight: &Flight,
        known: &InformationPrior,
    ) -> AdjustResult<Self> {
        let mut flight = flight.clone();
        let everywhere: Vec<_> = model
            .wrong
            .iter()
            .map(|s| RemovedObservation {
                group: 0,
                suspect: *s,
            })
            .collect();
        flight.usage.reset_except(&everywhere);
        let layout = model
            .layout
            .with_row_times(&flight.input, &flight.frames[0]);
        let frame = FrameHypothesis {
            model,
            layout,
            local,
            twist,
            flight,
            known,
        };
        let all = frame.solve_from(None)?;
        let (omega, redundancy) = (all.fit.omega, all.fit.redundancy);
        let test = quality::global_test(omega, redundancy, frame.flight.input.options.global_alpha);
        let markers = all.flight_problem.members[0].len();
        let SnoopingResult {
            model: frame,
            solved,
            removed,
            tested_sum,
        } = snoop_one_by_one(frame, all, markers)?;
        let solved = SolvedFlight {
            tested_sum,
            ..frame.solve_with(Some(&solved), false)?
        };
        let removed = removed
            .into_iter()
            .map(|suspect| RemovedObservation { group: 0, suspect });
        let removed = everywhere.into_iter().chain(removed).collect();
        Ok(Self {
            solved,
            removed,
            passed: test != Some(GlobalTest::Rejected),
        })
    }

    /// Returns whether the residuals are consistent with standard deviations increased by the square root of `factor`.
    pub fn is_explained(&self, factor: f64) -> bool {
        let fit = &self.solved.fit;
        quality::global_test(fit.omega / factor, fit.redundancy, DISTURBANCE_ALPHA)
            != Some(GlobalTest::Rejected)
    }

    /// Sum of squares, plus the required gain for each removed marker.
    pub fn penalized_misfit(&self) -> f64 {
        self.solved.fit.omega + self.removed.len() as f64 * chi_square_limit(2.0, DISTURBANCE_ALPHA)
    }
}

/// A frame, its hypothesis and the prior from earlier frames.
#[derive(Clone)]
struct FrameHypothesis<'s, 'a> {
    model: &'s LiveModel,
    layout: ParameterLayout,
    local: &'s DVector<f64>,
    twist: &'s LoadTwist,
    flight: Flight<'a>,
    known: &'s InformationPrior,
}

impl FrameHypothesis<'_, '_> {
    /// Solves the frame under this hypothesis, from the start values or from an earlier solution.
    fn solve_with(&self, before: Option<&SolvedFlight>, rough: bool) -> AdjustResult<SolvedFlight> {
        let Self {
            model,
            layout,
            flight,
            known,
            ..
        } = self;
        let local = before.map_or(self.local, |b| &b.fit.groups[0].local);
        let layout = self.twist.fix_derivatives(
            flight.input.scene,
            layout,
            &local.as_slice()[..layout.curvature_terms],
        );
        let (mut group, members) = flight.frame_group(0, &layout, None);
        group.local.copy_from(local);
        let problem = Problem {
            start: before.map_or(&known.mean, |b| &b.fit.global).clone(),
            missing: model.missing.clone(),
            priors: vec![],
            known: Some((*known).clone()),
            groups: vec![group],
        };
        let flight_problem = FlightProblem {
            layouts: vec![layout],
            members: vec![members],
            ground_members: vec![],
            problem,
            shape: model.shape.clone(),
            invariant: vec![],
            nominal: DVector::zeros(0),
            displacement_column: None,
            ground: None,
        };
        let solve_options = SolveOptions {
            rough,
            residuals: before.map_or(vec![], |b| b.fit.residuals()),
        };
        let fit = flight_problem.solve(flight.input.scene, &solve_options)?;
        Ok(SolvedFlight {
            flight_problem,
            fit,
            tested_sum: None,
        })
    }
}

impl SnoopingModel for FrameHypothesis<'_, '_> {
    type SolvedModel = SolvedFlight;

    fn solved_group<'s>(&'s self, solved: &'s SolvedFlight) -> SolvedGroup<'s> {
        solved.group(&self.flight.input, 0)
    }

    fn set_used(&mut self, suspect: &Suspect, used: bool) {
        self.flight.usage.frames[0][suspect.marker] = used;
    }

    fn is_sufficient(&self, last: &SolvedFlight) -> bool {
        last.flight_problem.members[0].len() > MIN_MARKERS + 1
    }

    fn solve_from(&self, before: Option<&SolvedFlight>) -> AdjustResult<SolvedFlight> {
        self.solve_with(before, true)
    }
}
