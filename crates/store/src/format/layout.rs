//! File and folder names of a store.

use std::path::{Path, PathBuf};

/// Format of a new store. Format 1, without chains and sums, is also read and written.
pub const FORMAT: u32 = 2;
/// Format of a store without evidence (chains and sums).
pub const FORMAT_WITHOUT_EVIDENCE: u32 = 1;
/// Format of `series.json`.
pub const SERIES_FORMAT: u32 = 1;

/// Format file: identifies a directory as a store and holds its format and id.
pub const STORE_FILE: &str = "store.toml";
/// Next ids of flights and series.
pub const COUNTER_FILE: &str = "counter.json";
/// Lock file, held by the only writer.
pub const LOCK_FILE: &str = "lock";
/// Log of refused series, one per line.
pub const REFUSED_FILE: &str = "refused.jsonl";
/// Frame being solved.
pub const SOLVING_FILE: &str = "solving.json";
/// Folder of series being recorded.
pub const INCOMING: &str = "incoming";
/// Folder of the installations that results were computed from, by digest.
pub const INSTALLATIONS: &str = "installations";
/// Digest chain of a flight: one line per closed series and per result, each with the digest of the line before.
pub const CHAIN_FILE: &str = "chain.jsonl";
/// Digests of all files of a flight, for `sha256sum -c`.
pub const SUMS_FILE: &str = "SHA256SUMS";
/// Result about to be appended.
pub const PENDING_FILE: &str = "pending.json";
/// Aircraft data being recorded.
pub const AIRCRAFT_FILE: &str = "aircraft.jsonl";
/// Live results being recorded.
pub const LIVE_FILE: &str = "live.rows";
/// Manual marks being recorded.
pub const MARKS_FILE: &str = "marks.jsonl";
/// Folder of flights being received, file by file.
pub const FETCHING: &str = "fetching";
/// Folder of flights being deleted.
pub const PRUNED: &str = "pruned";
/// Log of deleted flights, one per line.
pub const PRUNED_FILE: &str = "pruned.jsonl";
/// Folder of the flights with their finished series.
pub const FLIGHTS: &str = "flights";
/// Folder of incomplete frames and torn lines; listed, never deleted.
pub const PARTIAL: &str = "partial";
/// Manifest of a flight: time and reason of its beginning.
pub const FLIGHT_FILE: &str = "flight.json";
/// Manifest of a finished series.
pub const SERIES_FILE: &str = "series.json";
/// Journal of a series being recorded, one shot per line.
pub const JOURNAL_FILE: &str = "journal.jsonl";
/// Results of a finished series, one line per frame and inputs.
pub const RESULTS_FILE: &str = "results.jsonl";
/// Ending of a file that is being written.
pub const PART_ENDING: &str = ".part";

/// Largest number in a name, far above any that a recorder reaches; a larger one is no name of the store.
pub const MAX_NUMBER: u64 = 999_999_999;

/// Defines two functions for each kind of numbered name: the name of a number, and the number in a name.
macro_rules! numbered_names {
    ($($what:literal: $name:ident, $number:ident = $begin:literal, $digits:literal, $end:literal;)+) => {$(
        #[doc = concat!("Returns the name of ", $what, ".")]
        pub fn $name(number: u64) -> String {
            format!(concat!($begin, "{:0", $digits, "}", $end), number)
        }

        #[doc = concat!("Parses the number in the name of ", $what, "; `None` if [`", stringify!($name), "`] does not make it.")]
        pub fn $number(name: &str) -> Option<u64> {
            let number = name.strip_prefix($begin)?.strip_suffix($end)?.parse().ok();
            number.filter(|number| *number <= MAX_NUMBER && $name(*number) == name)
        }
    )+};
}

numbered_names! {
    "a flight": flight_id, flight_number = "f", 4, "";
    "a series, which is unique in the store": series_id, series_number = "s", 6, "";
    "a closed file with aircraft data": aircraft_name, aircraft_number = "aircraft-", 6, ".jsonl";
    "a closed file with live results": live_name, live_number = "live-", 6, ".rows";
    "a closed file with manual marks": marks_name, marks_number = "marks-", 6, ".jsonl";
}

/// Returns the file name of a shot's frame. Only characters that are safe in a file name are kept of the extension.
pub fn frame_name(shot: u32, extension: &str) -> String {
    let clean: String = extension
        .chars()
        .filter(char::is_ascii_alphanumeric)
        .take(8)
        .collect();
    let ending = if clean.is_empty() {
        "bin".to_owned()
    } else {
        clean.to_ascii_lowercase()
    };
    format!("{shot:04}.{ending}")
}

/// Returns whether [`frame_name`] can produce the name; prevents names read from files from escaping the folder.
pub fn is_frame_name(name: &str) -> bool {
    name.split_once('.').is_some_and(|(number, ending)| {
        number
            .parse()
            .is_ok_and(|shot: u32| frame_name(shot, ending) == name)
    })
}

/// Returns whether a name belongs in the root of a store (`lost+found` belongs to the file system).
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

/// Returns whether a name is that of a flight's file, or of its replacement while being written.
pub fn is_flight_file(name: &str) -> bool {
    let whole = name.strip_suffix(PART_ENDING);
    let known = [CHAIN_FILE, SUMS_FILE].contains(&whole.unwrap_or(name));
    name == FLIGHT_FILE
        || known
        || aircraft_number(name)
            .or(live_number(name))
            .or(marks_number(name))
            .is_some()
}

/// Returns the path `flights/<flight>`.
pub fn flight_folder(root: &Path, flight: &str) -> PathBuf {
    root.join(FLIGHTS).join(flight)
}

/// Returns the path `incoming/<series>`.
pub fn incoming_folder(root: &Path, series: &str) -> PathBuf {
    root.join(INCOMING).join(series)
}

/// Returns the path `flights/<flight>/<series>`.
pub fn series_folder(root: &Path, flight: &str, series: &str) -> PathBuf {
    self::flight_folder(root, flight).join(series)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_and_frame_names_round_trip_and_other_names_are_rejected() {
        assert_eq!(series_number(&series_id(12_345_678)), Some(12_345_678));
        assert_eq!(flight_number("f0001"), Some(1));
        for bad in [
            "f18446744073709551615",
            "f1",
            "s1",
            "f00001",
            "s+00001",
            "..",
            "s-00001",
            "",
            "x0001",
        ] {
            assert_eq!(flight_number(bad).or(series_number(bad)), None, "{bad}");
        }
        assert_eq!(aircraft_number(&aircraft_name(12)), Some(12));
        assert_eq!(live_number(&live_name(12)), Some(12));
        assert_eq!(marks_number(&marks_name(12)), Some(12));
        for bad in [
            "aircraft-1.jsonl",
            "aircraft-000001.json",
            "live-1.rows",
            "live.rows",
        ] {
            assert_eq!(aircraft_number(bad).or(live_number(bad)), None, "{bad}");
        }
        assert!(is_frame_name(&frame_name(3, "JPG")));
        for bad in [
            "../0001.jpg",
            "0001",
            "0001.jpg.part",
            "1.jpg",
            "series.json",
            "0001./x",
        ] {
            assert!(!is_frame_name(bad), "{bad}");
        }
    }
}
