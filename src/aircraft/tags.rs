//! Which time tags of a feed cannot be true, by when their lines came.

use std::collections::BTreeMap;

use super::layout::Sample;
use super::times::seconds;
use crate::clock::Stamp;
use crate::measure::estimation::robust::{SIGMA_OVER_MEDIAN, median};

/// A line cannot come before its tag by more than two clocks that are kept may differ, s (an assumption).
const AHEAD_S: f64 = 2.0;
/// No feed is so late, s (an assumption).
const LATE_S: f64 = 120.0;
/// A tag whose delay differs by more from the usual one has jumped, s.
const JUMP_S: f64 = 30.0;
/// One out of its turn has jumped where its delay differs by so many times the usual scatter, and by this, s.
const OUT_OF_TURN: (f64, f64) = (6.0, 2.0);
/// Delays that differ by less are of one jump, s.
const SAME_JUMP_S: f64 = 1.0;

/// How far a line came after its tag by a clock that was synchronised, s, where that cannot be: before it, or far too late.
#[must_use]
pub fn impossible(time_s: f64, at: &Stamp) -> Option<f64> {
    let delay_s = seconds(at.utc) - time_s;
    (at.utc_synchronised && !(-AHEAD_S..=LATE_S).contains(&delay_s)).then_some(delay_s)
}

/// What is usual in a boot, s.
struct Usual {
    /// UTC of the tags less time since boot of receipt, median.
    lead_s: f64,
    scatter_s: f64,
}

/// Looks at the lines of a feed in the order in which they came.
pub(super) struct Judge {
    boots: BTreeMap<String, Usual>,
    /// By boot: the newest tag that was believed.
    newest_s: BTreeMap<String, f64>,
    /// Difference from the usual delay of the line before, where that one had jumped.
    jumped_s: Option<f64>,
}

impl Judge {
    pub fn of(lines: &[(Sample, Option<Stamp>)]) -> Self {
        let mut leads: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for (sample, at) in lines.iter().filter_map(|(sample, at)| Some((sample, at.as_ref()?))) {
            if impossible(sample.time_s, at).is_none() {
                leads.entry(at.boot_id.clone()).or_default().push(sample.time_s - at.since_boot_s);
            }
        }
        let usual = |(boot, all): (String, Vec<f64>)| {
            let lead_s = median(all.clone())?;
            let apart = all.into_iter().map(|lead| (lead - lead_s).abs()).collect();
            Some((boot, Usual { lead_s, scatter_s: SIGMA_OVER_MEDIAN * median(apart)? }))
        };
        let boots = leads.into_iter().filter_map(usual).collect();
        Self { boots, newest_s: BTreeMap::new(), jumped_s: None }
    }

    /// By boot: UTC of the tags less time since boot of receipt, s.
    pub fn leads_s(&self) -> impl Iterator<Item = (String, f64)> + '_ {
        self.boots.iter().map(|(boot, usual)| (boot.clone(), usual.lead_s))
    }

    /// Whether the next line's tag can be true.
    pub fn believes(&mut self, time_s: f64, at: Option<&Stamp>) -> bool {
        let Some(at) = at else { return true };
        if impossible(time_s, at).is_some() {
            return false;
        }
        let Some(usual) = self.boots.get(&at.boot_id) else { return true };
        let apart_s = time_s - at.since_boot_s - usual.lead_s;
        let far = apart_s.abs() > OUT_OF_TURN.1 + OUT_OF_TURN.0 * usual.scatter_s;
        // What a link held back comes late and in its turn; what has jumped goes back, and stays there for a while.
        let back = self.newest_s.get(&at.boot_id).is_some_and(|newest_s| time_s <= *newest_s);
        let goes_on = self.jumped_s.is_some_and(|before_s| (apart_s - before_s).abs() < SAME_JUMP_S);
        if apart_s.abs() > JUMP_S || far && (back || goes_on) {
            self.jumped_s = Some(apart_s);
            return false;
        }
        self.jumped_s = None;
        let newest_s = self.newest_s.entry(at.boot_id.clone()).or_insert(time_s);
        *newest_s = newest_s.max(time_s);
        true
    }
}
