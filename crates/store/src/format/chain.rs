//! Digest chain of a flight, `chain.jsonl`: one line for each event that was made durable, with the digest of the line
//! before, so that a changed, missing or inserted line is detected.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::{jsonl, sha256_hex};

/// Digest in the `before` field of the first line.
pub const ZERO_DIGEST: &str = "0000000000000000000000000000000000000000000000000000000000000000";

/// Line of a chain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChainLine {
    /// SHA-256 of the line before without its newline, hex; zeros in the first line.
    pub before: String,
    #[serde(flatten)]
    pub event: ChainEvent,
}

/// Event that was made durable.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ChainEvent {
    /// The flight began; always the first line.
    Flight {
        /// Id of the store.
        store: String,
        flight: String,
        /// SHA-256 of `flight.json`, hex.
        sha256: String,
    },
    /// A series was closed; its manifest has the digests of its frames.
    Series {
        series: String,
        /// SHA-256 of `series.json`, hex.
        sha256: String,
    },
    /// Results were appended.
    Results(AppendedResults),
    /// A file with aircraft data was closed.
    Aircraft(ClosedFile),
    /// A file with live results was closed.
    Live(ClosedFile),
    /// A file with manual marks was closed.
    Marks(ClosedFile),
    /// An installation was stored in `installations/`; results from here on may come from it.
    Installation {
        /// Digest of the installation and name of its folder, hex.
        sha256: String,
    },
    /// The lines before this one were signed.
    Signature {
        /// Public key, Ed25519, hex.
        key: String,
        /// Signature of `wingd chain ` and the `before` field of this line, hex.
        signature: String,
    },
}

/// Length and digest of a series' `results.jsonl` after results were appended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AppendedResults {
    pub series: String,
    /// Length, bytes.
    pub bytes: u64,
    /// SHA-256 of that many bytes, hex.
    pub sha256: String,
}

/// Append-only file of a flight that was closed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClosedFile {
    /// Name of the file.
    pub file: String,
    /// Length, bytes.
    pub bytes: u64,
    /// SHA-256 of the file, hex.
    pub sha256: String,
}

/// Parsed chain.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chain {
    /// Events, each with the end of its line, bytes from the beginning.
    pub events: Vec<(usize, ChainEvent)>,
    /// Broken links, one sentence each.
    pub faults: Vec<String>,
    /// Length of the complete lines, bytes.
    pub good_length: usize,
}

impl Chain {
    /// Parses a chain; never fails.
    pub fn parse(bytes: &[u8]) -> Self {
        let lines = jsonl::parse_lines::<ChainLine>(bytes);
        let mut chain = Self {
            good_length: lines.good_length,
            ..Self::default()
        };
        chain
            .faults
            .extend(lines.damaged.iter().map(|n| format!("line {n} is damaged")));
        let mut before = ZERO_DIGEST.to_owned();
        let mut good = lines.good.into_iter().peekable();
        let mut end = 0;
        for (index, line) in bytes.split_inclusive(|byte| *byte == b'\n').enumerate() {
            end += line.len();
            if let Some((number, link)) = good.next_if(|(number, _)| *number == index + 1) {
                if link.before != before {
                    chain.faults.push(format!(
                        "line {number} does not follow from the line before it"
                    ));
                }
                chain.events.push((end, link.event));
            }
            before = line_digest(line);
        }
        if !matches!(chain.events.first(), Some((_, ChainEvent::Flight { .. }))) {
            chain
                .faults
                .push("does not begin with its flight".to_owned());
        }
        chain
    }

    /// Returns the id of the store that the chain belongs to.
    pub fn store_id(&self) -> Option<String> {
        self.state_at(usize::MAX)
            .flight
            .map(|(store, ..)| store)
            .filter(|id| !id.is_empty())
    }

    /// Returns the state after the lines that end at or before byte `end`.
    pub fn state_at(&self, end: usize) -> ChainState {
        let mut state = ChainState::default();
        for (_, event) in self.events.iter().take_while(|(at, _)| *at <= end) {
            state.apply_event(event.clone());
        }
        state
    }
}

/// State of a flight according to its chain.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ChainState {
    /// Store id, flight, SHA-256 of `flight.json`.
    pub flight: Option<(String, String, String)>,
    /// SHA-256 of `series.json`, by series.
    pub series: BTreeMap<String, String>,
    /// Lengths and SHA-256 of `results.jsonl` in the order written, by series.
    pub results: BTreeMap<String, Vec<(u64, String)>>,
    /// Length and SHA-256 of the closed append-only files, by name.
    pub files: BTreeMap<String, (u64, String)>,
    /// SHA-256 of installations.
    pub installations: BTreeSet<String>,
}

impl ChainState {
    fn apply_event(&mut self, event: ChainEvent) {
        match event {
            ChainEvent::Flight {
                store,
                flight,
                sha256,
            } => self.flight = Some((store, flight, sha256)),
            ChainEvent::Series { series, sha256 } => drop(self.series.insert(series, sha256)),
            ChainEvent::Results(AppendedResults {
                series,
                bytes,
                sha256,
            }) => {
                self.results
                    .entry(series)
                    .or_default()
                    .push((bytes, sha256));
            }
            ChainEvent::Aircraft(closed) | ChainEvent::Live(closed) | ChainEvent::Marks(closed) => {
                self.files
                    .insert(closed.file, (closed.bytes, closed.sha256));
            }
            ChainEvent::Installation { sha256 } => drop(self.installations.insert(sha256)),
            ChainEvent::Signature { .. } => {}
        }
    }
}

/// Computes the digest that the next line has in its `before` field.
pub(crate) fn line_digest(line: &[u8]) -> String {
    sha256_hex(line.strip_suffix(b"\n").unwrap_or(line))
}

/// Encodes events as the lines of a new chain.
pub(crate) fn encode_chain(
    events: impl IntoIterator<Item = ChainEvent>,
) -> std::io::Result<Vec<u8>> {
    let (mut bytes, mut before) = (Vec::new(), ZERO_DIGEST.to_owned());
    for event in events {
        let line = jsonl::encode_line(&ChainLine { before, event })?;
        before = line_digest(&line);
        bytes.extend(line);
    }
    Ok(bytes)
}

/// Returns the bytes without a torn end: one torn line, or several if a block shows stale data.
pub(crate) fn trim_torn_tail(bytes: &[u8]) -> &[u8] {
    let mut good = bytes;
    while let Some(last) = last_line(good) {
        if last.ends_with(b"\n") && serde_json::from_slice::<ChainLine>(last).is_ok() {
            break;
        }
        good = good.get(..good.len() - last.len()).unwrap_or_default();
    }
    good
}

/// Returns the last line, with its newline if there is one.
pub(crate) fn last_line(bytes: &[u8]) -> Option<&[u8]> {
    bytes.split_inclusive(|byte| *byte == b'\n').next_back()
}

/// Returns the chain's last entry for the results of a series; `None` if there is none. Reads from the end, because results are
/// mostly added to the newest series.
pub(crate) fn last_results_entry(bytes: &[u8], series_name: &str) -> Option<AppendedResults> {
    for line in bytes.split_inclusive(|byte| *byte == b'\n').rev() {
        match serde_json::from_slice::<ChainLine>(line)
            .ok()
            .map(|link| link.event)
        {
            Some(ChainEvent::Results(results)) if results.series == series_name => {
                return Some(results);
            }
            Some(ChainEvent::Series { series, .. }) if series == series_name => return None,
            _ => {}
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn three() -> Vec<u8> {
        let series = |n: u32| ChainEvent::Series {
            series: format!("s{n:06}"),
            sha256: sha256_hex(&[n as u8]),
        };
        let flight = ChainEvent::Flight {
            store: "a".into(),
            flight: "f0001".into(),
            sha256: "b".into(),
        };
        encode_chain([flight, series(1), series(2)]).unwrap()
    }

    #[test]
    fn a_sound_chain_has_no_fault_and_a_torn_tail_is_none() {
        let mut bytes = three();
        let length = bytes.len();
        bytes.extend(b"{\"before\":\"00");
        let chain = Chain::parse(&bytes);
        assert_eq!(
            (chain.faults, chain.events.len(), chain.good_length),
            (vec![], 3, length)
        );
        assert_eq!(trim_torn_tail(&bytes).len(), length);
    }

    #[test]
    fn a_changed_missing_or_inserted_line_is_detected() {
        let text = String::from_utf8(three()).unwrap();
        let lines: Vec<&str> = text.split_inclusive('\n').collect();
        let changed = text.replacen("s000001", "s000009", 1);
        let missing = [lines[0], lines[2]].concat();
        let repeated = [lines[0], lines[1], lines[1], lines[2]].concat();
        let headless = [lines[1], lines[2]].concat();
        for broken in [changed, missing, repeated, headless] {
            assert!(
                !Chain::parse(broken.as_bytes()).faults.is_empty(),
                "{broken}"
            );
        }
    }
}
