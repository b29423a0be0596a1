//! Import of a table of aircraft data into a flight: stored only if at least one frame gets a value.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::json;

use super::Failure;
use crate::aircraft::{
    self, AircraftTable, AircraftTrack, ColumnTally, DAY_S, Mapping, Quantity, ReceivedLine, TableContents, TimeFormat,
};
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;
use crate::installation::{self, Fault};
use crate::report::aircraft as joined;
use crate::store::aircraft::AircraftLine;
use crate::store::{FlightRef, RealDisk, Store, StoreError};

/// Number of lines written durably at once.
const LINES_PER_WRITE: usize = 5000;

/// Minimum time of a flight, seconds since 1970: 1 January 1980, before any digital camera.
const MIN_UNIX_TIME_S: f64 = 315_532_800.0;

/// Number of frames that use a source, by source number and quantity.
pub type FrameCounts = BTreeMap<(usize, Quantity), usize>;

/// Counts the frames that use each source for each quantity.
pub fn count_frames_by_source(track: &AircraftTrack, frames: &[(Stamp, Option<Exposure>)]) -> FrameCounts {
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
    mapping: Mapping,
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
    /// Quantities that are mapped or reach a frame.
    pub quantities: Vec<QuantityFrames>,
    /// Reason why no frame gets a value; `None` if at least one does.
    pub no_value_because: Option<String>,
}

/// Number of frames for which a quantity comes from the table.
#[derive(Clone, Copy)]
pub struct QuantityFrames {
    pub quantity: Quantity,
    pub frames: usize,
    /// Number of these frames that had a value from an earlier source.
    pub replaced: usize,
}

fn read_text_file(file: &Path) -> Result<String, Fault> {
    let trouble = |problem: String, remedy: &str| Fault::new(file, "file", problem, remedy);
    let bytes = std::fs::read(file)
        .map_err(|error| trouble(format!("cannot be read ({error})"), "name a file of UTF-8 text"))?;
    installation::decode_text(bytes).map_err(|(problem, remedy)| trouble(problem.into(), remedy))
}

impl TableImport {
    /// Reads a table and its mapping, and joins it with the frames of the flight.
    ///
    /// # Errors
    /// Returns the errors of table and mapping with file and remedy, or an error of the store.
    pub fn read(root: &Path, flight: &FlightRef, file: &Path, mapping: &Path) -> Result<Self, Failure> {
        let (text, written) = (read_text_file(file)?, read_text_file(mapping)?);
        let requested: Mapping = toml::from_str(&written)
            .map_err(|error| installation::toml_fault(mapping, &written, &error, "see docs/aircraft-data.md"))?;
        let faults: Vec<Fault> = requested.faults().into_iter().map(|fault| fault.into_fault(mapping)).collect();
        if !faults.is_empty() {
            return Err(faults.into());
        }
        let table = AircraftTable::parse(&requested, &text).map_err(|trouble| {
            let of_mapping = trouble.line == 0 && !trouble.key.is_empty();
            trouble.into_fault(if of_mapping { mapping } else { file })
        })?;
        let (sources, _) = joined::read_sources(&RealDisk, root, flight)?;
        let (track, _) = joined::read_track(&RealDisk, root, flight)?;
        let frames = joined::read_frame_times(&RealDisk, flight)?;
        Ok(Self::join_with_frames(requested, table, sources.len() + 1, track, &frames))
    }

    fn join_with_frames(
        mapping: Mapping,
        table: AircraftTable,
        source: usize,
        mut track: AircraftTrack,
        frames: &[(Stamp, Option<Exposure>)],
    ) -> Self {
        let contents = table.contents();
        let (repeated, before) = (track.unused.repeated, count_frames_by_source(&track, frames));
        let frames_s = frames.iter().filter_map(|(stamp, exposure)| track.time_s(stamp, exposure.as_ref())).collect();
        track.begin_source(source);
        let lines = table.lines.iter().map(|(_, line)| ReceivedLine { at: None, line: line.clone() });
        track.add_lines(&table.layout, &lines.collect::<Vec<_>>());
        let after = count_frames_by_source(&track, frames);
        let reached = |quantity: Quantity| {
            let total = |counts: &FrameCounts| -> usize {
                counts.iter().filter(|((_, q), _)| *q == quantity).map(|(_, frames)| frames).sum()
            };
            let frames = after.get(&(source, quantity)).copied().unwrap_or(0);
            QuantityFrames { quantity, frames, replaced: (total(&before) + frames).saturating_sub(total(&after)) }
        };
        let mut quantities: Vec<Quantity> = contents.tallies.iter().map(|tally| tally.quantity).collect();
        quantities.sort_unstable();
        quantities.dedup();
        let mut quantities: Vec<_> = quantities.into_iter().map(reached).collect();
        quantities.retain(|r| r.frames > 0 || mapping.column.iter().any(|c| c.quantity == r.quantity));
        let (samples, repeated) = (track.len(), track.unused.repeated - repeated);
        let frames = frames.len();
        let mut import =
            Self { mapping, table, contents, source, samples, repeated, frames, quantities, no_value_because: None };
        import.no_value_because = import.explain_no_value(frames_s);
        import
    }

    /// Explains why no frame gets a value; `None` if at least one does.
    fn explain_no_value(&self, mut frames_s: Vec<f64>) -> Option<String> {
        if self.quantities.iter().any(|reached| reached.frames > 0) {
            return None;
        }
        frames_s.sort_by(f64::total_cmp);
        let (Some(first), Some(last)) = (frames_s.first(), frames_s.last()) else {
            return Some(
                "no frame of this flight has a UTC time: the clock was not synchronised and no data feed was recorded"
                    .into(),
            );
        };
        if self.table.lines.is_empty() {
            return Some("the table has no lines below its header".into());
        }
        let times = self.other_time_format((*first, *last)).or_else(|| self.unreadable_times());
        // Cells are not evaluated in lines without a time.
        if let Some(cause) = times.as_ref().filter(|_| self.contents.times_s.is_empty()) {
            return Some(cause.clone());
        }
        let mut why_none: Vec<String> =
            self.contents.tallies.iter().filter_map(ColumnTally::no_values_reason).collect();
        let values = self.contents.tallies.iter().any(|tally| tally.values > 0);
        if let Some(cause) = times {
            why_none.insert(0, cause);
        } else if values {
            why_none = vec![self.times_outside_flight((*first, *last))];
        }
        Some(why_none.join("; "))
    }

    /// Reports times of an unsupported format; `None` if any line has a readable time.
    fn unreadable_times(&self) -> Option<String> {
        let (_, tag) = self.contents.unread.first().filter(|_| self.contents.times_s.is_empty())?;
        Some(format!(
            "its times (\"{tag}\") have an unsupported format; write them as 2026-06-01T07:59:50Z, or see \
             time_format in docs/aircraft-data.md"
        ))
    }

    /// Suggests a time format that fits the table better than the mapping's.
    fn other_time_format(&self, frames: (f64, f64)) -> Option<String> {
        let field = self.table.layout.time_field - 1;
        let fields = |(_, line): &(u64, String)| self.table.layout.fields(line).get(field).map(ToString::to_string);
        let tags: Vec<String> = self.table.lines.iter().filter_map(fields).collect();
        let tags: Vec<&str> = tags.iter().map(String::as_str).collect();
        let likeliest = aircraft::guess_format(&tags, self.mapping.time_format, frames)?;
        let day = aircraft::format_time(frames.0).chars().take(10).collect::<String>();
        let date = if likeliest == TimeFormat::SecondsOfDay { format!(", date = \"{day}\"") } else { String::new() };
        Some(format!(
            "its times are {} ({}), not {}; write time_format = \"{}\"{date} in the mapping",
            likeliest.description(),
            tags.first().copied().unwrap_or_default(),
            self.mapping.time_format.description(),
            likeliest.name()
        ))
    }

    /// Reports times that lie outside the flight.
    fn times_outside_flight(&self, (first, last): (f64, f64)) -> String {
        let times = &self.contents.times_s;
        let from = times.iter().copied().fold(f64::INFINITY, f64::min);
        let to = times.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if to < MIN_UNIX_TIME_S {
            return format!(
                "its times, {from} to {to}, count from an unknown origin; write them as \
                 2026-06-01T07:59:50Z, or see time_format in docs/aircraft-data.md"
            );
        }
        let shown = aircraft::format_time;
        format!(
            "its times are {} to {}, but the frames were taken {} to {}; name the table of this flight, or another --flight",
            shown(from),
            shown(to),
            shown(first),
            shown(last)
        )
    }

    /// Adds the lines to the flight as a new source.
    pub fn store_lines(&self, store: &Store, flight: &FlightRef, file: &Path) -> Result<(), StoreError> {
        let name = file.file_name().map(installation::printable_path);
        let head = json!({"table": name, "number": self.source, "layout": self.table.layout});
        let lines: Vec<AircraftLine> =
            self.table.lines.iter().map(|(_, line)| AircraftLine { at: None, line: line.clone() }).collect();
        for chunk in lines.chunks(LINES_PER_WRITE) {
            store.add_aircraft_lines_to(&flight.id, &head, chunk)?;
        }
        store.close_aircraft_file()
    }

    /// Returns whether the table gives seconds of the day that restart at midnight.
    pub fn passes_midnight(&self) -> bool {
        let back = |pair: &[f64]| pair[0] - pair[1] > 0.5 * DAY_S;
        self.mapping.time_format == TimeFormat::SecondsOfDay && self.contents.times_s.windows(2).any(back)
    }

    /// Explains for each mapped column without a value why it has none.
    pub fn empty_columns(&self) -> impl Iterator<Item = String> {
        let is_mapped = |tally: &&ColumnTally| self.mapping.column.iter().any(|c| c.quantity == tally.quantity);
        self.contents.tallies.iter().filter(is_mapped).filter_map(ColumnTally::no_values_reason)
    }

    /// Returns the tally of a quantity's column; if there are two, of the later.
    pub fn column_tally(&self, quantity: Quantity) -> Option<&ColumnTally> {
        self.contents.tallies.iter().rfind(|tally| tally.quantity == quantity)
    }
}
