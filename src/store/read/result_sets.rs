//! Which results of a flight belong together: those computed from the same inputs. Figures of two sets
//! are never mixed; one set is chosen, and that there are others is said.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::{Map, Value};

use super::catalogue::{self, FlightRef, SeriesRef};
use crate::store::disk::{Disk, StoreError};
use crate::store::format::manifest::ResultLine;
use crate::store::format::result_summary::{self, ResultSummary};
use crate::store::format::{Inputs, layout};

/// Characters of a set's key that a person reads and types.
const SHORT_KEY_LENGTH: usize = 8;

/// Results of a flight that were computed from the same inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultSet {
    /// Digest over the inputs, the frame apart; hex.
    pub key: String,
    /// Digests of the installation, program version, parameters.
    pub provenance: Map<String, Value>,
    /// Frames with such a result.
    pub results: usize,
    /// Of the last one: how many sets of its series it follows, its series' number.
    last: (usize, u64),
    /// As [`Gather::add`] counts it.
    index: usize,
}

impl ResultSet {
    /// Its number in what [`Gather::add`] returned.
    pub fn index(&self) -> usize {
        self.index
    }

    /// The key's beginning.
    pub fn short_key(&self) -> &str {
        self.key.get(..SHORT_KEY_LENGTH).unwrap_or(&self.key)
    }

    /// Key, program and count, in words.
    pub fn description(&self) -> String {
        let program = self.provenance.get("program").and_then(Value::as_str).unwrap_or("unknown program");
        format!("{} ({program}): {} results", self.short_key(), self.results)
    }
}

/// The sets of a flight.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResultSets {
    /// Frames that have a result.
    pub frames: usize,
    /// The oldest first.
    pub sets: Vec<ResultSet>,
}

impl ResultSets {
    /// Whose figures are shown: of the sets with the most frames the newest; or the one asked for by its
    /// key's beginning. A set that was broken off takes no figure away from a whole one.
    pub fn choose_set(&self, wanted: Option<&str>) -> Option<&ResultSet> {
        match wanted {
            Some(key) => self.sets.iter().rev().find(|set| set.key.starts_with(key)),
            None => self.sets.iter().max_by_key(|set| (set.results, set.last)),
        }
    }

    /// A sentence where a flight has results of several inputs; `None` where not.
    pub fn mixed_inputs_warning(&self, flight: &str, wanted: Option<&str>) -> Option<String> {
        let chosen = self.choose_set(wanted)?;
        let [_, _, ..] = self.sets.as_slice() else { return None };
        let all: Vec<String> = self.sets.iter().map(ResultSet::description).collect();
        let short = match self.frames - chosen.results.min(self.frames) {
            0 => String::new(),
            n => format!("; {n} frames have results of other inputs only and are shown without one"),
        };
        Some(format!(
            "{flight}: {} frames have results of {} inputs, {}; figures are of {} alone{short}",
            self.frames,
            self.sets.len(),
            all.join(", "),
            chosen.short_key()
        ))
    }
}

/// The sets of a flight. Reads the beginning of every result.
pub fn flight_result_sets(disk: &dyn Disk, flight: &FlightRef) -> Result<ResultSets, StoreError> {
    let mut gather = ResultGrouper::default();
    for series in catalogue::list_series(disk, flight)? {
        let bytes = disk.load_if_exists(&series.folder.join(layout::RESULTS_FILE))?;
        gather.add_series(&series.id, &result_summary::parse_summaries(&bytes.unwrap_or_default(), &[]));
    }
    Ok(gather.finish())
}

/// Sorts results into sets, series by series.
#[derive(Default)]
pub struct ResultGrouper {
    frames: usize,
    sets: Vec<ResultSet>,
}

impl ResultGrouper {
    /// Takes a series' results, in the order written; returns which set each belongs to.
    pub fn add_series(&mut self, series: &str, heads: &[ResultSummary]) -> Vec<usize> {
        let number = layout::series_number(series).unwrap_or(0);
        let sets: Vec<usize> = heads.iter().map(|head| self.set_index(&head.provenance)).collect();
        let mut order: Vec<usize> = Vec::new();
        for index in &sets {
            order.retain(|known| known != index);
            order.push(*index);
        }
        for (rank, index) in order.into_iter().enumerate() {
            if let Some(set) = self.sets.get_mut(index) {
                set.last = set.last.max((rank, number));
                set.results += sets.iter().filter(|one| **one == index).count();
            }
        }
        self.frames += heads.iter().map(|head| head.frame.as_str()).collect::<BTreeSet<_>>().len();
        sets
    }

    fn set_index(&mut self, provenance: &Map<String, Value>) -> usize {
        if let Some(known) = self.sets.iter().position(|set| set.provenance == *provenance) {
            return known;
        }
        let key = Inputs::new(provenance.clone()).key("");
        let index = self.sets.len();
        self.sets.push(ResultSet { key, provenance: provenance.clone(), results: 0, last: (0, 0), index });
        index
    }

    /// What they are.
    pub fn finish(mut self) -> ResultSets {
        self.sets.sort_by_key(|set| set.last);
        ResultSets { frames: self.frames, sets: self.sets }
    }
}

/// The results of a series that belong to a set, in the frames' order; all where none is named.
pub fn results_in_set(
    disk: &dyn Disk,
    series: &SeriesRef,
    set: Option<&ResultSet>,
) -> Result<Vec<ResultLine>, StoreError> {
    let belongs = |line: &ResultLine| set.is_none_or(|set| line.provenance == set.provenance);
    let mut latest = BTreeMap::new();
    for line in catalogue::read_results(disk, series)?.into_iter().filter(belongs) {
        latest.insert(line.frame.clone(), line);
    }
    Ok(latest.into_values().collect())
}

/// What is to be said of a store's flights with results of several inputs.
pub fn mixed_inputs_warnings(disk: &dyn Disk, root: &Path) -> Vec<String> {
    let flights = catalogue::list_flights(disk, root).unwrap_or_default();
    let of = |flight: &FlightRef| flight_result_sets(disk, flight).ok()?.mixed_inputs_warning(&flight.id, None);
    flights.iter().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    fn line(frame: u32, program: &str) -> String {
        format!("{{\"frame\":\"{frame:04}.jpg\",\"provenance\":{{\"program\":\"{program}\"}}}}\n")
    }

    fn sets(series: &[&[(u32, &str)]]) -> ResultSets {
        let mut gather = ResultGrouper::default();
        for (number, lines) in series.iter().enumerate() {
            let text: String = lines.iter().map(|(frame, program)| line(*frame, program)).collect();
            gather.add_series(&layout::series_id(number as u64 + 1), &result_summary::parse_summaries(text.as_bytes(), &[]));
        }
        gather.finish()
    }

    fn chosen(sets: &ResultSets) -> &str {
        sets.choose_set(None).unwrap().provenance["program"].as_str().unwrap()
    }

    #[test]
    fn a_whole_newer_set_is_shown_and_a_broken_off_one_is_not() {
        let whole = sets(&[&[(1, "a"), (2, "a"), (1, "b"), (2, "b")], &[(1, "a"), (1, "b")]]);
        assert_eq!((chosen(&whole), whole.frames), ("b", 3));
        let begun = sets(&[&[(1, "a"), (2, "a"), (1, "b"), (2, "b")], &[(1, "a")]]);
        assert_eq!(chosen(&begun), "a");
        assert!(begun.mixed_inputs_warning("f0001", None).unwrap().contains("results of 2 inputs"));
    }

    #[test]
    fn one_set_is_nothing_to_speak_of_and_parted_ones_are() {
        assert_eq!(sets(&[&[(1, "a")], &[(1, "a")]]).mixed_inputs_warning("f0001", None), None);
        assert_eq!(sets(&[]).mixed_inputs_warning("f0001", None), None);
        let parted = sets(&[&[(1, "a")], &[(1, "b")]]);
        assert_eq!(chosen(&parted), "b", "the newer series");
        let said = parted.mixed_inputs_warning("f0001", None).unwrap();
        assert!(said.contains("1 frames have results of other inputs only"), "{said}");
        let key = parted.sets.iter().find(|s| s.provenance["program"] == "a").unwrap().short_key().to_owned();
        assert_eq!(parted.choose_set(Some(&key)).unwrap().provenance["program"], "a");
    }
}
