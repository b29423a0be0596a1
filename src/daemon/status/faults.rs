//! Current faults of the parts of the recorder. Nothing but capturing may end the recorder: a part that does not work is
//! reported here, logged at growing intervals, and tried again by its thread.

use std::collections::BTreeMap;

use wingd_base::text::printable_text;

/// Part of the recorder: its group, and its name in the group, empty for the group's only part.
pub(crate) type Part = (&'static str, &'static str);

/// Group of the parts of live mode.
pub(crate) const LIVE_PARTS: &str = "live";
/// Feed of aircraft data.
pub(crate) const AIRCRAFT_PART: Part = ("aircraft data", "");
/// Web page.
pub(crate) const PAGE_PART: Part = ("web page", "");
/// Socket of the status.
pub(crate) const STATUS_PART: Part = ("status socket", "");
/// Signatures of the flights.
pub(crate) const SIGNING_PART: Part = ("signatures", "");
/// Solver of frames.
pub(crate) const SOLVER_PART: Part = ("solver", "");
/// Storage of the results of series.
pub(crate) const RESULTS_PART: Part = ("results", "");

/// Time from the first log entry of a fault to the second, s; it doubles with each entry.
const FIRST_PAUSE_S: f64 = 10.0;
/// Maximum time between two log entries of a lasting fault, s.
const MAX_PAUSE_S: f64 = 3600.0;

/// Fault of a part, current or past.
#[derive(Default)]
struct PartFault {
    /// Current fault; `None` if the part works again.
    what: Option<String>,
    pause_s: f64,
    next_entry_s: f64,
}

/// Current faults by part.
#[derive(Default)]
pub(super) struct Faults(BTreeMap<Part, PartFault>);

impl Faults {
    /// Sets or clears the fault of a part at `now_s` since boot; returns whether a fault has begun or changed.
    pub fn set(&mut self, part: Part, fault: Option<String>, now_s: f64) -> bool {
        if fault.is_none() && !self.0.contains_key(&part) {
            return false;
        }
        let entry = self.0.entry(part).or_default();
        let before = std::mem::replace(&mut entry.what, fault);
        let Some(what) = &entry.what else {
            if before.is_some() {
                tracing::info!(part = name(part), "works again");
            }
            return false;
        };
        if now_s >= entry.next_entry_s {
            let quiet = now_s > entry.next_entry_s + MAX_PAUSE_S;
            entry.pause_s = if quiet {
                FIRST_PAUSE_S
            } else {
                (2.0 * entry.pause_s).clamp(FIRST_PAUSE_S, MAX_PAUSE_S)
            };
            entry.next_entry_s = now_s + entry.pause_s;
            tracing::warn!(part = name(part), what = %printable_text(what));
        }
        before.as_ref() != Some(what)
    }

    /// Returns the current faults, with the group and name of their parts.
    pub fn current(&self) -> impl Iterator<Item = (Part, &str)> {
        self.0
            .iter()
            .filter_map(|(part, fault)| Some((*part, fault.what.as_deref()?)))
    }

    /// Returns the first current fault of a group.
    pub fn first_of(&self, group: &str) -> Option<String> {
        self.current()
            .find(|((of, _), _)| *of == group)
            .map(|(_, what)| what.to_owned())
    }
}

/// Returns the name of a part for people.
pub(super) fn name((group, part): Part) -> String {
    format!("{group} {part}").trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lasting_fault_is_logged_at_growing_intervals_and_ends() {
        let mut faults = Faults::default();
        let set = |faults: &mut Faults, what: &str, at: f64| {
            faults.set(PAGE_PART, Some(what.to_owned()), at)
        };
        assert!(
            set(&mut faults, "lost", 0.0)
                && !set(&mut faults, "lost", 5.0)
                && set(&mut faults, "empty", 6.0)
        );
        let pauses: Vec<f64> = (0..2000)
            .map(|k| {
                set(&mut faults, "empty", 10.0 * f64::from(k));
                faults.0[&PAGE_PART].pause_s
            })
            .collect();
        assert_eq!(
            (pauses[0], pauses[1], pauses[3], pauses[1999]),
            (10.0, 20.0, 40.0, MAX_PAUSE_S)
        );
        assert_eq!(faults.first_of("web page").as_deref(), Some("empty"));
        assert!(!faults.set(PAGE_PART, None, 3e4) && faults.current().next().is_none());
    }
}
