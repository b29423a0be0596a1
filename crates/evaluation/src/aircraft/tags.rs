//! Rejection of a feed's impossible time tags, by the times of receipt of their lines.

use std::collections::BTreeMap;

use super::layout::Sample;
use super::times::unix_seconds;
use wingd_base::clock::Stamp;
use wingd_measure::estimation::robust::{SIGMA_OVER_MEDIAN, median};

/// Largest time by which a line can come before its tag, s: two maintained clocks differ by less (an assumption).
const MAX_AHEAD_S: f64 = 2.0;
/// Largest delay of a feed, s (an assumption).
const MAX_LATE_S: f64 = 120.0;
/// Largest difference between a tag's delay and the typical one, s; a larger one is a jump.
const MAX_DELAY_CHANGE_S: f64 = 30.0;
/// Limits of the delay of a tag that is out of order, above which it has jumped: multiple of the typical scatter, and
/// addition, s.
const OUT_OF_ORDER_LIMITS: (f64, f64) = (6.0, 2.0);
/// Largest difference between the delays of one jump, s.
const SAME_JUMP_S: f64 = 1.0;

/// Returns the delay of a line after its tag, s, if it is impossible on a synchronised clock: negative, or far too large.
#[must_use]
pub fn impossible_delay_s(time_s: f64, at: &Stamp) -> Option<f64> {
    let delay_s = unix_seconds(at.utc) - time_s;
    (at.utc_synchronised && !(-MAX_AHEAD_S..=MAX_LATE_S).contains(&delay_s)).then_some(delay_s)
}

/// Typical delay of the tags in a boot, s.
struct TypicalDelay {
    /// Median difference between the tags' UTC and the time since boot of receipt.
    lead_s: f64,
    scatter_s: f64,
}

/// Filter of a feed's lines in the order of receipt.
pub(super) struct TagFilter {
    boots: BTreeMap<String, TypicalDelay>,
    /// Newest accepted tag, by boot.
    newest_s: BTreeMap<String, f64>,
    /// Difference of the previous line's delay from the typical one, if that line had jumped.
    jumped_s: Option<f64>,
}

impl TagFilter {
    /// Estimates the usable delays of time tags from recorded lines.
    pub fn from_lines(lines: &[(Sample, Option<Stamp>)]) -> Self {
        let mut leads: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for (sample, at) in lines
            .iter()
            .filter_map(|(sample, at)| Some((sample, at.as_ref()?)))
        {
            if impossible_delay_s(sample.time_s, at).is_none() {
                leads
                    .entry(at.boot_id.clone())
                    .or_default()
                    .push(sample.time_s - at.since_boot_s);
            }
        }
        let typical = |(boot, all): (String, Vec<f64>)| {
            let lead_s = median(all.clone())?;
            let apart = all.into_iter().map(|lead| (lead - lead_s).abs()).collect();
            Some((
                boot,
                TypicalDelay {
                    lead_s,
                    scatter_s: SIGMA_OVER_MEDIAN * median(apart)?,
                },
            ))
        };
        let boots = leads.into_iter().filter_map(typical).collect();
        Self {
            boots,
            newest_s: BTreeMap::new(),
            jumped_s: None,
        }
    }

    /// Returns the difference between the tags' UTC and the time since boot of receipt, s, by boot.
    pub fn leads_s(&self) -> impl Iterator<Item = (String, f64)> + '_ {
        self.boots
            .iter()
            .map(|(boot, typical)| (boot.clone(), typical.lead_s))
    }

    /// Returns whether the next line's tag is possible.
    pub fn accepts(&mut self, time_s: f64, at: Option<&Stamp>) -> bool {
        let Some(at) = at else { return true };
        if impossible_delay_s(time_s, at).is_some() {
            return false;
        }
        let Some(typical) = self.boots.get(&at.boot_id) else {
            return true;
        };
        let apart_s = time_s - at.since_boot_s - typical.lead_s;
        let far = apart_s.abs() > OUT_OF_ORDER_LIMITS.1 + OUT_OF_ORDER_LIMITS.0 * typical.scatter_s;
        // Lines delayed by a link come late but in order; jumped tags go back, and stay so for a while.
        let back = self
            .newest_s
            .get(&at.boot_id)
            .is_some_and(|newest_s| time_s <= *newest_s);
        let goes_on = self
            .jumped_s
            .is_some_and(|before_s| (apart_s - before_s).abs() < SAME_JUMP_S);
        if apart_s.abs() > MAX_DELAY_CHANGE_S || far && (back || goes_on) {
            self.jumped_s = Some(apart_s);
            return false;
        }
        self.jumped_s = None;
        let newest_s = self.newest_s.entry(at.boot_id.clone()).or_insert(time_s);
        *newest_s = newest_s.max(time_s);
        true
    }
}
