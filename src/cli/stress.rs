//! `wingd stress` computes bending moments of a store's flights, their extremes, load cycles and relative damage.

mod live;

use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use super::store_access::select_flights;
use super::{Completion, Failure, print_line};
use crate::clock::Stamp;
use crate::installation::{self, Installation, Structure};
use crate::measure::setup::{DEFAULT_BENDING_HZ, StiffnessSection, Width};
use crate::measure::stress::{BendingCurvature, DEFAULT_STEPS, bending_length_m};
use crate::report::grid::Grid;
use crate::report::number::{NONE, count_text, format_fixed, format_general, format_rounded, json_fields};
use crate::report::stress::{self, FlightLoad, StationLoad, StressFrame, StressQuery};
use crate::report::{ShotData, source};
use crate::store::result_sets::{self, ResultSet};
use crate::store::{FlightRef, RealDisk, catalogue, installations};

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

pub(super) fn run(args: &StressArgs) -> Result<Completion, Failure> {
    check_options(args)?;
    let given = args.structure.as_deref().map(installation::read_stiffness).transpose()?;
    let (mut answered, mut complete, mut table) = (0, true, MOMENTS_HEADER.to_owned());
    for flight in select_flights(&args.store, args.flight.as_deref())? {
        let Some(from) = ResultOrigin::from_args(args, &flight)? else { continue };
        let question = build_question(args, given.as_deref(), &flight, from.provenance())?;
        let (frames, excluded) = match &from {
            ResultOrigin::Series(set) => series_frames(&flight, set, &question.1)?,
            ResultOrigin::Live(provenance) => live::live_frames(&args.store, &flight, provenance, &question.1)?,
        };
        for why in &excluded {
            eprintln!("wingd: {}: {why}", flight.id);
        }
        complete &= excluded.is_empty();
        let Some(load) = stress::flight_load(&frames, &question.0) else { continue };
        answered += 1;
        if args.moments.is_some() {
            append_moments(&mut table, &flight, &frames, &question.0.sections);
        }
        print_load(args, &flight, from.inputs_key(), &load)?;
    }
    if answered == 0 {
        let store = args.store.display();
        let why = if args.live {
            format!("{store}: no flight has live results with a curvature; omit --live to use the results of series")
        } else {
            format!("{store}: no flight has a solved bending line; run `wingd solve {store}` first")
        };
        return Err(Failure::Failed(why));
    }
    write_moments(args, &table)?;
    Ok(Completion::from_success(complete))
}

fn check_options(args: &StressArgs) -> Result<(), Failure> {
    let positive = |value: f64| value.is_finite() && value > 0.0;
    if args.bending_hz.is_some_and(|hz| !positive(hz)) {
        return Err(Failure::Usage("--bending-hz: give a frequency above 0 Hz".into()));
    }
    if args.slopes.is_empty() || !args.slopes.iter().all(|m| (1.0..=30.0).contains(m)) {
        return Err(Failure::Usage("--slopes: give slopes of S-N curves from 1 to 30, such as 3,5,10".into()));
    }
    if !(1..=1000).contains(&args.levels) {
        return Err(Failure::Usage("--levels: give 1 to 1000".into()));
    }
    Ok(())
}

/// Results of a flight to evaluate.
enum ResultOrigin {
    Series(ResultSet),
    /// Results of live mode, by their provenance.
    Live(Map<String, Value>),
}

impl ResultOrigin {
    fn from_args(args: &StressArgs, flight: &FlightRef) -> Result<Option<Self>, Failure> {
        if args.live {
            return Ok(live::last_provenance(&args.store, flight)?.map(Self::Live));
        }
        let all = result_sets::flight_result_sets(&RealDisk, flight)?;
        let Some(set) = all.choose_set(args.inputs.as_deref()) else { return Ok(None) };
        if let Some(warning) = all.mixed_inputs_warning(&flight.id, args.inputs.as_deref()) {
            eprintln!("wingd: {warning}");
        }
        Ok(Some(Self::Series(set.clone())))
    }

    fn provenance(&self) -> &Map<String, Value> {
        match self {
            Self::Series(set) => &set.provenance,
            Self::Live(provenance) => provenance,
        }
    }

    fn inputs_key(&self) -> Option<&str> {
        match self {
            Self::Series(set) => Some(&set.key),
            Self::Live(_) => None,
        }
    }
}

/// Properties common to the bending lines of all frames.
struct BendingLine {
    length_m: f64,
    root_sigma_m: f64,
}

fn build_question(
    args: &StressArgs,
    given: Option<&[StiffnessSection]>,
    flight: &FlightRef,
    provenance: &Map<String, Value>,
) -> Result<(StressQuery, BendingLine), Failure> {
    let installation = load_installation(args, flight, provenance)?;
    let own: Option<&Structure> = installation.structure.as_ref();
    let sections = given.map(<[StiffnessSection]>::to_vec).or_else(|| own.map(|s| s.sections.clone()));
    let sections = sections.ok_or_else(|| {
        let what = "there is no bending stiffness: give --structure FILE, or [structure] in installation.toml";
        Failure::Usage(what.to_owned())
    })?;
    if let Some(section) = sections.iter().find(|s| args.goodman && s.ultimate_n_m.is_none()) {
        let what = format!("--goodman: ultimate_n_m of the station at {} m is missing", section.s_m);
        return Err(Failure::Usage(what));
    }
    let orientation = installation.require_orientation()?;
    let length_m = bending_length_m(&installation.setup, orientation);
    let length_m = length_m.map_err(|error| Failure::Failed(format!("{}: {error}", flight.id)))?;
    if let Some(section) = sections.iter().find(|s| s.s_m > length_m) {
        let what = format!("a station at {} m lies beyond the tip, {length_m:.2} m", section.s_m);
        return Err(Failure::Failed(format!("{what} from the bending root; remove it from the structure file")));
    }
    let hz = args.bending_hz.or(own.map(|s| s.bending_hz)).unwrap_or(DEFAULT_BENDING_HZ);
    let question = StressQuery {
        sections,
        bending_hz: hz,
        slopes: args.slopes.clone(),
        goodman: args.goodman,
        levels: args.levels,
    };
    Ok((question, BendingLine { length_m, root_sigma_m: installation.setup.uncertainty[Width::RootOffset] }))
}

/// Loads the installation of the command line, else the one that the results came from.
fn load_installation(
    args: &StressArgs,
    flight: &FlightRef,
    provenance: &Map<String, Value>,
) -> Result<Installation, Failure> {
    let directory = match &args.installation {
        Some(directory) => directory.clone(),
        None => {
            let digest = installations::digest_from_provenance(provenance);
            let kept = digest.map(|digest| installations::installation_folder(&args.store, &digest));
            kept.filter(|folder| folder.is_dir()).ok_or_else(|| {
                let (store, flight) = (args.store.display(), &flight.id);
                Failure::Failed(format!(
                    "{store}: the store has no installation for {flight}; name it with --installation"
                ))
            })?
        }
    };
    Ok(installation::load(&directory)?)
}

/// Reads the bending lines of a flight's solved frames, and the reasons for excluding others.
fn series_frames(
    flight: &FlightRef,
    set: &ResultSet,
    line: &BendingLine,
) -> Result<(Vec<StressFrame>, Vec<String>), Failure> {
    let (mut frames, mut excluded) = (Vec::new(), Vec::new());
    for series in catalogue::list_series(&RealDisk, flight)? {
        let Some(read) = source::read_series(&RealDisk, &series, Some(set), &mut excluded) else { continue };
        for record in &read.records {
            let Some(stamp) = read.shot_for_record(record).and_then(exposure_stamp) else { continue };
            match stress::curvature_coefficients(record) {
                Err(why) => excluded.push(format!("{}/{}: {why}", series.id, record.image)),
                Ok((coefficients_per_m, covariance)) => frames.push(StressFrame {
                    series: series.id.clone(),
                    image: record.image.clone(),
                    stamp,
                    curvature: BendingCurvature {
                        coefficients_per_m,
                        covariance,
                        length_m: line.length_m,
                        root_sigma_m: line.root_sigma_m,
                        steps: DEFAULT_STEPS,
                    },
                }),
            }
        }
    }
    Ok((frames, excluded))
}

/// Returns the time of exposure as a stamp.
fn exposure_stamp(shot: &ShotData) -> Option<Stamp> {
    let commanded = shot.stamp.clone()?;
    let exposure = shot.exposure.as_ref();
    Some(exposure.map_or(commanded.clone(), |exposure| Stamp {
        utc: exposure.exposure_time,
        since_boot_s: exposure.exposure_since_boot_s,
        ..commanded
    }))
}

const MOMENTS_HEADER: &str =
    "flight,series,image,utc,s_m,moment_n_m,sigma_moment_n_m,sigma_by_curvature_n_m,sigma_by_stiffness_n_m\n";

fn append_moments(table: &mut String, flight: &FlightRef, frames: &[StressFrame], sections: &[StiffnessSection]) {
    for frame in frames {
        for section in sections {
            let m = frame.curvature.bending_moment(section);
            let head = format!("{},{},{},{}", flight.id, frame.series, frame.image, frame.stamp.utc);
            let tail = format!("{},{},{},{}", m.value, m.sigma, m.sigma_by_curvature, m.sigma_by_stiffness);
            table.push_str(&format!("{head},{},{tail}\n", section.s_m));
        }
    }
}

fn write_moments(args: &StressArgs, table: &str) -> Result<(), Failure> {
    let Some(file) = args.moments.as_deref() else { return Ok(()) };
    installation::write_atomically(file, table).map_err(|e| moments_write_failure(file, &e))
}

fn moments_write_failure(file: &Path, error: &std::io::Error) -> Failure {
    let file = file.display();
    Failure::Failed(format!("{file}: could not write: {error}; choose another file with --moments"))
}

fn print_load(args: &StressArgs, flight: &FlightRef, inputs: Option<&str>, load: &FlightLoad) -> Result<(), Failure> {
    if args.json {
        let mut line = json_fields(&json!({"flight": flight.id, "inputs": inputs, "live": args.live}));
        line.extend(json_fields(load));
        return print_line(&json!(line).to_string());
    }
    let rate = load.rate_hz.map_or(NONE.to_owned(), format_general);
    let frames = count_text(load.frames, "frame");
    print_line(&format!("Flight {}: {frames}, {rate} per second; moments relative to the ground", flight.id))?;
    print_line(station_table(load).text().trim_end())?;
    if let Some(text) = load.gaps.message() {
        print_line(&format!("Gaps: {text}"))?;
    }
    load.no_cycles_because.as_ref().map_or(Ok(()), |why| print_line(&format!("No cycles: {why}")))
}

fn station_table(load: &FlightLoad) -> Grid {
    let slopes: Vec<f64> =
        load.stations.first().and_then(|s| s.damage.as_ref()).into_iter().flatten().map(|d| d.slope).collect();
    let mut titles: Vec<String> = ["s / m", "greatest / kN m", "sigma", "<in", "smallest / kN m", "sigma"]
        .into_iter()
        .chain(["ground-air-ground / kN m", "sigma"])
        .map(str::to_owned)
        .collect();
    if !slopes.is_empty() {
        titles.push("cycles".to_owned());
        titles.extend(slopes.iter().map(|m| format!("damage, slope {m}")));
    }
    let titles: Vec<&str> = titles.iter().map(String::as_str).collect();
    let mut grid = Grid::new(&titles);
    load.stations.iter().for_each(|station| grid.push(station_row(station)));
    grid
}

fn station_row(station: &StationLoad) -> Vec<String> {
    let kilo = |value: f64, sigma: f64| format_rounded(Some(1e-3 * value), Some(1e-3 * sigma), 1);
    let (high, low, cycle) = (&station.greatest, &station.smallest, &station.ground_air_ground);
    let (greatest, sigma_greatest) = kilo(high.moment_n_m, high.sigma_moment_n_m);
    let (smallest, sigma_smallest) = kilo(low.moment_n_m, low.sigma_moment_n_m);
    let (range, sigma_range) = kilo(cycle.range_n_m, cycle.sigma_range_n_m);
    let place = format!("{}/{}", high.series, high.image);
    let mut cells = vec![format!("{:.2}", station.s_m), greatest, sigma_greatest, place];
    cells.extend([smallest, sigma_smallest, range, sigma_range]);
    if let (Some(cycles), Some(damage)) = (&station.cycles, &station.damage) {
        cells.push(format_fixed(Some(cycles.iter().map(|c| c.count).sum()), 1));
        cells.extend(damage.iter().map(|d| {
            let (value, sigma) = format_rounded(Some(d.relative), Some(d.sigma_relative), 2);
            if sigma == NONE { value } else { format!("{value} ± {sigma}") }
        }));
    }
    cells
}
