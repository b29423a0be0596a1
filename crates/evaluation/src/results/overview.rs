//! Overview of a flight, one line per series, for pages that must load quickly. Only the beginning of each result is read,
//! so that 1000 series take little time and memory.

use serde::Deserialize;
use serde_json::Value;

use super::summary::{FrameDeflection, Mean};
use crate::record::{RecordStatus, Tip};
use wingd_base::clock::Stamp;
use wingd_measure::adjust::DeflectionReference;
use wingd_measure::estimation::quality::GlobalTest;
use wingd_store::manifest::{SeriesManifest, SeriesState};
use wingd_store::result_sets::{ResultGrouper, ResultSets};
use wingd_store::{Disk, FlightRef, SeriesRef, StoreResult, catalogue};

/// Series of a flight in one line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeriesOverview {
    pub name: String,
    /// Start time, if known.
    pub begun: Option<Stamp>,
    /// Ended early by a crash or a power failure.
    pub interrupted: bool,
    /// Number of planned shots.
    pub planned: usize,
    /// Number of stored frames.
    pub frames: usize,
    /// Size of the stored frames.
    pub bytes: u64,
    pub solved: usize,
    /// Number of frames with a result that reports a failure.
    pub failed: usize,
    /// Number of solved frames that their global test does not reject.
    pub passed: usize,
    /// Deflection of the outermost marker, relative to the flight's `reference`.
    pub tip_deflection_m: Option<Mean>,
    /// Largest tip deflection of a single frame.
    pub greatest: Option<FrameDeflection>,
}

impl SeriesOverview {
    /// Describes missing frames and results; empty if the series is complete.
    pub fn problems(&self) -> Vec<String> {
        let mut all = Vec::new();
        let mut add_problem = |count: usize, text: &str| {
            if count > 0 {
                all.push(format!("{count} {text}"));
            }
        };
        add_problem(
            self.planned.saturating_sub(self.frames),
            "shots without a frame",
        );
        add_problem(self.failed, "frames with a failed solution");
        add_problem(
            self.frames.saturating_sub(self.solved + self.failed),
            "frames not solved yet",
        );
        if self.interrupted {
            all.push("interrupted".to_owned());
        }
        all
    }
}

/// Overview of a flight.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FlightOverview {
    pub flight: String,
    /// Reference of the deflections.
    pub reference: DeflectionReference,
    /// Series in order.
    pub series: Vec<SeriesOverview>,
    /// Unreadable files.
    pub notes: Vec<String>,
    /// Warning if there are results from other inputs than those shown.
    pub warning: Option<String>,
    /// Time of the last frame.
    pub last_frame: Option<Stamp>,
}

impl FlightOverview {
    /// Adds up a count over all series.
    pub fn sum(&self, count: impl Fn(&SeriesOverview) -> usize) -> usize {
        self.series.iter().map(count).sum()
    }

    /// Returns the single frame with the largest tip deflection, and its series.
    pub fn greatest(&self) -> Option<(&SeriesOverview, &FrameDeflection)> {
        let deflections = self
            .series
            .iter()
            .filter_map(|line| Some((line, line.greatest.as_ref()?)));
        deflections.max_by(|a, b| a.1.deflection_m.total_cmp(&b.1.deflection_m))
    }

    /// Returns the size of the frames per hour over the last 24 series, bytes; `None` if there are fewer than two.
    pub fn bytes_per_hour(&self) -> Option<f64> {
        let lines: Vec<&SeriesOverview> = self.series.iter().rev().take(24).collect();
        let (last, first) = (
            lines.first()?.begun.as_ref()?,
            lines.last()?.begun.as_ref()?,
        );
        let hours = super::summary::hours_between(first, last);
        // The first series was recorded before this period.
        let bytes: u64 = lines.iter().rev().skip(1).map(|line| line.bytes).sum();
        (hours > 0.0).then(|| bytes as f64 / hours)
    }
}

/// Fields of a record that the pages need.
#[derive(Default, Deserialize)]
#[serde(default)]
struct ResultBrief {
    status: RecordStatus,
    global_test: Option<GlobalTest>,
    tip: Option<Tip>,
}

/// Result of a frame and its result set.
struct FrameResult {
    set: usize,
    frame: String,
    brief: ResultBrief,
}

impl FrameResult {
    fn is_ok(&self) -> bool {
        self.brief.status == RecordStatus::Ok
    }
}

/// Reads the overview of a flight. Damaged files are reported in `notes` and do not hide the rest.
pub fn read_overview(disk: &dyn Disk, flight: &FlightRef) -> StoreResult<FlightOverview> {
    let mut overview = FlightOverview {
        flight: flight.id.clone(),
        ..FlightOverview::default()
    };
    let mut grouper = ResultGrouper::default();
    let mut all = Vec::new();
    for series in catalogue::list_series(disk, flight)? {
        match catalogue::read_series_manifest(disk, &series) {
            Err(error) => overview.notes.push(error.to_string()),
            Ok(manifest) => {
                let results = read_frame_results(disk, &series, &mut grouper, &mut overview.notes);
                let shots = manifest
                    .shots
                    .iter()
                    .rev()
                    .filter(|shot| shot.frame.is_some());
                overview.last_frame = shots
                    .map(|s| s.stamp.clone())
                    .next()
                    .or(overview.last_frame);
                all.push((overview_of_manifest(manifest), results));
            }
        }
    }
    let sets: ResultSets = grouper.finish();
    let chosen = sets.choose_set(None).map(|set| set.index());
    overview.warning = sets.mixed_inputs_warning(&flight.id, None);
    let of_set = |results: &&FrameResult| results.is_ok() && Some(results.set) == chosen;
    let tips = all
        .iter()
        .flat_map(|(_, results)| results)
        .filter(of_set)
        .filter_map(|results| results.brief.tip.as_ref());
    overview.reference = Tip::most_precise_reference(tips);
    let counted = all
        .into_iter()
        .map(|(line, results)| summarize_results(line, &results, chosen, overview.reference));
    overview.series = counted.collect();
    Ok(overview)
}

fn overview_of_manifest(manifest: SeriesManifest) -> SeriesOverview {
    let begun = manifest.start_time();
    let frames = || manifest.shots.iter().filter_map(|shot| shot.frame.as_ref());
    SeriesOverview {
        begun,
        interrupted: manifest.state == SeriesState::Interrupted,
        planned: manifest.planned_shots as usize,
        frames: frames().count(),
        bytes: frames().map(|frame| frame.bytes).sum(),
        name: manifest.series,
        ..SeriesOverview::default()
    }
}

fn read_frame_results(
    disk: &dyn Disk,
    series: &SeriesRef,
    grouper: &mut ResultGrouper,
    notes: &mut Vec<String>,
) -> Vec<FrameResult> {
    let fields = ["status", "global_test", "tip"];
    let results = grouper.add_series(disk, series, &fields, |head| FrameResult {
        set: head.set,
        frame: head.frame,
        brief: serde_json::from_value(Value::Object(head.record)).unwrap_or_default(),
    });
    results.unwrap_or_else(|error| {
        notes.push(error.to_string());
        Vec::new()
    })
}

fn summarize_results(
    line: SeriesOverview,
    results: &[FrameResult],
    chosen: Option<usize>,
    reference: DeflectionReference,
) -> SeriesOverview {
    let in_set = results.iter().filter(|one| Some(one.set) == chosen);
    let latest: std::collections::BTreeMap<_, _> = in_set.map(|one| (&one.frame, one)).collect();
    let solved = || latest.values().filter(|s| s.is_ok());
    let tips = || solved().filter_map(|s| Some((s.frame.as_str(), s.brief.tip.as_ref()?)));
    let deflections: Vec<_> = tips()
        .filter_map(|(_, tip)| tip.deflection(reference))
        .collect();
    let (tip_deflection_m, greatest) = (
        Mean::from_values(&deflections),
        FrameDeflection::greatest(tips(), reference),
    );
    let passed = solved().filter(|s| s.brief.global_test != Some(GlobalTest::Rejected));
    let (passed, solved) = (passed.count(), solved().count());
    SeriesOverview {
        solved,
        passed,
        failed: latest.len() - solved,
        tip_deflection_m,
        greatest,
        ..line
    }
}
