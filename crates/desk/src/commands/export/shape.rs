//! `wingd export --table shape|series`: joint shapes with their covariance as NetCDF, and means of series also as tables.

use std::collections::BTreeMap;
use std::path::PathBuf;
use wingd_base::clock::is_known_time;

use jiff::Timestamp;
use nalgebra::DVector;
use serde_json::{Map, Value, json};

use super::sink::{ExportEnd, RowSink, finish_export, write_failure};
use super::{ExportArgs, FormatName};
use crate::export::{
    AttributeValue, ColumnValues, DatedShape, ExportColumn, NumberType, ShapeExport,
};
use crate::flight_shape::{FlightShape, ShapeSource, mean_conditions};
use wingd_base::clock::exposure::Exposure;
use wingd_base::clock::{Clock, SystemClock};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::print_line;
use wingd_base::pending_file::PendingFile;
use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::inputs::stored_flights;
use wingd_evaluation::installation;
use wingd_evaluation::pipeline::SolvedShape;
use wingd_evaluation::quantities::ResultTable;
use wingd_evaluation::record::{RecordStatus, variant_name};
use wingd_evaluation::results::{distinct_values, source};
use wingd_measure::adjust::{GlobalTest, JointShape, Solution, StationChoice};
use wingd_store::{FlightRef, FrameRef, Inputs, RealDisk, catalogue, sha256_hex};

/// Exports the joint shapes of frames, or their means in each series: as arrays, or the means as a table.
pub(super) fn export_shapes(args: &ExportArgs) -> TaskResult<Completion> {
    let flights = stored_flights::select_flights(&args.store, args.flight.as_deref())?;
    let is_table = args.format != FormatName::Netcdf;
    let stations = station_choice(args)?;
    let mut complete = true;
    let (mut sink, mut groups) = (None, Vec::<ShapeGroup>::new());
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
        let known = FlightFacts::read(args, flight, &solved)?;
        let shapes = match args.table {
            ResultTable::Series => series_shapes(&solved, &known)?,
            _ => frame_shapes(&solved, &known),
        };
        let Some(first) = solved.shapes.first() else {
            continue;
        };
        if !is_table {
            let mut one = ShapeExport::new(&first.shape, &solved.installation, args.full_factors);
            one.add_flight(shapes, &solved.installation);
            add_to_groups(&mut groups, &flight.id, one, &solved);
            continue;
        }
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
    write_groups(args, &groups)?;
    Ok(Completion::from_success(complete))
}

/// Flights whose shapes one file holds.
struct ShapeGroup {
    flights: Vec<String>,
    export: ShapeExport,
    /// Inputs of the results of each flight.
    provenance: Map<String, Value>,
}

/// Adds a flight to the group with its stations and markers, or to a new one.
fn add_to_groups(
    groups: &mut Vec<ShapeGroup>,
    flight: &str,
    export: ShapeExport,
    solved: &FlightShape,
) {
    let provenance = Value::Object(solved.provenance.clone());
    let known = groups
        .iter_mut()
        .find(|group| group.export.has_same_places(&export));
    if let Some(group) = known {
        group.flights.push(flight.to_owned());
        group.provenance.insert(flight.to_owned(), provenance);
        group.export.append(export);
        return;
    }
    groups.push(ShapeGroup {
        flights: vec![flight.to_owned()],
        export,
        provenance: Map::from_iter([(flight.to_owned(), provenance)]),
    });
}

/// Writes a file for each group.
fn write_groups(args: &ExportArgs, groups: &[ShapeGroup]) -> TaskResult<()> {
    if let ([first, second, ..], true) = (groups, args.output.is_some()) {
        let what = format!(
            "flights {} and {} have different stations or markers, so --output cannot be one file; name one flight with \
             --flight, or omit --output",
            first.flights[0], second.flights[0]
        );
        return Err(Failure::Usage(what));
    }
    let table = if args.table == ResultTable::Series {
        "series"
    } else {
        "shape"
    };
    let id = catalogue::store_id(&RealDisk, &args.store);
    for group in groups {
        let text = |text: String| AttributeValue::Text(text);
        let program = format!("wingd {}", env!("CARGO_PKG_VERSION"));
        let now = SystemClock::new().stamp().utc;
        let provenance = Value::Object(group.provenance.clone()).to_string();
        let attributes = [
            (
                "history",
                format!("{now:.0} {program} export --table {table}"),
            ),
            ("program", program),
            ("recorder_id", id.clone().unwrap_or_default()),
            ("provenance", provenance),
        ];
        let attributes = attributes.map(|(name, value)| (name.to_owned(), text(value)));
        let data = group.export.to_dataset(attributes.into());
        let default = || PathBuf::from(format!("{table}-{}.nc", group.flights[0]));
        let file = args.output.clone().unwrap_or_else(default);
        let write = || {
            let mut output = PendingFile::create_output(&file)?;
            data.write_netcdf(output.file().try_clone()?)?;
            output.commit()
        };
        write().map_err(|e: std::io::Error| write_failure(&file, &e))?;
        print_line(&file.display().to_string())?;
    }
    Ok(())
}

/// Facts about a flight's results that the shapes of its frames have in common.
struct FlightFacts {
    flight: String,
    recorder_id: String,
    /// Status and reason of each frame by its name.
    statuses: BTreeMap<String, (RecordStatus, Option<String>)>,
    inputs: String,
    /// Digests of the sources of errors of an installation, of a flight and of a CAD model.
    lasting: String,
    shared: String,
    fit: String,
}

impl FlightFacts {
    fn read(args: &ExportArgs, flight: &FlightRef, solved: &FlightShape) -> TaskResult<Self> {
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
        let inputs = Inputs::new(solved.provenance.clone()).key("");
        let id = catalogue::store_id(&RealDisk, &args.store).unwrap_or_default();
        let shape = solved.shapes.first().map(|one| &one.shape);
        let frame = shape.and_then(|shape| shape.frames.first());
        let lasting = frame.map_or(0, |frame| frame.lasting.ncols());
        let is_of_installation = |name: &str| name.ends_with(".sha256") || name == "parameters";
        let installation: Map<String, Value> = solved
            .provenance
            .iter()
            .filter(|(name, _)| is_of_installation(name))
            .map(|(name, value)| (name.clone(), value.clone()))
            .collect();
        let stations = shape.map_or(vec![], |shape| shape.arcs_m.clone());
        let (is_series, is_full) = (args.table == ResultTable::Series, args.full_factors);
        let fit = solved.installation.cad.as_ref();
        let fit = fit.map(|fit| format!("{:?} {:?}", fit.transform, fit.covariance));
        Ok(Self {
            flight: flight.id.clone(),
            lasting: digest_of(json!([installation, lasting])),
            shared: digest_of(json!([id, flight.id, inputs, stations, is_series, is_full])),
            fit: fit.map_or(String::new(), |fit| digest_of(json!(fit))),
            recorder_id: id,
            statuses,
            inputs,
        })
    }
}

/// Characters of a digest of sources: unique among the flights of a fleet.
const DIGEST_LENGTH: usize = 16;

fn digest_of(value: Value) -> String {
    let digest = sha256_hex(value.to_string().as_bytes());
    digest.chars().take(DIGEST_LENGTH).collect()
}

/// Reads the stations from the options.
fn station_choice(args: &ExportArgs) -> TaskResult<StationChoice> {
    match (&args.stations, &args.eta) {
        (Some(file), _) => Ok(StationChoice::ArcLengths(installation::read_stations(
            file,
        )?)),
        (None, Some(eta)) if eta.iter().all(|eta| (0.0..=1.0).contains(eta)) => {
            Ok(StationChoice::Fractions(eta.clone()))
        }
        (None, Some(_)) => Err(Failure::Usage(
            "--eta takes fractions of the length, 0 to 1".into(),
        )),
        (None, None) => Ok(StationChoice::Standard),
    }
}

/// Returns the shape of each frame, in order.
fn frame_shapes(solved: &FlightShape, known: &FlightFacts) -> Vec<DatedShape> {
    let each = solved
        .shapes
        .iter()
        .flat_map(|one| (0..one.frames.len()).map(move |k| (one, k)));
    each.map(|(one, k)| {
        let name = stored_flights::frame_name(&solved.frames[one.frames[k]]);
        mean_shape(solved, known, (one, &[k]), name)
    })
    .collect()
}

/// Returns the mean shape of each series.
///
/// # Errors
/// Returns an error if several frames of a series were adjusted singly: the errors that they share are not known.
fn series_shapes(solved: &FlightShape, known: &FlightFacts) -> TaskResult<Vec<DatedShape>> {
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
            [(one, frames)] => Ok(mean_shape(solved, known, (one, frames), name)),
            _ => Err(Failure::Failed(format!(
                "{}: the frames were adjusted singly, so the errors that they share are not known; run `wingd solve STORE` first",
                known.flight
            ))),
        }
    };
    distinct_values(names).into_iter().map(series).collect()
}

/// Returns the mean of frames of a shape, given by their indices in it.
fn mean_shape(
    solved: &FlightShape,
    known: &FlightFacts,
    (one, frames): (&SolvedShape, &[usize]),
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
    let first = &solved.frames[places[0]];
    let is_bad = |frame: &&usize| {
        let status = known.status_of(&solved.frames[**frame]);
        status.is_none_or(|(status, _)| *status != RecordStatus::Ok)
    };
    let worst = places.iter().find(is_bad).unwrap_or(&places[0]);
    let (status, reason) = known
        .status_of(&solved.frames[*worst])
        .map_or((String::new(), None), |(status, reason)| {
            (variant_name(status), reason.clone())
        });
    let frame_digests = places
        .iter()
        .map(|frame| &*solved.frames[*frame].entry.sha256);
    let own = digest_of(json!([known.shared, frame_digests.collect::<Vec<_>>()]));
    let (lasting, shared, fit) = (&known.lasting, &known.shared, &known.fit);
    DatedShape {
        flight: known.flight.clone(),
        recorder_id: known.recorder_id.clone(),
        name,
        time: exposure_time(first),
        time_synchronised: first.stamp.utc_synchronised,
        count: frames.len(),
        conditions,
        shape: one.shape.mean(frames),
        status,
        reason,
        inputs: known.inputs.clone(),
        sources: [lasting.clone(), shared.clone(), own, fit.clone()],
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

impl FlightFacts {
    fn status_of(&self, frame: &FrameRef) -> Option<&(RecordStatus, Option<String>)> {
        self.statuses.get(&stored_flights::frame_name(frame))
    }
}

/// Returns the time of a frame's exposure, or of the request to the camera, with its standard deviation, s; `None` if it is
/// not known.
fn exposure_time(frame: &FrameRef) -> Option<(Timestamp, Option<f64>)> {
    let exposure = frame.exposure.as_ref();
    let time = exposure.map_or(frame.stamp.utc, |exposure| exposure.exposure_time);
    let sigma =
        |exposure: &Exposure| Some(exposure.exposure_sigma_s.hypot(exposure.clock_sigma_s?));
    is_known_time(time).then(|| (time, exposure.and_then(sigma)))
}

/// Mean of a series with the standard deviations of its functions.
type SeriesMean<'a> = (&'a DatedShape, &'a DVector<f64>);

/// Degrees in a radian.
const DEGREES: f64 = 180.0 / std::f64::consts::PI;
/// Columns of the first functions of stations, with the factors of their units.
const SERIES_COLUMNS: [(&str, f64); 6] = [
    ("displacement_x_m", 1.0),
    ("displacement_y_m", 1.0),
    ("displacement_z_m", 1.0),
    ("slope_deg", DEGREES),
    ("twist_deg", DEGREES),
    ("streamwise_twist_deg", DEGREES),
];

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
            one.time
                .map_or(f64::NAN, |(time, _)| time.as_microsecond() as f64)
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
    for (f, (name, factor)) in SERIES_COLUMNS.into_iter().enumerate() {
        let of = |values: &DVector<f64>, s: usize| values[shape.station_function(f, s)] * factor;
        columns.push(numbers(name.into(), NumberType::Double, &|(one, _), s| {
            of(&one.shape.values, s)
        }));
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
            &|(one, _), _| {
                one.conditions
                    .get(&quantity)
                    .map_or(f64::NAN, |mean| mean.value)
            },
        ));
    }
    columns
}
