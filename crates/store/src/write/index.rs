//! State of an open store in memory.

use std::collections::{BTreeSet, HashSet};

use super::results::OpenResults;
use crate::format::manifest::Counter;
use wingd_base::clock::Stamp;

/// State of an open store, rebuilt by scanning.
#[derive(Default)]
pub(crate) struct StoreIndex {
    /// Next ids.
    pub counter: Counter,
    /// Newest flight.
    pub flight: Option<String>,
    /// Last time recorded in the newest flight.
    pub last_moment: Option<Stamp>,
    pub new_flight_requested: bool,
    /// Series without frames to solve, each with the key of the inputs.
    pub solved_series: HashSet<(String, String)>,
    /// Results of the series that was solved last.
    pub results: OpenResults,
    /// Installations in the chains, by flight and digest.
    pub installations: HashSet<(String, String)>,
    /// Flights whose SHA256SUMS are behind their chains.
    pub unsealed: BTreeSet<String>,
    /// Remarks of recoveries that were reported.
    pub reported: BTreeSet<String>,
}

impl StoreIndex {
    /// Creates an index with the next ids and the last flight.
    pub fn new(counter: Counter, flight: Option<String>, last: Option<Stamp>) -> Self {
        Self {
            counter,
            flight,
            last_moment: last,
            ..Self::default()
        }
    }

    /// Records the time of an event; an earlier time of the same boot changes nothing.
    pub fn note_moment(&mut self, now: &Stamp) {
        let last = self
            .last_moment
            .as_ref()
            .filter(|last| last.boot_id == now.boot_id);
        if last.is_none_or(|last| last.since_boot_s <= now.since_boot_s) {
            self.last_moment = Some(now.clone());
        }
    }
}
