//! `wingd export --table series`: the mean shape of each series, a row for each station.

use std::f64::consts::PI;

use jiff::Timestamp;
use nalgebra::DVector;

use super::ExportArgs;
use super::shape::{FrameStatuses, exposure_time, frame_statuses, solve_flight, station_choice};
use super::sink::write_rows;
use crate::export::{ColumnValues, ExportColumn, NumberType};
use crate::flight_shape::FlightShape;
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::print_notes;
use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::inputs::stored_flights;
use wingd_evaluation::pipeline::{ProcessedFrame, SolvedShape};
use wingd_evaluation::record::{RecordStatus, variant_name};
use wingd_evaluation::results::distinct_values;
use wingd_measure::adjust::{FrameShape, GlobalTest, JointShape};
use wingd_store::{RealDisk, catalogue};

/// Mean shape of the frames of a series.
struct SeriesMean<'a> {
    flight: &'a str,
    series: String,
    shape: &'a JointShape,
    /// Key of the results' inputs.
    inputs: &'a str,
    frames: Vec<&'a ProcessedFrame>,
    /// Time of the first frame.
    time: Option<Timestamp>,
    global_test: Option<GlobalTest>,
    mean: FrameShape,
    sigmas: DVector<f64>,
    /// Standard deviation of the frames about their mean; `None` for a single frame.
    scatter: Option<DVector<f64>>,
}

/// Exports the means of series as a table.
pub(super) fn export_series(args: &ExportArgs) -> TaskResult<Completion> {
    let flights = stored_flights::select_flights(&args.store, args.flight.as_deref())?;
    let stations = station_choice(args)?;
    let id = catalogue::store_id(&RealDisk, &args.store).unwrap_or_default();
    let is_incomplete = write_rows(args, columns(&id, &[]), |rows| {
        let mut is_incomplete = false;
        for flight in &flights {
            let solved = solve_flight(args, flight, &stations)?;
            let statuses = frame_statuses(flight, &solved)?;
            let means = series_means(&flight.id, &solved, &statuses)?;
            let series = distinct_values(solved.frames.iter().map(|frame| &frame.series.id));
            is_incomplete |= !solved.is_complete() || means.len() < series.len();
            rows.add(columns(&id, &means))?;
        }
        Ok(is_incomplete)
    })?;
    Ok(Completion::from_success(!is_incomplete))
}

/// Returns the mean shape of each series of a flight, of its frames with status `ok`; prints the number of the others.
///
/// # Errors
/// Returns an error if several frames of a series were adjusted singly: the errors that they share are not known.
fn series_means<'a>(
    flight: &'a str,
    solved: &'a FlightShape,
    statuses: &FrameStatuses,
) -> TaskResult<Vec<SeriesMean<'a>>> {
    let series_of = |frame: &usize| solved.frames[*frame].series.id.clone();
    let is_ok = |frame: &usize| {
        let name = stored_flights::frame_name(&solved.frames[*frame]);
        let status = statuses.get(&name).map(|(status, _)| *status);
        status.is_none_or(|status| status == RecordStatus::Ok)
    };
    let used = || solved.shapes.iter().flat_map(|one| &one.frames);
    let mut means = vec![];
    for series in distinct_values(used().map(series_of)) {
        let of_series = || used().filter(|frame| series_of(frame) == series);
        let others = of_series().filter(|frame| !is_ok(frame)).count();
        let all = of_series().count();
        print_notes((others > 0).then(|| {
            format!("{flight}/{series}: {others} of {all} frames are left out of the mean: their status is not ok")
        }));
        let frames_of = |one: &SolvedShape| {
            let is_used =
                |k: &usize| series_of(&one.frames[*k]) == series && is_ok(&one.frames[*k]);
            Vec::from_iter((0..one.frames.len()).filter(is_used))
        };
        let chosen = solved.shapes.iter().map(|one| (one, frames_of(one)));
        let chosen = Vec::from_iter(chosen.filter(|(_, frames)| !frames.is_empty()));
        match &chosen[..] {
            [] => {}
            [(one, frames)] => means.push(SeriesMean::new(flight, series, solved, one, frames)),
            _ => {
                return Err(Failure::Failed(format!(
                    "{flight}: the frames were adjusted singly, so the errors that they share are not known; run `wingd solve STORE` first"
                )));
            }
        }
    }
    Ok(means)
}

impl<'a> SeriesMean<'a> {
    /// Averages frames of a shape, given by their indices in it.
    fn new(
        flight: &'a str,
        series: String,
        solved: &'a FlightShape,
        one: &'a SolvedShape,
        frames: &[usize],
    ) -> Self {
        let shape = &one.shape;
        let tests = || {
            frames
                .iter()
                .filter_map(|k| shape.solutions[*k].global_test)
        };
        let rejected = tests().find(|test| *test == GlobalTest::Rejected);
        let mean = shape.mean(frames);
        let first = &solved.frames[one.frames[frames[0]]];
        let processed = frames.iter().map(|k| &solved.processed[one.frames[*k]]);
        Self {
            flight,
            series,
            shape,
            inputs: &solved.results.key,
            frames: processed.collect(),
            time: exposure_time(first).map(|(time, _)| time),
            global_test: rejected.or_else(|| tests().next()),
            sigmas: mean.sigmas(),
            scatter: shape.scatter(frames, &mean),
            mean,
        }
    }
}

/// Degrees in a radian.
const DEGREES: f64 = 180.0 / PI;
/// Columns of the first functions of stations, with the factors of their units.
const FUNCTION_COLUMNS: [(&str, f64); 6] = [
    ("displacement_x_m", 1.0),
    ("displacement_y_m", 1.0),
    ("displacement_z_m", 1.0),
    ("slope_deg", DEGREES),
    ("twist_deg", DEGREES),
    ("streamwise_twist_deg", DEGREES),
];

/// Builds the columns, with the id of the recorder's store: a row for each series and station.
fn columns(id: &str, means: &[SeriesMean]) -> Vec<ExportColumn> {
    let places = || {
        let stations = |one: &SeriesMean| 0..one.shape.arcs_m.len();
        means
            .iter()
            .flat_map(move |one| stations(one).map(move |s| (one, s)))
    };
    let numbers = |name: &str, kind, value: &dyn Fn(&SeriesMean, usize) -> Option<f64>| {
        let values = places().map(|(one, s)| value(one, s).unwrap_or(f64::NAN));
        ExportColumn {
            name: name.to_owned(),
            values: ColumnValues::Numbers(kind, values.collect()),
        }
    };
    let texts = |name: &str, text: &dyn Fn(&SeriesMean) -> String| ExportColumn {
        name: name.to_owned(),
        values: ColumnValues::Texts(places().map(|(one, _)| Some(text(one))).collect()),
    };
    let doubles = |name: &str, value: &dyn Fn(&SeriesMean, usize) -> Option<f64>| {
        numbers(name, NumberType::Double, value)
    };
    let mut columns = vec![
        texts("recorder_id", &|_| id.to_owned()),
        texts("flight", &|one| one.flight.to_owned()),
        texts("series", &|one| one.series.clone()),
        numbers("utc", NumberType::Time, &|one, _| {
            Some(one.time?.as_microsecond() as f64)
        }),
        numbers("frames", NumberType::Count, &|one, _| {
            Some(one.frames.len() as f64)
        }),
        texts("global_test", &|one| {
            one.global_test.map(variant_name).unwrap_or_default()
        }),
        doubles("arc_length_m", &|one, s| Some(one.shape.arcs_m[s])),
        doubles("eta", &|one, s| {
            Some(one.shape.arcs_m[s] / one.shape.length_m)
        }),
    ];
    for (f, (name, factor)) in FUNCTION_COLUMNS.into_iter().enumerate() {
        let row = |one: &SeriesMean, s: usize| one.shape.station_function(f, s);
        let value = |one: &SeriesMean, s| Some(one.mean.values[row(one, s)] * factor);
        let sigma = |one: &SeriesMean, s| {
            let is_known = !one.mean.values[row(one, s)].is_nan();
            is_known.then(|| one.sigmas[row(one, s)] * factor)
        };
        let scatter = |one: &SeriesMean, s| Some(one.scatter.as_ref()?[row(one, s)] * factor);
        columns.push(doubles(name, &value));
        columns.push(doubles(&format!("sigma_{name}"), &sigma));
        columns.push(doubles(&format!("scatter_{name}"), &scatter));
    }
    columns.extend(Quantity::ALL.map(|quantity| {
        doubles(quantity.name(), &|one, _| {
            let values = one
                .frames
                .iter()
                .map(|f| Some(f.aircraft.get(&quantity)?.value));
            let sum: f64 = values.sum::<Option<f64>>()?;
            Some(sum / one.frames.len() as f64)
        })
    }));
    let program = concat!("wingd ", env!("CARGO_PKG_VERSION"));
    columns.push(texts("program", &|_| program.to_owned()));
    columns.push(texts("inputs", &|one| one.inputs.to_owned()));
    columns
}
