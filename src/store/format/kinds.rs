//! Kinds of files of a flight that grow at their end and are then closed.

use super::chain::{ClosedFile, Event};
use super::{aircraft, columns, layout, marks};

/// A kind of such files.
#[derive(Debug)]
pub(crate) struct Kind {
    /// Name in the root.
    pub open: &'static str,
    /// In sentences.
    pub what: &'static str,
    /// Beginning of names below `partial/`.
    pub stem: &'static str,
    /// Names in a flight, by their number from 1.
    pub name: fn(u64) -> String,
    /// The number in such a name.
    pub number: fn(&str) -> Option<u64>,
    /// How many bytes are whole, and their flight; `None` where not even the first line is.
    pub whole: fn(&[u8]) -> Option<(usize, String)>,
    /// Its line in the chain.
    pub event: fn(ClosedFile) -> Event,
    /// Its invariant in docs/store.md.
    pub invariant: u8,
    /// Beyond this a file is closed and another one begun, bytes.
    pub longest: usize,
}

/// Lines of the aircraft's data.
pub(crate) const AIRCRAFT: Kind = Kind {
    open: layout::AIRCRAFT_FILE,
    what: "aircraft data",
    stem: "aircraft",
    name: layout::aircraft_name,
    number: layout::aircraft_number,
    whole: aircraft::whole,
    event: Event::Aircraft,
    invariant: 20,
    longest: 1 << 20,
};

/// Live results.
pub(crate) const LIVE: Kind = Kind {
    open: layout::LIVE_FILE,
    what: "live results",
    stem: "live",
    name: layout::live_name,
    number: layout::live_number,
    whole: columns::whole,
    event: Event::Live,
    invariant: 21,
    // Read as a whole, at the start after a power cut and by readers.
    longest: 8 << 20,
};

/// Markers marked by hand.
pub(crate) const MARKS: Kind = Kind {
    open: layout::MARKS_FILE,
    what: "marks by hand",
    stem: "marks",
    name: layout::marks_name,
    number: layout::marks_number,
    whole: marks::whole,
    event: Event::Marks,
    invariant: 22,
    longest: 1 << 20,
};

/// All of them.
pub(crate) const KINDS: [&Kind; 3] = [&AIRCRAFT, &LIVE, &MARKS];
