//! From frame bytes and an installation to a record: decode, detect, identify, adjust.
//!
//! | stage | in | out | module |
//! |---|---|---|---|
//! | decode | bytes as delivered | grey picture | [`decode`] |
//! | measure | grey picture, installation | identified markers | [`measure`](self::stages) |
//! | adjust | identified markers | solution | [`crate::measure::adjust`] |
//! | orient | ground frames | orientation | [`orienting`] |
//! | mark | one picture and what a person says of it | the same, with that | [`marking`] |
//! | live | frames as they come | the same, one by one | [`live`] |
//! | record | solution | the line of the results | [`recording`] |
//!
//! Beside them, [`shrink`] makes a frame small enough to be shown, and [`guard`] stands about libraries that may panic.

pub mod decode;
mod flight_priors;
pub mod guard;
pub mod guided;
pub mod live;
mod located;
pub mod manual_observations;
pub mod marking;
pub mod orienting;
mod pane_shifts;
pub mod recording;
pub mod shrink;
pub mod stages;

use std::borrow::Cow;
use std::time::Instant;

use serde_json::{Map, Value};

use crate::aircraft;
use crate::camera::Format;
use crate::installation::Installation;
use crate::measure::adjust::{self, Estimate, Method, Observation, Options};
use crate::measure::environment::{FlightConditions, RefractionReport, correct_observations};
use crate::measure::setup::Orientation;
use crate::record::{ImageRecord, Parameters, Provenance, Reason};
use guard::{BROKE_OFF, guarded};

use flight_priors::Together;

pub use flight_priors::learn_flight;
pub use stages::{ProcessedFrame, Stage, Work};

/// What to compute.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// Profile or spatial; flight is asked for by [`solve_flight`].
    pub method: Method,
    /// Choices of the adjustment.
    pub options: Options,
}

impl Default for Job {
    fn default() -> Self {
        Self { method: Method::Spatial, options: Options::default() }
    }
}

impl Job {
    /// Parameters as they enter the provenance.
    fn parameters(&self) -> Parameters {
        Parameters::new(recording::method(self.method), &self.options)
    }
}

/// Solves one frame. Whatever goes wrong with the frame is in the record, with the mend; so is a panic.
pub fn solve_frame(
    name: &str,
    bytes: &[u8],
    format: Option<&Format>,
    installation: &Installation,
    orientation: &Orientation,
    job: &Job,
) -> ImageRecord {
    let solve = || {
        let sighting = stages::process_frame(name, bytes, format, installation, Some(orientation));
        solve_sighting(&sighting, installation, orientation, job)
    };
    let broken = || ProcessedFrame::failed(name, BROKE_OFF);
    guarded(solve).unwrap_or_else(|| recording::record(&broken(), installation, job, Err(BROKE_OFF.into())))
}

/// Adjusts what was seen in one frame.
pub fn solve_sighting(
    sighting: &ProcessedFrame,
    installation: &Installation,
    orientation: &Orientation,
    job: &Job,
) -> ImageRecord {
    let started = Instant::now();
    let installation = &*in_its_air(sighting, installation);
    let corrected = corrected(sighting, installation, orientation);
    let mountings = sighting.mounting.map(|m| vec![m]);
    let options = Options { mountings, ..job.options.clone() };
    let (options, remarks) = flight_priors::options(options, installation, std::slice::from_ref(sighting));
    let job = &Job { options, ..job.clone() };
    let outcome = corrected.and_then(|(observations, report)| {
        let solution = adjust_one(installation, orientation, &observations, job);
        solution.map(|s| (with_remarks(s, &remarks), report)).map_err(Reason::of)
    });
    let mut record = recording::record(sighting, installation, job, outcome);
    record.timing_ms.solve = Some(recording::milliseconds(Stage::ended(Work::Solve, started).ms));
    record
}

/// The installation with the air and the wing's temperature of a frame, where the aircraft's data have them.
fn in_its_air<'a>(sighting: &ProcessedFrame, installation: &'a Installation) -> Cow<'a, Installation> {
    if sighting.aircraft.is_empty() {
        return Cow::Borrowed(installation);
    }
    let mut own = installation.clone();
    aircraft::conditions(&sighting.aircraft).apply(&mut own.setup);
    Cow::Owned(own)
}

/// Where the air was measured, how far off the refraction may be.
fn with_sigma(
    report: RefractionReport,
    sighting: &ProcessedFrame,
    installation: &Installation,
) -> RefractionReport {
    let measured = installation.setup.window.as_ref().filter(|_| !sighting.aircraft.is_empty());
    let share = measured.map(|w| aircraft::conditions(&sighting.aircraft).relative_refraction_sigma(w));
    RefractionReport { sigma_max_shift_px: share.map(|s| s * report.max_shift_px.abs()), ..report }
}

/// The mean of what the wing's temperatures are over a flight, whose frames share one length.
fn mean_temperature(sightings: &[ProcessedFrame]) -> FlightConditions {
    let of = |s: &ProcessedFrame| aircraft::conditions(&s.aircraft).wing_temperature_c;
    let all: Vec<Estimate> = sightings.iter().filter_map(of).collect();
    let count = all.len() as f64;
    let mean = all.iter().map(|e| e.value).sum::<f64>() / count;
    let variance = all.iter().map(|e| (e.value - mean).powi(2)).sum::<f64>() / count;
    // One doubt of the structure for all frames, and how far they differ.
    let doubt = all.iter().filter_map(|e| e.sigma).fold(0.0, f64::max);
    let sigma = Some(doubt.hypot(variance.sqrt()));
    let wing_temperature_c = (count > 0.0).then_some(Estimate { value: mean, sigma });
    FlightConditions { wing_temperature_c, ..FlightConditions::default() }
}

/// Observations without the window's refraction, and what that was; or why there are none.
type Corrected = Result<(Vec<Observation>, Option<RefractionReport>), Reason>;

fn with_remarks(mut solution: adjust::Solution, remarks: &[String]) -> adjust::Solution {
    solution.remarks.extend_from_slice(remarks);
    solution
}

/// A sighting's observations without the window's refraction; the failure of a sighting that has none.
fn corrected(sighting: &ProcessedFrame, installation: &Installation, orientation: &Orientation) -> Corrected {
    if let Some(reason) = &sighting.failure {
        return Err(reason.clone());
    }
    let mut observations = sighting.observations.clone();
    let report = correct_observations(&installation.setup, orientation, &mut observations);
    let report = report.map(|report| report.map(|r| with_sigma(r, sighting, installation)));
    report.map(|report| (observations, report)).map_err(Reason::of)
}

fn adjust_one(
    installation: &Installation,
    orientation: &Orientation,
    observations: &[Observation],
    job: &Job,
) -> Result<adjust::Solution, adjust::AdjustError> {
    let setup = &installation.setup;
    match job.method {
        Method::Profile => adjust::profile(setup, orientation, observations, &job.options),
        Method::Spatial | Method::Flight => adjust::spatial(setup, orientation, observations, &job.options),
    }
}

/// Adjusts the frames of a flight together; one record per frame, in order. Frames that could not be
/// sighted fail alone.
pub fn solve_flight(
    sightings: &[ProcessedFrame],
    installation: &Installation,
    orientation: &Orientation,
    job: &Job,
) -> Vec<ImageRecord> {
    let started = Instant::now();
    let job = Job { method: Method::Flight, ..job.clone() };
    let together = Together::new(sightings, installation, orientation, &job);
    let Together { setup, airs, corrected, frames, options, remarks } = together;
    let solved = guarded(|| adjust::flight(&setup, orientation, &frames, &options));
    let solved = solved.ok_or_else(|| BROKE_OFF.into()).and_then(|s| s.map_err(Reason::of));
    let mut solutions = match solved {
        Ok(solutions) => solutions.into_iter().map(Ok).collect::<Vec<_>>(),
        Err(reason) => vec![Err(reason); frames.len()],
    }
    .into_iter();
    let solve_ms = 1e3 * started.elapsed().as_secs_f64() / frames.len().max(1) as f64;
    let mut records = vec![];
    for ((sighting, corrected), own) in sightings.iter().zip(corrected).zip(&airs) {
        let outcome = corrected.and_then(|(_, report)| {
            let left_out = || Err("the flight adjustment left this frame out".into());
            solutions.next().unwrap_or_else(left_out).map(|s| (with_remarks(s, &remarks), report))
        });
        let mut record = recording::record(sighting, own, &job, outcome);
        record.flight = true;
        record.timing_ms.solve = Some(recording::milliseconds(solve_ms));
        records.push(record);
    }
    pane_shifts::name(&mut records, setup.lens.focal_px());
    records
}

/// Hashes and versions that a result stands on.
pub fn provenance(installation: &Installation, job: &Job) -> Provenance {
    let file = |(name, digest): &(String, String)| (format!("{name}.sha256"), digest.clone().into());
    Provenance {
        program: Some(format!("wingd {}", env!("CARGO_PKG_VERSION"))),
        files: installation.digests.iter().map(file).collect(),
        parameters: Some(job.parameters()),
        frame_sha256: None,
    }
}

/// The same as the store keeps it.
pub fn inputs(installation: &Installation, job: &Job) -> Map<String, Value> {
    match serde_json::to_value(provenance(installation, job)) {
        Ok(Value::Object(map)) => map,
        _ => Map::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decoder_that_breaks_costs_one_record_that_says_so() {
        let fixture = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev/installation");
        let installation = crate::installation::load_without_orientation(&fixture).unwrap();
        let camera_from_survey = nalgebra::Rotation3::identity();
        let orientation = Orientation { camera_from_survey, covariance_rad2: None, ground: vec![] };
        for format in [None, Some(Format::Jpeg)] {
            let bytes = decode::BREAKS;
            let record =
                solve_frame("one.jpg", bytes, format.as_ref(), &installation, &orientation, &Job::default());
            assert_eq!((record.image.as_str(), record.status), ("one.jpg", crate::record::Status::Failed));
            assert!(record.reason.as_ref().is_some_and(|r| r.contains("decoder broke off")), "{record:?}");
            assert_eq!(record.markers.len(), installation.setup.markers.len());
        }
    }
}
