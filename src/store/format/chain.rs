//! `chain.jsonl` of a flight: one line for each thing that was made durable, each with the digest of
//! the line before, so that a line that is changed, missing or put in shows.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::{jsonl, sha256};

/// `before` of the first line.
pub const BEGINNING: &str = "0000000000000000000000000000000000000000000000000000000000000000";

/// A line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Link {
    /// SHA-256 of the line before without its newline, hex; zeros in the first.
    pub before: String,
    /// What was made durable.
    #[serde(flatten)]
    pub event: Event,
}

/// What was made durable.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Event {
    /// The flight began; always the first line.
    Flight {
        /// The store's id.
        store: String,
        /// The flight's name.
        flight: String,
        /// Of `flight.json`.
        sha256: String,
    },
    /// A series was closed; its manifest holds the digests of its frames.
    Series {
        /// Its name.
        series: String,
        /// Of `series.json`.
        sha256: String,
    },
    /// Results were appended.
    Results(Appended),
    /// A file with lines of the aircraft's data was closed.
    Aircraft(ClosedFile),
    /// A file with live results was closed.
    Live(ClosedFile),
    /// A file with markers marked by hand was closed.
    Marks(ClosedFile),
    /// An installation that results from here on may come from lies in `installations/`.
    Installation {
        /// Its digest and folder's name.
        sha256: String,
    },
    /// All the lines before this one were signed.
    Signature {
        /// The public key, Ed25519, hex.
        key: String,
        /// Of `wingd chain ` and this line's `before`, hex.
        signature: String,
    },
}

/// What `results.jsonl` of a series is from here on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Appended {
    /// The series' name.
    pub series: String,
    /// Length.
    pub bytes: u64,
    /// Of those bytes.
    pub sha256: String,
}

/// A file of a flight that grows no more.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClosedFile {
    /// Its name.
    pub file: String,
    /// Its length.
    pub bytes: u64,
    /// Of it.
    pub sha256: String,
}

/// A chain that was read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chain {
    /// Each line's end, bytes from the beginning, and its event.
    pub events: Vec<(usize, Event)>,
    /// Broken links, one sentence each.
    pub faults: Vec<String>,
    /// Where the whole lines end.
    pub good_length: usize,
}

impl Chain {
    /// Reads a chain; never fails.
    pub fn parse(bytes: &[u8]) -> Self {
        let lines = jsonl::parse::<Link>(bytes);
        let mut chain = Self { good_length: lines.good_length, ..Self::default() };
        chain.faults.extend(lines.damaged.iter().map(|n| format!("line {n} is damaged")));
        let mut before = BEGINNING.to_owned();
        let mut good = lines.good.into_iter().peekable();
        let mut end = 0;
        for (index, line) in bytes.split_inclusive(|byte| *byte == b'\n').enumerate() {
            end += line.len();
            if let Some((number, link)) = good.next_if(|(number, _)| *number == index + 1) {
                if link.before != before {
                    chain.faults.push(format!("line {number} does not follow from the line before it"));
                }
                chain.events.push((end, link.event));
            }
            before = digest(line);
        }
        if !matches!(chain.events.first(), Some((_, Event::Flight { .. }))) {
            chain.faults.push("does not begin with its flight".to_owned());
        }
        chain
    }

    /// What the lines that end at or before `end` say.
    pub fn state(&self, end: usize) -> State {
        let mut state = State::default();
        for (_, event) in self.events.iter().take_while(|(at, _)| *at <= end) {
            state.add(event.clone());
        }
        state
    }
}

/// A flight as its chain has it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Store, flight, digest of `flight.json`.
    pub flight: Option<(String, String, String)>,
    /// Digest of `series.json` by series.
    pub series: BTreeMap<String, String>,
    /// Lengths and digests of `results.jsonl` in the order written, by series.
    pub results: BTreeMap<String, Vec<(u64, String)>>,
    /// Length and digest of the closed files with the aircraft's data, live results and marks by hand.
    pub files: BTreeMap<String, (u64, String)>,
    /// Digests of installations.
    pub installations: BTreeSet<String>,
}

impl State {
    fn add(&mut self, event: Event) {
        match event {
            Event::Flight { store, flight, sha256 } => self.flight = Some((store, flight, sha256)),
            Event::Series { series, sha256 } => drop(self.series.insert(series, sha256)),
            Event::Results(Appended { series, bytes, sha256 }) => {
                self.results.entry(series).or_default().push((bytes, sha256));
            }
            Event::Aircraft(closed) | Event::Live(closed) | Event::Marks(closed) => {
                self.files.insert(closed.file, (closed.bytes, closed.sha256));
            }
            Event::Installation { sha256 } => drop(self.installations.insert(sha256)),
            Event::Signature { .. } => {}
        }
    }
}

/// What the next line names as the one before.
pub(crate) fn digest(line: &[u8]) -> String {
    sha256(line.strip_suffix(b"\n").unwrap_or(line))
}

/// The lines of a new chain.
pub(crate) fn lines(events: impl IntoIterator<Item = Event>) -> std::io::Result<Vec<u8>> {
    let (mut bytes, mut before) = (Vec::new(), BEGINNING.to_owned());
    for event in events {
        let line = jsonl::line(&Link { before, event })?;
        before = digest(&line);
        bytes.extend(line);
    }
    Ok(bytes)
}

/// The bytes without a torn end: a torn line, or several where a block shows what was there before.
pub(crate) fn whole(bytes: &[u8]) -> &[u8] {
    let mut good = bytes;
    while let Some(last) = last_line(good) {
        if last.ends_with(b"\n") && serde_json::from_slice::<Link>(last).is_ok() {
            break;
        }
        good = good.get(..good.len() - last.len()).unwrap_or_default();
    }
    good
}

/// The last line, with its newline where it has one.
pub(crate) fn last_line(bytes: &[u8]) -> Option<&[u8]> {
    bytes.split_inclusive(|byte| *byte == b'\n').next_back()
}

/// A series' results by the chain; `None` where it has none. Read from the end, because results are mostly added to the
/// newest series.
pub(crate) fn last_results(bytes: &[u8], wanted: &str) -> Option<Appended> {
    for line in bytes.split_inclusive(|byte| *byte == b'\n').rev() {
        match serde_json::from_slice::<Link>(line).ok().map(|link| link.event) {
            Some(Event::Results(results)) if results.series == wanted => return Some(results),
            Some(Event::Series { series, .. }) if series == wanted => return None,
            _ => {}
        }
    }
    None
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    fn three() -> Vec<u8> {
        let series = |n: u32| Event::Series { series: format!("s{n:06}"), sha256: sha256(&[n as u8]) };
        let flight = Event::Flight { store: "a".into(), flight: "f0001".into(), sha256: "b".into() };
        lines([flight, series(1), series(2)]).unwrap()
    }

    #[test]
    fn a_sound_chain_has_no_fault_and_a_torn_tail_is_none() {
        let mut bytes = three();
        let length = bytes.len();
        bytes.extend(b"{\"before\":\"00");
        let chain = Chain::parse(&bytes);
        assert_eq!((chain.faults, chain.events.len(), chain.good_length), (vec![], 3, length));
        assert_eq!(whole(&bytes).len(), length);
    }

    #[test]
    fn a_line_that_is_changed_gone_or_put_in_shows() {
        let text = String::from_utf8(three()).unwrap();
        let lines: Vec<&str> = text.split_inclusive('\n').collect();
        let changed = text.replacen("s000001", "s000009", 1);
        let gone = [lines[0], lines[2]].concat();
        let twice = [lines[0], lines[1], lines[1], lines[2]].concat();
        let headless = [lines[1], lines[2]].concat();
        for broken in [changed, gone, twice, headless] {
            assert!(!Chain::parse(broken.as_bytes()).faults.is_empty(), "{broken}");
        }
    }
}
