//! Sets of results of a flight: those computed from the same inputs. Figures of two sets are never mixed; one set is
//! chosen, and a warning names the others.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::Path;

use serde_json::{Map, Value};

use super::catalogue::{self, FlightRef, SeriesRef};
use crate::disk::{Disk, StoreResult};
use crate::format::manifest::ResultLine;
use crate::format::result_summary;
use crate::format::{Inputs, layout};

/// Length of the abbreviated key that a person reads and types.
const SHORT_KEY_LENGTH: usize = 8;

/// Results of a flight that were computed from the same inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct ResultSet {
    /// Digest of the inputs other than the frame, hex.
    pub key: String,
    /// Digests of the installation, program version, parameters.
    pub provenance: Map<String, Value>,
    /// Number of frames with such a result.
    pub results: usize,
    /// Rank of the last result: number of sets that it follows in its series, number of the series.
    last: (usize, u64),
    /// Number in [`ResultHead::set`].
    index: usize,
}

impl ResultSet {
    /// Returns the number of the set in [`ResultHead::set`].
    pub fn index(&self) -> usize {
        self.index
    }

    /// Returns the abbreviated key.
    pub fn short_key(&self) -> &str {
        self.key.get(..SHORT_KEY_LENGTH).unwrap_or(&self.key)
    }

    /// Describes the set by key, program and count.
    pub fn description(&self) -> String {
        let program = self
            .provenance
            .get("program")
            .and_then(Value::as_str)
            .unwrap_or("unknown program");
        format!("{} ({program}): {} results", self.short_key(), self.results)
    }
}

/// Result sets of a flight.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResultSets {
    /// Number of frames that have a result.
    pub frames: usize,
    /// Sets, the oldest first.
    pub sets: Vec<ResultSet>,
}

impl ResultSets {
    /// Chooses the set whose figures are shown: the one whose key begins with `wanted`; by default the newest of the sets
    /// with the most frames, so that an incomplete set does not replace a complete one.
    pub fn choose_set(&self, requested: Option<&str>) -> Option<&ResultSet> {
        match requested {
            Some(key) => self.sets.iter().rev().find(|set| set.key.starts_with(key)),
            None => self.sets.iter().max_by_key(|set| (set.results, set.last)),
        }
    }

    /// Returns a warning if a flight has results of several inputs.
    pub fn mixed_inputs_warning(&self, flight: &str, requested: Option<&str>) -> Option<String> {
        let chosen = self.choose_set(requested)?;
        let [_, _, ..] = self.sets.as_slice() else {
            return None;
        };
        let all: Vec<String> = self.sets.iter().map(ResultSet::description).collect();
        let missing = match self.frames - chosen.results.min(self.frames) {
            0 => String::new(),
            n => format!(
                "; {n} frames have only results of other inputs and are shown without a result"
            ),
        };
        Some(format!(
            "{flight}: {} frames have results of {} inputs, {}; figures are from {} only{missing}",
            self.frames,
            self.sets.len(),
            all.join(", "),
            chosen.short_key()
        ))
    }
}

/// Groups the results of a flight into sets. Reads the beginning of every result.
pub fn flight_result_sets(disk: &dyn Disk, flight: &FlightRef) -> StoreResult<ResultSets> {
    let mut gather = ResultGrouper::default();
    for series in catalogue::list_series(disk, flight)? {
        gather.add_series(disk, &series, &[], |_| ())?;
    }
    Ok(gather.finish())
}

/// Beginning of a result in a series' `results.jsonl`.
pub struct ResultHead {
    /// File name of the frame.
    pub frame: String,
    /// Number of its set, [`ResultSet::index`].
    pub set: usize,
    /// Selected fields of the record.
    pub record: Map<String, Value>,
    /// Bytes of the line in the file.
    pub place: Range<u64>,
}

/// Groups results into sets, series by series.
#[derive(Default)]
pub struct ResultGrouper {
    frames: usize,
    sets: Vec<ResultSet>,
}

impl ResultGrouper {
    /// Reads the beginning of each result of a series, with the given `fields` of its record, and adds it to its set;
    /// returns what `make` makes of each, in the order written.
    pub fn add_series<T>(
        &mut self,
        disk: &dyn Disk,
        series: &SeriesRef,
        fields: &[&str],
        mut make: impl FnMut(ResultHead) -> T,
    ) -> StoreResult<Vec<T>> {
        let (mut made, mut sets, mut frames) = (Vec::new(), Vec::new(), BTreeSet::new());
        catalogue::for_each_line(
            disk,
            &series.folder.join(layout::RESULTS_FILE),
            |place, line| {
                let Some(head) = result_summary::parse_summary(line, fields) else {
                    return;
                };
                let set = self.find_or_add_set(&head.provenance);
                sets.push(set);
                frames.insert(head.frame.clone());
                made.push(make(ResultHead {
                    frame: head.frame,
                    set,
                    record: head.record,
                    place,
                }));
            },
        )?;
        self.count_results(&series.id, &sets, frames.len());
        Ok(made)
    }

    /// Counts the results of a series, by their sets in the order written.
    fn count_results(&mut self, series: &str, sets: &[usize], frames: usize) {
        let number = layout::series_number(series).unwrap_or(0);
        let mut order: Vec<usize> = Vec::new();
        for index in sets {
            order.retain(|known| known != index);
            order.push(*index);
        }
        for (rank, index) in order.into_iter().enumerate() {
            if let Some(set) = self.sets.get_mut(index) {
                set.last = set.last.max((rank, number));
                set.results += sets.iter().filter(|one| **one == index).count();
            }
        }
        self.frames += frames;
    }

    fn find_or_add_set(&mut self, provenance: &Map<String, Value>) -> usize {
        if let Some(known) = self
            .sets
            .iter()
            .position(|set| set.provenance == *provenance)
        {
            return known;
        }
        let key = Inputs::new(provenance.clone()).key("");
        let index = self.sets.len();
        self.sets.push(ResultSet {
            key,
            provenance: provenance.clone(),
            results: 0,
            last: (0, 0),
            index,
        });
        index
    }

    /// Returns the sets.
    pub fn finish(mut self) -> ResultSets {
        self.sets.sort_by_key(|set| set.last);
        ResultSets {
            frames: self.frames,
            sets: self.sets,
        }
    }
}

/// Reads the results of a series that belong to a set, in the order of frames; the latest of every frame if no set is
/// given. Each is converted by `make` as it is read, so that only the converted results are in memory.
pub fn results_in_set<T>(
    disk: &dyn Disk,
    series: &SeriesRef,
    set: Option<&ResultSet>,
    mut make: impl FnMut(ResultLine) -> Option<T>,
) -> StoreResult<Vec<T>> {
    let mut latest = BTreeMap::new();
    catalogue::for_each_line(
        disk,
        &series.folder.join(layout::RESULTS_FILE),
        |_, line| {
            let line = serde_json::from_slice::<ResultLine>(line).ok();
            if let Some(line) =
                line.filter(|line| set.is_none_or(|set| line.provenance == set.provenance))
            {
                latest.insert(line.frame.clone(), make(line));
            }
        },
    )?;
    Ok(latest.into_values().flatten().collect())
}

/// Returns a warning for every flight of a store with results of several inputs.
pub fn mixed_inputs_warnings(disk: &dyn Disk, root: &Path) -> Vec<String> {
    let flights = catalogue::list_flights(disk, root).unwrap_or_default();
    let warning_for = |flight: &FlightRef| {
        flight_result_sets(disk, flight)
            .ok()?
            .mixed_inputs_warning(&flight.id, None)
    };
    flights.iter().filter_map(warning_for).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sets(series: &[&[(u32, &str)]]) -> ResultSets {
        let mut gather = ResultGrouper::default();
        for (number, lines) in series.iter().enumerate() {
            let provenance =
                |program: &str| Map::from_iter([("program".to_owned(), Value::from(program))]);
            let sets: Vec<usize> = lines
                .iter()
                .map(|(_, program)| gather.find_or_add_set(&provenance(program)))
                .collect();
            let frames: BTreeSet<u32> = lines.iter().map(|(frame, _)| *frame).collect();
            gather.count_results(&layout::series_id(number as u64 + 1), &sets, frames.len());
        }
        gather.finish()
    }

    fn chosen(sets: &ResultSets) -> &str {
        sets.choose_set(None).unwrap().provenance["program"]
            .as_str()
            .unwrap()
    }

    #[test]
    fn a_complete_newer_set_is_shown_and_an_incomplete_one_is_not() {
        let whole = sets(&[
            &[(1, "a"), (2, "a"), (1, "b"), (2, "b")],
            &[(1, "a"), (1, "b")],
        ]);
        assert_eq!((chosen(&whole), whole.frames), ("b", 3));
        let incomplete = sets(&[&[(1, "a"), (2, "a"), (1, "b"), (2, "b")], &[(1, "a")]]);
        assert_eq!(chosen(&incomplete), "a");
        assert!(
            incomplete
                .mixed_inputs_warning("f0001", None)
                .unwrap()
                .contains("results of 2 inputs")
        );
    }

    #[test]
    fn a_single_set_gives_no_warning_and_separate_sets_do() {
        assert_eq!(
            sets(&[&[(1, "a")], &[(1, "a")]]).mixed_inputs_warning("f0001", None),
            None
        );
        assert_eq!(sets(&[]).mixed_inputs_warning("f0001", None), None);
        let separate = sets(&[&[(1, "a")], &[(1, "b")]]);
        assert_eq!(chosen(&separate), "b", "the newer series");
        let warning = separate.mixed_inputs_warning("f0001", None).unwrap();
        assert!(
            warning.contains("1 frames have only results of other inputs"),
            "{warning}"
        );
        let key = separate
            .sets
            .iter()
            .find(|s| s.provenance["program"] == "a")
            .unwrap()
            .short_key()
            .to_owned();
        assert_eq!(
            separate.choose_set(Some(&key)).unwrap().provenance["program"],
            "a"
        );
    }
}
