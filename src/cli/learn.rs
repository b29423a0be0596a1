//! `wingd learn` estimates flight-invariant parameters from several flights and stores them as a prior.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::{
    CHECK_WRITE_ACCESS, Completion, Failure, default_paths, image_batch, print_line, store_access, stored_frames,
    write_failure,
};
use crate::installation::{self, FLIGHT_PRIOR_FILE, Installation, PriorFlight, StoredFlightPrior};
use crate::measure::adjust::Estimate;
use crate::measure::adjust::flight_prior::{FlightContribution, InvariantParameter};
use crate::measure::widths::Unknown;
use crate::pipeline::guard::{PANIC_REASON, catch_panic};
use crate::pipeline::{self, ProcessedFrame, SolveJob};
use crate::record::Reason;
use crate::report::number::{count_text, format_rounded};
use crate::store::{self, FrameRef, RealDisk, catalogue};

/// Estimate flight-invariant parameters of wing, camera and survey from several flights, and write them into the
/// installation (flight_prior.json) as a prior for later flights, single frames and live mode.
#[derive(clap::Args)]
pub struct LearnArgs {
    /// Installation; flight_prior.json is written into it [default: installation/ in this directory]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Use only this flight of the stores, for example f0001 [default: all flights]
    #[arg(long, value_name = "FLIGHT")]
    flight: Option<String>,
    /// Print one JSON object: file, flights_in_prior, flights, differences
    #[arg(long)]
    json: bool,
    /// Images processed in parallel [default: number of cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
    /// Stores with flights of this installation; a flight that is already in the prior is skipped
    #[arg(required = true, value_name = "STORE")]
    stores: Vec<PathBuf>,
}

/// A flight that may contribute to the prior.
struct Candidate {
    store: String,
    flight: String,
    frames: Vec<String>,
    processed: Vec<ProcessedFrame>,
    contribution: Option<FlightContribution>,
}

/// Outcome of a flight, by store and name.
struct FlightOutcome {
    store: String,
    flight: String,
    frames: usize,
    status: &'static str,
    reason: Option<String>,
}

pub(super) fn run(args: &LearnArgs) -> Result<Completion, Failure> {
    let directory = default_paths::resolve_installation(args.installation.as_deref())?;
    let mut installation = super::load_installation(&directory)?;
    installation.require_orientation()?;
    let before = installation.flight_prior.as_ref().map_or(vec![], |prior| prior.flights.clone());
    let (mut outcomes, mut candidates) = (vec![], vec![]);
    for root in &args.stores {
        gather_candidates(args, root, &installation, &before, &mut outcomes, &mut candidates)?;
    }
    for _ in 0..LEARNING_ROUNDS {
        refine_contributions(&mut candidates, &before, &mut installation, &mut outcomes)?;
    }
    outcomes.extend(candidates.iter().map(|candidate| candidate.outcome("added", None)));
    let sources: Vec<PriorFlight> =
        before.into_iter().chain(candidates.iter().filter_map(Candidate::to_source)).collect();
    let count = sources.len();
    if !candidates.is_empty() {
        let prior = combine_sources(sources, &installation)?;
        let file = installation.directory.join(FLIGHT_PRIOR_FILE);
        installation::write_flight_prior(&installation, &prior).map_err(write_failure(&file, CHECK_WRITE_ACCESS))?;
    }
    let known =
        candidates.last().and_then(|candidate| candidate.contribution.as_ref()).map_or(vec![], estimated_differences);
    let output = if args.json { outcome_json } else { outcome_text };
    print_line(&output(&installation.directory.join(FLIGHT_PRIOR_FILE), &outcomes, count, &known))?;
    Ok(Completion::from_success(outcomes.iter().all(|outcome| outcome.status != "refused")))
}

/// Rounds of linearisation. Each flight is linearised first given the flights before it, then given all others: normal
/// equations that are added must refer to the same point.
const LEARNING_ROUNDS: usize = 2;

/// Estimates the contribution of each candidate given the others, and removes those that contradict the model or the prior.
fn refine_contributions(
    candidates: &mut Vec<Candidate>,
    before: &[PriorFlight],
    installation: &mut Installation,
    outcomes: &mut Vec<FlightOutcome>,
) -> Result<(), Failure> {
    let mut k = 0;
    while k < candidates.len() {
        let others = candidates.iter().enumerate().filter(|(other, _)| *other != k);
        let others = others.filter_map(|(_, candidate)| candidate.to_source());
        installation.flight_prior =
            Some(combine_sources(before.iter().cloned().chain(others).collect(), installation)?);
        match candidates[k].estimate_contribution(installation) {
            Ok(()) => k += 1,
            Err(reason) => outcomes.push(candidates.remove(k).outcome("refused", Some(reason.to_string()))),
        }
    }
    Ok(())
}

fn combine_sources(sources: Vec<PriorFlight>, installation: &Installation) -> Result<StoredFlightPrior, Failure> {
    let file = installation.directory.join(FLIGHT_PRIOR_FILE);
    let failure = |error| Failure::Failed(format!("{}: {error}", file.display()));
    StoredFlightPrior::from_flights(sources, &installation.setup).map_err(failure)
}

impl Candidate {
    /// Returns the contribution as stored in the prior; `None` before the first estimate.
    fn to_source(&self) -> Option<PriorFlight> {
        let contribution = self.contribution.as_ref()?;
        Some(PriorFlight {
            store: self.store.clone(),
            flight: self.flight.clone(),
            program: format!("wingd {}", env!("CARGO_PKG_VERSION")),
            frames: self.frames.clone(),
            normals: contribution.normals.clone(),
        })
    }

    fn estimate_contribution(&mut self, installation: &Installation) -> Result<(), Reason> {
        let busy = image_batch::show_busy(&format!("estimating from {}", self.flight));
        let orientation = installation.orientation.as_ref().ok_or("there is no orientation")?;
        let contribution = pipeline::learn_flight(&self.processed, installation, orientation, &SolveJob::default());
        drop(busy);
        self.contribution = Some(contribution?);
        Ok(())
    }

    fn outcome(&self, status: &'static str, reason: Option<String>) -> FlightOutcome {
        FlightOutcome {
            store: self.store.clone(),
            flight: self.flight.clone(),
            frames: self.frames.len(),
            status,
            reason,
        }
    }
}

/// Measures the frames of a store's flights; flights already in the prior are only listed.
fn gather_candidates(
    args: &LearnArgs,
    root: &Path,
    installation: &Installation,
    before: &[PriorFlight],
    outcomes: &mut Vec<FlightOutcome>,
    candidates: &mut Vec<Candidate>,
) -> Result<(), Failure> {
    let flights = store_access::select_flights(root, args.flight.as_deref())?;
    let store = catalogue::store_id(&RealDisk, root).unwrap_or_else(|| root.display().to_string());
    for flight in flights {
        let frames = store_access::flight_frames(&RealDisk, &flight, None)?;
        let digests: Vec<String> = frames.iter().map(|frame| frame.entry.sha256.clone()).collect();
        let (store, id) = (store.clone(), flight.id.clone());
        let candidate = Candidate { store, flight: id, frames: digests, processed: vec![], contribution: None };
        let is_known = |store: &str, flight: &str, frames: &[String]| {
            (store, flight) == (candidate.store.as_str(), candidate.flight.as_str())
                || frames.iter().any(|frame| candidate.frames.contains(frame))
        };
        if before.iter().any(|s| is_known(&s.store, &s.flight, &s.frames))
            || candidates.iter().any(|p| is_known(&p.store, &p.flight, &p.frames))
        {
            let reason = "already included in flight_prior.json; skipped".to_owned();
            outcomes.push(candidate.outcome("known", Some(reason)));
            continue;
        }
        let processed_frames = measure_frames(args, root, &flight, &frames, installation)?;
        match processed_frames.iter().all(|processed| processed.failure.is_some()) {
            true => {
                let first = processed_frames.iter().find_map(|processed| processed.failure.as_ref());
                let reason = first
                    .map_or("no frames".into(), |failure| format!("none of its frames can be processed: {failure}"));
                outcomes.push(candidate.outcome("refused", Some(reason)));
            }
            false => candidates.push(Candidate { processed: processed_frames, ..candidate }),
        }
    }
    Ok(())
}

fn measure_frames(
    args: &LearnArgs,
    root: &Path,
    flight: &store::FlightRef,
    list: &[FrameRef],
    installation: &Installation,
) -> Result<Vec<ProcessedFrame>, Failure> {
    let orientation = installation.require_orientation()?;
    let (track, _) = stored_frames::read_aircraft_data(&RealDisk, root, flight)?;
    let mountings: BTreeMap<_, _> = stored_frames::frame_mountings(&RealDisk, flight)?;
    let process = |frame: &FrameRef, bytes: Result<&[u8], Reason>| {
        let mounting = mountings.get(&frame.entry.sha256).copied();
        ProcessedFrame {
            mounting,
            ..stored_frames::process_stored_frame(frame, bytes, installation, orientation, &track)
        }
    };
    let one = |frame: &FrameRef| {
        let bytes = store::read_frame(&RealDisk, frame).map_err(Reason::from_error);
        let readable = bytes.as_deref().map_err(Clone::clone);
        catch_panic(|| process(frame, readable)).unwrap_or_else(|| process(frame, Err(PANIC_REASON.into())))
    };
    let mut processed_frames = Vec::with_capacity(list.len());
    image_batch::run_jobs(list, args.jobs, "measuring", one, |processed| {
        processed_frames.push(processed);
        Ok(())
    })?;
    Ok(processed_frames)
}

/// Parameters whose change is printed: key, factor to its unit, unknown, index within it.
const REPORTED_PARAMETERS: [(&str, f64, Unknown, usize); 8] = [
    ("root_offset_m", 1.0, Unknown::RootOffset, 0),
    ("axis_chord_offset_m", 1.0, Unknown::ChordOffset, 0),
    ("span_direction_deg", 180.0 / std::f64::consts::PI, Unknown::SpanDirection, 0),
    ("axis_height_root_m", 1.0, Unknown::AxisHeight, 0),
    ("ground_bend_m", 1.0, Unknown::GroundBend, 0),
    ("projection_centre_x_m", 1.0, Unknown::ProjectionCentre, 0),
    ("projection_centre_y_m", 1.0, Unknown::ProjectionCentre, 1),
    ("projection_centre_z_m", 1.0, Unknown::ProjectionCentre, 2),
];

/// Estimated minus specified value of the reported parameters.
fn estimated_differences(contribution: &FlightContribution) -> Vec<(&'static str, Estimate)> {
    let all = || contribution.normals.unknowns.iter().zip(&contribution.posterior);
    let of = |(name, factor, unknown, index): (&'static str, f64, Unknown, usize)| {
        let is = |(l, _): &(&InvariantParameter, &Estimate)| l.unknown == unknown && l.index == index;
        let (_, found) = all().find(is)?;
        Some((name, Estimate { value: factor * found.value, sigma: found.sigma.map(|s| factor * s) }))
    };
    REPORTED_PARAMETERS.into_iter().filter_map(of).collect()
}

fn outcome_json(file: &Path, outcomes: &[FlightOutcome], sources: usize, known: &[(&'static str, Estimate)]) -> String {
    let flight = |t: &FlightOutcome| {
        let FlightOutcome { store, flight, frames, status, reason } = t;
        json!({"store": store, "flight": flight, "frames": frames, "status": status, "reason": reason})
    };
    let known: serde_json::Map<String, Value> =
        known.iter().map(|(name, e)| ((*name).to_owned(), json!({"value": e.value, "sigma": e.sigma}))).collect();
    json!({
        "file": file,
        "flights_in_prior": sources,
        "flights": outcomes.iter().map(flight).collect::<Vec<_>>(),
        "differences": known,
    })
    .to_string()
}

fn outcome_text(file: &Path, outcomes: &[FlightOutcome], sources: usize, known: &[(&'static str, Estimate)]) -> String {
    let flight = |t: &FlightOutcome| {
        let why = t.reason.as_ref().map_or(String::new(), |reason| format!(": {reason}"));
        format!("{}  {} frames  {}{why}\n", t.flight, t.frames, if t.status == "known" { "skipped" } else { t.status })
    };
    let flights: String = outcomes.iter().map(flight).collect();
    let difference = |(name, e): &(&'static str, Estimate)| {
        let (value, sigma) = format_rounded(Some(e.value), e.sigma, 4);
        format!("\n{name:<24}{value} ± {sigma}")
    };
    let differences: String = known.iter().map(difference).collect();
    let head = if known.is_empty() { "" } else { "\nEstimated minus specified value:" };
    format!("{flights}{}: prior from {}{head}{differences}", file.display(), count_text(sources, "flight"))
}
