//! What people marked in the frames of a store.

use super::Args;
use crate::cli::Failure;
use crate::installation::{Installation, ManualObservation};
use crate::pipeline::manual_observations::observation;
use crate::store::{FlightRef, Store, marks};

/// What people marked in the frames of a flight.
#[derive(Default)]
pub(super) struct Marks {
    said: Vec<ManualObservation>,
    /// Over all of it; `None` where there is none.
    pub digest: Option<String>,
}

impl Marks {
    /// Reads them, where they are wanted.
    pub fn read(
        args: &Args,
        store: &Store,
        flight: &FlightRef,
        installation: &Installation,
    ) -> Result<Self, Failure> {
        if args.no_marks {
            return Ok(Self::default());
        }
        let (all, notes) = marks::read(store.disk(), store.root(), flight)?;
        for note in notes {
            eprintln!("wingd: {note}");
        }
        let counting = marks::standing(&all);
        let said: Vec<ManualObservation> =
            counting.iter().filter_map(|mark| observation(mark, &installation.setup)).collect();
        if !counting.is_empty() {
            eprintln!(
                "wingd: {}: {} marks by hand are used (--no-marks leaves them out)",
                flight.id,
                said.len()
            );
        }
        if said.len() < counting.len() {
            let strange = counting.len() - said.len();
            eprintln!("wingd: {}: {strange} marks are of markers that this survey does not have", flight.id);
        }
        Ok(Self { said, digest: marks::digest(&all) })
    }

    /// Those of a frame, by its name in the flight.
    pub fn of(&self, name: &str) -> impl Iterator<Item = &ManualObservation> {
        self.said.iter().filter(move |said| said.image.as_deref() == Some(name))
    }
}
