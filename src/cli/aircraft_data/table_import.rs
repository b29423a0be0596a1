//! Import of a table into a flight: stored only if at least one frame gets a value.

use std::path::Path;

use serde_json::json;

use super::{AircraftDataArgs, Completion, Failure, list, open_store, print_line, store_failure};
use crate::aircraft::{
    self, AircraftTable, AircraftTrack, DAY_S, Mapping, Quantity, ReceivedLine, TableContents, TimeFormat,
};
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;
use crate::installation::{self, Fault};
use crate::report::aircraft as joined;
use crate::store::aircraft::AircraftLine;
use crate::store::{FlightRef, RealDisk, Store};

/// Number of lines written durably at once.
const LINES_PER_WRITE: usize = 5000;

/// Minimum time of a flight, seconds since 1970: 1 January 1980, before any digital camera.
const MIN_UNIX_TIME_S: f64 = 315_532_800.0;

/// A table and its effect on the flight.
struct TableImport<'a> {
    args: &'a AircraftDataArgs,
    flight: &'a FlightRef,
    table: AircraftTable,
    contents: TableContents,
    /// Number of the table among the flight's sources.
    source: usize,
    /// Samples of the flight, including the table's.
    samples: usize,
    repeated: usize,
    frames: usize,
    quantities: Vec<QuantityFrames>,
}

/// Number of frames for which a quantity comes from the table.
#[derive(Clone, Copy)]
struct QuantityFrames {
    quantity: Quantity,
    frames: usize,
    /// Number of these frames that had a value from an earlier source.
    replaced: usize,
}

pub(super) fn import_table(
    args: &AircraftDataArgs,
    flight: &FlightRef,
    file: &Path,
    mapping: &Path,
) -> Result<Completion, Failure> {
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
    let (sources, _) = joined::read_sources(&RealDisk, &args.store, flight).map_err(store_failure)?;
    let (track, _) = joined::read_track(&RealDisk, &args.store, flight).map_err(store_failure)?;
    let frames = joined::read_frame_times(&RealDisk, flight).map_err(store_failure)?;
    let answer = TableImport::new(args, flight, table, sources.len() + 1, track.clone(), &frames);
    let times = frames.iter().filter_map(|(stamp, exposure)| track.time_s(stamp, exposure.as_ref()));
    let cause = answer.no_value_reason(&requested, times.collect());
    if cause.is_none() {
        answer.store_lines(&open_store(args)?, file)?;
    }
    answer.report_outcome(&requested, cause)
}

fn read_text_file(file: &Path) -> Result<String, Fault> {
    let trouble = |problem: String, remedy: &str| Fault::new(file, "file", problem, remedy);
    let bytes = std::fs::read(file)
        .map_err(|error| trouble(format!("cannot be read ({error})"), "name a file of UTF-8 text"))?;
    installation::decode_text(bytes).map_err(|(problem, remedy)| trouble(problem.into(), remedy))
}

impl<'a> TableImport<'a> {
    fn new(
        args: &'a AircraftDataArgs,
        flight: &'a FlightRef,
        table: AircraftTable,
        source: usize,
        mut track: AircraftTrack,
        frames: &[(Stamp, Option<Exposure>)],
    ) -> Self {
        let contents = table.contents();
        let (repeated, before) = (track.unused.repeated, list::count_frames_by_source(&track, frames));
        track.begin_source(source);
        let lines = table.lines.iter().map(|(_, line)| ReceivedLine { at: None, line: line.clone() });
        track.add_lines(&table.layout, &lines.collect::<Vec<_>>());
        let after = list::count_frames_by_source(&track, frames);
        let reached = |quantity: Quantity| {
            let total = |counts: &list::FrameCounts| -> usize {
                counts.iter().filter(|((_, q), _)| *q == quantity).map(|(_, frames)| frames).sum()
            };
            let frames = after.get(&(source, quantity)).copied().unwrap_or(0);
            QuantityFrames { quantity, frames, replaced: (total(&before) + frames).saturating_sub(total(&after)) }
        };
        let mut quantities: Vec<Quantity> = contents.tallies.iter().map(|tally| tally.quantity).collect();
        quantities.sort_unstable();
        quantities.dedup();
        let reached = quantities.into_iter().map(reached).collect();
        let (samples, repeated) = (track.len(), track.unused.repeated - repeated);
        Self { args, flight, table, contents, source, samples, repeated, frames: frames.len(), quantities: reached }
    }

    fn reaches_any(&self) -> bool {
        self.quantities.iter().any(|reached| reached.frames > 0)
    }

    /// Explains why no frame gets a value; `None` if at least one does.
    fn no_value_reason(&self, mapping: &Mapping, mut frames_s: Vec<f64>) -> Option<String> {
        if self.reaches_any() {
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
        let times = self.other_time_format(mapping, (*first, *last)).or_else(|| self.unreadable_times());
        // Cells are not evaluated in lines without a time.
        if let Some(cause) = times.as_ref().filter(|_| self.contents.times_s.is_empty()) {
            return Some(cause.clone());
        }
        let mut why_none =
            self.contents.tallies.iter().filter_map(aircraft::ColumnTally::no_values_reason).collect::<Vec<_>>();
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
    fn other_time_format(&self, mapping: &Mapping, frames: (f64, f64)) -> Option<String> {
        let field = self.table.layout.time_field - 1;
        let fields = |(_, line): &(u64, String)| self.table.layout.fields(line).get(field).map(ToString::to_string);
        let tags: Vec<String> = self.table.lines.iter().filter_map(fields).collect();
        let tags: Vec<&str> = tags.iter().map(String::as_str).collect();
        let likeliest = aircraft::guess_format(&tags, mapping.time_format, frames)?;
        let day = aircraft::format_time(frames.0).chars().take(10).collect::<String>();
        let date = if likeliest == TimeFormat::SecondsOfDay { format!(", date = \"{day}\"") } else { String::new() };
        Some(format!(
            "its times are {} ({}), not {}; write time_format = \"{}\"{date} in the mapping",
            likeliest.description(),
            tags.first().copied().unwrap_or_default(),
            mapping.time_format.description(),
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

    fn store_lines(&self, store: &Store, file: &Path) -> Result<(), Failure> {
        let name = file.file_name().map(installation::printable_path);
        let head = json!({"table": name, "number": self.source, "layout": self.table.layout});
        let lines: Vec<AircraftLine> =
            self.table.lines.iter().map(|(_, line)| AircraftLine { at: None, line: line.clone() }).collect();
        for chunk in lines.chunks(LINES_PER_WRITE) {
            store.add_aircraft_lines_to(&self.flight.id, &head, chunk).map_err(store_failure)?;
        }
        store.close_aircraft_file().map_err(store_failure)
    }

    /// Prints the outcome; exit status 1 if a quantity has no frame, or a line no time.
    fn report_outcome(&self, mapping: &Mapping, cause: Option<String>) -> Result<Completion, Failure> {
        let is_mapped = |q: Quantity| mapping.column.iter().any(|c| c.quantity == q);
        let wanted = |r: &&QuantityFrames| r.frames > 0 || is_mapped(r.quantity);
        let reached: Vec<_> = self.quantities.iter().filter(wanted).copied().collect();
        print_line(&if self.args.json {
            self.to_json(&reached, cause.as_deref())
        } else {
            self.to_text(&reached, cause.is_none())
        })?;
        self.table.remarks.iter().for_each(|remark| eprintln!("wingd: {remark}"));
        if let Some((line, tag)) = self.contents.unread.first() {
            let count = self.contents.unread.len();
            eprintln!("wingd: {count} lines without a time, first line {line} (\"{tag}\")");
        }
        if self.passes_midnight(mapping) {
            eprintln!("wingd: the seconds of the day restart at midnight: give one table per day, each with its date");
        }
        if let Some(cause) = cause {
            return Err(Failure::Failed(format!(
                "the table gives no frame of {} a value, so nothing was stored: {cause}",
                self.flight.id
            )));
        }
        for tally in self.contents.tallies.iter().filter(|tally| is_mapped(tally.quantity)) {
            tally.no_values_reason().iter().for_each(|why| eprintln!("wingd: {why}"));
        }
        let complete = self.contents.unread.is_empty() && reached.iter().all(|r| r.frames > 0);
        Ok(Completion::from_success(complete && !self.passes_midnight(mapping)))
    }

    fn passes_midnight(&self, mapping: &Mapping) -> bool {
        let back = |pair: &[f64]| pair[0] - pair[1] > 0.5 * DAY_S;
        mapping.time_format == TimeFormat::SecondsOfDay && self.contents.times_s.windows(2).any(back)
    }

    fn to_json(&self, reached: &[QuantityFrames], cause: Option<&str>) -> String {
        let quantity = |r: &QuantityFrames| {
            let tally = self.column_tally(r.quantity);
            json!({
                "quantity": r.quantity.name(),
                "values": tally.map_or(0, |t| t.values),
                "blank": tally.map_or(0, |t| t.blank),
                "text": tally.map_or(0, |t| t.text.0),
                "out_of_reason": tally.map_or(0, |t| t.out_of_range.0),
                "frames": r.frames,
                "replaced": r.replaced,
            })
        };
        json!({
            "flight": self.flight.id,
            "source": cause.is_none().then_some(self.source),
            "lines": self.table.lines.len(),
            "read": self.contents.times_s.len(),
            "samples": self.samples,
            "repeated": self.repeated,
            "frames": self.frames,
            "quantities": reached.iter().map(quantity).collect::<Vec<_>>(),
            "remarks": self.table.remarks,
            "reason": cause,
        })
        .to_string()
    }

    fn to_text(&self, reached: &[QuantityFrames], kept: bool) -> String {
        let id = &self.flight.id;
        let as_source = if kept { format!("stored as source {}", self.source) } else { "not stored".into() };
        let (lines, read) = (self.table.lines.len(), self.contents.times_s.len());
        let mut text = format!("{id}: {lines} lines {as_source}, {read} with a time, {} repeated", self.repeated);
        for QuantityFrames { quantity, frames, replaced } in reached {
            let tally = self.column_tally(*quantity);
            let values = tally.map_or(0, |t| t.values);
            let none = tally.map_or(String::new(), |t| {
                let parts = [(t.blank, "blank"), (t.text.0, "text"), (t.out_of_range.0, "implausible")];
                let notes = parts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!(", {n} {what}"));
                notes.collect()
            });
            let name = quantity.name();
            text += &format!("\n  {name}: {values} values{none}; {frames} of {} frames", self.frames);
            if *replaced > 0 {
                text += &format!(", {replaced} of them replacing an earlier source");
            }
        }
        text
    }

    /// Returns the tally of a quantity's column; if there are two, of the later.
    fn column_tally(&self, quantity: Quantity) -> Option<&aircraft::ColumnTally> {
        self.contents.tallies.iter().rfind(|tally| tally.quantity == quantity)
    }
}
