//! Application of the prior from earlier flights (`flight_prior.json`) to the frames that are solved; no flight is counted
//! twice.

use super::{
    CorrectedObservations, ProcessedFrame, SolveJob, correct_refraction, mean_temperature,
    with_frame_conditions,
};
use crate::installation::Installation;
use crate::pipeline::guard::{PANIC_REASON, catch_panic};
use crate::record::Reason;
use wingd_measure::adjust;
use wingd_measure::adjust::Observation;
use wingd_measure::adjust::Options;
use wingd_measure::adjust::flight_prior::FlightContribution;
use wingd_measure::setup::Orientation;

/// Characters of a store's id that are shown; enough to identify it.
const STORE_ID_LENGTH: usize = 8;

/// Adds the flight prior to the options for these frames; returns remarks for frames of a flight that is part of the prior.
pub(super) fn with_flight_prior(
    options: Options,
    installation: &Installation,
    processed_frames: &[ProcessedFrame],
) -> (Options, Vec<String>) {
    let Some(prior) = &installation.flight_prior else {
        return (options, vec![]);
    };
    let frames: Vec<&str> = processed_frames
        .iter()
        .map(|s| s.digest.as_str())
        .filter(|d| !d.is_empty())
        .collect();
    let remark = |source: &crate::installation::PriorFlight| {
        let store: String = source.store.chars().take(STORE_ID_LENGTH).collect();
        format!(
            "flight {} (store {store}) is part of flight_prior.json; its own contribution is excluded here",
            source.flight
        )
    };
    let remarks = prior
        .flights_with_frames(&frames)
        .into_iter()
        .map(remark)
        .collect();
    (
        Options {
            flight_prior: prior.prior_without(&frames, &installation.setup),
            ..options
        },
        remarks,
    )
}

/// Frames of a flight, ready for the joint adjustment.
pub(super) struct PreparedFlight<'a> {
    /// Setup with the mean wing temperature of the frames.
    pub setup: wingd_measure::setup::Setup,
    /// Installation with the frame's air and temperature, for each frame.
    pub installations: Vec<std::borrow::Cow<'a, Installation>>,
    /// Observations without refraction, or the failure, of each frame.
    pub corrected: Vec<CorrectedObservations>,
    /// Observations of each frame that could be processed.
    pub frames: Vec<Vec<Observation>>,
    /// Options with the mountings of the processed frames.
    pub options: Options,
    /// Remarks for every frame.
    pub remarks: Vec<String>,
}

impl<'a> PreparedFlight<'a> {
    /// Prepares processed frames for the joint adjustment.
    pub fn new(
        processed_frames: &[ProcessedFrame],
        installation: &'a Installation,
        orientation: &Orientation,
        job: &SolveJob,
    ) -> Self {
        let installations: Vec<_> = processed_frames
            .iter()
            .map(|s| with_frame_conditions(s, installation))
            .collect();
        let corrected: Vec<_> = processed_frames
            .iter()
            .zip(&installations)
            .map(|(s, own)| correct_refraction(s, own, orientation))
            .collect();
        let mut setup = installation.setup.clone();
        mean_temperature(processed_frames).apply(&mut setup);
        let frames = corrected.iter().flatten().map(|(o, _)| o.clone()).collect();
        let succeeded = processed_frames
            .iter()
            .zip(&corrected)
            .filter(|(_, c)| c.is_ok());
        let mountings = succeeded.map(|(s, _)| s.mounting).collect();
        let (options, remarks) =
            with_flight_prior(job.options.clone(), installation, processed_frames);
        Self {
            setup,
            installations,
            corrected,
            frames,
            options: Options {
                mountings,
                ..options
            },
            remarks,
        }
    }
}

/// Computes a flight's contribution to the flight prior, given the contributions of the other flights, which it does not
/// repeat.
///
/// # Errors
/// Returns an error if the frames cannot be adjusted jointly or contradict the model.
pub fn learn_flight(
    processed_frames: &[ProcessedFrame],
    installation: &Installation,
    orientation: &Orientation,
    job: &SolveJob,
) -> Result<FlightContribution, Reason> {
    let PreparedFlight {
        setup,
        frames,
        options,
        ..
    } = PreparedFlight::new(processed_frames, installation, orientation, job);
    if frames.is_empty() {
        return Err("no frame of the flight shows enough markers".into());
    }
    let learned = catch_panic(|| adjust::learn_from_flight(&setup, orientation, &frames, &options));
    learned
        .ok_or_else(|| PANIC_REASON.into())
        .and_then(|contribution| contribution.map_err(Reason::from_error))
}
