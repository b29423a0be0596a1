//! What an open store keeps in memory.

use std::collections::{BTreeSet, HashSet};

use crate::clock::Stamp;
use crate::store::format::manifest::Counter;

/// In memory only; rebuilt by scanning.
pub(crate) struct StoreIndex {
    /// The next ids.
    pub counter: Counter,
    /// The newest flight.
    pub flight: Option<String>,
    /// The last moment recorded in it.
    pub last_moment: Option<Stamp>,
    pub new_flight_requested: bool,
    /// Series without any frame to solve, by the inputs asked for.
    pub solved_series: HashSet<(String, String)>,
    /// Installations that the chains name, by flight and digest.
    pub installations: HashSet<(String, String)>,
    /// Flights whose SHA256SUMS are behind their chains.
    pub unsealed: BTreeSet<String>,
}

impl StoreIndex {
    pub fn new(counter: Counter, flight: Option<String>, last: Option<Stamp>) -> Self {
        let (settled, installations, unsealed) = (HashSet::new(), HashSet::new(), BTreeSet::new());
        Self { counter, flight, last_moment: last, new_flight_requested: false, solved_series: settled, installations, unsealed }
    }

    /// Something was recorded at a moment; the last one stays where it is later in the same boot.
    pub fn note_moment(&mut self, now: &Stamp) {
        let last = self.last_moment.as_ref().filter(|last| last.boot_id == now.boot_id);
        if last.is_none_or(|last| last.since_boot_s <= now.since_boot_s) {
            self.last_moment = Some(now.clone());
        }
    }
}
