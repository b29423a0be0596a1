//! Data snooping (Baarda): the observation that most probably holds a blunder, one at a time.

use super::layout::Member;
use super::{AdjustError, GlobalTest, Options};
use crate::estimation::quality::{self, Reliability};
use crate::estimation::{Fit, Problem};
use crate::setup::Setup;

/// A blunder in the survey must stand out by this factor against one in the images, which are
/// more often wrong.
const SURVEY_LEAD: f64 = 1.05;

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
}

/// What is left after data snooping.
pub struct Snooped<M: Removable> {
    /// With what is in use.
    pub model: M,
    /// Its solution.
    pub solved: M::Solved,
    /// What was taken out.
    pub removed: Vec<Suspect>,
}

/// Takes blunders out one by one, the worst first, `allowed` of them at most. An early suspect may have been the victim of a
/// later one: each gets a second chance, with all the others out.
pub fn one_by_one<M: Removable>(
    mut model: M,
    mut solved: M::Solved,
    allowed: usize,
) -> Result<Snooped<M>, AdjustError> {
    let mut removed: Vec<Suspect> = vec![];
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
    }
    if removed.len() < 2 {
        return Ok(Snooped { model, solved, removed });
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
    Ok(Snooped { model, solved, removed: out })
}

/// The largest w beyond the limit, if there is one. Where the global test rejects, w is studentised
/// by the variance factor of the others (Pope's tau in its external form), so that standard
/// deviations stated too small do not turn good markers into blunders.
pub fn worst(
    problem: &Problem,
    fit: &Fit,
    group: usize,
    members: &[Member],
    options: &Options,
) -> Option<Suspect> {
    let blocks = members.iter().enumerate();
    worst_of(problem, fit, group, blocks, options)
}

/// The same of some blocks only, given with their markers.
pub fn worst_of<'a>(
    problem: &Problem,
    fit: &Fit,
    group: usize,
    blocks: impl Iterator<Item = (usize, &'a Member)>,
    options: &Options,
) -> Option<Suspect> {
    let limit = quality::critical_w(options.snooping_alpha);
    let best = blocks
        .filter_map(|(block, member)| suspect(problem, fit, group, block, member, options))
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
    problem: &Problem,
    fit: &Fit,
    group: usize,
    block: usize,
    member: &Member,
    options: &Options,
) -> Option<Suspect> {
    let all = quality::reliability(problem, fit, group, block, options.snooping_alpha);
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
    let flight = member.flight.and_then(|k| largest(k, 2, Target::Flight));
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
