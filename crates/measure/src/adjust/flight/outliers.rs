//! Data snooping in all frames of a flight together.

use super::frames::Flight;
use super::free_causes::RoughFlight;
use super::knowledge::Knowledge;
use super::solving::SolvedFlight;
use super::usage::RemovedObservation;
use crate::adjust::AdjustResult;
use crate::adjust::layout::BlockMember;
use crate::adjust::snooping::{MAX_FIXED_TARGET_SCALE, ResidualSum, SuspectTarget};
use crate::ordering::sort_by_value;

/// Number of data-snooping rounds in several frames; each removes at most one observation per frame.
const SNOOPING_ROUNDS: usize = 4;
/// Number of a single frame's observations per round.
const OBSERVATIONS_PER_ROUND: usize = 3;
/// Fraction of the largest w above which suspects are removed in the same round. An outlier affects its neighbours in all
/// frames.
const WORST_FRACTION: f64 = 0.7;

impl<'a> Flight<'a> {
    /// Computes a rough solution without outliers, and lists them. If there are many, the common displacement that explains
    /// the markers best in all frames is used instead, provided that it leaves only few outliers.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn remove_or_explain_outliers(mut self) -> AdjustResult<RoughFlight<'a>> {
        let all = self.clone();
        let rough = self.solve_with_image_causes()?;
        let (solved, removed) = self.remove_outliers(rough)?;
        Ok(all.explain_many_outliers((self, solved, removed)))
    }

    /// Explains outliers, if many were found, by the common displacement that explains the markers best in all frames,
    /// provided that it leaves only few. `self`: the flight with all observations.
    pub fn explain_many_outliers(&self, found: RoughFlight<'a>) -> RoughFlight<'a> {
        if found.0.tested_sum.is_none() {
            return found;
        }
        // Compared before any observation is removed.
        let tried = self
            .common_displacements()
            .into_iter()
            .filter_map(|displacement| {
                let mut with = Flight {
                    common_displacement: Some(displacement),
                    ..self.clone()
                };
                let omega = with.solve_rough(None).ok()?.fit.omega;
                Some((omega, with))
            });
        let Some((_, mut with)) = tried.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            return found;
        };
        let explained = with
            .solve_with_image_causes()
            .and_then(|rough| with.remove_outliers(rough));
        match explained {
            Ok((solved, removed)) if with.tested_sum.is_none() => (with, solved, removed),
            _ => found,
        }
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
        if self.frames.len() == 1 {
            let solved = self.readmit_observations(solved, &mut removed)?;
            return Ok((solved, removed));
        }
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
        let frames = match self.knowledge {
            Knowledge::After(_) => 0,
            _ => self.frames.len(),
        };
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
        let rounds = match &self.frames[..] {
            [one] => one.iter().flatten().count() / OBSERVATIONS_PER_ROUND,
            _ => SNOOPING_ROUNDS,
        };
        for _ in 0..rounds {
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
        self.tested_sum = self.sum_if_many_removed(with_all, &removed);
        Ok((last, removed))
    }

    /// Returns the sum of squares with all observations if many were removed from one frame, or from survey and ground frame.
    fn sum_if_many_removed(
        &self,
        with_all: ResidualSum,
        removed: &[RemovedObservation],
    ) -> Option<ResidualSum> {
        let suspects_in = |group: usize| {
            removed
                .iter()
                .filter(move |r| r.group == group)
                .map(|r| &r.suspect)
        };
        (0..=self.frames.len()).find_map(|group| with_all.if_many_removed(suspects_in(group)))
    }

    /// Finds the worst suspect of each frame that has enough other markers, and of survey and ground frame.
    fn find_suspects(&self, solved: &SolvedFlight) -> Vec<RemovedObservation> {
        (0..=self.frames.len())
            .map(|group| solved.group(&self.input, group))
            .filter_map(|g| {
                Some(RemovedObservation {
                    group: g.group,
                    suspect: g.worst_suspect()?,
                })
            })
            .filter(|removed| self.is_sufficient_without(removed))
            .collect()
    }

    /// Tests each marker that was removed from all frames again, the least suspect first: it is added with all others
    /// removed, and stays if it fits. In a single frame each observation is tested, and none may be suspect then: an early
    /// suspect may be a consequence of a later one.
    ///
    /// # Errors
    /// Returns an error if the flight has no solution.
    pub fn readmit_observations(
        &mut self,
        mut last: SolvedFlight,
        removed: &mut Vec<RemovedObservation>,
    ) -> AdjustResult<SolvedFlight> {
        let is_single = self.frames.len() == 1;
        if is_single && removed.len() < 2 {
            return Ok(last);
        }
        let mut queue: Vec<_> = removed
            .iter()
            .filter(|r| is_single || r.suspect.target != SuspectTarget::Flight)
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
            let group = match is_single {
                true => candidate.group,
                false => self.frames.len(),
            };
            let is_tested = |m: &BlockMember| is_single || m.marker == candidate.suspect.marker;
            let before = self.hyperparameters.clone();
            let with = self.solve_rough(Some(&last.fit));
            let fits = |with: &SolvedFlight| {
                let group = with.group(&self.input, group);
                group.worst_suspect_among(is_tested).is_none()
            };
            match with {
                Ok(with) if fits(&with) => (*removed, last) = (others, with),
                _ => {
                    self.usage.reset_except(removed);
                    self.hyperparameters = before;
                }
            }
        }
        self.tested_sum = self
            .tested_sum
            .and_then(|sum| self.sum_if_many_removed(sum, removed));
        Ok(last)
    }
}
