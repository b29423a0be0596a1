//! What earlier flights taught, beside the frames that are solved: no flight is counted twice.

use super::{Corrected, Job, ProcessedFrame, corrected, in_its_air, mean_temperature};
use crate::installation::Installation;
use crate::measure::adjust::flight_prior::FlightContribution;
use crate::measure::adjust::{self, Method, Observation, Options};
use crate::measure::setup::Orientation;
use crate::pipeline::guard::{BROKE_OFF, guarded};
use crate::record::Reason;

/// So much of a store's id tells it from others, characters.
const STORE_SHOWN: usize = 8;

/// Options for the adjustment of these frames, and what is to be said where they are of a flight that taught.
pub(super) fn options(
    options: Options,
    installation: &Installation,
    sightings: &[ProcessedFrame],
) -> (Options, Vec<String>) {
    let Some(learnt) = &installation.learnt else { return (options, vec![]) };
    let frames: Vec<&str> = sightings.iter().map(|s| s.digest.as_str()).filter(|d| !d.is_empty()).collect();
    let said = |source: &crate::installation::Source| {
        let store: String = source.store.chars().take(STORE_SHOWN).collect();
        format!(
            "{} of store {store} is among the flights that taught: what it told itself is left out",
            source.flight
        )
    };
    let remarks = learnt.sources_of(&frames).into_iter().map(said).collect();
    (Options { flight_prior: learnt.beside(&frames, &installation.setup), ..options }, remarks)
}

/// The frames of a flight, ready to be adjusted together.
pub(super) struct Together<'a> {
    /// With the mean of its temperatures.
    pub setup: crate::measure::setup::Setup,
    /// Per frame.
    pub airs: Vec<std::borrow::Cow<'a, Installation>>,
    /// Per frame.
    pub corrected: Vec<Corrected>,
    /// Of those that were sighted.
    pub frames: Vec<Vec<Observation>>,
    /// With their mountings.
    pub options: Options,
    /// What is to be said of each.
    pub remarks: Vec<String>,
}

impl<'a> Together<'a> {
    /// Of what was seen in them.
    pub fn new(
        sightings: &[ProcessedFrame],
        installation: &'a Installation,
        orientation: &Orientation,
        job: &Job,
    ) -> Self {
        let airs: Vec<_> = sightings.iter().map(|s| in_its_air(s, installation)).collect();
        let corrected: Vec<_> =
            sightings.iter().zip(&airs).map(|(s, own)| corrected(s, own, orientation)).collect();
        let mut setup = installation.setup.clone();
        mean_temperature(sightings).apply(&mut setup);
        let frames = corrected.iter().flatten().map(|(o, _)| o.clone()).collect();
        let sighted = sightings.iter().zip(&corrected).filter(|(_, c)| c.is_ok());
        let mountings = sighted.map(|(s, _)| s.mounting).collect();
        let (options, remarks) = options(job.options.clone(), installation, sightings);
        Self { setup, airs, corrected, frames, options: Options { mountings, ..options }, remarks }
    }
}

/// What a flight's frames tell later ones; beside what other flights taught already, which it does not repeat.
///
/// # Errors
/// Where the frames cannot be adjusted together, or contradict the model.
pub fn learn_flight(
    sightings: &[ProcessedFrame],
    installation: &Installation,
    orientation: &Orientation,
    job: &Job,
) -> Result<FlightContribution, Reason> {
    let job = Job { method: Method::Flight, ..job.clone() };
    let Together { setup, frames, options, .. } = Together::new(sightings, installation, orientation, &job);
    if frames.is_empty() {
        return Err("none of its frames shows enough markers".into());
    }
    let learnt = guarded(|| adjust::learn(&setup, orientation, &frames, &options));
    learnt.ok_or_else(|| BROKE_OFF.into()).and_then(|lesson| lesson.map_err(Reason::of))
}
