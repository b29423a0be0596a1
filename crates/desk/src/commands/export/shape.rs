//! `wingd export --table shape`: joint shapes with their covariance as NetCDF.

use std::collections::BTreeMap;
use std::path::PathBuf;

use jiff::Timestamp;
use serde_json::{Map, Value, json};

use super::ExportArgs;
use super::sink::write_failure;
use crate::export::{DatedShape, ShapeExport};
use crate::flight_shape::{FlightShape, ShapeSource};
use wingd_base::clock::exposure::Exposure;
use wingd_base::clock::is_known_time;
use wingd_base::clock::{Clock, SystemClock};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::print_line;
use wingd_base::pending_file::PendingFile;
use wingd_evaluation::inputs::stored_flights;
use wingd_evaluation::pipeline::SolvedShape;
use wingd_evaluation::record::{RecordStatus, variant_name};
use wingd_evaluation::results::source;
use wingd_measure::adjust::StationChoice;
use wingd_store::{FlightRef, FrameRef, Inputs, RealDisk, catalogue, sha256_hex};

/// Adjusts a flight again at the stations of the options.
pub(super) fn solve_flight(
    args: &ExportArgs,
    flight: &FlightRef,
    stations: &StationChoice,
) -> TaskResult<FlightShape> {
    let source = ShapeSource {
        store: &args.store,
        flight,
        inputs: args.inputs.as_deref(),
        installation: args.installation.as_deref(),
    };
    source.solve(stations)
}

/// Exports the joint shapes of the frames of flights with the same stations and markers.
pub(super) fn export_shapes(args: &ExportArgs) -> TaskResult<Completion> {
    let flights = stored_flights::select_flights(&args.store, args.flight.as_deref())?;
    let stations = station_choice(args)?;
    let mut complete = true;
    let (mut file, mut provenance) = (None::<ShapeExport>, Map::new());
    for flight in &flights {
        let solved = solve_flight(args, flight, &stations)?;
        complete &= solved.is_complete();
        let known = FlightFacts::read(args, flight, &solved)?;
        let shapes = frame_shapes(&solved, &known);
        let Some(first) = solved.shapes.first() else {
            continue;
        };
        let mut one = ShapeExport::new(&first.shape, &solved.installation, args.full_factors);
        one.add_flight(shapes, &solved.installation);
        match &mut file {
            None => file = Some(one),
            Some(file) if file.has_same_places(&one) => file.append(one),
            Some(_) => {
                return Err(Failure::Usage(format!(
                    "flight {} has other stations or markers than those before it, so one file cannot hold both; name one \
                     flight with --flight",
                    flight.id
                )));
            }
        }
        provenance.insert(flight.id.clone(), Value::Object(solved.provenance));
    }
    if let Some(file) = file {
        let first = provenance.keys().next().cloned().unwrap_or_default();
        write_file(args, &file, &first, provenance)?;
    }
    Ok(Completion::from_success(complete))
}

fn write_file(
    args: &ExportArgs,
    export: &ShapeExport,
    first: &str,
    provenance: Map<String, Value>,
) -> TaskResult<()> {
    let program = format!("wingd {}", env!("CARGO_PKG_VERSION"));
    let now = SystemClock::new().stamp().utc;
    let history = format!("{now:.0} {program} export --table shape");
    let id = catalogue::store_id(&RealDisk, &args.store);
    let data = export.to_dataset(vec![
        ("history", json!(history)),
        ("program", json!(program)),
        ("recorder_id", json!(id.unwrap_or_default())),
        ("provenance", json!(Value::Object(provenance).to_string())),
    ]);
    let default = || PathBuf::from(format!("shape-{first}.nc"));
    let file = args.output.clone().unwrap_or_else(default);
    let write = || {
        let mut output = PendingFile::create_output(&file)?;
        data.write_netcdf(output.file().try_clone()?)?;
        output.commit()
    };
    write().map_err(|error: std::io::Error| write_failure(&file, &error))?;
    print_line(&file.display().to_string())
}

/// Facts about a flight's results that the shapes of its frames have in common.
struct FlightFacts {
    flight: String,
    recorder_id: String,
    /// Status and reason of each frame by its name.
    statuses: FrameStatuses,
    inputs: String,
    /// Digests of the sources of errors of an installation, of a flight and of a CAD model.
    lasting: String,
    shared: String,
    fit: String,
}

impl FlightFacts {
    fn read(args: &ExportArgs, flight: &FlightRef, solved: &FlightShape) -> TaskResult<Self> {
        let inputs = Inputs::new(solved.provenance.clone()).key("");
        let id = catalogue::store_id(&RealDisk, &args.store).unwrap_or_default();
        let shape = solved.shapes.first().map(|one| &one.shape);
        let frame = shape.and_then(|shape| shape.frames.first());
        let lasting = frame.map_or(0, |frame| frame.factors[0].ncols());
        let mut installation = solved.provenance.clone();
        installation.retain(|name, _| name.ends_with(".sha256") || name == "parameters");
        let stations = shape.map_or(vec![], |shape| shape.arcs_m.clone());
        let fit = solved.installation.cad.as_ref();
        let fit = fit.map(|fit| format!("{:?} {:?}", fit.transform, fit.covariance));
        Ok(Self {
            flight: flight.id.clone(),
            lasting: digest_of(json!([installation, lasting])),
            shared: digest_of(json!([id, flight.id, inputs, stations, args.full_factors])),
            fit: fit.map_or(String::new(), |fit| digest_of(json!(fit))),
            recorder_id: id,
            statuses: frame_statuses(flight, solved)?,
            inputs,
        })
    }
}

/// Statuses and reasons of results by the names of their frames.
pub(super) type FrameStatuses = BTreeMap<String, (RecordStatus, Option<String>)>;

/// Reads the statuses of a flight's results.
pub(super) fn frame_statuses(
    flight: &FlightRef,
    solved: &FlightShape,
) -> TaskResult<FrameStatuses> {
    let mut statuses = BTreeMap::new();
    for series in catalogue::list_series(&RealDisk, flight)? {
        let set = Some(&solved.results);
        // Damaged files were reported when the frames were adjusted.
        let read = source::read_series(&RealDisk, &series, set, &mut vec![]);
        for record in read.into_iter().flat_map(|read| read.records) {
            let name = format!("{}/{}", series.id, record.image);
            statuses.insert(name, (record.status, record.reason));
        }
    }
    Ok(statuses)
}

/// Characters of a digest of sources: unique among the flights of a fleet.
const DIGEST_LENGTH: usize = 16;

fn digest_of(value: Value) -> String {
    let digest = sha256_hex(value.to_string().as_bytes());
    digest.chars().take(DIGEST_LENGTH).collect()
}

/// Reads the stations from the options.
pub(super) fn station_choice(args: &ExportArgs) -> TaskResult<StationChoice> {
    let is_fraction = |eta: &f64| (0.0..=1.0).contains(eta);
    match &args.eta {
        None => Ok(StationChoice::Standard),
        Some(eta) if eta.iter().all(is_fraction) => Ok(StationChoice::Fractions(eta.clone())),
        Some(_) => Err(Failure::Usage(
            "--eta takes fractions of the length, 0 to 1".into(),
        )),
    }
}

/// Returns the shape of each frame, in order.
fn frame_shapes(solved: &FlightShape, known: &FlightFacts) -> Vec<DatedShape> {
    let of_shape = |one: &SolvedShape| {
        let shape = |k| frame_shape(solved, known, one, k);
        Vec::from_iter((0..one.frames.len()).map(shape))
    };
    solved.shapes.iter().flat_map(of_shape).collect()
}

/// Returns a frame of a shape, given by its index in it.
fn frame_shape(
    solved: &FlightShape,
    known: &FlightFacts,
    one: &SolvedShape,
    k: usize,
) -> DatedShape {
    let (frame, result) = (&solved.frames[one.frames[k]], &one.shape.solutions[k]);
    let name = stored_flights::frame_name(frame);
    let status = known.statuses.get(&name);
    let (status, reason) = status.map_or((String::new(), None), |(status, reason)| {
        (variant_name(status), reason.clone())
    });
    let own = digest_of(json!([known.shared, frame.entry.sha256]));
    let is_used = |marker: &usize| result.markers.get(*marker).is_some_and(|m| m.used);
    DatedShape {
        flight: known.flight.clone(),
        recorder_id: known.recorder_id.clone(),
        name,
        time: exposure_time(frame),
        conditions: solved.processed[one.frames[k]].aircraft.clone(),
        shape: one.shape.frames[k].clone(),
        status,
        reason,
        inputs: known.inputs.clone(),
        sources: [
            known.lasting.clone(),
            known.shared.clone(),
            own,
            known.fit.clone(),
        ],
        global_test: result.global_test,
        variance_factor: result.variance_factor,
        predicted: one.shape.markers.iter().map(|m| !is_used(m)).collect(),
    }
}

/// Returns the time of a frame's exposure, or of the request to the camera, with its standard deviation, s; `None` if it is
/// not known.
pub(super) fn exposure_time(frame: &FrameRef) -> Option<(Timestamp, Option<f64>)> {
    let exposure = frame.exposure.as_ref();
    let time = exposure.map_or(frame.stamp.utc, |exposure| exposure.exposure_time);
    let sigma =
        |exposure: &Exposure| Some(exposure.exposure_sigma_s.hypot(exposure.clock_sigma_s?));
    is_known_time(time).then(|| (time, exposure.and_then(sigma)))
}
