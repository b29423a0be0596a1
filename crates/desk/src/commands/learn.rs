//! `wingd learn` estimates flight-invariant parameters from several flights and stores them as a prior.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::learning;
use crate::learning::{NamedEstimate, PriorCandidate};
use wingd_base::failure::CHECK_WRITE_ACCESS;
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_line, print_notes};
use wingd_evaluation::inputs::batch;
use wingd_evaluation::inputs::default_paths::{load_installation, resolve_installation};
use wingd_evaluation::inputs::flight_marks::FlightMarks;
use wingd_evaluation::inputs::stopping::run_long_task;
use wingd_evaluation::inputs::stored_flights::{flight_frames, select_flights};
use wingd_evaluation::inputs::stored_frames;
use wingd_evaluation::inputs::stored_frames::{FlightAircraftData, FlightInputs};
use wingd_evaluation::installation;
use wingd_evaluation::installation::{FLIGHT_PRIOR_FILE, Installation};
use wingd_evaluation::number::{count_text, format_rounded};
use wingd_evaluation::pipeline::ProcessedFrame;
use wingd_evaluation::record::Reason;
use wingd_store::{FlightRef, FrameRef, RealDisk, catalogue};

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

#[derive(Clone, Copy, PartialEq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
enum LearnStatus {
    Added,
    Known,
    Refused,
}

/// Outcome of a flight, by store and name.
#[derive(serde::Serialize)]
struct FlightOutcome {
    store: String,
    flight: String,
    frames: usize,
    status: LearnStatus,
    reason: Option<String>,
}

impl FlightOutcome {
    fn new(candidate: &PriorCandidate, status: LearnStatus, reason: Option<String>) -> Self {
        let PriorCandidate {
            store,
            flight,
            frames,
            ..
        } = candidate;
        Self {
            store: store.clone(),
            flight: flight.clone(),
            frames: frames.len(),
            status,
            reason,
        }
    }
}

/// Estimates the repeating parameters from flights and writes them as the installation's prior.
pub(super) fn run(args: &LearnArgs) -> TaskResult<Completion> {
    let mut installation = load_installation(&resolve_installation(args.installation.as_deref())?)?;
    installation.require_orientation()?;
    let file = installation.directory.join(FLIGHT_PRIOR_FILE);
    let (mut outcomes, mut candidates) = (vec![], vec![]);
    for root in &args.stores {
        gather_candidates(args, root, &installation, &mut outcomes, &mut candidates)?;
    }
    let busy = |flight: &str, task: &mut dyn FnMut()| {
        run_long_task(&format!("estimating from {flight}"), task)
    };
    let (flights, refused) =
        learning::estimate_contributions(&mut candidates, &mut installation, busy)?;
    let refused = refused.iter().map(|(candidate, why)| {
        FlightOutcome::new(candidate, LearnStatus::Refused, Some(why.to_string()))
    });
    outcomes.extend(refused);
    outcomes.extend(
        candidates
            .iter()
            .map(|candidate| FlightOutcome::new(candidate, LearnStatus::Added, None)),
    );
    let count = flights.len();
    if !candidates.is_empty() {
        let prior = learning::combine_flights(flights, &installation)?;
        installation::write_flight_prior(&installation, &prior)
            .map_err(|error| Failure::from_write_error(&file, &error, CHECK_WRITE_ACCESS))?;
    }
    let last = candidates
        .last()
        .and_then(|candidate| candidate.contribution.as_ref());
    let known = last.map_or(vec![], learning::estimated_differences);
    let contradictions = last.map_or(vec![], learning::list_contradictions);
    print_notes(contradictions.iter().map(|text| format!("warning: {text}")));
    let output = if args.json {
        outcome_json
    } else {
        outcome_text
    };
    print_line(&output(&file, &outcomes, count, &known))?;
    Ok(Completion::from_success(
        outcomes
            .iter()
            .all(|outcome| outcome.status != LearnStatus::Refused),
    ))
}

/// Measures the frames of a store's flights; flights already in the prior are only listed.
fn gather_candidates(
    args: &LearnArgs,
    root: &Path,
    installation: &Installation,
    outcomes: &mut Vec<FlightOutcome>,
    candidates: &mut Vec<PriorCandidate>,
) -> TaskResult<()> {
    let store = catalogue::store_id(&RealDisk, root).unwrap_or_else(|| root.display().to_string());
    for flight in select_flights(root, args.flight.as_deref())? {
        let frames = flight_frames(&RealDisk, &flight, None)?;
        let digests = frames
            .iter()
            .map(|frame| frame.entry.sha256.clone())
            .collect();
        let candidate = PriorCandidate::new(store.clone(), flight.id.clone(), digests);
        let mut learnt = installation
            .flight_prior
            .iter()
            .flat_map(|prior| &prior.flights);
        if learnt.any(|known| candidate.is_same_flight(&known.store, &known.flight, &known.frames))
            || candidates
                .iter()
                .any(|known| candidate.is_same_flight(&known.store, &known.flight, &known.frames))
        {
            let reason = "already included in flight_prior.json; skipped".to_owned();
            outcomes.push(FlightOutcome::new(
                &candidate,
                LearnStatus::Known,
                Some(reason),
            ));
            continue;
        }
        let processed = measure_frames(args, root, &flight, &frames, installation)?;
        if processed.iter().all(|frame| frame.failure.is_some()) {
            let first = processed.iter().find_map(|frame| frame.failure.as_ref());
            let reason = first.map_or("no frames".into(), |failure| {
                format!("none of its frames can be processed: {failure}")
            });
            outcomes.push(FlightOutcome::new(
                &candidate,
                LearnStatus::Refused,
                Some(reason),
            ));
        } else {
            candidates.push(PriorCandidate {
                processed,
                ..candidate
            });
        }
    }
    Ok(())
}

fn measure_frames(
    args: &LearnArgs,
    root: &Path,
    flight: &FlightRef,
    frames: &[FrameRef],
    installation: &Installation,
) -> TaskResult<Vec<ProcessedFrame>> {
    let known = FlightInputs {
        installation,
        orientation: installation.require_orientation()?,
        aircraft: FlightAircraftData::read(&RealDisk, root, flight)?,
        marks: FlightMarks::default(),
        mountings: stored_frames::frame_mountings(&RealDisk, flight)?,
    };
    print_notes(&known.aircraft.notes);
    let process =
        |frame: &FrameRef, bytes: Result<&[u8], Reason>| known.process_frame(frame, bytes);
    let mut processed = Vec::with_capacity(frames.len());
    batch::for_each_stored_frame(
        frames,
        args.jobs,
        "measuring",
        process,
        batch::collect_into(&mut processed),
    )?;
    Ok(processed)
}

fn outcome_json(
    file: &Path,
    outcomes: &[FlightOutcome],
    sources: usize,
    known: &[NamedEstimate],
) -> String {
    let known: serde_json::Map<String, Value> = known
        .iter()
        .map(|(name, e)| {
            (
                (*name).to_owned(),
                json!({"value": e.value, "sigma": e.sigma}),
            )
        })
        .collect();
    json!({
        "file": file,
        "flights_in_prior": sources,
        "flights": outcomes,
        "differences": known,
    })
    .to_string()
}

fn outcome_text(
    file: &Path,
    outcomes: &[FlightOutcome],
    sources: usize,
    known: &[NamedEstimate],
) -> String {
    let flight = |t: &FlightOutcome| {
        let why = t
            .reason
            .as_ref()
            .map_or(String::new(), |reason| format!(": {reason}"));
        format!(
            "{}  {} frames  {}{why}\n",
            t.flight,
            t.frames,
            match t.status {
                LearnStatus::Added => "added",
                LearnStatus::Known => "skipped",
                LearnStatus::Refused => "refused",
            }
        )
    };
    let flights: String = outcomes.iter().map(flight).collect();
    let difference = |(name, e): &NamedEstimate| {
        let (value, sigma) = format_rounded(Some(e.value), e.sigma, 4);
        format!("\n{name:<24}{value} ± {sigma}")
    };
    let differences: String = known.iter().map(difference).collect();
    let head = if known.is_empty() {
        ""
    } else {
        "\nEstimated minus specified value:"
    };
    format!(
        "{flights}{}: prior from {}{head}{differences}",
        file.display(),
        count_text(sources, "flight")
    )
}
