//! `wingd stress` computes bending moments of a store's flights, their extremes, load cycles and relative damage.

use std::path::PathBuf;

use serde_json::json;

use crate::stress::tables as stress;
use crate::stress::tables::{FlightLoad, StationLoad, StressFrame};
use crate::stress::{ResultOrigin, StressRequest};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line, print_notes, write_output};
use wingd_evaluation::grid::Grid;
use wingd_evaluation::inputs::stored_flights::select_flights;
use wingd_evaluation::installation;
use wingd_evaluation::number::{NONE, count_text, format_fixed, format_general, format_rounded};
use wingd_evaluation::record::json_fields;
use wingd_measure::setup::StiffnessSection;
use wingd_store::FlightRef;

/// Compute bending moments relative to the ground at stations along the span, from the curvature of the solved bending
/// line.
#[derive(clap::Args)]
pub struct StressArgs {
    /// Store
    store: PathBuf,
    /// Bending stiffness along the span, CSV: s_m,ei_n_m2,sigma_ei_n_m2 and optionally ground_n_m,ultimate_n_m [default:
    /// structure.stiffness of the installation]
    #[arg(long, value_name = "FILE")]
    structure: Option<PathBuf>,
    /// Flight, for example f0001 [default: all flights]
    #[arg(long)]
    flight: Option<String>,
    /// Use the results of live mode, whose rate is high enough to count load cycles
    #[arg(long, conflicts_with = "inputs")]
    live: bool,
    /// Results to use if a flight was solved with several inputs: first characters of their key [default: newest complete
    /// solve]
    #[arg(long, value_name = "KEY")]
    inputs: Option<String>,
    /// Installation [default: the one kept in the store]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Lowest bending frequency of the wing; counting cycles needs 10 frames per period [default: from the installation,
    /// else 3]
    #[arg(long, value_name = "HZ")]
    bending_hz: Option<f64>,
    /// Slopes of the S-N curves
    #[arg(long, value_name = "M,M", value_delimiter = ',', default_values_t = [3.0, 5.0, 10.0])]
    slopes: Vec<f64>,
    /// Correct each cycle for its mean (Goodman), relative to ultimate_n_m of the stations
    #[arg(long)]
    goodman: bool,
    /// Number of exceedance levels
    #[arg(long, value_name = "N", default_value_t = 10)]
    levels: usize,
    /// Write the moments of every frame to this file, CSV
    #[arg(long, value_name = "FILE")]
    moments: Option<PathBuf>,
    /// Print one JSON object per flight
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &StressArgs) -> TaskResult<Completion> {
    check_stress_options(args)?;
    let request = StressRequest {
        installation: args.installation.clone(),
        sections: args
            .structure
            .as_deref()
            .map(installation::read_stiffness)
            .transpose()?,
        bending_hz: args.bending_hz,
        slopes: args.slopes.clone(),
        goodman: args.goodman,
        levels: args.levels,
    };
    let (mut answered, mut complete, mut table) = (0, true, MOMENTS_HEADER.to_owned());
    for flight in select_flights(&args.store, args.flight.as_deref())? {
        let found = ResultOrigin::find(&args.store, &flight, args.live, args.inputs.as_deref())?;
        let Some((from, warning)) = found else {
            continue;
        };
        print_notes(warning);
        let (query, line) = request.to_query(&args.store, &flight, from.provenance())?;
        let (frames, excluded) = from.read_frames(&args.store, &flight, &line)?;
        print_notes(excluded.iter().map(|why| format!("{}: {why}", flight.id)));
        complete &= excluded.is_empty();
        let Some(load) = stress::flight_load(&frames, &query) else {
            continue;
        };
        answered += 1;
        if args.moments.is_some() {
            append_moment_rows(&mut table, &flight, &frames, &query.sections);
        }
        print_load(args, &flight, from.inputs_key(), &load)?;
    }
    if answered == 0 {
        let why = if args.live {
            "no flight has live results with a curvature; omit --live to use the results of series"
                .to_owned()
        } else {
            format!(
                "no flight has a solved bending line; run `wingd solve {}` first",
                args.store.display()
            )
        };
        return Err(Failure::from_path_error(&args.store, why));
    }
    if let Some(file) = &args.moments {
        write_output(file, &table, "choose another file with --moments")?;
    }
    Ok(Completion::from_success(complete))
}

fn check_stress_options(args: &StressArgs) -> TaskResult<()> {
    let positive = |value: f64| value.is_finite() && value > 0.0;
    if args.bending_hz.is_some_and(|hz| !positive(hz)) {
        return Err(Failure::Usage(
            "--bending-hz: give a frequency above 0 Hz".into(),
        ));
    }
    if args.slopes.is_empty() || !args.slopes.iter().all(|m| (1.0..=30.0).contains(m)) {
        return Err(Failure::Usage(
            "--slopes: give slopes of S-N curves from 1 to 30, such as 3,5,10".into(),
        ));
    }
    if !(1..=1000).contains(&args.levels) {
        return Err(Failure::Usage("--levels: give 1 to 1000".into()));
    }
    Ok(())
}

const MOMENTS_HEADER: &str = "flight,series,image,utc,s_m,moment_n_m,sigma_moment_n_m,sigma_by_curvature_n_m,sigma_by_stiffness_n_m\n";

fn append_moment_rows(
    table: &mut String,
    flight: &FlightRef,
    frames: &[StressFrame],
    sections: &[StiffnessSection],
) {
    for frame in frames {
        for section in sections {
            let m = frame.curvature.bending_moment(section);
            let head = format!(
                "{},{},{},{}",
                flight.id, frame.series, frame.image, frame.stamp.utc
            );
            let tail = format!(
                "{},{},{},{}",
                m.value, m.sigma, m.sigma_by_curvature, m.sigma_by_stiffness
            );
            table.push_str(&format!("{head},{},{tail}\n", section.s_m));
        }
    }
}

fn print_load(
    args: &StressArgs,
    flight: &FlightRef,
    inputs: Option<&str>,
    load: &FlightLoad,
) -> TaskResult<()> {
    if args.json {
        let mut line =
            json_fields(&json!({"flight": flight.id, "inputs": inputs, "live": args.live}));
        line.extend(json_fields(load));
        return print_json(&line);
    }
    let rate = load.rate_hz.map_or(NONE.to_owned(), format_general);
    let frames = count_text(load.frames, "frame");
    print_line(&format!(
        "Flight {}: {frames}, {rate} per second; moments relative to the ground",
        flight.id
    ))?;
    print_line(station_table(load).text().trim_end())?;
    if let Some(text) = load.gaps.message() {
        print_line(&format!("Gaps: {text}"))?;
    }
    load.no_cycles_because
        .as_ref()
        .map_or(Ok(()), |why| print_line(&format!("No cycles: {why}")))
}

fn station_table(load: &FlightLoad) -> Grid {
    let slopes: Vec<f64> = load
        .stations
        .first()
        .and_then(|s| s.damage.as_ref())
        .into_iter()
        .flatten()
        .map(|d| d.slope)
        .collect();
    let mut titles = [
        "s / m",
        "greatest / kN m",
        "sigma",
        "<in",
        "smallest / kN m",
        "sigma",
    ]
    .map(str::to_owned)
    .to_vec();
    titles.extend(["ground-air-ground / kN m", "sigma"].map(str::to_owned));
    if !slopes.is_empty() {
        titles.push("cycles".to_owned());
        titles.extend(slopes.iter().map(|m| format!("damage, slope {m}")));
    }
    let titles: Vec<&str> = titles.iter().map(String::as_str).collect();
    let mut grid = Grid::new(&titles);
    load.stations
        .iter()
        .for_each(|station| grid.push(station_row(station)));
    grid
}

fn station_row(station: &StationLoad) -> Vec<String> {
    let kilo = |value: f64, sigma: f64| format_rounded(Some(1e-3 * value), Some(1e-3 * sigma), 1);
    let (high, low, cycle) = (
        &station.greatest,
        &station.smallest,
        &station.ground_air_ground,
    );
    let (greatest, sigma_greatest) = kilo(high.moment_n_m, high.sigma_moment_n_m);
    let (smallest, sigma_smallest) = kilo(low.moment_n_m, low.sigma_moment_n_m);
    let (range, sigma_range) = kilo(cycle.range_n_m, cycle.sigma_range_n_m);
    let place = format!("{}/{}", high.series, high.image);
    let mut cells = vec![
        format!("{:.2}", station.s_m),
        greatest,
        sigma_greatest,
        place,
    ];
    cells.extend([smallest, sigma_smallest, range, sigma_range]);
    if let (Some(cycles), Some(damage)) = (&station.cycles, &station.damage) {
        cells.push(format_fixed(Some(cycles.iter().map(|c| c.count).sum()), 1));
        cells.extend(damage.iter().map(|d| {
            let (value, sigma) = format_rounded(Some(d.relative), Some(d.sigma_relative), 2);
            if sigma == NONE {
                value
            } else {
                format!("{value} ± {sigma}")
            }
        }));
    }
    cells
}
