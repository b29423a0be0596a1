//! A frame solved under one hypothesis, with what was known before it.

use nalgebra::DVector;

use crate::adjust::flight::flight_problem::FlightProblem;
use crate::adjust::flight::frames::{Flight, MIN_MARKERS};
use crate::adjust::flight::shape::SharedShape;
use crate::adjust::flight::solving::Solved;
use crate::adjust::flight::usage::Removed;
use crate::adjust::layout::Layout;
use crate::adjust::snooping::{self, Removable, ResidualSum, Suspect};
use crate::adjust::{AdjustError, GlobalTest};
use crate::estimation::quality::{self, chi_square_limit};
use crate::estimation::{InformationPrior, Problem, SolveOptions};

/// What a mount disturbance must gain, and what a marker that is left out must: quantiles of their chi-squares at this level.
pub const DISTURBANCE_ALPHA: f64 = 1e-6;
/// No more markers than one in so many are left out of a frame.
const LEFT_OUT: usize = 3;

/// What all frames are set up with, fixed at the first one so that unknowns keep their meaning.
#[derive(Clone, Debug)]
pub struct Model {
    /// Where the unknowns stand.
    pub layout: Layout,
    /// What is missing where a global one cannot be determined.
    pub missing: Vec<&'static str>,
    /// The shape that frames share.
    pub shape: SharedShape,
    /// Markers whose surveyed position is wrong.
    pub wrong: Vec<Suspect>,
}

/// A frame solved under one hypothesis.
pub struct Attempt {
    /// With what is left of it.
    pub solved: Solved,
    /// What is not.
    pub removed: Vec<Removed>,
    /// Whether all markers together passed the global test.
    pub passed: bool,
}

impl Attempt {
    /// Solves the frame, its worst marker left out as long as there is one beyond the limit; one that fits later comes
    /// back. `local`: its own unknowns to begin with.
    pub fn new(
        model: &Model,
        local: &DVector<f64>,
        flight: &Flight,
        known: &InformationPrior,
    ) -> Result<Self, AdjustError> {
        let mut flight = flight.clone();
        let everywhere: Vec<_> = model.wrong.iter().map(|s| Removed { group: 0, suspect: *s }).collect();
        flight.usage.all_but(&everywhere);
        let layout = model.layout.with_rows(&flight.input, &flight.frames[0]);
        let frame = Frame { model, layout, local, flight, known };
        let all = frame.solve(None)?;
        let (omega, redundancy) = (all.fit.omega, all.fit.redundancy);
        let test = quality::global_test(omega, redundancy, frame.flight.input.options.global_alpha);
        let allowed = all.setting.members[0].len() / LEFT_OUT;
        let snooping::Snooped { model: frame, solved, removed, judged } =
            snooping::one_by_one(frame, all, allowed)?;
        let solved = Solved { judged, ..frame.solve_by(Some(&solved), false)? };
        let removed = removed.into_iter().map(|suspect| Removed { group: 0, suspect });
        let removed = everywhere.into_iter().chain(removed).collect();
        Ok(Self { solved, removed, passed: test != GlobalTest::Rejected })
    }

    /// Whether chance explains what is left, where standard deviations are stated too small by the root of a factor.
    pub fn is_explained(&self, factor: f64) -> bool {
        let fit = &self.solved.fit;
        quality::global_test(fit.omega / factor, fit.redundancy, DISTURBANCE_ALPHA) != GlobalTest::Rejected
    }

    /// Sum of squares, and for each marker left out what a marker must gain to be left out.
    pub fn cost(&self) -> f64 {
        self.solved.fit.omega + self.removed.len() as f64 * chi_square_limit(2.0, DISTURBANCE_ALPHA)
    }
}

/// A frame and what is known before it.
#[derive(Clone)]
struct Frame<'s, 'a> {
    model: &'s Model,
    layout: Layout,
    local: &'s DVector<f64>,
    flight: Flight<'a>,
    known: &'s InformationPrior,
}

impl Frame<'_, '_> {
    fn solve_by(&self, before: Option<&Solved>, rough: bool) -> Result<Solved, AdjustError> {
        let Self { model, layout, flight, known, .. } = self;
        let (mut group, members) = flight.group(0, layout, None);
        group.local.copy_from(before.map_or(self.local, |b| &b.fit.groups[0].local));
        let problem = Problem {
            start: before.map_or(&known.mean, |b| &b.fit.global).clone(),
            missing: model.missing.clone(),
            priors: vec![],
            known: Some((*known).clone()),
            groups: vec![],
        };
        let setting = FlightProblem::of_frame(layout.clone(), model.shape.clone(), group, members, problem);
        let course = SolveOptions { rough, residuals: before.map(|b| &b.fit) };
        let fit = setting.solve(flight.input.scene, &course)?;
        Ok(Solved { setting, fit, judged: None })
    }
}

impl Removable for Frame<'_, '_> {
    type Solved = Solved;

    fn worst(&self, Solved { setting, fit, .. }: &Solved) -> Option<Suspect> {
        snooping::worst(&self.flight.input, &setting.problem, fit, 0, &setting.members[0])
    }

    fn judged(solved: &Solved) -> ResidualSum {
        ResidualSum::of(&solved.fit)
    }

    fn use_marker(&mut self, suspect: &Suspect, used: bool) {
        self.flight.usage.frames[0][suspect.marker] = used;
    }

    fn is_enough(&self, last: &Solved) -> bool {
        last.setting.members[0].len() > MIN_MARKERS + 1
    }

    fn solve(&self, before: Option<&Solved>) -> Result<Solved, AdjustError> {
        self.solve_by(before, true)
    }
}
