//! `wingd mean` averages the shapes of frames by the model, with the errors that they share.

use serde_json::json;

use super::difference::{MEASURED, station_grid, station_objects};
use crate::flight_shape::{FrameSelection, MeanOptions, SelectedMean};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line};
use wingd_evaluation::number::count_text;
use wingd_measure::adjust::{CommonErrors, ShapeMean};

/// Average the shapes of frames. Errors that the frames share stay in the standard deviation; scatter is that of single
/// frames about the mean of their flight. Markers that are hidden in some frames do not change the mean: the adjusted shape
/// is averaged.
#[derive(clap::Args)]
pub struct MeanArgs {
    /// Measured frames: STORE, STORE:FLIGHT, STORE:FLIGHT/SERIES or STORE:FLIGHT/SERIES/FRAME; several flights count equally
    #[arg(value_name = "FRAMES", required = true)]
    frames: Vec<String>,
    #[command(flatten)]
    mean: MeanOptions,
}

pub(super) fn run(args: &MeanArgs) -> TaskResult<Completion> {
    let stations = args.mean.stations()?;
    let solve = |frames: &String| FrameSelection::parse(frames).solve(&args.mean, &stations);
    let means = args
        .frames
        .iter()
        .map(solve)
        .collect::<TaskResult<Vec<_>>>()?;
    let Some(first) = means.first() else {
        return Ok(Completion::All);
    };
    for (k, other) in means.iter().enumerate() {
        means[..k]
            .iter()
            .try_for_each(|before| check_pair(before, other))?;
    }
    let rows = first.shape.marker_function(0);
    let cut: Vec<ShapeMean> = means
        .iter()
        .map(|mean| mean.mean.first_functions(rows))
        .collect();
    let mean = ShapeMean::average(&cut);
    let sigmas = mean.sigmas();
    let known = |f: &usize| !mean.values[first.shape.station_function(*f, 0)].is_nan();
    let functions: Vec<usize> = MEASURED.into_iter().filter(known).collect();
    let count: usize = means.iter().map(|mean| mean.frames.len()).sum();
    let (mut kinds, mut fields) = (
        vec![("", &mean.values), ("sigma", &sigmas)],
        vec![("", &mean.values), ("sigma_", &sigmas)],
    );
    if let Some(scatter) = &mean.scatter {
        kinds.push(("scatter", scatter));
        fields.push(("scatter_", scatter));
    }
    if args.mean.json {
        let stations = station_objects(&first.shape, &functions, &fields);
        return print_json(&json!({"frames": count, "stations": stations}))
            .map(|()| Completion::All);
    }
    print_line(
        station_grid(&first.shape, &functions, &kinds)
            .text_with_width(args.mean.wide)
            .trim_end(),
    )?;
    print_line(&format!(
        "mean of {} of {}",
        count_text(count, "frame"),
        count_text(means.len(), "flight")
    ))?;
    Ok(Completion::All)
}

/// Checks that two means may be averaged: the errors that they share must be known, since they do not become smaller.
fn check_pair(one: &SelectedMean, other: &SelectedMean) -> TaskResult<()> {
    let what = if other.side != one.side {
        "the flights are of the left and the right wing; average each alone"
    } else if one.frames.iter().any(|frame| other.frames.contains(frame)) {
        "a frame is named twice; name each once"
    } else {
        match one.common_errors(other)? {
            CommonErrors::Installation => return Ok(()),
            CommonErrors::Flight => {
                "several names are of one flight; name the flight, and choose frames with --where"
            }
            CommonErrors::None => {
                "the flights have different installations, and it is not known which errors of survey and camera these share; \
                 average each alone"
            }
        }
    };
    Err(Failure::Failed(what.into()))
}
