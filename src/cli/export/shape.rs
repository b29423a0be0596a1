//! `wingd export --table shape`: joint shape of a flight with its covariance, as NetCDF or NumPy arrays.

use std::path::{Path, PathBuf};

use super::sink::write_failure;
use super::{ExportArgs, FormatName};
use crate::cli::flight_shape::{FlightShape, ShapeSource};
use crate::cli::{Completion, Failure, TaskResult, print_line};
use crate::desk::stored_flights;
use crate::installation;
use crate::measure::adjust::StationChoice;
use crate::report::export::{ShapeFrame, shape_dataset};
use crate::store::{FlightRef, RealDisk, catalogue};

/// Writes the joint shapes of one flight, or of each flight to a file of its own.
pub(super) fn export_shapes(args: &ExportArgs) -> TaskResult<Completion> {
    let flights = stored_flights::select_flights(&args.store, args.flight.as_deref())?;
    if flights.len() > 1 && args.output.is_some() {
        return Err(Failure::Usage("--output is one file; name one flight with --flight".into()));
    }
    let stations = station_choice(args)?;
    let mut complete = true;
    for flight in &flights {
        let (store, inputs, installation) = (&*args.store, args.inputs.as_deref(), args.installation.as_deref());
        let shape = ShapeSource { store, flight, inputs, installation }.solve(&stations)?;
        complete &= shape.shapes.iter().map(|solved| solved.frames.len()).sum::<usize>() == shape.frames.len();
        write_shape(args, flight, &shape)?;
    }
    Ok(Completion::from_success(complete))
}

/// Reads the stations from the options.
fn station_choice(args: &ExportArgs) -> TaskResult<StationChoice> {
    match (&args.stations, &args.eta) {
        (Some(file), _) => {
            let stations = installation::read_stations(file)?;
            Ok(StationChoice::ArcLengths(stations.iter().map(|station| station.arc_length_m).collect()))
        }
        (None, Some(eta)) if eta.iter().all(|eta| (0.0..=1.0).contains(eta)) => {
            Ok(StationChoice::Fractions(eta.clone()))
        }
        (None, Some(_)) => Err(Failure::Usage("--eta takes fractions of the length, 0 to 1".into())),
        (None, None) => Ok(StationChoice::Standard),
    }
}

fn write_shape(args: &ExportArgs, flight: &FlightRef, solved: &FlightShape) -> TaskResult<()> {
    let name = |(k, frame): (&usize, usize)| ShapeFrame {
        name: stored_flights::frame_name(&solved.frames[*k]),
        stamp: solved.frames[*k].stamp.clone(),
        aircraft: solved.processed[*k].aircraft.clone(),
        frame,
    };
    let frames = solved.shapes.iter().flat_map(|s| {
        s.frames.iter().zip(0..).map(name).zip(s.shape.frames.iter()).map(|(name, frame)| (name, &s.shape, frame))
    });
    let mut attributes = super::recorder_metadata(catalogue::store_id(&RealDisk, &args.store).as_deref());
    attributes.retain(|(name, _)| name != "units" && name != "schema_version");
    attributes.push(("flight".into(), flight.id.clone()));
    attributes.push(("provenance".into(), serde_json::to_string(&solved.provenance).unwrap_or_default()));
    let data = shape_dataset(&frames.collect::<Vec<_>>(), &solved.installation, solved.jointly, attributes);
    let is_netcdf = args.format == FormatName::Netcdf;
    let extension = if is_netcdf { "nc" } else { "npz" };
    let file = args.output.clone().unwrap_or_else(|| PathBuf::from(format!("shape-{}.{extension}", flight.id)));
    let write = |output: &mut std::fs::File| {
        if is_netcdf { data.write_netcdf(output.try_clone()?) } else { data.write_npz(output) }
    };
    installation::write_file_atomically(&file, write).map_err(|e| write_failure(&file, &e))?;
    print_line(&Path::new(&file).display().to_string())
}
