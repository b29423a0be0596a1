//! Import of a table of aircraft data into a flight: stored only if at least one frame gets a value.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::json;

use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;
use wingd_base::clock::written_time::duration_text;
use wingd_base::failure::TaskResult;
use wingd_evaluation::aircraft::{
    AircraftTable, AircraftTrack, ColumnTally, MAX_NEAREST_S, Quantity, TableContents, format_time,
};
use wingd_evaluation::installation;
use wingd_evaluation::results::aircraft as joined;
use wingd_measure::estimation::robust::median;
use wingd_store::aircraft::AircraftLine;
use wingd_store::{FlightRef, RealDisk, Store, StoreResult};

/// Number of lines written durably at once.
const LINES_PER_WRITE: usize = 5000;

/// Largest offset of a zone from UTC, h.
const MAX_ZONE_H: i32 = 14;

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
    /// Samples of the flight, including the table's.
    pub samples: usize,
    /// Number of lines that repeat the time of an earlier one.
    pub repeated: usize,
    /// Number of frames of the flight.
    pub frames: usize,
    /// Quantities of the header's columns, or those of IWG1 that reach a frame.
    pub quantities: Vec<QuantityFrames>,
    /// Reason why no frame gets a value; `None` if at least one does.
    pub no_value_because: Option<String>,
    /// Remark on frames within the table's times that are too far from its lines.
    pub gaps: Option<String>,
}

/// Number of frames for which a quantity comes from the table.
pub struct QuantityFrames {
    pub tally: ColumnTally,
    pub frames: usize,
    /// Number of these frames that had a value from an earlier source.
    pub replaced: usize,
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
        let before = count_frames_by_source(&track, &frames);
        let utc =
            |(stamp, exposure): &(Stamp, Option<Exposure>)| track.time_s(stamp, exposure.as_ref());
        let mut frames_s = Vec::from_iter(frames.iter().filter_map(utc));
        frames_s.sort_by(f64::total_cmp);
        let known_repeated = track.unused.repeated;
        track.begin_source(source);
        track.add_lines(&table.layout, &aircraft_lines(&table));
        let after = count_frames_by_source(&track, &frames);
        let contents = table.contents();
        let reached = |tally: &ColumnTally| {
            let total = |counts: &FrameCounts| {
                let of_quantity = counts.iter().filter(|((_, q), _)| *q == tally.quantity);
                of_quantity.map(|(_, frames)| frames).sum::<usize>()
            };
            let frames = after.get(&(source, tally.quantity)).copied().unwrap_or(0);
            QuantityFrames {
                tally: tally.clone(),
                frames,
                replaced: (total(&before) + frames).saturating_sub(total(&after)),
            }
        };
        let mut quantities = Vec::from_iter(contents.tallies.iter().map(reached));
        quantities.sort_by_key(|reached| reached.tally.quantity);
        quantities.retain(|r| r.frames > 0 || table.layout.begins_with.is_none());
        let is_used = quantities.iter().any(|reached| reached.frames > 0);
        let reason = (!is_used).then(|| explain_no_value(&table, &contents, &frames_s));
        let gaps = describe_gaps(&contents.valued_s, &frames_s).filter(|_| is_used);
        Ok(Self {
            gaps,
            table,
            contents,
            source,
            samples: track.len(),
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

/// Explains why no frame gets a value; the times of the frames are in ascending order.
fn explain_no_value(table: &AircraftTable, contents: &TableContents, frames_s: &[f64]) -> String {
    let (Some(first), Some(last)) = (frames_s.first(), frames_s.last()) else {
        return "no frame of this flight has a UTC time: the clock was not synchronised and no data feed was recorded, or the \
                images were imported without --clock-sigma; import them with it and --zone into a new store"
            .into();
    };
    if table.lines.is_empty() {
        return "the table has no lines below its header".into();
    }
    // Cells are not evaluated in lines without a time.
    if let (true, Some((_, tag))) = (contents.times_s.is_empty(), contents.unread.first()) {
        return format!(
            "its times (\"{tag}\") are not UTC; write them as 2026-06-01T07:59:50Z (`wingd-table` converts other formats)"
        );
    }
    let valued = &contents.valued_s;
    let (Some(from), Some(to)) = (valued.first(), valued.last()) else {
        let reasons = contents
            .tallies
            .iter()
            .filter_map(ColumnTally::no_values_reason);
        return Vec::from_iter(reasons).join("; ");
    };
    if let Some(gaps) = describe_gaps(valued, frames_s) {
        return format!("{gaps}; export the table with more lines");
    }
    let is_apart = from > last || to < first;
    if let Some((count, shift_s)) = zone_shift(valued, frames_s).filter(|_| is_apart) {
        let way = if shift_s > 0.0 { "before" } else { "after" };
        return format!(
            "its times are exactly {} {way} those of {count} frames: local time; convert them to UTC, or import the images \
             again with the right --zone into a new store",
            duration_text(shift_s)
        );
    }
    let [from, to, first, last] = [from, to, first, last].map(|time_s| format_time(*time_s));
    format!(
        "its times are {from} to {to}, but the frames were taken {first} to {last}; name the table of this flight, or another \
         --flight"
    )
}

/// Remarks on frames within the table's times that get no value because its lines are too far apart.
fn describe_gaps(valued_s: &[f64], frames_s: &[f64]) -> Option<String> {
    let (first, last) = (valued_s.first()?, valued_s.last()?);
    let within = || frames_s.iter().filter(|t| (first..=last).contains(t));
    let lost = within().filter(|t| !is_near(valued_s, **t)).count();
    let steps = valued_s.windows(2).map(|pair| pair[1] - pair[0]);
    let step_s = median(steps.collect()).unwrap_or(0.0);
    (lost > 0).then(|| {
        format!(
            "{lost} of {} frames within the table's times are more than {MAX_NEAREST_S} s from a line with a value: its lines \
             are {step_s:.0} s apart",
            within().count()
        )
    })
}

/// Returns whether a line with a value is near enough to a frame at a time.
fn is_near(valued_s: &[f64], time_s: f64) -> bool {
    let place = valued_s.partition_point(|t| *t < time_s - MAX_NEAREST_S);
    let next_s = valued_s.get(place);
    next_s.is_some_and(|next_s| *next_s <= time_s + MAX_NEAREST_S)
}

/// Returns the number of frames that get a value if the table's times are shifted by an offset between zones, and the offset
/// with the most of them, s, whole hours first; `None` if none does.
fn zone_shift(valued_s: &[f64], frames_s: &[f64]) -> Option<(usize, f64)> {
    let count_near = |s: f64| {
        let shifted = frames_s.iter().filter(|t| is_near(valued_s, **t - s));
        shifted.count()
    };
    let quarters = (-4 * MAX_ZONE_H..=4 * MAX_ZONE_H).map(|quarter| 900.0 * f64::from(quarter));
    let fitting = quarters.map(|s| (count_near(s), s));
    let fitting = fitting.filter(|(count, _)| *count > 0);
    fitting.max_by(|(n, s), (m, r)| {
        let whole = |s: f64| s % 3600.0 == 0.0;
        n.cmp(m)
            .then(whole(*s).cmp(&whole(*r)))
            .then(r.abs().total_cmp(&s.abs()))
    })
}
