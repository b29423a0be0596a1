//! Data snooping (Baarda): the observation that most probably holds a blunder, one at a time.

use super::input::Input;
use super::layout::Member;
use super::{AdjustError, GlobalTest, Options};
use crate::estimation::quality::{self, Reliability};
use crate::estimation::{Fit, Problem};
use crate::setup::Setup;

/// A blunder in the survey must stand out by this factor against one in the images, which are
/// more often wrong.
const SURVEY_LEAD: f64 = 1.05;

/// An image that lies farther off than this, px, or a surveyed position, m, is of something else: what flight does to wing,
/// camera and marks moves none of them so far from the others.
const GROSS: (f64, f64) = (5.0, 0.05);
/// Where so many markers are out that are not, a common cause is likelier than as many blunders.
const MANY: usize = 3;
/// Of so many fixed marks the others do not outvote one.
const FEW_MARKS: usize = 4;

/// A sum of squares and its redundancy: what a global test judges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualSum {
    /// Weighted sum of squares.
    pub omega: f64,
    /// Its redundancy.
    pub redundancy: usize,
}

impl ResidualSum {
    /// Of a solution.
    pub fn of(fit: &Fit) -> Self {
        Self { omega: fit.omega, redundancy: fit.redundancy }
    }

    /// Itself, where removal took out so much that what is left can no longer be the judge.
    pub fn unless_few<'s>(self, removed: impl Iterator<Item = &'s Suspect>) -> Option<Self> {
        let mut markers: Vec<_> = removed.filter(|s| !s.is_gross()).map(|s| s.marker).collect();
        markers.sort_unstable();
        markers.dedup();
        (markers.len() >= MANY).then_some(self)
    }
}

/// What of a marker is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Its image in flight.
    Flight,
    /// Its image on ground.
    Ground,
    /// Its surveyed position.
    Survey,
}

/// A blunder with what speaks for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Suspect {
    /// Index in the survey.
    pub marker: usize,
    /// What of it.
    pub target: Target,
    /// Statistic of the w-test.
    pub w: f64,
    /// Estimated size, px or m.
    pub size: f64,
    /// Whether the ground frame tells image and survey apart.
    pub apart: bool,
}

impl Suspect {
    /// Whether it is so far off that nothing but a blunder explains it.
    pub fn is_gross(&self) -> bool {
        let limit = if self.target == Target::Survey { GROSS.1 } else { GROSS.0 };
        self.size.abs() > limit
    }

    /// One sentence for a person.
    pub fn sentence(&self, setup: &Setup, options: &Options) -> String {
        let id = setup.markers.get(self.marker).map_or("", |m| m.id.as_str());
        let limit = quality::critical_w(options.snooping_alpha);
        let (w, size) = (self.w.abs(), self.size.abs());
        match (self.target, self.apart) {
            (Target::Flight, true) => format!(
                "marker {id} was left out: its image lies about {size:.1} px from where the other markers put it (w = {w:.1}, limit {limit:.1})"
            ),
            (Target::Flight, false) => format!(
                "marker {id} was left out: its image or its surveyed position is wrong, about {size:.1} px in the image (w = {w:.1}, limit {limit:.1})"
            ),
            (Target::Ground, _) => format!(
                "the ground frame's image of marker {id} was left out: it lies about {size:.1} px off (w = {w:.1}, limit {limit:.1})"
            ),
            (Target::Survey, _) => format!(
                "marker {id} was left out: its surveyed position is wrong by about {size:.3} m (w = {w:.1}, limit {limit:.1}); survey it again"
            ),
        }
    }
}

/// A model that data snooping takes observations out of, one after the other.
pub trait Removable: Clone {
    /// It and its solution.
    type Solved;

    /// The suspect beyond the limit, if there is one.
    fn worst(&self, solved: &Self::Solved) -> Option<Suspect>;

    /// Whether what is suspect of a marker takes part.
    fn use_marker(&mut self, suspect: &Suspect, used: bool);

    /// Whether what is in use determines a solution and checks it.
    fn is_enough(&self, last: &Self::Solved) -> bool;

    /// Solves with what is in use, from an earlier solution.
    fn solve(&self, before: Option<&Self::Solved>) -> Result<Self::Solved, AdjustError>;

    /// What a global test says of a solution.
    fn judged(solved: &Self::Solved) -> ResidualSum;
}

/// What is left after data snooping.
pub struct Snooped<M: Removable> {
    /// With what is in use.
    pub model: M,
    /// Its solution.
    pub solved: M::Solved,
    /// What was taken out.
    pub removed: Vec<Suspect>,
    /// What the global test is to judge where so much is out: all but gross errors.
    pub judged: Option<ResidualSum>,
}

/// Takes blunders out one by one, the worst first, `allowed` of them at most. An early suspect may have been the victim of a
/// later one: each gets a second chance, with all the others out.
pub fn one_by_one<M: Removable>(
    mut model: M,
    mut solved: M::Solved,
    allowed: usize,
) -> Result<Snooped<M>, AdjustError> {
    let mut removed: Vec<Suspect> = vec![];
    let mut with_all = M::judged(&solved);
    while removed.len() < allowed {
        let Some(suspect) = model.worst(&solved) else { break };
        let mut without = model.clone();
        without.use_marker(&suspect, false);
        if !without.is_enough(&solved) {
            break;
        }
        solved = without.solve(Some(&solved))?;
        model = without;
        removed.push(suspect);
        if removed.iter().all(Suspect::is_gross) {
            with_all = M::judged(&solved);
        }
    }
    if removed.len() < 2 {
        return Ok(Snooped { model, solved, removed, judged: None });
    }
    let mut out = vec![];
    for suspect in removed {
        let mut with = model.clone();
        with.use_marker(&suspect, true);
        match with.solve(Some(&solved)) {
            Ok(again) if with.worst(&again).is_none() => (model, solved) = (with, again),
            _ => out.push(suspect),
        }
    }
    Ok(Snooped { model, solved, judged: with_all.unless_few(out.iter()), removed: out })
}

/// The largest w beyond the limit, if there is one. Where the global test rejects, w is studentised
/// by the variance factor of the others (Pope's tau in its external form), so that standard
/// deviations stated too small do not turn good markers into blunders.
pub fn worst(
    input: &Input,
    problem: &Problem,
    fit: &Fit,
    group: usize,
    members: &[Member],
) -> Option<Suspect> {
    let blocks = members.iter().enumerate();
    worst_of(input, problem, fit, group, blocks)
}

/// Whether fixed marks contradict each other in flight: they move, and none of few is the wrong one. Of so many `frames` any
/// may show it: each is tested at its share of the level, since what moves, moves in all of them.
pub fn marks_contradict(
    input: &Input,
    problem: &Problem,
    fit: &Fit,
    group: usize,
    members: &[Member],
    frames: usize,
) -> bool {
    if !marks_are_few(input) {
        return false;
    }
    let limit = quality::critical_w(input.options.snooping_alpha / frames as f64);
    let fixed = members.iter().enumerate().filter(|(_, m)| input.scene.is_fixed(m.marker));
    let beyond = |(block, member): (usize, &Member)| {
        let all = quality::observation_reliability(problem, fit, group, block, input.options.snooping_alpha);
        let seen = member.flight.and_then(|first| all.get(first..first + 2));
        seen.is_some_and(|seen| seen.iter().filter_map(|r| r.w).any(|w| w.abs() > limit))
    };
    fixed.into_iter().any(beyond)
}

/// Fixed marks that contradict each other are taken to move by as much more, at most.
pub const MAX_FIXED_TARGET_SCALE: f64 = 64.0;

/// Says that fixed marks contradict each other.
pub fn widened_marks(factor: f64) -> Option<String> {
    (factor > 1.0).then(|| {
        format!(
            "the fixed marks contradict each other: they are taken to move in flight by {factor:.0} times what \
             flight_motion_m says, all of them; look at what holds them"
        )
    })
}

fn marks_are_few(input: &Input) -> bool {
    input.setup.markers.iter().filter(|m| m.fixed).count() <= FEW_MARKS
}

/// The same of some blocks only, given with their markers.
pub fn worst_of<'a>(
    input: &Input,
    problem: &Problem,
    fit: &Fit,
    group: usize,
    blocks: impl Iterator<Item = (usize, &'a Member)>,
) -> Option<Suspect> {
    let options = input.options;
    let limit = quality::critical_w(options.snooping_alpha);
    let best = blocks
        .filter_map(|(block, member)| suspect(input, problem, fit, group, block, member))
        .reduce(|a, b| if b.w.abs() > a.w.abs() { b } else { a })?;
    // The factor is not below 1 and costs more than all the rest.
    (best.w.abs() > limit && best.w.abs() / root_variance_factor(fit, best.w, options) > limit)
        .then_some(best)
}

/// Root of the variance factor without the suspect, not below 1.
pub(super) fn root_variance_factor(fit: &Fit, w: f64, options: &Options) -> f64 {
    if fit.redundancy < 2
        || quality::global_test(fit.omega, fit.redundancy, options.global_alpha) == GlobalTest::Passed
    {
        return 1.0;
    }
    ((fit.omega - w * w).max(0.0) / (fit.redundancy - 1) as f64).sqrt().max(1.0)
}

fn suspect(
    input: &Input,
    problem: &Problem,
    fit: &Fit,
    group: usize,
    block: usize,
    member: &Member,
) -> Option<Suspect> {
    let options = input.options;
    let moves = input.scene.is_fixed(member.marker) && marks_are_few(input);
    let all = quality::observation_reliability(problem, fit, group, block, options.snooping_alpha);
    let shift = quality::detectable_shift(options.snooping_alpha);
    let largest = |first: usize, n: usize, target: Target| {
        let one = |r: &Reliability| {
            let w = r.w?;
            let size = w * r.minimal_detectable_bias? / shift;
            Some(Suspect { marker: member.marker, target, w, size, apart: member.ground.is_some() })
        };
        all.get(first..first + n)?
            .iter()
            .filter_map(one)
            .reduce(|a, b| if b.w.abs() > a.w.abs() { b } else { a })
    };
    let flight = member.flight.filter(|_| !moves).and_then(|k| largest(k, 2, Target::Flight));
    let ground = member.ground.and_then(|k| largest(k, 2, Target::Ground));
    let survey = largest(0, 3, Target::Survey).map(|s| (s.w.abs() / SURVEY_LEAD, s));
    let image =
        [flight, ground].into_iter().flatten().reduce(|a, b| if b.w.abs() > a.w.abs() { b } else { a });
    match (image, survey) {
        (Some(image), Some((lead, _))) if image.w.abs() >= lead => Some(image),
        (_, Some((_, survey))) => Some(survey),
        (image, None) => image,
    }
}
