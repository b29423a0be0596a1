//! Import of a table of aircraft data into a flight: stored only if at least one frame gets a value.

use std::collections::BTreeMap;
use std::path::Path;
use wingd_base::clock::FIRST_KNOWN_UTC;

use serde_json::json;

use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::{Exposure, ExposureSource};
use wingd_base::clock::written_time::duration_text;
use wingd_base::failure::TaskResult;
use wingd_evaluation::aircraft;
use wingd_evaluation::aircraft::{
    AircraftTable, AircraftTrack, ColumnTally, Quantity, ReceivedLine, TableContents,
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
#[derive(Clone, Copy)]
pub struct QuantityFrames {
    pub quantity: Quantity,
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
        let (sources, _) = joined::read_sources(&RealDisk, root, flight)?;
        let (track, _) = joined::read_track(&RealDisk, root, flight)?;
        let frames = joined::read_frame_times(&RealDisk, flight)?;
        Ok(Self::join_with_frames(
            table,
            sources.len() + 1,
            track,
            &frames,
        ))
    }

    fn join_with_frames(
        table: AircraftTable,
        source: usize,
        mut track: AircraftTrack,
        frames: &[(Stamp, Option<Exposure>)],
    ) -> Self {
        let contents = table.contents();
        let is_imported = |e: &Exposure| e.exposure_source == ExposureSource::CameraClock;
        let imported = frames
            .iter()
            .any(|(_, exposure)| exposure.as_ref().is_some_and(is_imported));
        let (repeated, before) = (
            track.unused.repeated,
            count_frames_by_source(&track, frames),
        );
        let frames_s: Vec<f64> = frames
            .iter()
            .filter_map(|(stamp, exposure)| track.time_s(stamp, exposure.as_ref()))
            .collect();
        track.begin_source(source);
        let lines = table.lines.iter().map(|(_, line)| ReceivedLine {
            at: None,
            line: line.clone(),
        });
        track.add_lines(&table.layout, &lines.collect::<Vec<_>>());
        let after = count_frames_by_source(&track, frames);
        let reached = |quantity: Quantity| {
            let total = |counts: &FrameCounts| -> usize {
                counts
                    .iter()
                    .filter(|((_, q), _)| *q == quantity)
                    .map(|(_, frames)| frames)
                    .sum()
            };
            let frames = after.get(&(source, quantity)).copied().unwrap_or(0);
            QuantityFrames {
                quantity,
                frames,
                replaced: (total(&before) + frames).saturating_sub(total(&after)),
            }
        };
        let mut quantities: Vec<Quantity> = contents
            .tallies
            .iter()
            .map(|tally| tally.quantity)
            .collect();
        quantities.sort_unstable();
        quantities.dedup();
        let mut quantities: Vec<_> = quantities.into_iter().map(reached).collect();
        quantities.retain(|r| r.frames > 0 || table.layout.begins_with.is_none());
        let (samples, repeated) = (track.len(), track.unused.repeated - repeated);
        let frames = frames.len();
        let mut import = Self {
            table,
            contents,
            source,
            samples,
            repeated,
            frames,
            quantities,
            no_value_because: None,
            gaps: None,
        };
        import.gaps = import.describe_gaps(&frames_s);
        import.no_value_because = import.explain_no_value(frames_s, imported);
        import
    }

    /// Explains why no frame gets a value; `None` if at least one does.
    fn explain_no_value(&self, mut frames_s: Vec<f64>, imported: bool) -> Option<String> {
        if self.quantities.iter().any(|reached| reached.frames > 0) {
            return None;
        }
        frames_s.sort_by(f64::total_cmp);
        if frames_s.is_empty() {
            let cause = if imported {
                "the images were imported without --clock-sigma; import them with it and --zone into a new store"
            } else {
                "the clock was not synchronised and no data feed was recorded"
            };
            return Some(format!("no frame of this flight has a UTC time: {cause}"));
        }
        if self.table.lines.is_empty() {
            return Some("the table has no lines below its header".into());
        }
        let times = self.unreadable_times();
        // Cells are not evaluated in lines without a time.
        if let Some(cause) = times.as_ref().filter(|_| self.contents.times_s.is_empty()) {
            return Some(cause.clone());
        }
        let mut why_none: Vec<String> = self
            .contents
            .tallies
            .iter()
            .filter_map(ColumnTally::no_values_reason)
            .collect();
        let values = self.contents.tallies.iter().any(|tally| tally.values > 0);
        if let Some(cause) = times {
            why_none.insert(0, cause);
        } else if values {
            why_none = vec![self.explain_distance(&frames_s)];
        }
        Some(why_none.join("; "))
    }

    /// Reports times of an unsupported format; `None` if any line has a readable time.
    fn unreadable_times(&self) -> Option<String> {
        let (_, tag) = self
            .contents
            .unread
            .first()
            .filter(|_| self.contents.times_s.is_empty())?;
        Some(format!(
            "its times (\"{tag}\") are not UTC; write them as 2026-06-01T07:59:50Z (`wingd-table` converts other formats)"
        ))
    }

    /// Returns the distance of a time to the nearest line with a value, s; infinite without one.
    fn distance_s(&self, time_s: f64) -> f64 {
        let valued = &self.contents.valued_s;
        let place = valued.partition_point(|t| *t < time_s);
        let near = [place.checked_sub(1), Some(place)]
            .into_iter()
            .flatten()
            .filter_map(|k| valued.get(k));
        near.map(|t| (t - time_s).abs())
            .fold(f64::INFINITY, f64::min)
    }

    /// Counts the frames that get a value if the table's times are shifted by some seconds.
    fn count_near(&self, frames_s: &[f64], shift_s: f64) -> usize {
        frames_s
            .iter()
            .filter(|t| self.distance_s(**t - shift_s) <= aircraft::MAX_NEAREST_S)
            .count()
    }

    /// Returns the median time between lines with a value, s.
    fn median_step_s(&self) -> Option<f64> {
        median(
            self.contents
                .valued_s
                .windows(2)
                .map(|pair| pair[1] - pair[0])
                .collect(),
        )
    }

    /// Remarks on frames within the table's times that get no value because its lines are too far apart.
    fn describe_gaps(&self, frames_s: &[f64]) -> Option<String> {
        let (first, last) = (
            self.contents.valued_s.first()?,
            self.contents.valued_s.last()?,
        );
        let within: Vec<f64> = frames_s
            .iter()
            .copied()
            .filter(|t| (*first..=*last).contains(t))
            .collect();
        let lost = within.len() - self.count_near(&within, 0.0);
        (lost > 0).then(|| {
            let (near, step) = (aircraft::MAX_NEAREST_S, self.median_step_s().unwrap_or(0.0));
            format!("{lost} frames within the table's times are more than {near} s from a line with a value: its lines are {step} s apart")
        })
    }

    /// Explains why lines with values reach no frame: lines too far apart, local time, or another flight.
    fn explain_distance(&self, frames_s: &[f64]) -> String {
        let (valued, near) = (&self.contents.valued_s, aircraft::MAX_NEAREST_S);
        let (Some(first), Some(last)) = (frames_s.first(), frames_s.last()) else {
            return String::new();
        };
        let (Some(from), Some(to)) = (valued.first(), valued.last()) else {
            return String::new();
        };
        if *from - near <= *last && *to + near >= *first {
            let nearest = frames_s
                .iter()
                .map(|t| self.distance_s(*t))
                .fold(f64::INFINITY, f64::min);
            let step = self
                .median_step_s()
                .map_or(String::new(), |s| format!(" are {s:.0} s apart, and"));
            return format!(
                "no line with a value lies within {near} s of a frame: the lines with values{step} come as near as \
                 {nearest:.0} s; export the table with more lines"
            );
        }
        let quarters = (-4 * MAX_ZONE_H..=4 * MAX_ZONE_H).map(|quarter| 900.0 * f64::from(quarter));
        let fitting = quarters
            .map(|s| (self.count_near(frames_s, s), s))
            .filter(|(count, _)| *count > 0);
        let best = fitting.max_by(|(n, s), (m, r)| {
            let whole = |s: f64| s % 3600.0 == 0.0;
            n.cmp(m)
                .then(whole(*s).cmp(&whole(*r)))
                .then(r.abs().total_cmp(&s.abs()))
        });
        let Some((count, shift_s)) = best else {
            return self.times_outside_flight((*first, *last));
        };
        let way = if shift_s > 0.0 { "before" } else { "after" };
        format!(
            "its times are exactly {} {way} those of {count} frames: local time; convert them to UTC, or import the images \
             again with the right --zone into a new store",
            duration_text(shift_s)
        )
    }

    /// Reports times that lie outside the flight.
    fn times_outside_flight(&self, (first, last): (f64, f64)) -> String {
        let times = &self.contents.times_s;
        let from = times.iter().copied().fold(f64::INFINITY, f64::min);
        let to = times.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if to < FIRST_KNOWN_UTC.as_second() as f64 {
            return format!(
                "its times, {from} to {to}, count from an unknown origin; write them as 2026-06-01T07:59:50Z"
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
    pub fn store_lines(&self, store: &Store, flight: &FlightRef, file: &Path) -> StoreResult<()> {
        let name = file.file_name().map(installation::printable_path);
        let head = json!({"table": name, "number": self.source, "layout": self.table.layout});
        let lines: Vec<AircraftLine> = self
            .table
            .lines
            .iter()
            .map(|(_, line)| AircraftLine {
                at: None,
                line: line.clone(),
            })
            .collect();
        for chunk in lines.chunks(LINES_PER_WRITE) {
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

    /// Returns the tally of a quantity's column; if there are two, of the later.
    pub fn column_tally(&self, quantity: Quantity) -> Option<&ColumnTally> {
        self.contents
            .tallies
            .iter()
            .rfind(|tally| tally.quantity == quantity)
    }
}
