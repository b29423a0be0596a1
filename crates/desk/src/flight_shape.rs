//! Joint shape of a stored flight, by the adjustment that its results came from.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use wingd_base::failure::{Failure, TaskResult};
use wingd_base::output::print_notes;
use wingd_evaluation::aircraft::{FlightCondition, Quantity};
use wingd_evaluation::inputs::batch;
use wingd_evaluation::inputs::flight_marks::FlightMarks;
use wingd_evaluation::inputs::stored_flights;
use wingd_evaluation::inputs::stored_frames;
use wingd_evaluation::inputs::stored_frames::{FlightAircraftData, FlightInputs};
use wingd_evaluation::installation::{self, Installation};
use wingd_evaluation::pipeline::{self, ProcessedFrame, SolveJob, SolvedShape};
use wingd_evaluation::record::{Parameters, Reason};
use wingd_measure::adjust::AdjustmentMethod;
use wingd_measure::adjust::GlobalTest;
use wingd_measure::adjust::{CommonErrors, ShapeMean};
use wingd_measure::adjust::{JointShape, StationChoice};
use wingd_measure::observation::Estimate;
use wingd_measure::setup::WingSide;
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

/// Options of commands that average frames.
#[derive(Default, clap::Args)]
pub struct MeanOptions {
    /// Frames to average by their aircraft data: `mach between 0.78 and 0.80 and weight_kg < 190000`
    #[arg(long = "where", value_name = "CONDITIONS")]
    pub conditions: Option<String>,
    /// Results to use if a flight was solved with several inputs: first characters of their key [default: newest complete
    /// solve]
    #[arg(long, value_name = "KEY")]
    pub inputs: Option<String>,
    /// Stations as fractions of the length to the tip [default: 0.1, 0.2, ... 1]
    #[arg(long, value_name = "ETA,ETA", value_delimiter = ',')]
    pub eta: Option<Vec<f64>>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
    /// Show all columns of the tables [default: those that fit 80 characters]
    #[arg(long)]
    pub wide: bool,
}

impl MeanOptions {
    fn conditions(&self) -> TaskResult<Vec<FlightCondition>> {
        let parsed = self.conditions.as_deref().map(FlightCondition::parse_all);
        let conditions = parsed
            .transpose()
            .map_err(|e| Failure::Usage(format!("--where: {e}")))?;
        Ok(conditions.unwrap_or_default())
    }

    /// Returns the stations as given, or at tenths of the length.
    pub fn stations(&self) -> TaskResult<StationChoice> {
        let etas = self
            .eta
            .clone()
            .unwrap_or_else(|| (1..=10).map(|k| f64::from(k) / 10.0).collect());
        match etas.iter().all(|eta| (0.0..=1.0).contains(eta)) {
            true => Ok(StationChoice::Fractions(etas)),
            false => Err(Failure::Usage(
                "--eta takes fractions of the length, 0 to 1".into(),
            )),
        }
    }
}

/// Frames of a store, named as `STORE`, `STORE:FLIGHT`, `STORE:FLIGHT/SERIES` or `STORE:FLIGHT/SERIES/FRAME`.
#[derive(Clone, Debug)]
pub struct FrameSelection {
    /// Text as given.
    text: String,
    store: PathBuf,
    flight: Option<String>,
    /// Series, or series and frame.
    within: Option<String>,
}

impl FrameSelection {
    /// Splits a name at its last colon, unless there is a store with the whole name.
    pub fn parse(text: &str) -> Self {
        let (store, rest) = text
            .rsplit_once(':')
            .filter(|_| !Path::new(text).exists())
            .unwrap_or((text, ""));
        let (flight, within) = rest.split_once('/').unwrap_or((rest, ""));
        let part = |part: &str| (!part.is_empty()).then(|| part.to_owned());
        Self {
            text: text.to_owned(),
            store: store.into(),
            flight: part(flight),
            within: part(within),
        }
    }

    /// Adjusts the flight again and returns the mean of the selected frames in which the conditions hold.
    ///
    /// # Errors
    /// Returns an error if the selection names no flight or none of its frames has a shape, or if it means several frames
    /// whose common errors are not known because they were adjusted singly.
    pub fn solve(
        &self,
        options: &MeanOptions,
        stations: &StationChoice,
    ) -> TaskResult<SelectedMean> {
        let conditions = options.conditions()?;
        let inputs = options.inputs.as_deref();
        let fail = |what: &str| Failure::Failed(format!("{}: {what}", self.text));
        let flights = stored_flights::select_flights(&self.store, self.flight.as_deref())?;
        let [flight] = flights.as_slice() else {
            return Err(fail(
                "the store has several flights; name one as STORE:FLIGHT",
            ));
        };
        let solved = ShapeSource {
            store: &self.store,
            flight,
            inputs,
            installation: None,
        }
        .solve(stations)?;
        let within = self.within.as_deref().unwrap_or_default();
        let is_selected = |k: usize| {
            let name = stored_flights::frame_name(&solved.frames[k]);
            let is_named = name == within
                || name
                    .split_once('/')
                    .is_some_and(|(series, _)| series == within);
            let aircraft = &solved.processed[k].aircraft;
            (within.is_empty() || is_named)
                && conditions.iter().all(|condition| condition.holds(aircraft))
        };
        let means = solved.shapes.iter().filter_map(|one| {
            let chosen: Vec<usize> = (0..one.frames.len())
                .filter(|k| is_selected(one.frames[*k]))
                .collect();
            (!chosen.is_empty()).then_some((one, chosen))
        });
        let mut means: Vec<(&SolvedShape, Vec<usize>)> = means.collect();
        if means.len() > 1 {
            return Err(fail(
                "the frames were adjusted singly, so the errors that they share are not known; name one frame as \
                 STORE:FLIGHT/SERIES/FRAME, or run `wingd solve STORE --flight`",
            ));
        }
        let (one, chosen) = means
            .pop()
            .ok_or_else(|| fail("no frame with this name and these conditions has a shape"))?;
        let installation = solved
            .provenance
            .iter()
            .filter(|(name, _)| name.ends_with(".sha256"));
        Ok(SelectedMean {
            mean: one.shape.mean(&chosen),
            frames: chosen
                .iter()
                .map(|k| solved.frames[one.frames[*k]].entry.sha256.clone())
                .collect(),
            rejected: chosen
                .iter()
                .any(|k| one.shape.frames[*k].solution.global_test == Some(GlobalTest::Rejected)),
            shape: JointShape {
                frames: vec![],
                ..one.shape.clone()
            },
            side: solved.installation.setup.side(),
            flight: solved
                .jointly
                .then(|| serde_json::to_string(&solved.provenance).unwrap_or_default()),
            installation: serde_json::to_string(&installation.collect::<BTreeMap<_, _>>())
                .unwrap_or_default(),
            conditions: mean_conditions(chosen.iter().map(|k| &solved.processed[one.frames[*k]])),
            jointly: solved.jointly,
        })
    }
}

/// Returns the means of the aircraft data that all frames have, with the mean standard deviation: the errors of an instrument
/// are common to the frames.
pub fn mean_conditions<'a>(
    frames: impl Iterator<Item = &'a ProcessedFrame> + Clone,
) -> BTreeMap<Quantity, Estimate> {
    let count = frames.clone().count().max(1) as f64;
    let mean = |quantity: Quantity| {
        let values: Option<Vec<_>> = frames
            .clone()
            .map(|frame| frame.aircraft.get(&quantity))
            .collect();
        let sum = values?.iter().fold((0.0, 0.0), |sum, joined| {
            (sum.0 + joined.value, sum.1 + joined.sigma)
        });
        Some((
            quantity,
            Estimate {
                value: sum.0 / count,
                sigma: Some(sum.1 / count),
            },
        ))
    };
    Quantity::ALL.into_iter().filter_map(mean).collect()
}

/// Mean of selected frames of a flight.
pub struct SelectedMean {
    pub mean: ShapeMean,
    /// Digests of the frames.
    pub frames: Vec<String>,
    /// True if the test of one of the frames rejects its adjustment.
    pub rejected: bool,
    /// Stations and markers, without frames.
    pub shape: JointShape,
    pub side: Option<WingSide>,
    /// Means of the aircraft data.
    pub conditions: BTreeMap<Quantity, Estimate>,
    /// Inputs of a joint adjustment: those of two means from one adjustment are equal.
    flight: Option<String>,
    /// Digests of the installation's files.
    installation: String,
    jointly: bool,
}

impl SelectedMean {
    /// Returns the errors that two means have in common.
    ///
    /// # Errors
    /// Returns an error if they are of one installation, but these errors are not known because frames were adjusted singly
    /// or with other parameters.
    pub fn common_errors(&self, other: &Self) -> TaskResult<CommonErrors> {
        if self.installation != other.installation {
            return Ok(CommonErrors::None);
        }
        let has_same_sources = self.mean.lasting.ncols() == other.mean.lasting.ncols();
        if !(self.jointly && other.jointly && has_same_sources) {
            let what = "the errors that the frames share are not known, because frames were adjusted singly or with other \
                        parameters; run `wingd solve STORE --flight` with the same options for all";
            return Err(Failure::Failed(what.into()));
        }
        Ok(if self.flight == other.flight {
            CommonErrors::Flight
        } else {
            CommonErrors::Installation
        })
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
