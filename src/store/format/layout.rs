//! Names and places in a store.

use std::path::{Path, PathBuf};

/// Of a new store. Format 1, without chains and sums, is read and written too (`wingd verify --upgrade`).
pub const FORMAT: u32 = 2;
/// Of a store without evidence.
pub const FORMAT_WITHOUT_EVIDENCE: u32 = 1;
/// Of `series.json`.
pub const SERIES_FORMAT: u32 = 1;

/// The mark of a store, with its format.
pub const STORE_FILE: &str = "store.toml";
/// The next ids.
pub const COUNTER_FILE: &str = "counter.json";
/// Held by the one writer.
pub const LOCK_FILE: &str = "lock";
/// One line per refused series.
pub const REFUSED_FILE: &str = "refused.jsonl";
/// The frame being solved.
pub const SOLVING_FILE: &str = "solving.json";
/// A series being taken.
pub const INCOMING: &str = "incoming";
/// What results were computed from, by digest.
pub const INSTALLATIONS: &str = "installations";
/// In a flight: one line per closed series and per result, each with the digest of the line before.
pub const CHAIN_FILE: &str = "chain.jsonl";
/// In a flight: every file's digest, for `sha256sum -c`.
pub const SUMS_FILE: &str = "SHA256SUMS";
/// The result that is about to be appended.
pub const PENDING_FILE: &str = "pending.json";
/// Lines of the aircraft's data that are being recorded.
pub const AIRCRAFT_FILE: &str = "aircraft.jsonl";
/// Live results that are being recorded.
pub const LIVE_FILE: &str = "live.rows";
/// Markers that are being marked by hand.
pub const MARKS_FILE: &str = "marks.jsonl";
/// Flights being received, file by file.
pub const FETCHING: &str = "fetching";
/// Flights being deleted.
pub const PRUNED: &str = "pruned";
/// One line per deleted flight.
pub const PRUNED_FILE: &str = "pruned.jsonl";
/// Finished series, by flight.
pub const FLIGHTS: &str = "flights";
/// Half frames and torn lines; listed, never deleted.
pub const PARTIAL: &str = "partial";
/// In a flight: when and why it began.
pub const FLIGHT_FILE: &str = "flight.json";
/// In a finished series: its manifest.
pub const SERIES_FILE: &str = "series.json";
/// In an incoming series: one line per shot.
pub const JOURNAL_FILE: &str = "journal.jsonl";
/// In a finished series: one line per frame and inputs.
pub const RESULTS_FILE: &str = "results.jsonl";
/// Ending of a file that is being written.
pub const PART_ENDING: &str = ".part";

/// Name of a flight.
pub fn flight_id(number: u64) -> String {
    format!("f{number:04}")
}

/// Name of a series; unique in the store.
pub fn series_id(number: u64) -> String {
    format!("s{number:06}")
}

/// The number in a flight's name.
pub fn flight_number(id: &str) -> Option<u64> {
    numbered(id, "f", "", flight_id)
}

/// The number in a series' name.
pub fn series_number(id: &str) -> Option<u64> {
    numbered(id, "s", "", series_id)
}

/// The number between beginning and end of a name that is written just so.
fn numbered(name: &str, begin: &str, end: &str, write: fn(u64) -> String) -> Option<u64> {
    let number = name.strip_prefix(begin)?.strip_suffix(end)?.parse().ok();
    number.filter(|number| write(*number) == name)
}

/// File name of a shot's frame. The ending is cut to what is safe in a file name.
pub fn frame_name(shot: u32, extension: &str) -> String {
    let clean: String = extension.chars().filter(char::is_ascii_alphanumeric).take(8).collect();
    let ending = if clean.is_empty() { "bin".to_owned() } else { clean.to_ascii_lowercase() };
    format!("{shot:04}.{ending}")
}

/// Whether a name is one that [`frame_name`] can give; keeps names read from files from leaving the folder.
pub fn is_frame_name(name: &str) -> bool {
    name.split_once('.').is_some_and(|(number, ending)| {
        number.parse().is_ok_and(|shot: u32| frame_name(shot, ending) == name)
    })
}

/// Whether a name belongs into a store's root (`lost+found` is the file system's).
pub fn is_root_name(name: &str) -> bool {
    let ours = [
        STORE_FILE,
        COUNTER_FILE,
        LOCK_FILE,
        REFUSED_FILE,
        SOLVING_FILE,
        PENDING_FILE,
        INCOMING,
        FLIGHTS,
        PARTIAL,
        INSTALLATIONS,
        FETCHING,
        PRUNED,
        PRUNED_FILE,
        AIRCRAFT_FILE,
        LIVE_FILE,
        MARKS_FILE,
    ];
    name == "lost+found" || ours.contains(&name.strip_suffix(PART_ENDING).unwrap_or(name))
}

/// Whether a name is that of a file of a flight, or of one that is being written anew.
pub fn is_flight_file(name: &str) -> bool {
    let whole = name.strip_suffix(PART_ENDING);
    let known = [CHAIN_FILE, SUMS_FILE].contains(&whole.unwrap_or(name));
    name == FLIGHT_FILE
        || known
        || aircraft_number(name).or(live_number(name)).or(marks_number(name)).is_some()
}

/// Name of a flight's file with lines of the aircraft's data.
pub fn aircraft_name(number: u64) -> String {
    format!("aircraft-{number:06}.jsonl")
}

/// The number in such a name.
pub fn aircraft_number(name: &str) -> Option<u64> {
    numbered(name, "aircraft-", ".jsonl", aircraft_name)
}

/// Name of a flight's file with live results.
pub fn live_name(number: u64) -> String {
    format!("live-{number:06}.rows")
}

/// The number in such a name.
pub fn live_number(name: &str) -> Option<u64> {
    numbered(name, "live-", ".rows", live_name)
}

/// Name of a flight's file with markers marked by hand.
pub fn marks_name(number: u64) -> String {
    format!("marks-{number:06}.jsonl")
}

/// The number in such a name.
pub fn marks_number(name: &str) -> Option<u64> {
    numbered(name, "marks-", ".jsonl", marks_name)
}

/// `flights/<flight>`.
pub fn flight(root: &Path, flight: &str) -> PathBuf {
    root.join(FLIGHTS).join(flight)
}

/// `incoming/<series>`.
pub fn incoming(root: &Path, series: &str) -> PathBuf {
    root.join(INCOMING).join(series)
}

/// `flights/<flight>/<series>`.
pub fn finished(root: &Path, flight: &str, series: &str) -> PathBuf {
    self::flight(root, flight).join(series)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn ids_and_frame_names_round_trip_and_nothing_else_passes() {
        assert_eq!(series_number(&series_id(12_345_678)), Some(12_345_678));
        assert_eq!(flight_number("f0001"), Some(1));
        for bad in ["f1", "s1", "f00001", "s+00001", "..", "s-00001", "", "x0001"] {
            assert_eq!(flight_number(bad).or(series_number(bad)), None, "{bad}");
        }
        assert_eq!(aircraft_number(&aircraft_name(12)), Some(12));
        assert_eq!(live_number(&live_name(12)), Some(12));
        assert_eq!(marks_number(&marks_name(12)), Some(12));
        for bad in ["aircraft-1.jsonl", "aircraft-000001.json", "live-1.rows", "live.rows"] {
            assert_eq!(aircraft_number(bad).or(live_number(bad)), None, "{bad}");
        }
        assert!(is_frame_name(&frame_name(3, "JPG")));
        for bad in ["../0001.jpg", "0001", "0001.jpg.part", "1.jpg", "series.json", "0001./x"] {
            assert!(!is_frame_name(bad), "{bad}");
        }
    }
}
