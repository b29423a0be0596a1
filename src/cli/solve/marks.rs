//! Manual marks in the frames of a store.

use super::SolveArgs;
use crate::cli::Failure;
use crate::installation::{Installation, ManualObservation};
use crate::pipeline::manual_observations::observation_from_mark;
use crate::store::{FlightRef, Store, manual_marks};

/// Manual marks in the frames of a flight.
#[derive(Default)]
pub(super) struct FlightMarks {
    observations: Vec<ManualObservation>,
    /// Digest of all marks; `None` if there are none.
    pub digest: Option<String>,
}

impl FlightMarks {
    /// Reads the marks, unless `--no-marks` is given.
    pub fn read(
        args: &SolveArgs,
        store: &Store,
        flight: &FlightRef,
        installation: &Installation,
    ) -> Result<Self, Failure> {
        if args.no_marks {
            return Ok(Self::default());
        }
        let (all, notes) = manual_marks::read_marks(store.disk(), store.root(), flight)?;
        for note in notes {
            eprintln!("wingd: {note}");
        }
        let counting = manual_marks::effective_marks(&all);
        let observations: Vec<ManualObservation> =
            counting.iter().filter_map(|mark| observation_from_mark(mark, &installation.setup)).collect();
        if !counting.is_empty() {
            eprintln!("wingd: {}: using {} manual marks (--no-marks ignores them)", flight.id, observations.len());
        }
        if observations.len() < counting.len() {
            let unknown = counting.len() - observations.len();
            eprintln!("wingd: {}: {unknown} manual marks name markers that are not in this survey", flight.id);
        }
        Ok(Self { observations, digest: manual_marks::marks_digest(&all) })
    }

    /// Iterates over the marks of a frame, by its name in the flight.
    pub fn for_frame(&self, name: &str) -> impl Iterator<Item = &ManualObservation> {
        self.observations.iter().filter(move |point| point.image.as_deref() == Some(name))
    }
}
