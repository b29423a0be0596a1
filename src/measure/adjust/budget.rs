//! What the variance of the tip's deflection comes from, in the field's words.

use super::layout::Member;
use super::outcome::Outcome;
use super::{Budget, BudgetShare, MarkerSolution, Reference};
use crate::estimation::{AttributedInformation, Fit, Naming, Observed, Problem, Sources};

/// Sigma of a deflection below this share of another's tells better. A difference of less than a hundredth shows in no
/// figure of two digits.
const BETTER: f64 = 0.99;
/// What a frame's images are called.
pub const IMAGE: &str = "image";
/// What the survey is called.
pub const SURVEY: &str = "survey";
/// The ground frames' images.
const GROUND_FRAME: &str = "ground frame";
/// What ties a frame's bending to the flight's.
const SHAPE: &str = "shape of bending";

/// Priors by the name of what is stated or measured for them; a name that is not here stands for itself.
const WORDS: [(&str, &str); 30] = [
    ("height of the bending axis", "axis"),
    ("chord offset of the bending axis", "chord offset"),
    ("root offset", "root"),
    ("direction of the span", "span direction"),
    ("thermal scale", "temperature"),
    ("interior orientation", "lens"),
    ("scale of the camera in flight", "camera in flight"),
    ("principal point in flight", "camera in flight"),
    ("panes' shift", "window"),
    ("panes' bow", "window"),
    ("rotation of the mounting", "mounting"),
    ("shift of the mounting", "mounting"),
    ("projection centre", "projection centre"),
    ("bend between survey and ground frame", "ground bend"),
    ("bend that does not go with the load", "constant bend"),
    ("vertical of the survey", "vertical"),
    ("motion of the skin", "skin"),
    ("bulges of the skin", "skin"),
    ("motion of the fixed marks", "fixed marks"),
    ("rotation of the root", "root motion"),
    ("shift of the root", "root motion"),
    ("bending in the wing's plane", "in-plane"),
    ("moving part", "moving parts"),
    ("torque of control surfaces", "torque"),
    ("vibration of the wing", "rolling shutter"),
    ("shake of the camera", "rolling shutter"),
    (SHAPE, SHAPE),
    ("burning of fuel", SHAPE),
    ("load's turning", SHAPE),
    ("twist", "twist"),
];

fn word(name: &'static str) -> &'static str {
    WORDS.iter().find(|(prior, _)| *prior == name).map_or(name, |(_, word)| word)
}

/// Whose images the blocks of each group are; groups beyond these hold survey and ground frame.
#[derive(Clone, Copy)]
pub struct Blocks<'a> {
    /// Per group.
    pub members: &'a [Vec<Member>],
    /// Of the last group.
    pub ground: &'a [Member],
}

impl Blocks<'_> {
    /// A block without a member ties a frame's bending to the shape that a flight has in common.
    fn observations(&self, problem: &Problem, group: usize, block: usize) -> Vec<Observed> {
        let count = problem.groups[group].blocks[block].observed.len();
        let members = self.members.get(group).map_or(self.ground, Vec::as_slice);
        members.get(block).map_or_else(|| vec![(SHAPE, 0..count)], |member| named(member, count))
    }
}

fn named(member: &Member, count: usize) -> Vec<Observed> {
    let images = [(IMAGE, member.flight), (GROUND_FRAME, member.ground)];
    let images: Vec<Observed> =
        images.into_iter().filter_map(|(name, first)| first.map(|first| (name, first..first + 2))).collect();
    let surveyed = count > 2 * images.len();
    surveyed.then_some((SURVEY, 0..3)).into_iter().chain(images).collect()
}

/// Calls `with` with all that a solution rests on; `told`: what of the frames before keeps its name.
pub fn with_sources<T>(
    blocks: Blocks,
    problem: &Problem,
    fit: &Fit,
    told: Option<&AttributedInformation>,
    with: impl FnOnce(&Sources) -> T,
) -> T {
    let observations = |group: usize, block: usize| blocks.observations(problem, group, block);
    let known = if told.is_some() { "frames before" } else { "flights before" };
    let naming = Naming { observations: &observations, prior: word, known, rest: IMAGE };
    with(&Sources::new(problem, fit, naming, told))
}

/// What keeps its name when a solution becomes knowledge: its priors on columns that do not change from frame to frame,
/// survey and ground frame.
pub fn told(
    blocks: Blocks,
    problem: &Problem,
    fit: &Fit,
    lasting: impl Fn(usize) -> bool,
) -> AttributedInformation {
    let observations = |group: usize, block: usize| blocks.observations(problem, group, block);
    let naming = Naming { observations: &observations, prior: word, known: "frames before", rest: IMAGE };
    AttributedInformation::from_solution(problem, fit, lasting, blocks.members.len(), &naming)
}

impl MarkerSolution {
    /// Against what the deflection is told best: the survey, or the ground frame or the root's tangent where their standard
    /// deviation is smaller by more than a hundredth. `None` without a deflection.
    fn better(&self) -> Option<Reference> {
        let sigma = |reference| self.deflection_against(reference).and_then(|deflection| deflection.sigma);
        self.deflection_m?;
        let better = |best: Reference, other: Reference| {
            let smaller = sigma(other).zip(sigma(best)).is_some_and(|(other, best)| other < BETTER * best);
            if smaller { other } else { best }
        };
        Some([Reference::Ground, Reference::Root].into_iter().fold(Reference::Survey, better))
    }
}

impl Outcome<'_> {
    /// Of the outermost used marker; `None` without one.
    pub fn budget(&self, markers: &[MarkerSolution], sources: &Sources) -> Option<Budget> {
        let stations = &self.input.scene.ground.stations;
        let span = |m: &&MarkerSolution| stations.get(m.marker).map_or(f64::MIN, |s| s.surveyed_m.x);
        let deflected = markers.iter().filter(|m| m.used && m.deflection_m.is_some());
        let tip = deflected.max_by(|a, b| span(a).total_cmp(&span(b)))?;
        let reference = tip.better()?;
        let parts = sources.contributions(self.group, &self.deflection_gradient(tip.marker, reference)?);
        let total: f64 = parts.iter().map(|part| part.variance).sum();
        let share = |part: &crate::estimation::Part| BudgetShare {
            source: part.source,
            share: part.variance / total,
            sigma_if_known_m: part.if_known.map(|variance| self.scale() * variance.sqrt()),
        };
        let mut shares: Vec<_> = parts.iter().filter(|_| total > 0.0).map(share).collect();
        shares.sort_by(|a, b| b.share.total_cmp(&a.share));
        Some(Budget { marker: tip.marker, reference, shares })
    }
}
