//! Frames that contradict the others of their flight: they are left out of the joint adjustment, adjusted alone, and doubtful.

use super::joint::JointSolution;
use super::single_frame::solve_frame_with;
use super::solving::SolvedFlight;
use crate::adjust::causes::{CAUSES_ALPHA, IN_IMAGE};
use crate::adjust::snooping::{ResidualSum, SuspectTarget};
use crate::adjust::{MarkerSolution, Observation, Options, Solution};
use crate::estimation::{Prior, quality};
use crate::setup::{Orientation, Setup};

/// Fraction of the largest contradiction from which on frames are left out in the same pass. A wrong frame affects the others.
const WORST_FRACTION: f64 = 0.5;
/// Largest number of joint solutions, each without the frames that contradict the one before.
pub const LEAVING_PASSES: usize = 4;

impl JointSolution<'_> {
    /// Returns the indices of the frames that contradict the others most: they have a scale or an aspect of their own, data
    /// snooping removes many of their images, or it leaves a contradiction that the largest of all observations has in one of
    /// 1000 flights. Empty if none does, or if half of all frames do, so that nobody knows which are right.
    pub fn contradicting_frames(&self) -> Vec<usize> {
        let frames = self.flight.frames.len();
        let contradictions: Vec<f64> = (0..frames).map(|frame| self.contradiction(frame)).collect();
        let largest = contradictions.iter().copied().fold(0.0, f64::max);
        let found: Vec<usize> = (0..frames)
            .filter(|frame| contradictions[*frame] > WORST_FRACTION * largest)
            .collect();
        match 2 * found.len() < frames {
            true => found,
            false => vec![],
        }
    }

    /// Statistics of another scale and another aspect of one frame alone; a flight that its test rejects is tested relative
    /// to its variance factor.
    fn image_statistics(&self, frame: usize) -> impl Iterator<Item = f64> {
        let SolvedFlight {
            flight_problem,
            fit,
            tested_sum,
        } = &self.solved;
        let problem = &flight_problem.problem;
        let alpha = self.flight.input.options.global_alpha;
        let (omega, redundancy) = ResidualSum::tested(*tested_sum, fit);
        let factor = quality::rejected_factor(omega, redundancy, alpha);
        let of_image = |prior: &&Prior| {
            IN_IMAGE
                .iter()
                .any(|cause| prior.name.unknown == cause.name())
        };
        let columns = problem
            .priors
            .iter()
            .filter(of_image)
            .map(|prior| prior.columns[0]);
        columns
            .filter_map(move |column| quality::group_bias_statistic(problem, fit, frame, column))
            .map(move |w| w / factor.sqrt())
    }

    /// Sum of the squared statistics of a frame's image and outliers; 0 if it has the flight's scale and aspect, and its
    /// outliers may be independent.
    fn contradiction(&self, frame: usize) -> f64 {
        let input = &self.flight.input;
        let removed: Vec<_> = self
            .removed
            .iter()
            .filter(|one| one.group == frame && one.suspect.target == SuspectTarget::Flight)
            .map(|one| one.suspect)
            .collect();
        let left = self.solved.group(input, frame).worst_suspect();
        let observed: usize = self.flight.frames.iter().flatten().flatten().count();
        let level = input.options.snooping_alpha / (2 * observed.max(1)) as f64;
        let largest = left.filter(|suspect| suspect.w.abs() > quality::critical_w(level));
        let many = ResidualSum::from_fit(&self.solved.fit).if_many_removed(removed.iter());
        let images = self.flight.frames.len() * IN_IMAGE.len();
        let limit = match input.options.global_alpha > 0.0 {
            true => quality::critical_w(CAUSES_ALPHA / images as f64),
            false => f64::INFINITY,
        };
        let changed: Vec<f64> = self
            .image_statistics(frame)
            .filter(|w| w.abs() > limit)
            .collect();
        if many.is_none() && largest.is_none() && changed.is_empty() {
            return 0.0;
        }
        let outliers = removed.iter().chain(&largest).map(|suspect| suspect.w);
        outliers.chain(changed).map(|w| w * w).sum()
    }
}

/// Returns the indices of the frames that can be adjusted alone without a cause; `None` if these are not most of the frames.
pub fn find_sound_frames(
    setup: &Setup,
    orientation: &Orientation,
    frames: &[Vec<Observation>],
    options: &Options,
) -> Option<Vec<usize>> {
    let is_sound = |frame: &usize| {
        let options = options.for_frames(&[*frame]);
        solve_frame_with(setup, orientation, &frames[*frame], &options, |_| ())
            .is_ok_and(|(solution, ())| solution.counted_causes.is_empty())
    };
    let sound: Vec<usize> = (0..frames.len()).filter(is_sound).collect();
    (2 * sound.len() > frames.len() && sound.len() < frames.len()).then_some(sound)
}

/// Adjusts a frame alone that contradicts the others of its flight; the result is doubtful.
pub fn solve_contradicting_frame(
    setup: &Setup,
    orientation: &Orientation,
    observations: &[Observation],
    options: &Options,
) -> Solution {
    let alone = solve_frame_with(setup, orientation, observations, options, |_| ());
    let contradicts = "the frame contradicts the other frames of its flight";
    match alone {
        Ok((solution, ())) => {
            let causes = solution.counted_causes.iter();
            let parts: Vec<&str> = causes.map(|cause| cause.as_str()).collect();
            let doubt = match parts.is_empty() {
                true => format!("{contradicts}; it was adjusted without them"),
                false => format!(
                    "{contradicts}, and was adjusted without them: {}",
                    parts.join("; ")
                ),
            };
            Solution {
                doubt: Some(doubt),
                ..solution
            }
        }
        Err(error) => {
            let doubt = format!("{contradicts} and has no solution without them: {error}");
            let markers = 0..setup.markers.len();
            Solution {
                markers: markers
                    .map(|marker| MarkerSolution::unused(marker, doubt.clone()))
                    .collect(),
                doubt: Some(doubt),
                ..Solution::default()
            }
        }
    }
}
