//! `wingd mean` averages the shapes of frames by the model, with the errors that they share.

use serde_json::json;

use super::difference::{MEASURED, station_grid, station_objects};
use super::flight_shape::{FrameSelection, MeanOptions};
use super::{Completion, Failure, TaskResult, print_json, print_line};
use crate::measure::adjust::{CommonErrors, ShapeMean};

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
    let means = args.frames.iter().map(solve).collect::<TaskResult<Vec<_>>>()?;
    let Some((first, others)) = means.split_first() else { return Ok(Completion::All) };
    let mut common = CommonErrors::Installation;
    for (k, other) in others.iter().enumerate() {
        if other.side != first.side {
            return Err(Failure::Failed("the flights are of the left and the right wing; average each alone".into()));
        }
        if means[..=k].iter().any(|before| before.frames.iter().any(|frame| other.frames.contains(frame))) {
            return Err(Failure::Failed("a frame is named twice; name each once".into()));
        }
        match first.common_errors(other) {
            Some(CommonErrors::None) => common = CommonErrors::None,
            Some(CommonErrors::Flight) => {
                let what = "several names are of one flight; name the flight, and choose frames with --where";
                return Err(Failure::Failed(what.into()));
            }
            Some(CommonErrors::Installation) => {}
            None => {
                return Err(Failure::Failed(
                    "flights that were solved frame by frame cannot be averaged; run `wingd solve STORE --flight`"
                        .into(),
                ));
            }
        }
    }
    let rows = first.shape.marker_function(0);
    let cut: Vec<ShapeMean> = means.iter().map(|mean| mean.mean.first_functions(rows)).collect();
    let mean = ShapeMean::average(&cut, common);
    let sigmas = mean.sigmas();
    let known = |f: &usize| !mean.values[first.shape.station_function(*f, 0)].is_nan();
    let functions: Vec<usize> = MEASURED.into_iter().filter(known).collect();
    let count: usize = means.iter().map(|mean| mean.frames.len()).sum();
    if args.mean.json {
        let mut stations = station_objects(&first.shape, &functions, &mean.values, &sigmas);
        let scatter = mean.scatter.as_ref().map(|scatter| station_objects(&first.shape, &functions, scatter, &sigmas));
        for (station, scatter) in stations.iter_mut().zip(scatter.into_iter().flatten()) {
            let named = scatter.into_iter().filter(|(name, _)| station.contains_key(&format!("sigma_{name}")));
            station.extend(named.map(|(name, value)| (format!("scatter_{name}"), value)).collect::<Vec<_>>());
        }
        return print_json(&json!({"frames": count, "stations": stations})).map(|()| Completion::All);
    }
    let mut kinds = vec![("", &mean.values), ("sigma", &sigmas)];
    kinds.extend(mean.scatter.as_ref().map(|scatter| ("scatter", scatter)));
    print_line(station_grid(&first.shape, &functions, &kinds).text_with_width(args.mean.wide).trim_end())?;
    print_line(&format!("mean of {count} frames in {} flights", means.len()))?;
    Ok(Completion::All)
}
