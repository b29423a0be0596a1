//! Manual marks in the frames of a store.

use std::path::Path;

use crate::installation::ManualObservation;
use crate::pipeline::manual_observations::observation_from_mark;
use wingd_measure::setup::Setup;
use wingd_store::{Disk, FlightRef, StoreResult, manual_marks};

/// Manual marks in the frames of a flight.
#[derive(Default)]
pub struct FlightMarks {
    observations: Vec<ManualObservation>,
    /// Digest of all marks; `None` if there are none.
    pub digest: Option<String>,
    /// Notes on the marks.
    pub notes: Vec<String>,
}

impl FlightMarks {
    /// Reads the marks.
    pub fn read(
        disk: &dyn Disk,
        root: &Path,
        flight: &FlightRef,
        setup: &Setup,
    ) -> StoreResult<Self> {
        let (all, mut notes) = manual_marks::read_marks(disk, root, flight)?;
        let counting = manual_marks::effective_marks(&all);
        let observations: Vec<ManualObservation> = counting
            .iter()
            .filter_map(|mark| observation_from_mark(mark, setup))
            .collect();
        let (flight, used) = (&flight.id, observations.len());
        if !counting.is_empty() {
            notes.push(format!(
                "{flight}: using {used} manual marks (--no-marks ignores them)"
            ));
        }
        if used < counting.len() {
            let unknown = counting.len() - used;
            notes.push(format!(
                "{flight}: {unknown} manual marks name markers that are not in this survey"
            ));
        }
        Ok(Self {
            observations,
            digest: manual_marks::marks_digest(&all),
            notes,
        })
    }

    /// Iterates over the marks of a frame, by its name in the flight.
    pub fn for_frame(&self, name: &str) -> impl Iterator<Item = &ManualObservation> {
        self.observations
            .iter()
            .filter(move |point| point.image.as_deref() == Some(name))
    }
}
