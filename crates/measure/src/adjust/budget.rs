//! Uncertainty budget of the tip deflection, by named error sources.

use super::layout::BlockMember;
use super::outcome::FrameOutcome;
use super::{DeflectionReference, MarkerSolution, VarianceBudget, VarianceShare};
use crate::estimation::{
    AttributedInformation, Fit, NamedObservations, Problem, SourceNames, VarianceSources,
};
use crate::ordering::sort_by_value;
use crate::widths::Unknown;

/// Source name of a frame's image coordinates.
pub const IMAGE: &str = "image";
/// Source name of the survey.
pub const SURVEY: &str = Unknown::Survey.source();
/// Source name of the ground frames' image coordinates.
const GROUND_FRAME: &str = "ground frame";
/// Source name of the condition that ties a frame's bending to the shape shared by the flight.
const SHAPE: &str = Unknown::Shape.source();

/// Markers to which the blocks of each group belong. Groups beyond these hold survey and ground frame.
#[derive(Clone, Copy)]
pub struct BlockMembers<'a> {
    /// Members of the blocks, per group.
    pub members: &'a [Vec<BlockMember>],
    /// Members of the last group's blocks.
    pub ground: &'a [BlockMember],
}

impl BlockMembers<'_> {
    /// Names the observations of a block. A block without a member ties a frame's bending to the shape shared by the
    /// flight.
    fn named_observations(
        &self,
        problem: &Problem,
        group: usize,
        block: usize,
    ) -> Vec<NamedObservations> {
        let count = problem.groups[group].blocks[block].observed.len();
        let members = self.members.get(group).map_or(self.ground, Vec::as_slice);
        members.get(block).map_or_else(
            || vec![(SHAPE, 0..count)],
            |member| member_observation_ranges(member, count),
        )
    }
}

fn member_observation_ranges(member: &BlockMember, count: usize) -> Vec<NamedObservations> {
    let images = [(IMAGE, member.flight), (GROUND_FRAME, member.ground)];
    let images: Vec<NamedObservations> = images
        .into_iter()
        .filter_map(|(name, first)| first.map(|first| (name, first..first + 2)))
        .collect();
    let surveyed = count > 2 * images.len();
    surveyed
        .then_some((SURVEY, 0..3))
        .into_iter()
        .chain(images)
        .collect()
}

/// Calls `with` with the error sources of a solution. `attributed`: information from earlier frames that keeps its source
/// names.
pub fn with_variance_sources<T>(
    blocks: BlockMembers,
    problem: &Problem,
    fit: &Fit,
    attributed: Option<&AttributedInformation>,
    with: impl FnOnce(&VarianceSources) -> T,
) -> T {
    let observations =
        |group: usize, block: usize| blocks.named_observations(problem, group, block);
    let known = if attributed.is_some() {
        "earlier frames"
    } else {
        "earlier flights"
    };
    let naming = SourceNames {
        observations: &observations,
        known,
        rest: IMAGE,
    };
    with(&VarianceSources::new(problem, fit, naming, attributed))
}

/// Extracts the information that keeps its source names if a solution becomes a prior: priors on columns that do not change
/// from frame to frame, survey and ground frame.
pub fn attribute_information(
    blocks: BlockMembers,
    problem: &Problem,
    fit: &Fit,
    invariant: impl Fn(usize) -> bool,
) -> AttributedInformation {
    let observations =
        |group: usize, block: usize| blocks.named_observations(problem, group, block);
    let naming = SourceNames {
        observations: &observations,
        known: "earlier frames",
        rest: IMAGE,
    };
    AttributedInformation::from_solution(problem, fit, invariant, blocks.members.len(), &naming)
}

impl FrameOutcome<'_> {
    /// Computes the budget for the outermost marker with a deflection; `None` if there is no such marker.
    pub fn variance_budget(
        &self,
        markers: &[MarkerSolution],
        sources: &VarianceSources,
    ) -> Option<VarianceBudget> {
        let stations = &self.solved.input.scene.ground.stations;
        let span =
            |m: &&MarkerSolution| stations.get(m.marker).map_or(f64::MIN, |s| s.surveyed_m.x);
        let deflected = markers.iter().filter(|m| m.deflection_m.is_some());
        let tip = deflected.max_by(|a, b| span(a).total_cmp(&span(b)))?;
        let reference =
            DeflectionReference::most_precise(|reference| tip.deflection_against(reference)?.sigma);
        let parts = sources.contributions(
            self.solved.group,
            &self.deflection_gradient(tip.marker, reference),
        );
        let total: f64 = parts.iter().map(|part| part.variance).sum();
        let share = |part: &crate::estimation::VarianceContribution| VarianceShare {
            source: part.source.into(),
            share: part.variance / total,
            sigma_if_known_m: part.if_known.map(|variance| self.scale() * variance.sqrt()),
        };
        let mut shares: Vec<_> = parts.iter().filter(|_| total > 0.0).map(share).collect();
        sort_by_value(&mut shares, |one| -one.share);
        Some(VarianceBudget {
            marker: tip.marker,
            reference,
            shares,
        })
    }
}
