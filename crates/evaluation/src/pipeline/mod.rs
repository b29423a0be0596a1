//! Processing of a frame from its bytes to a record: decode, detect, identify, adjust.
//!
//! | stage | in | out | module |
//! |---|---|---|---|
//! | decode | bytes as delivered | grey image | [`decode`] |
//! | measure | grey image, installation | identified markers | [`stages`], [`wingd_measure::view`] |
//! | adjust | identified markers | solution | [`wingd_measure::adjust`] |
//! | orient | ground frames | orientation | [`orienting`] |
//! | mark | image, manual marks | solution with the marks | [`marking`] |
//! | shape | identified markers of a flight | joint shape with covariance (`shapes.rs`) |
//! | live | frames as they arrive | one solution per frame | [`live`] |
//! | record | solution | line of the results | [`recording`] |
//!
//! [`shrink`] makes a frame small enough for display, and [`guard`] is the boundary around libraries that may panic.

mod correlation;
pub mod curvature;
pub mod decode;
mod flight_priors;
pub mod guard;
pub mod live;
pub mod manual_observations;
pub mod marking;
pub mod orienting;
mod pane_shifts;
pub mod recording;
mod shapes;
pub mod shrink;
pub mod stages;
mod timing;

use std::borrow::Cow;
use std::time::Instant;

use serde_json::{Map, Value};

use crate::aircraft;
use crate::frame_format::Format;
use crate::installation::Installation;
use crate::record::{ImageRecord, Parameters, Provenance, Reason, RecordStatus};
use guard::{PANIC_REASON, catch_panic};
use wingd_measure::adjust;
use wingd_measure::adjust::{AdjustmentMethod, Options};
use wingd_measure::adjust::{Estimate, Observation};
use wingd_measure::environment::FlightConditions;
use wingd_measure::environment::{RefractionReport, correct_observations};
use wingd_measure::estimation::quality::GlobalTest;
use wingd_measure::identify;
use wingd_measure::identify::Diagnosis;
use wingd_measure::identify::Identities;
use wingd_measure::identify::SizedShape;
use wingd_measure::identify::WingView;
use wingd_measure::setup::{Orientation, Setup, Shape};

use flight_priors::PreparedFlight;

pub use flight_priors::learn_flight;
pub use shapes::{SolvedShape, solve_shapes};
pub use stages::{ProcessedFrame, StageTime};
pub use wingd_measure::view::Work;

/// Method and options of a computation.
#[derive(Clone, Debug, PartialEq)]
pub struct SolveJob {
    /// Deflection model; a flight's frames are adjusted jointly with the spatial one.
    pub method: AdjustmentMethod,
    /// Options of the adjustment.
    pub options: Options,
}

impl Default for SolveJob {
    fn default() -> Self {
        Self {
            method: AdjustmentMethod::Spatial,
            options: Options::default(),
        }
    }
}

impl SolveJob {
    /// Returns the parameters for the provenance.
    fn parameters(&self) -> Parameters {
        Parameters::new(Some(self.method), &self.options)
    }
}

/// Solves one frame. Errors and panics are reported in the record, with the remedy.
pub fn solve_frame(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
    installation: &Installation,
    orientation: &Orientation,
    job: &SolveJob,
) -> ImageRecord {
    let solve = || {
        let processed =
            stages::process_frame(name, bytes, format, &installation.setup, Some(orientation));
        solve_processed_frame(&processed, installation, orientation, job)
    };
    let broken = || ProcessedFrame::failed(name, PANIC_REASON);
    catch_panic(solve).unwrap_or_else(|| {
        recording::build_record(&broken(), installation, job, Err(PANIC_REASON.into()))
    })
}

/// Adjusts the observations of one processed frame.
pub fn solve_processed_frame(
    processed: &ProcessedFrame,
    installation: &Installation,
    orientation: &Orientation,
    job: &SolveJob,
) -> ImageRecord {
    let started = Instant::now();
    let installation = &*with_frame_conditions(processed, installation);
    let corrected = correct_refraction(processed, installation, orientation);
    let (options, remarks) = single_frame_options(processed, installation, job);
    let job = &SolveJob {
        options,
        ..job.clone()
    };
    let outcome = corrected.and_then(|(observations, report)| {
        let solution = adjust_single_frame(installation, orientation, &observations, job);
        solution
            .map(|s| (append_remarks(s, &remarks), report))
            .map_err(Reason::from_adjustment)
    });
    let problem = adjustment_problem(&outcome);
    let mut record = recording::build_record(processed, installation, job, outcome);
    add_diagnosis(&mut record, problem, processed, (installation, orientation));
    record.timing_ms.solve = Some(recording::round_ms(
        StageTime::since(Work::Solve, started).ms,
    ));
    record
}

/// Options of a frame that is adjusted alone, with its mounting and the prior from other flights; and remarks.
fn single_frame_options(
    processed: &ProcessedFrame,
    installation: &Installation,
    job: &SolveJob,
) -> (Options, Vec<String>) {
    let mountings = processed.mounting.map(|m| vec![m]);
    let options = Options {
        mountings,
        ..job.options.clone()
    };
    flight_priors::with_flight_prior(options, installation, std::slice::from_ref(processed))
}

/// Returns the message of an adjustment that failed, without its general remedy.
fn adjustment_problem<T>(outcome: &Result<T, Reason>) -> Option<String> {
    Some(outcome.as_ref().err()?.problem().to_owned())
}

/// Standard deviations of markers' sizes from which they are diagnosed: 0.1 % after the number of causes.
const MAX_SIZE_SIGMAS: f64 = 4.0;

/// Number of removed images of a frame from which a cause is diagnosed: in sound ones 1 of 500.
const SUSPECT_REMOVALS: usize = 2;

/// Adds the cause to the reason of a doubtful or failed result. A result becomes doubtful if a diagnosis finds a cause and its
/// test rejects it, several images were removed, or markers have another size than their distances predict.
fn add_diagnosis(
    record: &mut ImageRecord,
    problem: Option<String>,
    processed: &ProcessedFrame,
    (installation, orientation): (&Installation, &Orientation),
) {
    let setup = &installation.setup;
    let size = || {
        let identities = processed.identities.as_ref()?;
        WingView::in_flight(setup, orientation)
            .log_size_ratio(&processed.detections.markers, identities)
    };
    let is_off = |e: Estimate| {
        e.sigma
            .is_some_and(|sigma| e.value.abs() > MAX_SIZE_SIGMAS * sigma)
    };
    let is_needed = match record.status {
        RecordStatus::Ok if record.global_test == Some(GlobalTest::Rejected) => true,
        RecordStatus::Ok if record.counted => false,
        RecordStatus::Ok => {
            let used = record.markers.iter().filter(|marker| marker.used).count();
            let removes_several = used + SUSPECT_REMOVALS <= processed.observations.len();
            removes_several || size().is_some_and(is_off)
        }
        // Markers that are named, but could not be adjusted.
        RecordStatus::Failed => !processed.observations.is_empty(),
        RecordStatus::Doubtful => record.cause.is_none(),
    };
    if !is_needed {
        return;
    }
    let is_used = |marker: usize| record.markers.get(marker).is_some_and(|m| m.used);
    let is_ok = record.status == RecordStatus::Ok;
    record.cause = match diagnose_frame(processed, setup, orientation) {
        Err(cause) => cause,
        Ok(found) if is_ok && found.concerns_unused_markers(is_used) => None,
        Ok(found) => found.text(),
    };
    match (&record.cause, &mut record.reason) {
        (Some(cause), _) if is_ok => {
            record.status = RecordStatus::Doubtful;
            record.reason = Some(cause.clone());
        }
        (Some(cause), Some(reason)) => {
            // The cause replaces the general remedy of an adjustment that failed.
            *reason = format!("{}; {cause}", problem.as_deref().unwrap_or(reason));
        }
        (None, Some(reason)) if record.status == RecordStatus::Doubtful => {
            reason.push_str("; no single cause explains it: see residuals and remarks");
        }
        _ => {}
    }
}

/// Diagnoses the observations of a frame in flight.
///
/// # Errors
/// Returns a cause that hides the identities, if one is found, in a frame without most of them.
pub fn diagnose_frame(
    processed: &ProcessedFrame,
    setup: &Setup,
    orientation: &Orientation,
) -> Result<Diagnosis, Option<String>> {
    let detections = &processed.detections.markers;
    let identified = processed
        .identities
        .as_ref()
        .map_or(0, Identities::count_named);
    if 3 * identified < 2 * detections.len().min(setup.markers.len()) && processed.manual.is_empty()
    {
        return Err(WingView::in_flight(setup, orientation).diagnose_frame(detections));
    }
    let (observations, outlines) = outlined_observations(processed);
    identify::diagnose_observations(setup, Some(orientation), observations, &outlines).ok_or(None)
}

/// Returns the observations with kind and semi-major axis, px, of each that was not marked manually.
fn outlined_observations(processed: &ProcessedFrame) -> (&[Observation], Vec<Option<SizedShape>>) {
    let identities = processed.identities.as_ref();
    let detection = |marker: usize| {
        let at = identities?
            .marker_of
            .iter()
            .position(|m| *m == Some(marker))?;
        processed.detections.markers.get(at)
    };
    let is_manual = |marker: usize| processed.manual.iter().any(|(other, _)| *other == marker);
    let outline = |o: &Observation| {
        let found =
            detection(o.marker).filter(|d| d.shape != Shape::Point && !is_manual(o.marker))?;
        Some((found.shape, Some(found.semi_major_px)))
    };
    (
        &processed.observations,
        processed.observations.iter().map(outline).collect(),
    )
}

/// Returns the installation with the air and wing temperature at the time of the frame, if the aircraft data have them.
fn with_frame_conditions<'a>(
    processed: &ProcessedFrame,
    installation: &'a Installation,
) -> Cow<'a, Installation> {
    if processed.aircraft.is_empty() {
        return Cow::Borrowed(installation);
    }
    let mut own = installation.clone();
    aircraft::flight_conditions(&processed.aircraft).apply(&mut own.setup);
    Cow::Owned(own)
}

/// Adds the standard deviation of the refraction if the air was measured.
fn with_refraction_sigma(
    report: RefractionReport,
    processed: &ProcessedFrame,
    installation: &Installation,
) -> RefractionReport {
    let measured = installation
        .setup
        .window
        .as_ref()
        .filter(|_| !processed.aircraft.is_empty());
    let share = measured
        .map(|w| aircraft::flight_conditions(&processed.aircraft).relative_refraction_sigma(w));
    RefractionReport {
        sigma_max_shift_px: share.map(|s| s * report.max_shift_px.abs()),
        ..report
    }
}

/// Computes the mean wing temperature over a flight, whose frames share one length.
fn mean_temperature(processed_frames: &[ProcessedFrame]) -> FlightConditions {
    let of = |s: &ProcessedFrame| aircraft::flight_conditions(&s.aircraft).wing_temperature_c;
    let all: Vec<Estimate> = processed_frames.iter().filter_map(of).collect();
    let count = all.len() as f64;
    let mean = all.iter().map(|e| e.value).sum::<f64>() / count;
    let variance = all.iter().map(|e| (e.value - mean).powi(2)).sum::<f64>() / count;
    // One uncertainty of the structure's temperature for all frames, and their scatter.
    let structure_sigma = all.iter().filter_map(|e| e.sigma).fold(0.0, f64::max);
    let sigma = Some(structure_sigma.hypot(variance.sqrt()));
    let wing_temperature_c = (count > 0.0).then_some(Estimate { value: mean, sigma });
    FlightConditions {
        wing_temperature_c,
        ..FlightConditions::default()
    }
}

/// Observations without the window's refraction and the correction applied, or the reason why there are none.
type CorrectedObservations = Result<(Vec<Observation>, Option<RefractionReport>), Reason>;

fn append_remarks(mut solution: adjust::Solution, remarks: &[String]) -> adjust::Solution {
    solution.remarks.extend_from_slice(remarks);
    solution
}

/// Removes the window's refraction from a frame's observations; a failed frame returns its failure.
fn correct_refraction(
    processed: &ProcessedFrame,
    installation: &Installation,
    orientation: &Orientation,
) -> CorrectedObservations {
    if let Some(reason) = &processed.failure {
        return Err(reason.clone());
    }
    let mut observations = processed.observations.clone();
    let report = correct_observations(&installation.setup, orientation, &mut observations)
        .map_err(Reason::from_error)?;
    let with_sigma = |r| with_refraction_sigma(r, processed, installation);
    Ok((observations, report.map(with_sigma)))
}

fn adjust_single_frame(
    installation: &Installation,
    orientation: &Orientation,
    observations: &[Observation],
    job: &SolveJob,
) -> Result<adjust::Solution, adjust::AdjustError> {
    let adjust = match job.method {
        AdjustmentMethod::Profile => adjust::solve_profile,
        AdjustmentMethod::Spatial => adjust::solve_spatial,
    };
    let setup = &installation.setup;
    adjust(setup, orientation, observations, &job.options)
}

/// Adjusts the frames of a flight jointly; returns one record per frame, in order. Frames that could not be processed fail
/// individually.
pub fn solve_flight(
    processed_frames: &[ProcessedFrame],
    installation: &Installation,
    orientation: &Orientation,
    job: &SolveJob,
) -> Vec<ImageRecord> {
    let started = Instant::now();
    let job = SolveJob {
        method: AdjustmentMethod::Spatial,
        ..job.clone()
    };
    let together = PreparedFlight::new(processed_frames, installation, orientation, &job);
    let PreparedFlight {
        setup,
        installations,
        corrected,
        frames,
        options,
        remarks,
    } = together;
    let solved = catch_panic(|| adjust::solve_flight(&setup, orientation, &frames, &options));
    let solved = solved
        .ok_or_else(|| PANIC_REASON.into())
        .and_then(|s| s.map_err(Reason::from_adjustment));
    let mut solutions = match solved {
        Ok(solutions) => solutions.into_iter().map(Ok).collect::<Vec<_>>(),
        Err(reason) => vec![Err(reason); frames.len()],
    }
    .into_iter();
    let solve_ms = 1e3 * started.elapsed().as_secs_f64() / frames.len().max(1) as f64;
    let mut records = vec![];
    for ((processed, corrected), own) in processed_frames.iter().zip(corrected).zip(&installations)
    {
        let outcome = corrected.and_then(|(_, report)| {
            let excluded = || Err("the flight adjustment omitted this frame".into());
            solutions
                .next()
                .unwrap_or_else(excluded)
                .map(|s| (append_remarks(s, &remarks), report))
        });
        let problem = adjustment_problem(&outcome);
        let mut record = recording::build_record(processed, own, &job, outcome);
        add_diagnosis(&mut record, problem, processed, (own, orientation));
        record.flight = true;
        record.timing_ms.solve = Some(recording::round_ms(solve_ms));
        records.push(record);
    }
    pane_shifts::remark_pane_shifts(&mut records, setup.lens.focal_px());
    records
}

/// Returns the hashes and versions that a result depends on.
pub fn provenance(installation: &Installation, job: &SolveJob) -> Provenance {
    let file =
        |(name, digest): &(String, String)| (format!("{name}.sha256"), digest.clone().into());
    Provenance {
        program: Some(format!("wingd {}", env!("CARGO_PKG_VERSION"))),
        files: installation.digests.iter().map(file).collect(),
        parameters: Some(job.parameters()),
        frame_sha256: None,
    }
}

/// Returns the provenance as a map, as the store keeps it.
pub fn provenance_map(installation: &Installation, job: &SolveJob) -> Map<String, Value> {
    match serde_json::to_value(provenance(installation, job)) {
        Ok(Value::Object(map)) => map,
        _ => Map::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decoder_crash_costs_one_record_that_reports_it() {
        let fixture = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../fixtures/dev/installation");
        let installation = crate::installation::load_without_orientation(&fixture).unwrap();
        let camera_from_survey = nalgebra::Rotation3::identity();
        let orientation = Orientation::from_rotation(camera_from_survey);
        for format in [None, Some(Format::Jpeg)] {
            let bytes = decode::BREAKS;
            let record = solve_frame(
                "one.jpg",
                bytes,
                format.as_ref(),
                &installation,
                &orientation,
                &SolveJob::default(),
            );
            assert_eq!(
                (record.image.as_str(), record.status),
                ("one.jpg", crate::record::RecordStatus::Failed)
            );
            assert!(
                record
                    .reason
                    .as_ref()
                    .is_some_and(|r| r.contains("decoder failed")),
                "{record:?}"
            );
            assert_eq!(record.markers.len(), installation.setup.markers.len());
        }
    }
}
