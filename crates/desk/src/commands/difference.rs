//! `wingd difference` compares two measured shapes, or a measured shape with a computation.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::DVector;
use serde_json::json;

use crate::flight_shape::{FrameSelection, MeanOptions, SelectedMean};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line, print_notes};
use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::grid::ColumnDefinition::One;
use wingd_evaluation::grid::Grid;
use wingd_evaluation::installation;
use wingd_evaluation::installation::{PREDICTED_COUNT, PredictedStation, STATION_COLUMNS};
use wingd_evaluation::number::format_fixed;
use wingd_evaluation::results::{ComparedStation, ShapeComparison, ShapeQuantity};
use wingd_measure::adjust::{JointShape, StationChoice};
use wingd_measure::adjust::{ShapeDifference, ShapeTest, TestedCombination};
use wingd_measure::observation::Estimate;

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
    /// Effect to subtract, so that loads are equal: a table as for --against, of the change per unit of a condition, and the
    /// condition: FILE:weight_kg (its difference), FILE:weight_kg=60000 (of the computation), or FILE:DELTA,SIGMA
    #[arg(long, value_name = "FILE:CONDITION")]
    slope: Vec<String>,
    /// The frames are of the left and the right wing: compare what does not depend on the side
    #[arg(long, conflicts_with = "against")]
    mirror: bool,
    #[command(flatten)]
    mean: MeanOptions,
}

/// Station functions of the columns of a table of stations after the first, in its order, and the factor of its unit.
pub(super) const COLUMN_UNITS: [(&str, f64); PREDICTED_COUNT] = [
    ("m", 1.0),
    ("m", 1.0),
    ("m", 1.0),
    ("deg", DEGREES),
    ("deg", DEGREES),
    ("deg", DEGREES),
];
/// Degrees in a radian.
const DEGREES: f64 = 180.0 / std::f64::consts::PI;
/// Functions that are compared between measurements: vertical displacement, slope, twist, streamwise twist.
pub(super) const MEASURED: [usize; 4] = [2, 3, 4, 5];
/// Function that follows from slope and twist and is not tested beside them.
const STREAMWISE: usize = 5;
/// Significance level of the verdict.
const ALPHA: f64 = 0.01;

pub(super) fn run(args: &DifferenceArgs) -> TaskResult<Completion> {
    let (shape, mut difference, mut functions, notes, conditions) = match &args.against {
        Some(file) => subtract_computation(
            &args.frames,
            &args.mean,
            file,
            &installation::read_stations(file)?,
        )?,
        None => subtract_measurement(args)?,
    };
    print_notes(notes);
    for slope in &args.slope {
        let effect = LoadEffect::read(slope, &conditions)?;
        let (values, sigmas) =
            station_values(&shape, difference.values.len(), &effect.stations, slope)?;
        functions.retain(|f| !values[shape.station_function(*f, 0)].is_nan());
        difference = difference.without_effect(&values, &sigmas, effect.amount);
    }
    if functions.is_empty() {
        return Err(Failure::Failed(
            "--slope: the tables have no quantity that is compared; add their columns".into(),
        ));
    }
    let test = test_functions(&shape, &difference, &functions);
    if args.mean.json {
        print_json_object(&shape, &difference, &functions, &test)
    } else {
        print_table(args, &shape, &difference, &functions, &test)
    }?;
    Ok(Completion::All)
}

/// Tests the functions of a difference at all stations.
fn test_functions(
    shape: &JointShape,
    difference: &ShapeDifference,
    functions: &[usize],
) -> ShapeTest {
    let tested = functions
        .iter()
        .filter(|f| **f != STREAMWISE || !functions.contains(&(STREAMWISE - 1)));
    let rows = tested.flat_map(|f| (0..shape.arcs_m.len()).map(|s| shape.station_function(*f, s)));
    difference.test(&rows.collect::<Vec<_>>())
}

/// Compares the mean of frames with a computation, for a report; also returns notes.
pub(super) fn compare_with_computation(
    frames: &str,
    inputs: Option<&str>,
    file: &Path,
) -> TaskResult<(ShapeComparison, Vec<String>)> {
    let options = MeanOptions {
        inputs: inputs.map(str::to_owned),
        ..MeanOptions::default()
    };
    let stations = installation::read_stations(file)?;
    let (shape, difference, functions, notes, _) =
        subtract_computation(frames, &options, file, &stations)?;
    let test = test_functions(&shape, &difference, &functions);
    let sigmas = difference.sigmas();
    let quantity = |f: &usize| {
        let (unit, factor) = COLUMN_UNITS[*f];
        let station = |(s, station): (usize, &PredictedStation)| {
            let (at, computed) = (shape.station_function(*f, s), station.values[*f]?);
            let computed_sigma = station.sigmas[*f];
            // The difference has both errors; the band is that of the measurement.
            let sigma = (sigmas[at] * factor).powi(2) - computed_sigma.unwrap_or(0.0).powi(2);
            let measured = difference.values[at] * factor + computed;
            let (arc_length_m, sigma) = (shape.arcs_m[s], Some(sigma.max(0.0).sqrt()));
            measured.is_finite().then_some(ComparedStation {
                arc_length_m,
                measured,
                sigma,
                computed,
                computed_sigma,
            })
        };
        let stations = stations.iter().enumerate().filter_map(station).collect();
        ShapeQuantity {
            label: format!("{} / {unit}", column_name(*f).replace('_', " ")),
            stations,
        }
    };
    let comparison = ShapeComparison {
        measured: format!("mean of {frames}"),
        computed: file.display().to_string(),
        verdict: verdict_text(&test),
        combinations: test
            .combinations
            .iter()
            .map(|c| combination_text(&shape, c))
            .collect(),
        quantities: functions.iter().map(quantity).collect(),
    };
    Ok((comparison, notes))
}

/// Describes a test with its verdict.
fn verdict_text(test: &ShapeTest) -> String {
    let verdict = if test.p >= ALPHA {
        "no significant difference"
    } else {
        "significant difference"
    };
    let ShapeTest {
        chi_square,
        freedom,
        p,
        ..
    } = test;
    format!(
        "chi-square {chi_square:.1} of {freedom} combinations, p = {p:.3}: {verdict} at {:.0} %",
        1e2 * ALPHA
    )
}

/// Describes a combination that says much, by the value with the largest weight in it.
fn combination_text(shape: &JointShape, combination: &TestedCombination) -> String {
    let (name, arc_m) = function_place(shape, combination.function);
    format!(
        "{:.1} sigma: mostly {name} at {arc_m:.2} m",
        combination.sigmas
    )
}

/// Difference of the stations' functions, with the functions that are compared, notes, and the conditions of both sides,
/// without the second for a computation.
type Compared = (
    JointShape,
    ShapeDifference,
    Vec<usize>,
    Vec<String>,
    Conditions,
);
type Conditions = (
    BTreeMap<Quantity, Estimate>,
    Option<BTreeMap<Quantity, Estimate>>,
);

fn subtract_measurement(args: &DifferenceArgs) -> TaskResult<Compared> {
    let stations = args.mean.stations()?;
    let solve = |frames: &str| FrameSelection::parse(frames).solve(&args.mean, &stations);
    let (ours, theirs) = (
        solve(&args.frames)?,
        solve(args.other.as_deref().unwrap_or_default())?,
    );
    if ours
        .frames
        .iter()
        .any(|frame| theirs.frames.contains(frame))
    {
        return Err(Failure::Failed(
            "both sides have a frame in common; name different frames".into(),
        ));
    }
    if ours
        .side
        .zip(theirs.side)
        .is_some_and(|(a, b)| (a != b) != args.mirror)
    {
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
    let notes = [
        (&ours, &args.frames),
        (&theirs, args.other.as_ref().unwrap_or(&args.frames)),
    ];
    let notes = notes
        .into_iter()
        .flat_map(|(mean, name)| rejection_note(mean, name))
        .collect();
    let known = |f: &usize| !difference.values[ours.shape.station_function(*f, 0)].is_nan();
    let functions = MEASURED.into_iter().filter(known).collect();
    Ok((
        ours.shape,
        difference,
        functions,
        notes,
        (ours.conditions, Some(theirs.conditions)),
    ))
}

fn rejection_note(mean: &SelectedMean, name: &str) -> Option<String> {
    mean.rejected.then(|| {
        format!(
            "{name}: the test of the adjustment rejects a frame; its standard deviations are scaled"
        )
    })
}

fn subtract_computation(
    frames: &str,
    options: &MeanOptions,
    path: &Path,
    stations: &[PredictedStation],
) -> TaskResult<Compared> {
    let file = path.display();
    let functions: Vec<usize> = (0..COLUMN_UNITS.len())
        .filter(|f| stations.iter().any(|station| station.values[*f].is_some()))
        .collect();
    if functions.is_empty() {
        let columns = STATION_COLUMNS[1..].join(", ");
        return Err(Failure::Failed(format!(
            "{file}: has no quantity to compare; add one of the columns {columns}"
        )));
    }
    let arcs = stations
        .iter()
        .map(|station| station.arc_length_m)
        .collect();
    let choice = StationChoice::ArcLengths(arcs);
    let measured = FrameSelection::parse(frames).solve(options, &choice)?;
    let name = file.to_string();
    let (predicted, sigmas) =
        station_values(&measured.shape, measured.mean.values.len(), stations, &name)?;
    let zero = DVector::zeros(predicted.len());
    let certain = Estimate {
        value: 1.0,
        sigma: Some(0.0),
    };
    let difference = measured
        .mean
        .difference_from(&zero)
        .without_effect(&predicted, &sigmas, certain);
    let streamwise = measured.shape.station_function(STREAMWISE, 0);
    let unknown = functions.contains(&STREAMWISE) && measured.mean.values[streamwise].is_nan();
    let unknown = unknown
        .then(|| "streamwise_twist_deg is not compared: give wing.flow_direction".to_owned());
    let notes = rejection_note(&measured, frames)
        .into_iter()
        .chain(unknown)
        .collect();
    Ok((
        measured.shape,
        difference,
        functions,
        notes,
        (measured.conditions, None),
    ))
}

/// Effect of a condition on the shape.
struct LoadEffect {
    /// Change per unit of the condition.
    stations: Vec<PredictedStation>,
    /// Difference of the condition.
    amount: Estimate,
}

impl LoadEffect {
    /// Reads `FILE:QUANTITY`, `FILE:QUANTITY=VALUE` or `FILE:DELTA,SIGMA`.
    fn read(text: &str, (ours, theirs): &Conditions) -> TaskResult<Self> {
        let fail = |what: String| Failure::Usage(format!("--slope {text}: {what}"));
        let form = "write FILE:QUANTITY, FILE:QUANTITY=VALUE or FILE:DELTA,SIGMA";
        let number = |text: &str| {
            let finite = text
                .trim()
                .parse::<f64>()
                .ok()
                .filter(|number| number.is_finite());
            finite.ok_or_else(|| fail(format!("\"{text}\" is not a number; {form}")))
        };
        let (file, condition) = text.rsplit_once(':').ok_or_else(|| fail(form.into()))?;
        let stations = installation::read_stations(Path::new(file))?;
        if let Some((delta, sigma)) = condition.split_once(',') {
            let (value, sigma) = (number(delta)?, number(sigma)?);
            if sigma < 0.0 {
                return Err(fail(
                    "the standard deviation is negative; give 0 or a positive number".into(),
                ));
            }
            return Ok(Self {
                stations,
                amount: Estimate {
                    value,
                    sigma: Some(sigma),
                },
            });
        }
        let (name, reference) = condition
            .split_once('=')
            .map_or((condition, None), |(name, value)| (name, Some(value)));
        let (quantity, (scale, offset)) = Quantity::parse_with_unit(name).map_err(fail)?;
        let mean = |of: &BTreeMap<Quantity, Estimate>| {
            of.get(&quantity).copied().ok_or_else(|| {
                fail(format!(
                    "a frame has no {}; import aircraft data",
                    quantity.name()
                ))
            })
        };
        let other = match (reference, theirs) {
            (Some(value), None) => Estimate {
                value: scale * number(value)? + offset,
                sigma: Some(0.0),
            },
            (None, Some(theirs)) => mean(theirs)?,
            (None, None) => {
                return Err(fail(format!(
                    "give the computation's value: FILE:{name}=VALUE"
                )));
            }
            (Some(_), Some(_)) => {
                return Err(fail("both sides have their own values; omit =VALUE".into()));
            }
        };
        let one = mean(ours)?;
        // Tables of a quantity in another unit give the change per that unit.
        let sigma = one.sigma.unwrap_or(0.0).hypot(other.sigma.unwrap_or(0.0)) / scale;
        Ok(Self {
            stations,
            amount: Estimate {
                value: (one.value - other.value) / scale,
                sigma: Some(sigma),
            },
        })
    }
}

/// Functions of the stations of a shape by a table, interpolated along the span, with their standard deviations; NaN if the
/// table does not have them.
///
/// # Errors
/// Returns an error if a station is not between those of the table.
fn station_values(
    shape: &JointShape,
    count: usize,
    table: &[PredictedStation],
    name: &str,
) -> TaskResult<(DVector<f64>, DVector<f64>)> {
    let (mut values, mut sigmas) = (
        DVector::from_element(count, f64::NAN),
        DVector::zeros(count),
    );
    for (s, arc_m) in shape.arcs_m.iter().enumerate() {
        let after = table.partition_point(|station| station.arc_length_m < *arc_m - 1e-9);
        let Some(next) = table
            .get(after)
            .filter(|next| after > 0 || (next.arc_length_m - arc_m).abs() < 1e-9)
        else {
            let what = format!(
                "{name}: has no stations around {arc_m:.3} m; add them, or choose others with --eta"
            );
            return Err(Failure::Failed(what));
        };
        let before = &table[after.saturating_sub(1)];
        let apart_m = next.arc_length_m - before.arc_length_m;
        let share = if apart_m > 0.0 {
            (arc_m - before.arc_length_m) / apart_m
        } else {
            1.0
        };
        for (f, (_, factor)) in COLUMN_UNITS.iter().enumerate() {
            let between = |of: fn(&PredictedStation) -> &[Option<f64>; PREDICTED_COUNT]| {
                let (low, high) = (of(before)[f]?, of(next)[f]?);
                Some((low + (high - low) * share) / factor)
            };
            let at = shape.station_function(f, s);
            values[at] = between(|station| &station.values).unwrap_or(f64::NAN);
            sigmas[at] = between(|station| &station.sigmas).unwrap_or(0.0);
        }
    }
    Ok((values, sigmas))
}

fn print_table(
    args: &DifferenceArgs,
    shape: &JointShape,
    difference: &ShapeDifference,
    functions: &[usize],
    test: &ShapeTest,
) -> TaskResult<()> {
    let sigmas = difference.sigmas();
    let grid = station_grid(
        shape,
        functions,
        &[("", &difference.values), ("sigma", &sigmas)],
    );
    print_line(grid.text_with_width(args.mean.wide).trim_end())?;
    print_line(&verdict_text(test))?;
    for c in &test.combinations {
        print_line(&format!("  {}", combination_text(shape, c)))?;
    }
    Ok(())
}

/// Table of stations with columns of values for each function; a kind of values without a name has the function's.
pub(super) fn station_grid(
    shape: &JointShape,
    functions: &[usize],
    kinds: &[(&str, &DVector<f64>)],
) -> Grid {
    let stations: Vec<usize> = (0..shape.arcs_m.len()).collect();
    let mut grid = Grid::for_rows(&stations).columns(&[
        One("arc length / m", &|s| {
            format_fixed(Some(shape.arcs_m[*s]), 2)
        }),
        One("eta", &|s| {
            format_fixed(Some(shape.arcs_m[*s] / shape.length_m), 3)
        }),
    ]);
    for &f in functions {
        let (unit, factor) = COLUMN_UNITS[f];
        for (kind, values) in kinds {
            let title = if kind.is_empty() {
                format!("{} / {unit}", column_name(f))
            } else {
                (*kind).to_owned()
            };
            grid.columns.extend(Grid::new(&[&title]).columns);
            for (row, s) in grid.rows.iter_mut().zip(&stations) {
                let value = Some(values[shape.station_function(f, *s)] * factor)
                    .filter(|value| !value.is_nan());
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
    (
        column_name(function / stations),
        shape.arcs_m[function % stations],
    )
}

fn print_json_object(
    shape: &JointShape,
    difference: &ShapeDifference,
    functions: &[usize],
    test: &ShapeTest,
) -> TaskResult<()> {
    let sigmas = difference.sigmas();
    let stations = station_objects(
        shape,
        functions,
        &[("", &difference.values), ("sigma_", &sigmas)],
    );
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
                station.insert(
                    format!("{prefix}{name}"),
                    json!(is_known.then_some(values[at] * unit)),
                );
            }
        }
        station
    };
    (0..shape.arcs_m.len()).map(station).collect()
}
