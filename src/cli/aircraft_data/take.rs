//! A table taken into a flight: kept where it tells any frame anything.

use std::path::Path;

use serde_json::json;

use super::{Args, Done, Failure, list, open, print, undone};
use crate::aircraft::{self, Contents, DAY_S, Mapping, Quantity, Received, Table, TimeFormat, Track};
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;
use crate::installation::{self, Fault};
use crate::report::aircraft as joined;
use crate::store::aircraft::AircraftLine;
use crate::store::{FlightRef, RealDisk, Store};

/// Lines that are made durable together.
const CHUNK: usize = 5000;

/// Numbers below are no seconds since 1970 of a flight that was photographed by a digital camera: 1 January 1980, s.
const BEFORE_S: f64 = 315_532_800.0;

/// A table, and what would become of it.
struct Answer<'a> {
    args: &'a Args,
    flight: &'a FlightRef,
    table: Table,
    contents: Contents,
    /// Its number among the flight's sources.
    source: usize,
    /// Samples of the flight with it, and its lines with a tag that was there before.
    samples: usize,
    repeated: usize,
    /// Frames of the flight.
    frames: usize,
    /// The frames of each of its quantities.
    reached: Vec<Reached>,
}

/// Frames of a quantity.
#[derive(Clone, Copy)]
struct Reached {
    quantity: Quantity,
    /// At which the table counts.
    frames: usize,
    /// Of these, told by an earlier source without it.
    replaced: usize,
}

pub(super) fn run(args: &Args, flight: &FlightRef, file: &Path, mapping: &Path) -> Result<Done, Failure> {
    let (text, written) = (read(file)?, read(mapping)?);
    let asked: Mapping = toml::from_str(&written)
        .map_err(|error| installation::toml_fault(mapping, &written, &error, "see docs/aircraft-data.md"))?;
    let faults: Vec<Fault> = asked.faults().into_iter().map(|fault| fault.of(mapping)).collect();
    if !faults.is_empty() {
        return Err(faults.into());
    }
    let table = Table::find(&asked, &text).map_err(|trouble| {
        let of_mapping = trouble.line == 0 && !trouble.key.is_empty();
        trouble.of(if of_mapping { mapping } else { file })
    })?;
    let (sources, _) = joined::sources(&RealDisk, &args.store, flight).map_err(undone)?;
    let (track, _) = joined::track(&RealDisk, &args.store, flight).map_err(undone)?;
    let frames = joined::frames(&RealDisk, flight).map_err(undone)?;
    let answer = Answer::new(args, flight, table, sources.len() + 1, track.clone(), &frames);
    let times = frames.iter().filter_map(|(stamp, exposure)| track.time_s(stamp, exposure.as_ref()));
    let cause = answer.cause(&asked, times.collect());
    if cause.is_none() {
        answer.keep(&open(args)?, file)?;
    }
    answer.say(&asked, cause)
}

fn read(file: &Path) -> Result<String, Fault> {
    let trouble = |problem: String, mend: &str| Fault::new(file, "file", problem, mend);
    let bytes = std::fs::read(file)
        .map_err(|error| trouble(format!("cannot be read ({error})"), "name a file of UTF-8 text"))?;
    installation::text_of(bytes).map_err(|(problem, mend)| trouble(problem.into(), mend))
}

impl<'a> Answer<'a> {
    fn new(
        args: &'a Args,
        flight: &'a FlightRef,
        table: Table,
        source: usize,
        mut track: Track,
        frames: &[(Stamp, Option<Exposure>)],
    ) -> Self {
        let contents = table.contents();
        let (repeated, before) = (track.unused.repeated, list::counts(&track, frames));
        track.begin_source(source);
        let lines = table.lines.iter().map(|(_, line)| Received { at: None, line: line.clone() });
        track.add(&table.layout, &lines.collect::<Vec<_>>());
        let after = list::counts(&track, frames);
        let reached = |quantity: Quantity| {
            let told = |counts: &list::Counts| -> usize {
                counts.iter().filter(|((_, q), _)| *q == quantity).map(|(_, frames)| frames).sum()
            };
            let frames = after.get(&(source, quantity)).copied().unwrap_or(0);
            Reached { quantity, frames, replaced: (told(&before) + frames).saturating_sub(told(&after)) }
        };
        let mut quantities: Vec<Quantity> = contents.tallies.iter().map(|tally| tally.quantity).collect();
        quantities.sort_unstable();
        quantities.dedup();
        let reached = quantities.into_iter().map(reached).collect();
        let (samples, repeated) = (track.len(), track.unused.repeated - repeated);
        Self { args, flight, table, contents, source, samples, repeated, frames: frames.len(), reached }
    }

    fn reaches_any(&self) -> bool {
        self.reached.iter().any(|reached| reached.frames > 0)
    }

    /// Why no frame gets a value, where none does.
    fn cause(&self, mapping: &Mapping, mut frames_s: Vec<f64>) -> Option<String> {
        if self.reaches_any() {
            return None;
        }
        frames_s.sort_by(f64::total_cmp);
        let (Some(first), Some(last)) = (frames_s.first(), frames_s.last()) else {
            return Some("no frame of the flight has a UTC: neither clock nor feed tells it".into());
        };
        if self.table.lines.is_empty() {
            return Some("the table has no lines below its header".into());
        }
        let times = self.other_times(mapping, (*first, *last)).or_else(|| self.no_times());
        // Of lines without a moment no cell is looked at.
        if let Some(cause) = times.as_ref().filter(|_| self.contents.times_s.is_empty()) {
            return Some(cause.clone());
        }
        let mut why_none =
            self.contents.tallies.iter().filter_map(aircraft::Tally::why_none).collect::<Vec<_>>();
        let values = self.contents.tallies.iter().any(|tally| tally.values > 0);
        if let Some(cause) = times {
            why_none.insert(0, cause);
        } else if values {
            why_none = vec![self.elsewhere((*first, *last))];
        }
        Some(why_none.join("; "))
    }

    /// Where no line has a moment.
    fn no_times(&self) -> Option<String> {
        let (_, tag) = self.contents.unread.first().filter(|_| self.contents.times_s.is_empty())?;
        Some(format!(
            "its times (\"{tag}\") are in none of the ways that are read; write them as 2026-06-01T07:59:50Z, or see \
             time_format in docs/aircraft-data.md"
        ))
    }

    /// Times in another way of writing than the mapping says.
    fn other_times(&self, mapping: &Mapping, frames: (f64, f64)) -> Option<String> {
        let field = self.table.layout.time_field - 1;
        let fields =
            |(_, line): &(u64, String)| self.table.layout.fields(line).get(field).map(ToString::to_string);
        let tags: Vec<String> = self.table.lines.iter().filter_map(fields).collect();
        let tags: Vec<&str> = tags.iter().map(String::as_str).collect();
        let likeliest = aircraft::likeliest(&tags, mapping.time_format, frames)?;
        let day = aircraft::shown(frames.0).chars().take(10).collect::<String>();
        let date =
            if likeliest == TimeFormat::SecondsOfDay { format!(", date = \"{day}\"") } else { String::new() };
        Some(format!(
            "its times are {} ({}), not {}; write time_format = \"{}\"{date} in the mapping",
            likeliest.words(),
            tags.first().copied().unwrap_or_default(),
            mapping.time_format.words(),
            likeliest.name()
        ))
    }

    /// Times that are none of the flight.
    fn elsewhere(&self, (first, last): (f64, f64)) -> String {
        let times = &self.contents.times_s;
        let from = times.iter().copied().fold(f64::INFINITY, f64::min);
        let to = times.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if to < BEFORE_S {
            return format!(
                "its times, {from} to {to}, count from a beginning that the table does not say; write them as \
                 2026-06-01T07:59:50Z, or see time_format in docs/aircraft-data.md"
            );
        }
        let shown = aircraft::shown;
        format!(
            "its times are {} to {}, the frames' {} to {}; name the flight's own table, or another --flight",
            shown(from),
            shown(to),
            shown(first),
            shown(last)
        )
    }

    fn keep(&self, store: &Store, file: &Path) -> Result<(), Failure> {
        let name = file.file_name().map(installation::shown_path);
        let head = json!({"table": name, "number": self.source, "layout": self.table.layout});
        let lines: Vec<AircraftLine> =
            self.table.lines.iter().map(|(_, line)| AircraftLine { at: None, line: line.clone() }).collect();
        for chunk in lines.chunks(CHUNK) {
            store.add_aircraft_to(&self.flight.id, &head, chunk).map_err(undone)?;
        }
        store.close_aircraft().map_err(undone)
    }

    /// What came and where it went; exit 1 where a quantity reached no frame, or a line has no time.
    fn say(&self, mapping: &Mapping, cause: Option<String>) -> Result<Done, Failure> {
        let stated = |q: Quantity| mapping.column.iter().any(|c| c.quantity == q);
        let wanted = |r: &&Reached| r.frames > 0 || stated(r.quantity);
        let reached: Vec<_> = self.reached.iter().filter(wanted).copied().collect();
        print(&if self.args.json {
            self.json(&reached, cause.as_deref())
        } else {
            self.text(&reached, cause.is_none())
        })?;
        self.table.remarks.iter().for_each(|remark| eprintln!("wingd: {remark}"));
        if let Some((line, tag)) = self.contents.unread.first() {
            let count = self.contents.unread.len();
            eprintln!("wingd: {count} lines without a time, line {line} first (\"{tag}\")");
        }
        if self.passes_midnight(mapping) {
            eprintln!("wingd: its seconds of the day begin anew: give a table, with its date, for each day");
        }
        if let Some(cause) = cause {
            return Err(Failure::Failed(format!(
                "no frame of {} gets a value, nothing is kept: {cause}",
                self.flight.id
            )));
        }
        for tally in self.contents.tallies.iter().filter(|tally| stated(tally.quantity)) {
            tally.why_none().iter().for_each(|why| eprintln!("wingd: {why}"));
        }
        let whole = self.contents.unread.is_empty() && reached.iter().all(|r| r.frames > 0);
        Ok(Done::all(whole && !self.passes_midnight(mapping)))
    }

    fn passes_midnight(&self, mapping: &Mapping) -> bool {
        let back = |pair: &[f64]| pair[0] - pair[1] > 0.5 * DAY_S;
        mapping.time_format == TimeFormat::SecondsOfDay && self.contents.times_s.windows(2).any(back)
    }

    fn json(&self, reached: &[Reached], cause: Option<&str>) -> String {
        let quantity = |r: &Reached| {
            let tally = self.tally(r.quantity);
            json!({
                "quantity": r.quantity.name(),
                "values": tally.map_or(0, |t| t.values),
                "blank": tally.map_or(0, |t| t.blank),
                "text": tally.map_or(0, |t| t.text.0),
                "out_of_reason": tally.map_or(0, |t| t.out_of_reason.0),
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

    fn text(&self, reached: &[Reached], kept: bool) -> String {
        let id = &self.flight.id;
        let as_source = if kept { format!("kept as source {}", self.source) } else { "not kept".into() };
        let (lines, read) = (self.table.lines.len(), self.contents.times_s.len());
        let mut text =
            format!("{id}: {lines} lines {as_source}, {read} with a time, {} repeated", self.repeated);
        for Reached { quantity, frames, replaced } in reached {
            let tally = self.tally(*quantity);
            let values = tally.map_or(0, |t| t.values);
            let none = tally.map_or(String::new(), |t| {
                let parts = [(t.blank, "blank"), (t.text.0, "text"), (t.out_of_reason.0, "out of reason")];
                let said = parts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!(", {n} {what}"));
                said.collect()
            });
            let name = quantity.name();
            text += &format!("\n  {name}: {values} values{none}; {frames} of {} frames", self.frames);
            if *replaced > 0 {
                text += &format!(", {replaced} of them in place of an earlier source");
            }
        }
        text
    }

    /// The cells of a quantity's column; of two the later counts.
    fn tally(&self, quantity: Quantity) -> Option<&aircraft::Tally> {
        self.contents.tallies.iter().rfind(|tally| tally.quantity == quantity)
    }
}
