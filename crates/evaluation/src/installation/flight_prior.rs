//! `flight_prior.json`: prior of the flight-invariant parameters from earlier flights, written by `wingd learn`
//! (docs/adjustment/learning.md).

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::{INSTALLATION_FILE, Installation, ORIENTATION_FILE, Reader};
use wingd_base::pending_file::write_atomically;
use wingd_measure::adjust::AdjustError;
use wingd_measure::adjust::flight_prior::{FlightPrior, InvariantParameter, ReducedNormals};
use wingd_measure::setup::{Setup, SurveyMarker};
use wingd_measure::widths::Unknown;

/// Name of the file that `wingd learn` writes.
pub const FLIGHT_PRIOR_FILE: &str = "flight_prior.json";
/// Version of the file format.
const FORMAT: u32 = 1;

#[derive(Serialize, Deserialize)]
struct FlightPriorDocument {
    format: u32,
    /// File name -> SHA-256 of the files that the prior was computed with.
    made_with: BTreeMap<String, String>,
    unknowns: Vec<UnknownEntry>,
    /// Contributions, one per flight.
    sources: Vec<FlightEntry>,
}

#[derive(Serialize, Deserialize)]
struct UnknownEntry {
    term: Unknown,
    index: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    marker: Option<String>,
    /// Prior standard deviation without the flights.
    sigma: f64,
}

#[derive(Serialize, Deserialize)]
struct FlightEntry {
    store: String,
    flight: String,
    program: String,
    /// SHA-256 of each frame.
    frames: Vec<String>,
    /// Upper triangle of the normal matrix, row by row.
    normal: Vec<f64>,
    right: Vec<f64>,
}

/// Flight that contributes to the prior.
#[derive(Clone, Debug, PartialEq)]
pub struct PriorFlight {
    /// Id of its store.
    pub store: String,
    /// Name of the flight in its store.
    pub flight: String,
    /// Name and version of the program that computed the contribution.
    pub program: String,
    /// SHA-256 of each of its frames.
    pub frames: Vec<String>,
    /// Normal equations, reduced to the flight-invariant parameters.
    pub normals: ReducedNormals,
}

impl PriorFlight {
    fn has_frame(&self, frame: &str) -> bool {
        self.frames.iter().any(|known| known == frame)
    }
}

/// Prior from earlier flights, with the contribution of each.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredFlightPrior {
    /// Contributions, one per flight.
    pub flights: Vec<PriorFlight>,
    combined: Option<Arc<FlightPrior>>,
}

impl StoredFlightPrior {
    /// Combines the contributions of flights.
    ///
    /// # Errors
    /// Returns an error if they do not have the same unknowns.
    pub fn from_flights(sources: Vec<PriorFlight>, setup: &Setup) -> Result<Self, AdjustError> {
        let together = combined_prior(sources.iter(), setup)?;
        Ok(Self {
            flights: sources,
            combined: together,
        })
    }

    /// Returns the number of flights in words.
    pub fn flight_count_text(&self) -> String {
        match self.flights.len() {
            1 => "a flight".into(),
            n => format!("{n} flights"),
        }
    }

    /// Returns the flights that contain one of these frames (SHA-256).
    pub fn flights_with_frames<'a>(&'a self, frames: &[&str]) -> Vec<&'a PriorFlight> {
        self.flights
            .iter()
            .filter(|source| frames.iter().any(|frame| source.has_frame(frame)))
            .collect()
    }

    /// Combines the contributions of all flights except those that contain one of these frames, so that nothing is counted
    /// twice.
    pub fn prior_without(&self, frames: &[&str], setup: &Setup) -> Option<Arc<FlightPrior>> {
        let own = self.flights_with_frames(frames);
        if own.is_empty() {
            return self.combined.clone();
        }
        // A subset of regular contributions is regular too.
        combined_prior(
            self.flights.iter().filter(|source| !own.contains(source)),
            setup,
        )
        .ok()
        .flatten()
    }
}

/// Combines the contributions of flights into one prior.
fn combined_prior<'a>(
    sources: impl Iterator<Item = &'a PriorFlight>,
    setup: &Setup,
) -> Result<Option<Arc<FlightPrior>>, AdjustError> {
    let normals: Vec<_> = sources.map(|source| &source.normals).collect();
    Ok(FlightPrior::from_flights(&normals, setup)?.map(Arc::new))
}

/// Selects the files that the prior depends on: camera, survey, orientation and installation.toml.
fn bound_files(sources: &[String; 2], digests: &[(String, String)]) -> BTreeMap<String, String> {
    let is_bound = |name: &str| {
        [INSTALLATION_FILE, ORIENTATION_FILE].contains(&name) || sources.iter().any(|s| s == name)
    };
    digests
        .iter()
        .filter(|(name, _)| is_bound(name))
        .cloned()
        .collect()
}

/// Remedy for every error of the file.
const RELEARN_REMEDY: &str =
    "delete the file, and run `wingd learn` again with the stores of the flights since the change";

/// Reads the flight prior if the file exists; an orientation is required.
pub(super) fn read_flight_prior(
    reader: &mut Reader,
    setup: &Setup,
    sources: &[String; 2],
) -> Option<StoredFlightPrior> {
    let path = reader.directory.join(FLIGHT_PRIOR_FILE);
    if !path.exists() {
        return None;
    }
    let now = bound_files(sources, &reader.digests);
    let (file, text) = reader.read_text(FLIGHT_PRIOR_FILE, RELEARN_REMEDY)?;
    let document = serde_json::from_str(&text).map_err(|error| {
        (
            "file",
            format!("was not written by `wingd learn` ({error})"),
        )
    });
    let prior = document.and_then(|document| match find_mismatch(&document, &now) {
        Some(mismatch) => Err(mismatch),
        None => prior_from_document(document, setup),
    });
    let fault = |(place, problem)| reader.fault(&file, place, problem, RELEARN_REMEDY);
    prior.map_err(fault).ok()
}

type PlacedProblem = (&'static str, String);

/// Returns why the prior does not apply to the present installation.
fn find_mismatch(
    document: &FlightPriorDocument,
    now: &BTreeMap<String, String>,
) -> Option<PlacedProblem> {
    if document.format != FORMAT {
        return Some((
            "format",
            format!("is {}, but this program reads {FORMAT}", document.format),
        ));
    }
    let changed: Vec<&str> = now
        .iter()
        .filter(|(name, digest)| document.made_with.get(*name) != Some(digest))
        .map(|(name, _)| name.as_str())
        .collect();
    let gone = document
        .made_with
        .keys()
        .filter(|name| !now.contains_key(*name))
        .map(String::as_str);
    let names: Vec<&str> = changed.into_iter().chain(gone).collect();
    let problem = format!(
        "{} changed since the prior was computed",
        names.join(" and ")
    );
    (!names.is_empty()).then_some(("made_with", problem))
}

fn prior_from_document(
    document: FlightPriorDocument,
    setup: &Setup,
) -> Result<StoredFlightPrior, PlacedProblem> {
    let index = |id: &str| setup.markers.iter().position(|marker| marker.id == id);
    let sigmas = DVector::from_iterator(
        document.unknowns.len(),
        document.unknowns.iter().map(|u| u.sigma),
    );
    if !sigmas.iter().all(|sigma| sigma.is_finite() && *sigma > 0.0) {
        return Err((
            "unknowns",
            "have a sigma that is not a positive number".into(),
        ));
    }
    let unknown = |unknown: UnknownEntry| {
        let found = unknown.marker.as_deref().map(|id| index(id).ok_or(id));
        let marker = found
            .transpose()
            .map_err(|id| ("unknowns", format!("marker \"{id}\" is not in the survey")))?;
        Ok(InvariantParameter {
            unknown: unknown.term,
            index: unknown.index,
            marker,
        })
    };
    let unknowns: Vec<InvariantParameter> = document
        .unknowns
        .into_iter()
        .map(unknown)
        .collect::<Result<_, PlacedProblem>>()?;
    let source = |entry: FlightEntry| {
        let normals = normals_from_entry(&unknowns, &sigmas, &entry).ok_or_else(|| {
            (
                "sources",
                format!("{} does not have one number per unknown", entry.flight),
            )
        })?;
        Ok(PriorFlight {
            store: entry.store,
            flight: entry.flight,
            program: entry.program,
            frames: entry.frames,
            normals,
        })
    };
    let sources = document
        .sources
        .into_iter()
        .map(source)
        .collect::<Result<_, PlacedProblem>>()?;
    StoredFlightPrior::from_flights(sources, setup).map_err(|error| ("sources", error.to_string()))
}

fn normals_from_entry(
    unknowns: &[InvariantParameter],
    sigmas: &DVector<f64>,
    entry: &FlightEntry,
) -> Option<ReducedNormals> {
    let n = unknowns.len();
    let finite = entry
        .normal
        .iter()
        .chain(&entry.right)
        .all(|value| value.is_finite());
    if entry.right.len() != n || entry.normal.len() != n * (n + 1) / 2 || !finite {
        return None;
    }
    let mut normal = DMatrix::zeros(n, n);
    let mut values = entry.normal.iter();
    for i in 0..n {
        for j in i..n {
            normal[(i, j)] = *values.next()?;
            normal[(j, i)] = normal[(i, j)];
        }
    }
    Some(ReducedNormals {
        unknowns: unknowns.to_vec(),
        normal,
        right: DVector::from_column_slice(&entry.right),
        sigmas: sigmas.clone(),
    })
}

/// Writes `flight_prior.json` atomically. The flights have the same unknowns ([`StoredFlightPrior::from_flights`]).
///
/// # Errors
/// Returns an error if the file cannot be written.
pub fn write_flight_prior(
    installation: &Installation,
    prior: &StoredFlightPrior,
) -> std::io::Result<()> {
    let id = |marker: usize| {
        installation
            .setup
            .markers
            .get(marker)
            .map(|m: &SurveyMarker| m.id.clone())
    };
    let unknown = |(parameter, sigma): (&InvariantParameter, &f64)| UnknownEntry {
        term: parameter.unknown,
        index: parameter.index,
        marker: parameter.marker.and_then(id),
        sigma: *sigma,
    };
    let first = prior.flights.first().map(|source| &source.normals);
    let unknowns = first
        .into_iter()
        .flat_map(|first| first.unknowns.iter().zip(first.sigmas.iter()));
    let entry = |source: &PriorFlight| {
        let n = source.normals.right.len();
        let row = |i: usize| (i..n).map(move |j| source.normals.normal[(i, j)]);
        FlightEntry {
            store: source.store.clone(),
            flight: source.flight.clone(),
            program: source.program.clone(),
            frames: source.frames.clone(),
            normal: (0..n).flat_map(row).collect(),
            right: source.normals.right.as_slice().to_vec(),
        }
    };
    let document = FlightPriorDocument {
        format: FORMAT,
        made_with: bound_files(&installation.sources, &installation.digests),
        unknowns: unknowns.map(unknown).collect(),
        sources: prior.flights.iter().map(entry).collect(),
    };
    let text = serde_json::to_string(&document)?;
    write_atomically(
        &installation.directory.join(FLIGHT_PRIOR_FILE),
        &(text + "\n"),
    )
}
