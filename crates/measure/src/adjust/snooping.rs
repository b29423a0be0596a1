//! Data snooping (Baarda): finds the observation that is most probably an outlier, one at a time.

use super::input::AdjustmentInput;
use super::layout::BlockMember;
use super::{GlobalTest, Options};
use crate::estimation::quality::{self, Reliability};
use crate::estimation::{Fit, Problem};
use crate::setup::Setup;

/// Factor by which a surveyed position must be more suspect than an image to be rejected instead; images are wrong more
/// often.
const SURVEY_LEAD: f64 = 1.05;

/// Limits of a gross error: an image farther off, px, or a surveyed position, m, does not belong to the marker. In-flight
/// effects on wing, camera and fixed targets are smaller.
const GROSS_ERROR_LIMITS: (f64, f64) = (5.0, 0.05);
/// Number of removed markers, without gross errors, from which one common cause is more probable than independent outliers.
const MANY_MARKERS: usize = 3;
/// Largest number of fixed targets among which an outlier cannot be identified.
const FEW_FIXED_TARGETS: usize = 4;

/// Sum of squares and its redundancy, the input of a global test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResidualSum {
    /// Weighted sum of squared residuals.
    pub omega: f64,
    pub redundancy: usize,
}

impl ResidualSum {
    /// Takes the sum from a solution.
    pub fn from_fit(fit: &Fit) -> Self {
        Self {
            omega: fit.omega,
            redundancy: fit.redundancy,
        }
    }

    /// Returns the sum of a global test, which is that of the solution if no other is given, and its redundancy.
    pub fn tested(sum: Option<Self>, fit: &Fit) -> (f64, usize) {
        let Self { omega, redundancy } = sum.unwrap_or(Self::from_fit(fit));
        (omega, redundancy)
    }

    /// Returns the sum if so much was removed that the remaining observations cannot be tested on their own; otherwise
    /// `None`.
    pub fn if_many_removed<'s>(self, removed: impl Iterator<Item = &'s Suspect>) -> Option<Self> {
        let mut markers: Vec<_> = removed
            .filter(|s| !s.is_gross())
            .map(|s| s.marker)
            .collect();
        markers.sort_unstable();
        markers.dedup();
        (markers.len() >= MANY_MARKERS).then_some(self)
    }
}

/// Kind of observation that is suspect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SuspectTarget {
    /// Image in flight.
    Flight,
    /// Image in the ground frame.
    Ground,
    /// Surveyed position.
    Survey,
}

/// Suspected outlier with its test statistic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Suspect {
    /// Index in the survey.
    pub marker: usize,
    pub target: SuspectTarget,
    /// Statistic of the w-test.
    pub w: f64,
    /// Estimated size of the error, px or m.
    pub size: f64,
}

impl Suspect {
    /// Returns whether the error is so large that only a wrong observation explains it.
    pub fn is_gross(&self) -> bool {
        let limit = if self.target == SuspectTarget::Survey {
            GROSS_ERROR_LIMITS.1
        } else {
            GROSS_ERROR_LIMITS.0
        };
        self.size.abs() > limit
    }

    /// Remark about the removed observation, one sentence.
    pub fn remark(&self, setup: &Setup, options: &Options) -> String {
        let id = setup.markers.get(self.marker).map_or("", |m| m.id.as_str());
        let limit = quality::critical_w(options.snooping_alpha);
        let (w, size) = (self.w.abs(), self.size.abs());
        let test = format!("(w = {w:.1}, limit {limit:.1})");
        // The largest of all coordinates of good markers is as large.
        let markers = setup.markers.len();
        let largest = quality::critical_w(options.snooping_alpha / (3 * markers.max(1)) as f64);
        match self.target {
            SuspectTarget::Flight => format!(
                "marker {id} was removed: its image is about {size:.1} px from the position that the other markers predict {test}; check the image, and its survey if other frames remove it too"
            ),
            SuspectTarget::Ground => format!(
                "the ground-frame image of marker {id} was removed: it is off by about {size:.1} px {test}"
            ),
            SuspectTarget::Survey if w < largest => format!(
                "marker {id} was removed: its surveyed position disagrees by about {size:.3} m {test}, as one of {markers} good markers may"
            ),
            SuspectTarget::Survey => format!(
                "marker {id} was removed: its surveyed position is wrong by about {size:.3} m {test}; survey it again"
            ),
        }
    }
}

/// A group of a solved problem: a frame, or survey and ground frame.
#[derive(Clone, Copy)]
pub struct SolvedGroup<'a> {
    pub input: &'a AdjustmentInput<'a>,
    pub problem: &'a Problem,
    pub fit: &'a Fit,
    /// Index of the group.
    pub group: usize,
    /// Members of the group's blocks.
    pub members: &'a [BlockMember],
}

impl SolvedGroup<'_> {
    /// Finds the largest w-statistic beyond the limit. If the global test rejects the model, w is studentised by the
    /// variance factor of the other observations (external form of Pope's tau), so that standard deviations that are too
    /// small do not turn good markers into outliers.
    pub fn worst_suspect(&self) -> Option<Suspect> {
        self.worst_suspect_among(|_| true)
    }

    /// Finds the largest w-statistic beyond the limit among some blocks.
    pub fn worst_suspect_among(&self, selects: impl Fn(&BlockMember) -> bool) -> Option<Suspect> {
        let options = self.input.options;
        let limit = quality::critical_w(options.snooping_alpha);
        let blocks = self
            .members
            .iter()
            .enumerate()
            .filter(|(_, member)| selects(member));
        let best = blocks
            .filter_map(|(block, member)| self.block_suspect(block, member))
            .reduce(larger_suspect)?;
        // The factor is at least 1 and expensive to compute, so it is computed last.
        (best.w.abs() > limit
            && best.w.abs() / root_variance_factor(self.fit, best.w, options) > limit)
            .then_some(best)
    }

    /// Returns whether few fixed targets contradict each other in flight; they then move, and the wrong one cannot be
    /// identified. Each of the `frames` is tested at its fraction of the significance level, because a moving target moves
    /// in all frames.
    pub fn fixed_targets_conflict(&self, frames: usize) -> bool {
        if !self.has_few_fixed_targets() {
            return false;
        }
        let limit = quality::critical_w(self.input.options.snooping_alpha / frames as f64);
        let mut fixed = self
            .members
            .iter()
            .enumerate()
            .filter(|(_, m)| self.input.scene.is_fixed(m.marker));
        fixed.any(|(block, member)| {
            let all = self.reliability(block);
            let seen = member.flight.and_then(|first| all.get(first..first + 2));
            seen.is_some_and(|seen| seen.iter().filter_map(|r| r.w).any(|w| w.abs() > limit))
        })
    }

    /// Returns the reliability of a block's observations.
    pub fn reliability(&self, block: usize) -> Vec<Reliability> {
        let alpha = self.input.options.snooping_alpha;
        quality::observation_reliability(self.problem, self.fit, self.group, block, alpha)
    }

    fn has_few_fixed_targets(&self) -> bool {
        self.input.setup.markers.iter().filter(|m| m.fixed).count() <= FEW_FIXED_TARGETS
    }

    fn block_suspect(&self, block: usize, member: &BlockMember) -> Option<Suspect> {
        let moves = self.input.scene.is_fixed(member.marker) && self.has_few_fixed_targets();
        let all = self.reliability(block);
        let shift = quality::detectable_shift(self.input.options.snooping_alpha);
        let largest = |first: usize, n: usize, target: SuspectTarget| {
            let one = |r: &Reliability| {
                let w = r.w?;
                let size = w * r.minimal_detectable_bias? / shift;
                Some(Suspect {
                    marker: member.marker,
                    target,
                    w,
                    size,
                })
            };
            all.get(first..first + n)?
                .iter()
                .filter_map(one)
                .reduce(larger_suspect)
        };
        let flight = member
            .flight
            .filter(|_| !moves)
            .and_then(|k| largest(k, 2, SuspectTarget::Flight));
        let ground = member
            .ground
            .and_then(|k| largest(k, 2, SuspectTarget::Ground));
        let survey = largest(0, 3, SuspectTarget::Survey).map(|s| (s.w.abs() / SURVEY_LEAD, s));
        match (
            [flight, ground]
                .into_iter()
                .flatten()
                .reduce(larger_suspect),
            survey,
        ) {
            (Some(image), Some((lead, _))) if image.w.abs() >= lead => Some(image),
            (_, Some((_, survey))) => Some(survey),
            (image, None) => image,
        }
    }
}

fn larger_suspect(a: Suspect, b: Suspect) -> Suspect {
    if b.w.abs() > a.w.abs() { b } else { a }
}

/// Largest factor by which the motion of contradicting fixed targets is increased.
pub const MAX_FIXED_TARGET_SCALE: f64 = 64.0;

/// Remark that fixed targets contradict each other.
pub fn fixed_target_remark(factor: f64) -> Option<String> {
    (factor > 1.0).then(|| {
        format!(
            "the fixed targets contradict each other: their motion in flight was assumed to be {factor:.0} times \
             flight_motion_m, for all of them; check how they are attached"
        )
    })
}

/// Square root of the variance factor without the suspect, at least 1.
pub(super) fn root_variance_factor(fit: &Fit, w: f64, options: &Options) -> f64 {
    if fit.redundancy < 2
        || quality::global_test(fit.omega, fit.redundancy, options.global_alpha)
            == Some(GlobalTest::Passed)
    {
        return 1.0;
    }
    ((fit.omega - w * w).max(0.0) / (fit.redundancy - 1) as f64)
        .sqrt()
        .max(1.0)
}

/// Returns the reliability of the observations of each group's first block.
pub(super) fn marker_reliabilities(
    problem: &Problem,
    fit: &Fit,
    alpha: f64,
) -> Vec<Vec<Reliability>> {
    (0..problem.groups.len())
        .map(|index| quality::observation_reliability(problem, fit, index, 0, alpha))
        .collect()
}

/// Element with the largest absolute test statistic.
pub(super) fn largest_statistic(all: &[Reliability]) -> Option<&Reliability> {
    let w = |r: &Reliability| r.w.map_or(-1.0, f64::abs);
    all.iter().reduce(|a, b| if w(b) > w(a) { b } else { a })
}
