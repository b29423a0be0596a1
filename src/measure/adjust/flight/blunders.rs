//! Data snooping in all frames of a flight at once.

use super::frames::{Flight, MIN_MARKERS};
use super::solving::Solved;
use super::usage::Removed;
use crate::adjust::AdjustError;
use crate::adjust::snooping::{self, MAX_FIXED_TARGET_SCALE, ResidualSum, Target};

/// Rounds of data snooping, each removing at most one observation per frame.
const ROUNDS: usize = 4;
/// A blunder pulls at its neighbours in all frames: only those go at once whose w is more than this share of the worst.
const WORST_SHARE: f64 = 0.7;

impl Flight<'_> {
    /// A rough solution without blunders, and what they are; where these are many, with the cause that explains the markers best
    /// in all frames, if but few are left out then.
    pub fn without_blunders_or_cause(&mut self) -> Result<(Solved, Vec<Removed>), AdjustError> {
        let all = self.clone();
        let found = self.without_blunders()?;
        if self.judged.is_none() {
            return Ok(found);
        }
        // Judged before anything is left out.
        let tried = all.causes().into_iter().filter_map(|cause| {
            let mut with = Flight { cause: Some(cause), ..all.clone() };
            let omega = with.solve(None).ok()?.fit.omega;
            Some((omega, with))
        });
        let Some((_, mut with)) = tried.min_by(|a, b| a.0.total_cmp(&b.0)) else { return Ok(found) };
        match with.without_blunders() {
            Ok(explained) if with.judged.is_none() => {
                *self = with;
                Ok(explained)
            }
            _ => Ok(found),
        }
    }

    /// A rough solution without blunders, and what they are.
    pub fn without_blunders(&mut self) -> Result<(Solved, Vec<Removed>), AdjustError> {
        let mut solved = self.solve(None)?;
        while self.factors.marks < MAX_FIXED_TARGET_SCALE && self.marks_contradict(&solved) {
            self.factors.marks *= 2.0;
            solved = self.solve(Some(&solved.fit))?;
        }
        let (solved, mut removed) = self.snoop(solved)?;
        // Images that were tested while a wrong surveyed position was still in are tested again without it.
        let of_survey = |r: &Removed| r.suspect.target == Target::Survey;
        let of_image = |r: &Removed| r.suspect.target == Target::Flight;
        let last = removed.iter().rposition(of_survey).map_or(0, |k| k + 1);
        if !removed[..last].iter().any(of_image) {
            return Ok((solved, removed));
        }
        removed.retain(|r| !of_image(r));
        self.usage.all_but(&removed);
        let again = self.solve(Some(&solved.fit))?;
        let (solved, mut found) = self.snoop(again)?;
        removed.append(&mut found);
        Ok((solved, removed))
    }

    fn marks_contradict(&self, Solved { setting, fit, .. }: &Solved) -> bool {
        setting.members.iter().enumerate().any(|(frame, members)| {
            let frames = setting.members.len();
            snooping::marks_contradict(&self.input, &setting.problem, fit, frame, members, frames)
        })
    }

    /// Removes at most one observation per frame and round; returns what was removed.
    fn snoop(&mut self, mut last: Solved) -> Result<(Solved, Vec<Removed>), AdjustError> {
        let mut removed: Vec<Removed> = vec![];
        let mut with_all = ResidualSum::of(&last.fit);
        for _ in 0..ROUNDS {
            let mut found = self.suspects(&last);
            let most = found.iter().fold(0.0, |m: f64, r| m.max(r.suspect.w.abs()));
            found.retain(|r| r.suspect.w.abs() > WORST_SHARE * most);
            if found.is_empty() {
                break;
            }
            found.iter().for_each(|r| self.usage.remove(r));
            removed.append(&mut found);
            last = self.solve(Some(&last.fit))?;
            if removed.iter().all(|r| r.suspect.is_gross()) {
                with_all = ResidualSum::of(&last.fit);
            }
        }
        // Of one frame, or of survey and ground frame.
        let of = |group: usize| removed.iter().filter(move |r| r.group == group).map(|r| &r.suspect);
        self.judged = (0..=self.frames.len()).find_map(|group| with_all.unless_few(of(group)));
        Ok((last, removed))
    }

    /// The worst of each frame, and of survey and ground frame.
    fn suspects(&self, Solved { setting, fit, .. }: &Solved) -> Vec<Removed> {
        let ground = self.frames.len();
        let frames =
            setting.members.iter().enumerate().filter(|(_, members)| members.len() > MIN_MARKERS + 1);
        let groups = frames.chain([(ground, &setting.ground_members)]);
        let worst = |(group, members): (usize, &Vec<_>)| {
            let suspect = snooping::worst(&self.input, &setting.problem, fit, group, members)?;
            Some(Removed { group, suspect })
        };
        groups.filter_map(worst).collect()
    }

    /// Backward step: each marker that was taken out as a whole, the least suspect first, is put back
    /// and tested with all the others out; it stays if it fits.
    pub fn readmit(&mut self, mut last: Solved, removed: &mut Vec<Removed>) -> Result<Solved, AdjustError> {
        let ground = self.frames.len();
        let mut queue: Vec<_> =
            removed.iter().filter(|r| r.suspect.target != Target::Flight).copied().collect();
        queue.sort_by(|a, b| a.suspect.w.abs().total_cmp(&b.suspect.w.abs()));
        for candidate in queue {
            let others: Vec<_> = removed.iter().filter(|r| **r != candidate).copied().collect();
            self.usage.all_but(&others);
            let with = self.solve(Some(&last.fit))?;
            let Solved { setting, fit, .. } = &with;
            let members = setting.ground_members.iter().enumerate();
            let blocks = members.filter(|(_, m)| m.marker == candidate.suspect.marker);
            if snooping::worst_of(&self.input, &setting.problem, fit, ground, blocks).is_some() {
                self.usage.all_but(removed);
            } else {
                *removed = others;
                last = with;
            }
        }
        Ok(last)
    }
}
