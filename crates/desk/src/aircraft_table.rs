//! Import of a table of aircraft data into a flight: stored only if at least one frame gets a value.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::json;

use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;
use wingd_base::failure::TaskResult;
use wingd_evaluation::aircraft::{
    AircraftTable, AircraftTrack, ColumnTally, MAX_NEAREST_S, Quantity, TableContents, format_time,
};
use wingd_evaluation::installation;
use wingd_evaluation::results::aircraft as joined;
use wingd_store::aircraft::AircraftLine;
use wingd_store::{FlightRef, RealDisk, Store, StoreResult};

/// Number of lines written durably at once.
const LINES_PER_WRITE: usize = 5000;

/// Number of frames that use a source, by source number and quantity.
pub type FrameCounts = BTreeMap<(usize, Quantity), usize>;

/// Counts the frames that use each source for each quantity.
pub fn count_frames_by_source(
    track: &AircraftTrack,
    frames: &[(Stamp, Option<Exposure>)],
) -> FrameCounts {
    let mut counts = BTreeMap::new();
    for (stamp, exposure) in frames {
        for (quantity, joined) in track.state_at(stamp, exposure.as_ref()) {
            *counts.entry((joined.source, quantity)).or_default() += 1;
        }
    }
    counts
}

/// A table and its effect on the flight.
pub struct TableImport {
    pub table: AircraftTable,
    pub contents: TableContents,
    /// Number of the table among the flight's sources.
    pub source: usize,
    /// Number of lines that repeat the time of an earlier one.
    pub repeated: usize,
    /// Number of frames of the flight.
    pub frames: usize,
    /// Quantities of the header's columns, or those of IWG1 that reach a frame.
    pub quantities: Vec<QuantityFrames>,
    /// Reason why no frame gets a value; `None` if at least one does.
    pub no_value_because: Option<String>,
}

/// Number of frames for which a quantity comes from the table.
pub struct QuantityFrames {
    pub tally: ColumnTally,
    pub frames: usize,
}

impl TableImport {
    /// Reads a table and joins it with the frames of the flight.
    ///
    /// # Errors
    /// Returns the errors of the table with file and remedy, or an error of the store.
    pub fn read(root: &Path, flight: &FlightRef, file: &Path) -> TaskResult<Self> {
        let table = AircraftTable::read(file)?;
        let source = joined::read_sources(&RealDisk, root, flight)?.0.len() + 1;
        let (mut track, _) = joined::read_track(&RealDisk, root, flight)?;
        let frames = joined::read_frame_times(&RealDisk, flight)?;
        let known_repeated = track.unused.repeated;
        track.begin_source(source);
        track.add_lines(&table.layout, &aircraft_lines(&table));
        let counts = count_frames_by_source(&track, &frames);
        let contents = table.contents();
        let reached = |tally: &ColumnTally| QuantityFrames {
            tally: tally.clone(),
            frames: counts.get(&(source, tally.quantity)).copied().unwrap_or(0),
        };
        let mut quantities = Vec::from_iter(contents.tallies.iter().map(reached));
        quantities.sort_by_key(|reached| reached.tally.quantity);
        quantities.retain(|r| r.frames > 0 || table.layout.begins_with.is_none());
        let is_used = quantities.iter().any(|reached| reached.frames > 0);
        let utc =
            |(stamp, exposure): &(Stamp, Option<Exposure>)| track.time_s(stamp, exposure.as_ref());
        let frames_s = Vec::from_iter(frames.iter().filter_map(utc));
        let reason = (!is_used).then(|| explain_no_value(&table, &contents, &frames_s));
        Ok(Self {
            table,
            contents,
            source,
            repeated: track.unused.repeated - known_repeated,
            frames: frames.len(),
            quantities,
            no_value_because: reason,
        })
    }

    /// Adds the lines to the flight as a new source.
    pub fn store_lines(&self, store: &Store, flight: &FlightRef, file: &Path) -> StoreResult<()> {
        let name = file.file_name().map(installation::printable_path);
        let head = json!({"table": name, "number": self.source, "layout": self.table.layout});
        for chunk in aircraft_lines(&self.table).chunks(LINES_PER_WRITE) {
            store.add_aircraft_lines_to(&flight.id, &head, chunk)?;
        }
        store.close_aircraft_file()
    }

    /// Explains for each column without a value why it has none; IWG1 may leave its fields empty.
    pub fn empty_columns(&self) -> impl Iterator<Item = String> {
        let of_a_header = self.table.layout.begins_with.is_none();
        let tallies = self.contents.tallies.iter().filter(move |_| of_a_header);
        tallies.filter_map(ColumnTally::no_values_reason)
    }
}

/// Lines of a table as the store keeps them.
fn aircraft_lines(table: &AircraftTable) -> Vec<AircraftLine> {
    let line = |(_, line): &(u64, String)| AircraftLine {
        at: None,
        line: line.clone(),
    };
    table.lines.iter().map(line).collect()
}

/// Explains why no frame gets a value.
fn explain_no_value(table: &AircraftTable, contents: &TableContents, frames_s: &[f64]) -> String {
    let first = frames_s.iter().copied().reduce(f64::min);
    let last = frames_s.iter().copied().reduce(f64::max);
    let Some((first, last)) = first.zip(last) else {
        return "no frame of this flight has a UTC time: the clock was not synchronised and no data feed was recorded, or the \
                images were imported without --clock-sigma; import them with it and --zone into a new store"
            .into();
    };
    if table.lines.is_empty() {
        return "the table has no lines below its header".into();
    }
    // Cells are not evaluated in lines without a time.
    if let (0, Some((_, tag))) = (contents.timed, contents.unread.first()) {
        return format!(
            "its times (\"{tag}\") are not UTC; write them as 2026-06-01T07:59:50Z (`wingd-table` converts other formats)"
        );
    }
    let Some((from, to)) = contents.valued_s else {
        let reasons = contents
            .tallies
            .iter()
            .filter_map(ColumnTally::no_values_reason);
        return Vec::from_iter(reasons).join("; ");
    };
    let [from, to, first, last] = [from, to, first, last].map(format_time);
    format!(
        "no line with a value is within {MAX_NEAREST_S} s of a frame: its times are {from} to {to}, but the frames were taken \
         {first} to {last}; export more lines, convert local times with `wingd-table`, or name the table of this flight"
    )
}
