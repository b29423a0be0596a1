//! `wingd learn` writes what flights told together of all that lasts.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::{Done, Failure, RIGHTS, default_paths, frames, print, stored, stores, unwritable};
use crate::installation::{self, Installation, LEARNT_FILE, Learnt, Source};
use crate::measure::adjust::Estimate;
use crate::measure::adjust::flight_prior::{FlightContribution, InvariantParameter};
use crate::pipeline::guard::{BROKE_OFF, guarded};
use crate::pipeline::{self, Job, ProcessedFrame};
use crate::record::Reason;
use crate::report::number::{count, rounded};
use crate::store::{self, FrameRef, RealDisk, catalogue};

/// Write what flights told together of the wing, the camera and the survey into the installation (flight_prior.json), for later
/// flights, single frames and live mode.
#[derive(clap::Args)]
pub struct Args {
    /// The installation; flight_prior.json is written into it [default: installation/ of this folder]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Learn from this flight of the stores alone, for example f0001 [default: all]
    #[arg(long, value_name = "FLIGHT")]
    flight: Option<String>,
    /// One JSON object: file, flights, known
    #[arg(long)]
    json: bool,
    /// Images worked on at once [default: the cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
    /// Stores of flights with this installation; a flight that taught already is not counted again
    #[arg(required = true, value_name = "STORE")]
    stores: Vec<PathBuf>,
}

/// A flight that is to teach.
struct Candidate {
    store: String,
    flight: String,
    frames: Vec<String>,
    sightings: Vec<ProcessedFrame>,
    lesson: Option<FlightContribution>,
}

/// A flight, by store and name, and what became of it.
struct FlightOutcome {
    store: String,
    flight: String,
    frames: usize,
    status: &'static str,
    reason: Option<String>,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let directory = default_paths::installation(args.installation.as_deref())?;
    let mut installation = super::load_installation(&directory)?;
    installation.require_orientation()?;
    let before = installation.learnt.as_ref().map_or(vec![], |learnt| learnt.sources.clone());
    let (mut told, mut candidates) = (vec![], vec![]);
    for root in &args.stores {
        gather(args, root, &installation, &before, &mut told, &mut candidates)?;
    }
    for _ in 0..ROUNDS {
        learn(&mut candidates, &before, &mut installation, &mut told)?;
    }
    told.extend(candidates.iter().map(|candidate| candidate.told("added", None)));
    let sources: Vec<Source> =
        before.into_iter().chain(candidates.iter().filter_map(Candidate::source)).collect();
    let count = sources.len();
    if !candidates.is_empty() {
        let learnt = together(sources, &installation)?;
        let file = installation.directory.join(LEARNT_FILE);
        installation::write_learnt(&installation, &learnt).map_err(unwritable(&file, RIGHTS))?;
    }
    let known = candidates.last().and_then(|candidate| candidate.lesson.as_ref()).map_or(vec![], known);
    let output = if args.json { as_json } else { text };
    print(&output(&installation.directory.join(LEARNT_FILE), &told, count, &known))?;
    Ok(Done::all(told.iter().all(|told| told.status != "refused")))
}

/// A flight is linearised where it is solved beside those before it, and once more beside all: equations that add up are to
/// hold at one place.
const ROUNDS: usize = 2;

/// Learns from each beside what the others told; those that contradict the model, or what was told, are taken out.
fn learn(
    candidates: &mut Vec<Candidate>,
    before: &[Source],
    installation: &mut Installation,
    told: &mut Vec<FlightOutcome>,
) -> Result<(), Failure> {
    let mut k = 0;
    while k < candidates.len() {
        let others = candidates.iter().enumerate().filter(|(other, _)| *other != k);
        let others = others.filter_map(|(_, candidate)| candidate.source());
        installation.learnt = Some(together(before.iter().cloned().chain(others).collect(), installation)?);
        match candidates[k].learn(installation) {
            Ok(()) => k += 1,
            Err(reason) => told.push(candidates.remove(k).told("refused", Some(reason.to_string()))),
        }
    }
    Ok(())
}

fn together(sources: Vec<Source>, installation: &Installation) -> Result<Learnt, Failure> {
    let file = installation.directory.join(LEARNT_FILE);
    let undone = |error| Failure::Failed(format!("{}: {error}", file.display()));
    Learnt::of(sources, &installation.setup).map_err(undone)
}

impl Candidate {
    /// What it told so far.
    fn source(&self) -> Option<Source> {
        let lesson = self.lesson.as_ref()?;
        Some(Source {
            store: self.store.clone(),
            flight: self.flight.clone(),
            program: format!("wingd {}", env!("CARGO_PKG_VERSION")),
            frames: self.frames.clone(),
            normals: lesson.normals.clone(),
        })
    }

    fn learn(&mut self, installation: &Installation) -> Result<(), Reason> {
        let busy = frames::busy(&format!("learning from {}", self.flight));
        let orientation = installation.orientation.as_ref().ok_or("there is no orientation")?;
        let lesson = pipeline::learn_flight(&self.sightings, installation, orientation, &Job::default());
        drop(busy);
        self.lesson = Some(lesson?);
        Ok(())
    }

    fn told(&self, status: &'static str, reason: Option<String>) -> FlightOutcome {
        FlightOutcome {
            store: self.store.clone(),
            flight: self.flight.clone(),
            frames: self.frames.len(),
            status,
            reason,
        }
    }
}

/// Looks at the frames of a store's flights; those that taught already are only named.
fn gather(
    args: &Args,
    root: &Path,
    installation: &Installation,
    before: &[Source],
    told: &mut Vec<FlightOutcome>,
    candidates: &mut Vec<Candidate>,
) -> Result<(), Failure> {
    let flights = stores::flights(root, args.flight.as_deref())?;
    let store = catalogue::store_id(&RealDisk, root).unwrap_or_else(|| root.display().to_string());
    for flight in flights {
        let frames = stores::frames(&RealDisk, &flight, None)?;
        let digests: Vec<String> = frames.iter().map(|frame| frame.entry.sha256.clone()).collect();
        let (store, id) = (store.clone(), flight.id.clone());
        let candidate = Candidate { store, flight: id, frames: digests, sightings: vec![], lesson: None };
        let is_known = |store: &str, flight: &str, frames: &[String]| {
            (store, flight) == (candidate.store.as_str(), candidate.flight.as_str())
                || frames.iter().any(|frame| candidate.frames.contains(frame))
        };
        if before.iter().any(|s| is_known(&s.store, &s.flight, &s.frames))
            || candidates.iter().any(|p| is_known(&p.store, &p.flight, &p.frames))
        {
            let reason = "it taught already, and is not counted twice".to_owned();
            told.push(candidate.told("known", Some(reason)));
            continue;
        }
        let sightings = sighted(args, root, &flight, &frames, installation)?;
        match sightings.iter().all(|sighting| sighting.failure.is_some()) {
            true => {
                let first = sightings.iter().find_map(|sighting| sighting.failure.as_ref());
                let reason = first.map_or("it has no frames".into(), |failure| {
                    format!("no frame of it can be solved: {failure}")
                });
                told.push(candidate.told("refused", Some(reason)));
            }
            false => candidates.push(Candidate { sightings, ..candidate }),
        }
    }
    Ok(())
}

fn sighted(
    args: &Args,
    root: &Path,
    flight: &store::FlightRef,
    list: &[FrameRef],
    installation: &Installation,
) -> Result<Vec<ProcessedFrame>, Failure> {
    let orientation = installation.require_orientation()?;
    let (track, _) = stored::aircraft_data(&RealDisk, root, flight)?;
    let mountings: BTreeMap<_, _> = stored::mountings(&RealDisk, flight)?;
    let sight = |frame: &FrameRef, bytes: Result<&[u8], Reason>| {
        let mounting = mountings.get(&frame.entry.sha256).copied();
        ProcessedFrame { mounting, ..stored::sight(frame, bytes, installation, orientation, &track) }
    };
    let one = |frame: &FrameRef| {
        let bytes = store::read_frame(&RealDisk, frame).map_err(Reason::of);
        let readable = bytes.as_deref().map_err(Clone::clone);
        guarded(|| sight(frame, readable)).unwrap_or_else(|| sight(frame, Err(BROKE_OFF.into())))
    };
    let mut sightings = Vec::with_capacity(list.len());
    frames::run(list, args.jobs, "measuring", one, |sighting| {
        sightings.push(sighting);
        Ok(())
    })?;
    Ok(sightings)
}

/// What is told of the drawings and the camera: key, factor to its unit, the term, which of its unknowns.
const NAMES: [(&str, f64, &str, usize); 8] = [
    ("root_offset_m", 1.0, "root offset", 0),
    ("axis_chord_offset_m", 1.0, "chord offset of the bending axis", 0),
    ("span_direction_deg", 180.0 / std::f64::consts::PI, "direction of the span", 0),
    ("axis_height_root_m", 1.0, "height of the bending axis", 0),
    ("ground_bend_m", 1.0, "bend between survey and ground frame", 0),
    ("projection_centre_x_m", 1.0, "projection centre", 0),
    ("projection_centre_y_m", 1.0, "projection centre", 1),
    ("projection_centre_z_m", 1.0, "projection centre", 2),
];

/// By how much they differ from what is stated.
fn known(lesson: &FlightContribution) -> Vec<(&'static str, Estimate)> {
    let all = || lesson.normals.unknowns.iter().zip(&lesson.known);
    let of = |(name, factor, term, index): (&'static str, f64, &str, usize)| {
        let is = |(l, _): &(&InvariantParameter, &Estimate)| l.term == term && l.index == index;
        let (_, found) = all().find(is)?;
        Some((name, Estimate { value: factor * found.value, sigma: found.sigma.map(|s| factor * s) }))
    };
    NAMES.into_iter().filter_map(of).collect()
}

fn as_json(
    file: &Path,
    told: &[FlightOutcome],
    sources: usize,
    known: &[(&'static str, Estimate)],
) -> String {
    let flight = |t: &FlightOutcome| {
        let FlightOutcome { store, flight, frames, status, reason } = t;
        json!({"store": store, "flight": flight, "frames": frames, "status": status, "reason": reason})
    };
    let known: serde_json::Map<String, Value> = known
        .iter()
        .map(|(name, e)| ((*name).to_owned(), json!({"value": e.value, "sigma": e.sigma})))
        .collect();
    json!({
        "file": file,
        "flights_in_prior": sources,
        "flights": told.iter().map(flight).collect::<Vec<_>>(),
        "differences": known,
    })
    .to_string()
}

fn text(file: &Path, told: &[FlightOutcome], sources: usize, known: &[(&'static str, Estimate)]) -> String {
    let flight = |t: &FlightOutcome| {
        let why = t.reason.as_ref().map_or(String::new(), |reason| format!(": {reason}"));
        format!(
            "{}  {} frames  {}{why}\n",
            t.flight,
            t.frames,
            if t.status == "known" { "left" } else { t.status }
        )
    };
    let flights: String = told.iter().map(flight).collect();
    let difference = |(name, e): &(&'static str, Estimate)| {
        let (value, sigma) = rounded(Some(e.value), e.sigma, 4);
        format!("\n{name:<24}{value} ± {sigma}")
    };
    let differences: String = known.iter().map(difference).collect();
    let head = if known.is_empty() { "" } else { "\nless what is stated, with all that is known:" };
    format!("{flights}{}: taught by {}{head}{differences}", file.display(), count(sources, "flight"))
}
