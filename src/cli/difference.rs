//! `wingd difference` compares two measured shapes, or a measured shape with a computation.

use std::path::PathBuf;

use nalgebra::DVector;
use serde_json::json;

use super::flight_shape::{FrameSelection, MeanOptions, SelectedMean};
use super::{Completion, Failure, TaskResult, print_json, print_line, print_notes};
use crate::installation::{self, PredictedStation, STATION_COLUMNS};
use crate::measure::adjust::{JointShape, ShapeDifference, ShapeTest, StationChoice};
use crate::report::grid::{ColumnDefinition::One, Grid};
use crate::report::number::format_fixed;

/// Compare two measured shapes, or a measured shape with a computation. Errors that both have in common cancel: those of a
/// flight within it, those of the installation between its flights.
#[derive(clap::Args)]
pub struct DifferenceArgs {
    /// Measured frames: STORE, STORE:FLIGHT, STORE:FLIGHT/SERIES or STORE:FLIGHT/SERIES/FRAME; the mean of several
    #[arg(value_name = "FRAMES")]
    frames: String,
    /// Frames to subtract
    #[arg(value_name = "OTHER", required_unless_present = "against")]
    other: Option<String>,
    /// Computation to subtract, CSV: arc_length_m and any of displacement_x_m, _y_m, _z_m (survey frame), slope_deg,
    /// twist_deg, streamwise_twist_deg, all as changes from the surveyed state
    #[arg(long, value_name = "FILE", conflicts_with = "other")]
    against: Option<PathBuf>,
    /// The frames are of the left and the right wing: compare what does not depend on the side
    #[arg(long, conflicts_with = "against")]
    mirror: bool,
    #[command(flatten)]
    mean: MeanOptions,
}

/// Station functions of the columns of a table of stations after the first, in its order, and the factor of its unit.
const COLUMN_UNITS: [(&str, f64); STATION_COLUMNS.len() - 1] =
    [("m", 1.0), ("m", 1.0), ("m", 1.0), ("deg", DEGREES), ("deg", DEGREES), ("deg", DEGREES)];
/// Degrees in a radian.
const DEGREES: f64 = 180.0 / std::f64::consts::PI;
/// Functions that are compared between measurements: vertical displacement, slope, twist, streamwise twist.
pub(super) const MEASURED: [usize; 4] = [2, 3, 4, 5];
/// Function that follows from slope and twist and is not tested beside them.
const STREAMWISE: usize = 5;
/// Significance level of the verdict.
const ALPHA: f64 = 0.01;

pub(super) fn run(args: &DifferenceArgs) -> TaskResult<Completion> {
    let (shape, difference, functions, notes) = match &args.against {
        Some(file) => subtract_computation(args, &installation::read_stations(file)?)?,
        None => subtract_measurement(args)?,
    };
    print_notes(notes);
    let tested: Vec<usize> = functions
        .iter()
        .filter(|f| **f != STREAMWISE || !functions.contains(&(STREAMWISE - 1)))
        .flat_map(|f| (0..shape.arcs_m.len()).map(|s| shape.station_function(*f, s)))
        .collect();
    let test = difference.test(&tested);
    if args.mean.json {
        print_json_object(&shape, &difference, &functions, &test)
    } else {
        print_table(args, &shape, &difference, &functions, &test)
    }?;
    Ok(Completion::All)
}

/// Difference of the stations' functions, with the functions that are compared, and notes.
type Compared = (JointShape, ShapeDifference, Vec<usize>, Vec<String>);

fn subtract_measurement(args: &DifferenceArgs) -> TaskResult<Compared> {
    let stations = args.mean.stations()?;
    let solve = |frames: &str| FrameSelection::parse(frames).solve(&args.mean, &stations);
    let (ours, theirs) = (solve(&args.frames)?, solve(args.other.as_deref().unwrap_or_default())?);
    if ours.frames.iter().any(|frame| theirs.frames.contains(frame)) {
        return Err(Failure::Failed("both sides have a frame in common; name different frames".into()));
    }
    if ours.side.zip(theirs.side).is_some_and(|(a, b)| (a != b) != args.mirror) {
        let what = match args.mirror {
            true => "both shapes are of one side; omit --mirror",
            false => "the shapes are of the left and the right wing; add --mirror",
        };
        return Err(Failure::Failed(what.into()));
    }
    let common = ours.common_errors(&theirs)?;
    // The number of markers may differ: stations alone are compared.
    let rows = ours.shape.marker_function(0);
    let cut = |mean: &SelectedMean| mean.mean.first_functions(rows);
    let difference = cut(&ours).minus(&cut(&theirs), common);
    let notes = [(&ours, &args.frames), (&theirs, args.other.as_ref().unwrap_or(&args.frames))];
    let notes = notes.into_iter().flat_map(|(mean, name)| rejection_note(mean, name)).collect();
    let known = |f: &usize| !difference.values[ours.shape.station_function(*f, 0)].is_nan();
    let functions = MEASURED.into_iter().filter(known).collect();
    Ok((ours.shape, difference, functions, notes))
}

fn rejection_note(mean: &SelectedMean, name: &str) -> Option<String> {
    mean.rejected
        .then(|| format!("{name}: the test of the adjustment rejects a frame; its standard deviations are scaled"))
}

fn subtract_computation(args: &DifferenceArgs, stations: &[PredictedStation]) -> TaskResult<Compared> {
    let file = args.against.as_deref().unwrap_or(std::path::Path::new("")).display();
    let functions: Vec<usize> =
        (0..COLUMN_UNITS.len()).filter(|f| stations.iter().any(|station| station.values[*f].is_some())).collect();
    if functions.is_empty() {
        let columns = STATION_COLUMNS[1..].join(", ");
        return Err(Failure::Failed(format!("{file}: has no quantity to compare; add one of the columns {columns}")));
    }
    let arcs = stations.iter().map(|station| station.arc_length_m).collect();
    let choice = StationChoice::ArcLengths(arcs);
    let measured = FrameSelection::parse(&args.frames).solve(&args.mean, &choice)?;
    let mut predicted = DVector::from_element(measured.mean.values.len(), f64::NAN);
    for (s, station) in stations.iter().enumerate() {
        for (f, value) in station.values.iter().enumerate() {
            let at = measured.shape.station_function(f, s);
            predicted[at] = value.map_or(f64::NAN, |value| value / COLUMN_UNITS[f].1);
        }
    }
    let difference = measured.mean.difference_from(&predicted);
    let streamwise = measured.shape.station_function(STREAMWISE, 0);
    let unknown = functions.contains(&STREAMWISE) && measured.mean.values[streamwise].is_nan();
    let unknown = unknown.then(|| "streamwise_twist_deg is not compared: give wing.flow_direction".to_owned());
    let notes = rejection_note(&measured, &args.frames).into_iter().chain(unknown).collect();
    Ok((measured.shape, difference, functions, notes))
}

fn print_table(
    args: &DifferenceArgs,
    shape: &JointShape,
    difference: &ShapeDifference,
    functions: &[usize],
    test: &ShapeTest,
) -> TaskResult<()> {
    let sigmas = difference.sigmas();
    let grid = station_grid(shape, functions, &[("", &difference.values), ("sigma", &sigmas)]);
    print_line(grid.text_with_width(args.mean.wide).trim_end())?;
    let verdict = if test.p >= ALPHA { "no significant difference" } else { "significant difference" };
    let ShapeTest { chi_square, freedom, p, combinations } = test;
    print_line(&format!(
        "chi-square {chi_square:.1} of {freedom} combinations, p = {p:.3}: {verdict} at {:.0} %",
        1e2 * ALPHA
    ))?;
    for c in combinations {
        let (name, arc_m) = function_place(shape, c.function);
        print_line(&format!("  {:.1} sigma: mostly {name} at {arc_m:.2} m", c.sigmas))?;
    }
    Ok(())
}

/// Table of stations with columns of values for each function; a kind of values without a name has the function's.
pub(super) fn station_grid(shape: &JointShape, functions: &[usize], kinds: &[(&str, &DVector<f64>)]) -> Grid {
    let stations: Vec<usize> = (0..shape.arcs_m.len()).collect();
    let mut grid = Grid::for_rows(&stations).columns(&[
        One("arc length / m", &|s| format_fixed(Some(shape.arcs_m[*s]), 2)),
        One("eta", &|s| format_fixed(Some(shape.arcs_m[*s] / shape.length_m), 3)),
    ]);
    for &f in functions {
        let (unit, factor) = COLUMN_UNITS[f];
        for (kind, values) in kinds {
            let title = if kind.is_empty() { format!("{} / {unit}", column_name(f)) } else { (*kind).to_owned() };
            grid.columns.extend(Grid::new(&[&title]).columns);
            for (row, s) in grid.rows.iter_mut().zip(&stations) {
                let value = Some(values[shape.station_function(f, *s)] * factor).filter(|value| !value.is_nan());
                row.push(format_fixed(value, if f < 3 { 4 } else { 3 }));
            }
        }
    }
    grid
}

/// Name of a function's column without its unit.
fn column_name(f: usize) -> &'static str {
    let name = STATION_COLUMNS[f + 1];
    name.rsplit_once('_').map_or(name, |(name, _)| name)
}

/// Column and arc length (m) of a station's function.
fn function_place(shape: &JointShape, function: usize) -> (&'static str, f64) {
    let stations = shape.arcs_m.len().max(1);
    (column_name(function / stations), shape.arcs_m[function % stations])
}

fn print_json_object(
    shape: &JointShape,
    difference: &ShapeDifference,
    functions: &[usize],
    test: &ShapeTest,
) -> TaskResult<()> {
    let sigmas = difference.sigmas();
    let stations = station_objects(shape, functions, &[("", &difference.values), ("sigma_", &sigmas)]);
    let combinations = test.combinations.iter().map(|c| {
        let (name, arc_m) = function_place(shape, c.function);
        json!({"sigmas": c.sigmas, "largest": name, "arc_length_m": arc_m})
    });
    print_json(&json!({
        "stations": stations,
        "chi_square": test.chi_square,
        "freedom": test.freedom,
        "p": test.p,
        "combinations": combinations.collect::<Vec<_>>(),
    }))
}

/// Objects of stations with several kinds of values for each function, under the names of columns with the prefix of the kind;
/// `null` if one of them does not exist.
pub(super) fn station_objects(
    shape: &JointShape,
    functions: &[usize],
    kinds: &[(&str, &DVector<f64>)],
) -> Vec<serde_json::Map<String, serde_json::Value>> {
    let station = |s: usize| {
        let mut station = serde_json::Map::new();
        station.insert(STATION_COLUMNS[0].into(), json!(shape.arcs_m[s]));
        for &f in functions {
            let at = shape.station_function(f, s);
            let (name, unit) = (STATION_COLUMNS[f + 1], COLUMN_UNITS[f].1);
            let is_known = kinds.iter().all(|(_, values)| values[at].is_finite());
            for (prefix, values) in kinds {
                station.insert(format!("{prefix}{name}"), json!(is_known.then_some(values[at] * unit)));
            }
        }
        station
    };
    (0..shape.arcs_m.len()).map(station).collect()
}
