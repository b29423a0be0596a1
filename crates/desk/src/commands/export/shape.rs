//! `wingd export --table shape|series`: joint shapes with their covariance as NetCDF or NumPy arrays, and means of series
//! also as tables.

use std::path::{Path, PathBuf};

use nalgebra::DVector;

use super::sink::{ExportEnd, RowSink, finish_export, write_failure};
use super::{ExportArgs, FormatName};
use crate::commands::difference::COLUMN_UNITS;
use crate::export::{ColumnValues, DatedShape, ExportColumn, NumberType, shape_dataset};
use crate::flight_shape::{FlightShape, ShapeSource, mean_conditions};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::print_line;
use wingd_base::pending_file::PendingFile;
use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::inputs::stored_flights;
use wingd_evaluation::installation;
use wingd_evaluation::installation::STATION_COLUMNS;
use wingd_evaluation::pipeline::SolvedShape;
use wingd_evaluation::quantities::ResultTable;
use wingd_evaluation::record::variant_name;
use wingd_evaluation::results::distinct_values;
use wingd_measure::adjust::GlobalTest;
use wingd_measure::adjust::Solution;
use wingd_measure::adjust::{JointShape, StationChoice};
use wingd_store::{FlightRef, RealDisk, catalogue};

/// Exports the joint shapes of frames, or their means in each series: as arrays, a file per flight, or the means as a table.
pub(super) fn export_shapes(args: &ExportArgs) -> TaskResult<Completion> {
    let flights = stored_flights::select_flights(&args.store, args.flight.as_deref())?;
    let is_table = matches!(args.format, FormatName::Csv | FormatName::Parquet);
    if !is_table && flights.len() > 1 && args.output.is_some() {
        return Err(Failure::Usage(
            "--output is one file; name one flight with --flight".into(),
        ));
    }
    let stations = station_choice(args)?;
    let mut complete = true;
    let mut sink = None;
    for flight in &flights {
        let (store, inputs, installation) = (
            &*args.store,
            args.inputs.as_deref(),
            args.installation.as_deref(),
        );
        let solved = ShapeSource {
            store,
            flight,
            inputs,
            installation,
        }
        .solve(&stations)?;
        complete &= solved
            .shapes
            .iter()
            .map(|one| one.frames.len())
            .sum::<usize>()
            == solved.frames.len();
        let shapes = match args.table {
            ResultTable::Series => series_shapes(&solved, &flight.id, &args.store)?,
            _ => frame_shapes(&solved),
        };
        if !is_table {
            write_arrays(args, flight, &solved, &shapes)?;
            continue;
        }
        let Some(first) = solved.shapes.first() else {
            continue;
        };
        let rows = series_columns(&flight.id, &shapes, &first.shape);
        let written = match &mut sink {
            Some(sink) => RowSink::add_rows(sink, rows).map_err(ExportEnd::from),
            None => {
                let notes = || {
                    Ok(super::recorder_metadata(
                        catalogue::store_id(&RealDisk, &args.store).as_deref(),
                    ))
                };
                RowSink::begin(args, rows, notes).map(|begun| sink = Some(begun))
            }
        };
        written.or_else(|end| finish_export(args, Err(end)))?;
    }
    if let Some(sink) = sink {
        finish_export(args, sink.finish().map_err(ExportEnd::from))?;
    }
    Ok(Completion::from_success(complete))
}

/// Reads the stations from the options.
fn station_choice(args: &ExportArgs) -> TaskResult<StationChoice> {
    match (&args.stations, &args.eta) {
        (Some(file), _) => {
            let stations = installation::read_stations(file)?;
            Ok(StationChoice::ArcLengths(
                stations
                    .iter()
                    .map(|station| station.arc_length_m)
                    .collect(),
            ))
        }
        (None, Some(eta)) if eta.iter().all(|eta| (0.0..=1.0).contains(eta)) => {
            Ok(StationChoice::Fractions(eta.clone()))
        }
        (None, Some(_)) => Err(Failure::Usage(
            "--eta takes fractions of the length, 0 to 1".into(),
        )),
        (None, None) => Ok(StationChoice::Standard),
    }
}

/// Writes the shapes of frames or the means of series as arrays, or the means as a table.
fn write_arrays(
    args: &ExportArgs,
    flight: &FlightRef,
    solved: &FlightShape,
    shapes: &[DatedShape],
) -> TaskResult<()> {
    let Some(first) = solved.shapes.first() else {
        return Ok(());
    };
    let mut attributes =
        super::recorder_metadata(catalogue::store_id(&RealDisk, &args.store).as_deref());
    attributes.retain(|(name, _)| name != "units" && name != "schema_version");
    attributes.push(("flight".into(), flight.id.clone()));
    attributes.push((
        "provenance".into(),
        serde_json::to_string(&solved.provenance).unwrap_or_default(),
    ));
    let data = shape_dataset(
        shapes,
        &first.shape,
        &solved.installation,
        solved.jointly,
        attributes,
    );
    let is_netcdf = args.format == FormatName::Netcdf;
    let extension = if is_netcdf { "nc" } else { "npz" };
    let table = if args.table == ResultTable::Series {
        "series"
    } else {
        "shape"
    };
    let file = args
        .output
        .clone()
        .unwrap_or_else(|| PathBuf::from(format!("{table}-{}.{extension}", flight.id)));
    let write = || {
        let mut output = PendingFile::create_output(&file)?;
        if is_netcdf {
            data.write_netcdf(output.file().try_clone()?)
        } else {
            data.write_npz(output.file())
        }?;
        output.commit()
    };
    write().map_err(|e: std::io::Error| write_failure(&file, &e))?;
    print_line(&Path::new(&file).display().to_string())
}

/// Returns the shape of each frame, in order.
fn frame_shapes(solved: &FlightShape) -> Vec<DatedShape> {
    let each = solved
        .shapes
        .iter()
        .flat_map(|one| (0..one.frames.len()).map(move |k| (one, k)));
    each.map(|(one, k)| {
        let name = stored_flights::frame_name(&solved.frames[one.frames[k]]);
        mean_shape(solved, one, &[k], name)
    })
    .collect()
}

/// Returns the mean shape of each series.
///
/// # Errors
/// Returns an error if several frames of a series were adjusted singly: the errors that they share are not known.
fn series_shapes(solved: &FlightShape, flight: &str, store: &Path) -> TaskResult<Vec<DatedShape>> {
    let series_of = |frame: usize| solved.frames[frame].series.id.clone();
    let names = solved
        .shapes
        .iter()
        .flat_map(|one| one.frames.iter().map(|frame| series_of(*frame)));
    let series = |name: String| {
        let chosen = solved.shapes.iter().filter_map(|one| {
            let frames: Vec<usize> = (0..one.frames.len())
                .filter(|k| series_of(one.frames[*k]) == name)
                .collect();
            (!frames.is_empty()).then_some((one, frames))
        });
        match chosen.collect::<Vec<_>>().as_slice() {
            [(one, frames)] => Ok(mean_shape(solved, one, frames, name)),
            _ => Err(Failure::Failed(format!(
                "{flight}: the frames were adjusted singly, so the errors that they share are not known; run `wingd solve \
                 {} --flight` first",
                store.display()
            ))),
        }
    };
    distinct_values(names).into_iter().map(series).collect()
}

/// Returns the mean of frames of a shape, given by their indices in it.
fn mean_shape(
    solved: &FlightShape,
    one: &SolvedShape,
    frames: &[usize],
    name: String,
) -> DatedShape {
    let results: Vec<&Solution> = frames
        .iter()
        .map(|k| &one.shape.frames[*k].solution)
        .collect();
    let places: Vec<usize> = frames.iter().map(|k| one.frames[*k]).collect();
    let conditions = mean_conditions(places.iter().map(|frame| &solved.processed[*frame]));
    let rejected = results
        .iter()
        .find_map(|s| s.global_test.filter(|test| *test == GlobalTest::Rejected));
    let factors: Vec<f64> = results.iter().filter_map(|s| s.variance_factor).collect();
    let is_used = |s: &&Solution, marker: usize| s.markers.get(marker).is_some_and(|m| m.used);
    DatedShape {
        name,
        stamp: solved.frames[places[0]].stamp.clone(),
        count: frames.len(),
        conditions: conditions
            .into_iter()
            .map(|(quantity, mean)| (quantity, mean.value))
            .collect(),
        shape: one.shape.mean(frames),
        global_test: rejected.or_else(|| results.iter().find_map(|s| s.global_test)),
        variance_factor: (!factors.is_empty())
            .then(|| factors.iter().sum::<f64>() / factors.len() as f64),
        posterior: results.iter().any(|s| s.posterior),
        predicted: one
            .shape
            .markers
            .iter()
            .map(|m| !results.iter().any(|s| is_used(s, *m)))
            .collect(),
    }
}

/// Mean of a series with the standard deviations of its functions.
type SeriesMean<'a> = (&'a DatedShape, &'a DVector<f64>);

/// Columns of the means of series: a row per series and station.
fn series_columns(flight: &str, shapes: &[DatedShape], shape: &JointShape) -> Vec<ExportColumn> {
    let sigmas: Vec<DVector<f64>> = shapes.iter().map(|one| one.shape.sigmas()).collect();
    let places = || {
        shapes
            .iter()
            .zip(&sigmas)
            .flat_map(|one| (0..shape.arcs_m.len()).map(move |s| (one, s)))
    };
    let numbers =
        |name: String, kind: NumberType, value: &dyn Fn(SeriesMean, usize) -> f64| ExportColumn {
            name,
            values: ColumnValues::Numbers(kind, places().map(|(one, s)| value(one, s)).collect()),
        };
    let texts = |name: &str, text: &dyn Fn(&DatedShape) -> String| ExportColumn {
        name: name.into(),
        values: ColumnValues::Texts(places().map(|((one, _), _)| Some(text(one))).collect()),
    };
    let mut columns = vec![
        texts("flight", &|_| flight.to_owned()),
        texts("series", &|one| one.name.clone()),
        numbers("utc".into(), NumberType::Time, &|(one, _), _| {
            one.stamp.utc.as_microsecond() as f64
        }),
        numbers("frames".into(), NumberType::Count, &|(one, _), _| {
            one.count as f64
        }),
        texts("global_test", &|one| {
            one.global_test.map(variant_name).unwrap_or_default()
        }),
        numbers("arc_length_m".into(), NumberType::Double, &|_, s| {
            shape.arcs_m[s]
        }),
        numbers("eta".into(), NumberType::Double, &|_, s| {
            shape.arcs_m[s] / shape.length_m
        }),
    ];
    for (f, (name, (_, factor))) in STATION_COLUMNS[1..].iter().zip(COLUMN_UNITS).enumerate() {
        let of = |values: &DVector<f64>, s: usize| values[shape.station_function(f, s)] * factor;
        columns.push(numbers(
            (*name).into(),
            NumberType::Double,
            &|(one, _), s| of(&one.shape.values, s),
        ));
        columns.push(numbers(
            format!("sigma_{name}"),
            NumberType::Double,
            &|(one, sigmas), s| {
                if of(&one.shape.values, s).is_nan() {
                    f64::NAN
                } else {
                    of(sigmas, s)
                }
            },
        ));
        columns.push(numbers(
            format!("scatter_{name}"),
            NumberType::Double,
            &|(one, _), s| {
                one.shape
                    .scatter
                    .as_ref()
                    .map_or(f64::NAN, |scatter| of(scatter, s))
            },
        ));
    }
    for quantity in Quantity::ALL {
        columns.push(numbers(
            quantity.name().into(),
            NumberType::Double,
            &|(one, _), _| one.conditions.get(&quantity).copied().unwrap_or(f64::NAN),
        ));
    }
    columns
}
