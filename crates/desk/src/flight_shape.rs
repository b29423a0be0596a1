//! Joint shape of a stored flight, by the adjustment that its results came from.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Map, Value};

use wingd_base::failure::{Failure, TaskResult};
use wingd_base::output::print_notes;
use wingd_evaluation::inputs::batch;
use wingd_evaluation::inputs::flight_marks::FlightMarks;
use wingd_evaluation::inputs::stored_flights;
use wingd_evaluation::inputs::stored_frames;
use wingd_evaluation::inputs::stored_frames::{FlightAircraftData, FlightInputs};
use wingd_evaluation::installation::{self, Installation};
use wingd_evaluation::pipeline::{self, ProcessedFrame, SolveJob, SolvedShape};
use wingd_evaluation::record::{Parameters, Reason};
use wingd_measure::adjust::AdjustmentMethod;
use wingd_measure::adjust::StationChoice;
use wingd_store::result_sets::{self, ResultSet};
use wingd_store::{FlightRef, FrameRef, RealDisk};

/// Joint shape of a flight, or one shape per frame if its frames were adjusted singly.
pub struct FlightShape {
    pub installation: Installation,
    /// Frames of the flight, in order.
    pub frames: Vec<FrameRef>,
    pub processed: Vec<ProcessedFrame>,
    pub shapes: Vec<SolvedShape>,
    /// True if the frames were adjusted jointly.
    pub jointly: bool,
    /// Inputs of the results.
    pub provenance: Map<String, Value>,
    /// Results of the frames.
    pub results: ResultSet,
}

impl FlightShape {
    /// Returns whether each frame has a shape.
    pub fn is_complete(&self) -> bool {
        let with_shape = self.shapes.iter().map(|one| one.frames.len());
        with_shape.sum::<usize>() == self.frames.len()
    }
}

/// Selects the results of a flight by the first characters of their key; by default the newest complete ones.
#[derive(Clone, Copy)]
pub struct ShapeSource<'a> {
    pub store: &'a Path,
    pub flight: &'a FlightRef,
    pub inputs: Option<&'a str>,
    /// Installation, if not the one kept in the store.
    pub installation: Option<&'a Path>,
}

impl ShapeSource<'_> {
    /// Adjusts the frames again with the inputs and parameters of their results, and returns the shape with its covariance.
    /// Prints the frames that have none.
    ///
    /// # Errors
    /// Returns an error if the flight has no results of the spatial method, or they have other inputs than those at hand.
    pub fn solve(&self, stations: &StationChoice) -> TaskResult<FlightShape> {
        let flight = &self.flight.id;
        let failed = |what: String| Failure::Failed(format!("{flight}: {what}"));
        let sets = result_sets::flight_result_sets(&RealDisk, self.flight)?;
        let set = sets.choose_set(self.inputs);
        let set = set.ok_or_else(|| {
            failed("has no such results; run `wingd solve` on the store first".into())
        })?;
        print_notes(sets.mixed_inputs_warning(flight, self.inputs));
        let parameters = set
            .provenance
            .get("parameters")
            .cloned()
            .map(serde_json::from_value::<Parameters>);
        let parameters = parameters.and_then(Result::ok).unwrap_or_default();
        if parameters.method == Some(AdjustmentMethod::Profile) {
            let what = "was solved with the profile method, which has no sections; run `wingd solve` with --method spatial";
            return Err(failed(what.into()));
        }
        let directory =
            stored_flights::flight_installation(self.installation, self.store, self.flight)?;
        let installation = installation::load(&directory)?;
        let orientation = installation.require_orientation()?;
        let jointly = set.provenance.contains_key("frames_together");
        let known = FlightInputs {
            installation: &installation,
            orientation,
            aircraft: match set.provenance.contains_key("aircraft_data") {
                true => FlightAircraftData::read(&RealDisk, self.store, self.flight)?,
                false => FlightAircraftData::default(),
            },
            marks: match set.provenance.contains_key("marks") {
                true => FlightMarks::read(&RealDisk, self.store, self.flight, &installation.setup)?,
                false => FlightMarks::default(),
            },
            mountings: match jointly {
                true => stored_frames::frame_mountings(&RealDisk, self.flight)?,
                false => BTreeMap::new(),
            },
        };
        let frames = stored_flights::flight_frames(&RealDisk, self.flight, None)?;
        let job = SolveJob {
            method: AdjustmentMethod::Spatial,
            options: parameters.options(),
        };
        let provenance = known.provenance(&job, jointly.then_some(&frames));
        let differs = |key: &&String| provenance.get(*key) != set.provenance.get(*key);
        let mut others: Vec<&String> = provenance
            .keys()
            .chain(set.provenance.keys())
            .filter(differs)
            .collect();
        others.dedup();
        if let Some(first) = others.first() {
            let what = format!(
                "its results (inputs {}) are from another {first}; run `wingd solve` on the store first, or name the \
                 installation with --installation",
                set.short_key()
            );
            return Err(failed(what));
        }
        let mut processed = Vec::with_capacity(frames.len());
        let process =
            |frame: &FrameRef, bytes: Result<&[u8], Reason>| known.process_frame(frame, bytes);
        batch::for_each_stored_frame(
            &frames,
            0,
            "measuring",
            process,
            batch::collect_into(&mut processed),
        )?;
        let (shapes, without) = pipeline::solve_shapes(
            &processed,
            &installation,
            orientation,
            &job,
            (jointly, stations),
        );
        print_notes(
            without
                .iter()
                .map(|(k, reason)| format!("{flight}/{}: {reason}", processed[*k].image)),
        );
        if shapes.is_empty() {
            return Err(failed("no frame has a shape".into()));
        }
        Ok(FlightShape {
            installation,
            frames,
            processed,
            shapes,
            jointly,
            provenance,
            results: set.clone(),
        })
    }
}
