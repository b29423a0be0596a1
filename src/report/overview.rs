//! A flight in a line per series, for pages that must cost little: of each result only its beginning is
//! read, so that a thousand series take a moment and no memory to speak of.

use serde::Deserialize;
use serde_json::Value;

use super::summary::{Mean, Single};
use crate::clock::Stamp;
use crate::record::{Reference, Status, Tip};
use crate::store::manifest::{SeriesManifest, SeriesState};
use crate::store::result_sets::{ResultGrouper, ResultSets};
use crate::store::{Disk, FlightRef, SeriesRef, StoreError, catalogue, layout, result_summary};

/// A series.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Line {
    /// Its name.
    pub name: String,
    /// When it began, where that is known.
    pub begun: Option<Stamp>,
    /// A crash or a power cut ended it early.
    pub interrupted: bool,
    /// Shots that were wanted.
    pub planned: usize,
    /// Frames that are there.
    pub frames: usize,
    /// Their bytes.
    pub bytes: u64,
    /// Frames solved.
    pub solved: usize,
    /// Frames with a result that says why not.
    pub failed: usize,
    /// Deflection of the outermost marker, as the flight's `reference` says.
    pub tip_deflection_m: Option<Mean>,
    /// The greatest of single frames.
    pub greatest: Option<Single>,
}

impl Line {
    /// What is not as it should be, in words; empty where all is there.
    pub fn missing(&self) -> Vec<String> {
        let mut all = Vec::new();
        let mut say = |count: usize, what: &str| {
            if count > 0 {
                all.push(format!("{count} {what}"));
            }
        };
        say(self.planned.saturating_sub(self.frames), "shots without a frame");
        say(self.failed, "frames not solvable");
        say(self.frames.saturating_sub(self.solved + self.failed), "frames not solved yet");
        if self.interrupted {
            all.push("interrupted".to_owned());
        }
        all
    }
}

/// A flight.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Overview {
    /// Its name.
    pub flight: String,
    /// Against what its deflections are counted.
    pub reference: Reference,
    /// Its series, in order.
    pub series: Vec<Line>,
    /// What could not be read.
    pub notes: Vec<String>,
    /// Results of other inputs than those that are shown.
    pub warning: Option<String>,
    /// The last frame's moment.
    pub last_frame: Option<Stamp>,
}

impl Overview {
    /// A sum over the series.
    pub fn sum(&self, of: impl Fn(&Line) -> usize) -> usize {
        self.series.iter().map(of).sum()
    }

    /// The single frame with the greatest tip deflection, and its series.
    pub fn greatest(&self) -> Option<(&Line, &Single)> {
        let deflections = self.series.iter().filter_map(|line| Some((line, line.greatest.as_ref()?)));
        deflections.max_by(|a, b| a.1.deflection_m.total_cmp(&b.1.deflection_m))
    }

    /// Bytes of frames an hour, over the last day of series; `None` before there are two.
    pub fn bytes_per_hour(&self) -> Option<f64> {
        let lines: Vec<&Line> = self.series.iter().rev().take(24).collect();
        let (last, first) = (lines.first()?.begun.as_ref()?, lines.last()?.begun.as_ref()?);
        let hours = super::summary::hours_between(first, last);
        // The first of them stands for the time before it.
        let bytes: u64 = lines.iter().rev().skip(1).map(|line| line.bytes).sum();
        (hours > 0.0).then(|| bytes as f64 / hours)
    }
}

/// What the pages ask of a record.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Brief {
    status: Status,
    tip: Option<Tip>,
}

/// What a head says of deflection and success.
struct Seen {
    set: usize,
    frame: String,
    ok: bool,
    tip: Option<Tip>,
}

/// Reads a flight. Damage in one place does not hide the rest: it is noted.
pub fn flight(disk: &dyn Disk, flight: &FlightRef) -> Result<Overview, StoreError> {
    let mut overview = Overview { flight: flight.id.clone(), ..Overview::default() };
    let mut gather = ResultGrouper::default();
    let mut all = Vec::new();
    for series in catalogue::list_series(disk, flight)? {
        match catalogue::read_series_manifest(disk, &series) {
            Err(error) => overview.notes.push(error.to_string()),
            Ok(manifest) => {
                let seen = seen(disk, &series, &mut gather, &mut overview.notes);
                let shots = manifest.shots.iter().rev().filter(|shot| shot.frame.is_some());
                overview.last_frame = shots.map(|s| s.stamp.clone()).next().or(overview.last_frame);
                all.push((line(manifest), seen));
            }
        }
    }
    let sets: ResultSets = gather.finish();
    let chosen = sets.choose_set(None).map(|set| set.index());
    overview.warning = sets.mixed_inputs_warning(&flight.id, None);
    let of_set = |seen: &&Seen| seen.ok && Some(seen.set) == chosen;
    let tips = all.iter().flat_map(|(_, seen)| seen).filter(of_set).filter_map(|seen| seen.tip.as_ref());
    overview.reference = Reference::of(tips);
    let counted = all.into_iter().map(|(line, seen)| with_results(line, &seen, chosen, overview.reference));
    overview.series = counted.collect();
    Ok(overview)
}

fn line(manifest: SeriesManifest) -> Line {
    let begun = manifest.start_time();
    let frames = || manifest.shots.iter().filter_map(|shot| shot.frame.as_ref());
    Line {
        begun,
        interrupted: manifest.state == SeriesState::Interrupted,
        planned: manifest.planned_shots as usize,
        frames: frames().count(),
        bytes: frames().map(|frame| frame.bytes).sum(),
        name: manifest.series,
        ..Line::default()
    }
}

fn seen(disk: &dyn Disk, series: &SeriesRef, gather: &mut ResultGrouper, notes: &mut Vec<String>) -> Vec<Seen> {
    let path = series.folder.join(layout::RESULTS_FILE);
    let bytes = match disk.read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Vec::new(),
        Err(error) => {
            notes.push(format!("{}: cannot be read: {error}", path.display()));
            return Vec::new();
        }
    };
    let heads = result_summary::parse_summaries(&bytes, &["status", "tip"]);
    let sets = gather.add_series(&series.id, &heads);
    let one = |(head, set): (result_summary::ResultSummary, usize)| {
        let brief: Brief = serde_json::from_value(Value::Object(head.record)).unwrap_or_default();
        Seen { set, frame: head.frame, ok: brief.status == Status::Ok, tip: brief.tip }
    };
    heads.into_iter().zip(sets).map(one).collect()
}

fn with_results(line: Line, seen: &[Seen], chosen: Option<usize>, reference: Reference) -> Line {
    let mut latest = std::collections::BTreeMap::new();
    for one in seen.iter().filter(|one| Some(one.set) == chosen) {
        latest.insert(&one.frame, one);
    }
    let solved = || latest.values().filter(|s| s.ok);
    let tips = || solved().filter_map(|s| Some((s.frame.as_str(), s.tip.as_ref()?)));
    let deflections: Vec<_> = tips().filter_map(|(_, tip)| tip.deflection(reference)).collect();
    let (tip_deflection_m, greatest) = (Mean::of(&deflections), Single::greatest(tips(), reference));
    let solved = solved().count();
    Line { solved, failed: latest.len() - solved, tip_deflection_m, greatest, ..line }
}
