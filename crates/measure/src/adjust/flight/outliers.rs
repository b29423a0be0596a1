//! Data snooping in all frames of a flight together.

use super::frames::{Flight, MIN_MARKERS};
use super::solving::SolvedFlight;
use super::usage::RemovedObservation;
use crate::adjust::AdjustResult;
use crate::adjust::causes::solve_with_image_causes;
use crate::adjust::layout::BlockMember;
use crate::adjust::snooping::{MAX_FIXED_TARGET_SCALE, ResidualSum, SuspectTarget};
use crate::ordering::sort_by_value;

/// Number of data-snooping rounds; each removes at most one observation per frame.
const SNOOPING_ROUNDS: usize = 4;
/// Fraction of the largest w above which suspects are removed in the same round. An outlier affects its neighbours in all
/// frames.
const WORST_FRACTION: f64 = 0.7;

impl Flight<'_> {
    /// Computes a rough solution without outliers, and lists them. If there are many, the common displacement that explains
    /// the markers best in all frames is used instead, provided that it leaves only few outliers.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn remove_or_explain_outliers(
        &mut self,
    ) -> AdjustResult<(SolvedFlight, Vec<RemovedObservation>)> {
        let all = self.clone();
        let rough = self.solve_with_image_causes()?;
        let found = self.remove_outliers(rough)?;
        if self.tested_sum.is_none() {
            return Ok(found);
        }
        // Compared before any observation is removed.
        let tried = all
            .common_displacements()
            .into_iter()
            .filter_map(|displacement| {
                let mut with = Flight {
                    common_displacement: Some(displacement),
                    ..all.clone()
                };
                let omega = with.solve_rough(None).ok()?.fit.omega;
                Some((omega, with))
            });
        let Some((_, mut with)) = tried.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            return Ok(found);
        };
        let explained = with
            .solve_with_image_causes()
            .and_then(|rough| with.remove_outliers(rough));
        match explained {
            Ok(explained) if with.tested_sum.is_none() => {
                *self = with;
                Ok(explained)
            }
            _ => Ok(found),
        }
    }

    /// Computes a rough solution with all observations, and with the causes in the image that they ask for.
    fn solve_with_image_causes(&mut self) -> AdjustResult<SolvedFlight> {
        let alpha = self.input.options.global_alpha;
        let solve = |widened, from: Option<&SolvedFlight>| {
            self.widened = widened;
            self.solve_rough(from.map(|solved| &solved.fit))
        };
        solve_with_image_causes(alpha, solve, |solved| {
            (&solved.flight_problem.problem, &solved.fit)
        })
    }

    /// Computes a rough solution without outliers from one with all observations, and lists them.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn remove_outliers(
        &mut self,
        mut solved: SolvedFlight,
    ) -> AdjustResult<(SolvedFlight, Vec<RemovedObservation>)> {
        while self.prior_scales.fixed_targets < MAX_FIXED_TARGET_SCALE
            && self.fixed_targets_conflict(&solved)
        {
            self.prior_scales.fixed_targets *= 2.0;
            solved = self.solve_rough(Some(&solved.fit))?;
        }
        let (solved, mut removed) = self.run_data_snooping(solved)?;
        // Images that were tested together with a wrong surveyed position are tested again without it.
        let of_survey = |r: &RemovedObservation| r.suspect.target == SuspectTarget::Survey;
        let of_image = |r: &RemovedObservation| r.suspect.target == SuspectTarget::Flight;
        let last = removed.iter().rposition(of_survey).map_or(0, |k| k + 1);
        if !removed[..last].iter().any(of_image) {
            return Ok((solved, removed));
        }
        removed.retain(|r| !of_image(r));
        self.usage.reset_except(&removed);
        let again = self.solve_rough(Some(&solved.fit))?;
        let (solved, mut found) = self.run_data_snooping(again)?;
        removed.append(&mut found);
        Ok((solved, removed))
    }

    fn fixed_targets_conflict(&self, solved: &SolvedFlight) -> bool {
        let frames = self.frames.len();
        (0..frames).any(|frame| {
            solved
                .group(&self.input, frame)
                .fixed_targets_conflict(frames)
        })
    }

    /// Removes at most one observation per frame and round; returns the removed observations.
    fn run_data_snooping(
        &mut self,
        mut last: SolvedFlight,
    ) -> AdjustResult<(SolvedFlight, Vec<RemovedObservation>)> {
        let mut removed: Vec<RemovedObservation> = vec![];
        let mut with_all = ResidualSum::from_fit(&last.fit);
        for _ in 0..SNOOPING_ROUNDS {
            let mut found = self.find_suspects(&last);
            let most = found.iter().fold(0.0, |m: f64, r| m.max(r.suspect.w.abs()));
            found.retain(|r| r.suspect.w.abs() > WORST_FRACTION * most);
            if found.is_empty() {
                break;
            }
            found.iter().for_each(|r| self.usage.remove(r));
            removed.append(&mut found);
            last = self.solve_rough(Some(&last.fit))?;
            if removed.iter().all(|r| r.suspect.is_gross()) {
                with_all = ResidualSum::from_fit(&last.fit);
            }
        }
        // The group of one frame, or of survey and ground frame.
        let suspects_in = |group: usize| {
            removed
                .iter()
                .filter(move |r| r.group == group)
                .map(|r| &r.suspect)
        };
        self.tested_sum =
            (0..=self.frames.len()).find_map(|group| with_all.if_many_removed(suspects_in(group)));
        Ok((last, removed))
    }

    /// Finds the worst suspect of each frame, and of survey and ground frame.
    fn find_suspects(&self, solved: &SolvedFlight) -> Vec<RemovedObservation> {
        let ground = self.frames.len();
        let groups = (0..=ground).map(|group| solved.group(&self.input, group));
        let tested = groups.filter(|g| g.group == ground || g.members.len() > MIN_MARKERS + 1);
        tested
            .filter_map(|g| {
                Some(RemovedObservation {
                    group: g.group,
                    suspect: g.worst_suspect()?,
                })
            })
            .collect()
    }

    /// Tests each marker that was removed from all frames again, the least suspect first: it is added with all others
    /// removed, and stays if it fits.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn readmit_observations(
        &mut self,
        mut last: SolvedFlight,
        removed: &mut Vec<RemovedObservation>,
    ) -> AdjustResult<SolvedFlight> {
        let ground = self.frames.len();
        let mut queue: Vec<_> = removed
            .iter()
            .filter(|r| r.suspect.target != SuspectTarget::Flight)
            .copied()
            .collect();
        sort_by_value(&mut queue, |one| one.suspect.w.abs());
        for candidate in queue {
            let others: Vec<_> = removed
                .iter()
                .filter(|r| **r != candidate)
                .copied()
                .collect();
            self.usage.reset_except(&others);
            let with = self.solve_rough(Some(&last.fit))?;
            let is_own = |m: &BlockMember| m.marker == candidate.suspect.marker;
            if with
                .group(&self.input, ground)
                .worst_suspect_among(is_own)
                .is_some()
            {
                self.usage.reset_except(removed);
            } else {
                *removed = others;
                last = with;
            }
        }
        Ok(last)
    }
}
