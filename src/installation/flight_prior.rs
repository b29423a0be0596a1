//! `flight_prior.json`: what flights told of all that lasts, written by `wingd learn` (docs/adjustment/learning.md).

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::toml_file::FILE;
use super::{Installation, ORIENTATION_FILE, Reader, write_whole};
use crate::measure::adjust::AdjustError;
use crate::measure::adjust::flight_prior::{FlightPrior, InvariantParameter, ReducedNormals};
use crate::measure::setup::{Setup, SurveyMarker};

/// Name of the file that `wingd learn` writes.
pub const LEARNT_FILE: &str = "flight_prior.json";
/// Of this file's form.
const FORMAT: u32 = 1;

#[derive(Serialize, Deserialize)]
struct Document {
    format: u32,
    /// File name -> SHA-256 of what it holds for.
    made_with: BTreeMap<String, String>,
    unknowns: Vec<Unknown>,
    /// A flight each.
    sources: Vec<Entry>,
}

#[derive(Serialize, Deserialize)]
struct Unknown {
    term: String,
    index: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    marker: Option<String>,
    /// Without the flights.
    sigma: f64,
}

#[derive(Serialize, Deserialize)]
struct Entry {
    store: String,
    flight: String,
    program: String,
    /// SHA-256 of each frame.
    frames: Vec<String>,
    /// Upper triangle, row by row.
    normal: Vec<f64>,
    right: Vec<f64>,
}

/// A flight that taught.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// Id of its store.
    pub store: String,
    /// Its name there.
    pub flight: String,
    /// Name and version of the program that learnt.
    pub program: String,
    /// SHA-256 of each of its frames.
    pub frames: Vec<String>,
    /// What it told.
    pub normals: ReducedNormals,
}

impl Source {
    fn has(&self, frame: &str) -> bool {
        self.frames.iter().any(|known| known == frame)
    }
}

/// All that flights taught of an installation.
#[derive(Clone, Debug, PartialEq)]
pub struct Learnt {
    /// Each flight once.
    pub sources: Vec<Source>,
    together: Option<Arc<FlightPrior>>,
}

impl Learnt {
    /// Of these flights.
    ///
    /// # Errors
    /// Where they have not the same unknowns.
    pub fn of(sources: Vec<Source>, setup: &Setup) -> Result<Self, AdjustError> {
        let together = taught(sources.iter(), setup)?;
        Ok(Self { sources, together })
    }

    /// How many flights, in words.
    pub fn counted(&self) -> String {
        match self.sources.len() {
            1 => "a flight".into(),
            n => format!("{n} flights"),
        }
    }

    /// The flights that one of these frames (SHA-256) is of.
    pub fn sources_of<'a>(&'a self, frames: &[&str]) -> Vec<&'a Source> {
        self.sources.iter().filter(|source| frames.iter().any(|frame| source.has(frame))).collect()
    }

    /// What all flights told together but for those that one of these frames is of: nothing is counted twice.
    pub fn beside(&self, frames: &[&str], setup: &Setup) -> Option<Arc<FlightPrior>> {
        let own = self.sources_of(frames);
        if own.is_empty() {
            return self.together.clone();
        }
        // What together is regular is so without some of it.
        taught(self.sources.iter().filter(|source| !own.contains(source)), setup).ok().flatten()
    }
}

fn taught<'a>(
    sources: impl Iterator<Item = &'a Source>,
    setup: &Setup,
) -> Result<Option<Arc<FlightPrior>>, AdjustError> {
    let normals: Vec<_> = sources.map(|source| &source.normals).collect();
    Ok(FlightPrior::of(&normals, setup)?.map(Arc::new))
}

/// What it holds for: camera, survey, ground frames, and what installation.toml states.
fn bound_to(sources: &[String; 2], digests: &[(String, String)]) -> BTreeMap<String, String> {
    let is_bound = |name: &str| [FILE, ORIENTATION_FILE].contains(&name) || sources.iter().any(|s| s == name);
    digests.iter().filter(|(name, _)| is_bound(name)).cloned().collect()
}

/// What mends all of it.
const AGAIN: &str =
    "remove the file, and run `wingd learn` again with the stores of the flights since the change";

/// Reads it where it lies beside an orientation.
pub(super) fn read(reader: &mut Reader, setup: &Setup, sources: &[String; 2]) -> Option<Learnt> {
    let path = reader.directory.join(LEARNT_FILE);
    if !path.exists() {
        return None;
    }
    let now = bound_to(sources, &reader.digests);
    let (file, text) = reader.text(LEARNT_FILE, AGAIN)?;
    let document: Document = match serde_json::from_str(&text) {
        Ok(document) => document,
        Err(error) => {
            reader.fault(&file, "file", format!("is not what `wingd learn` writes ({error})"), AGAIN);
            return None;
        }
    };
    if let Some((place, problem)) = stale(&document, &now) {
        reader.fault(&file, place, problem, AGAIN);
        return None;
    }
    match learnt(document, setup) {
        Ok(learnt) => Some(learnt),
        Err((place, problem)) => {
            reader.fault(&file, place, problem, AGAIN);
            None
        }
    }
}

type Wrong = (&'static str, String);

/// Why it does not hold for the installation as it is.
fn stale(document: &Document, now: &BTreeMap<String, String>) -> Option<Wrong> {
    if document.format != FORMAT {
        return Some(("format", format!("is {}, this program reads {FORMAT}", document.format)));
    }
    let changed: Vec<&str> = now
        .iter()
        .filter(|(name, digest)| document.made_with.get(*name) != Some(digest))
        .map(|(name, _)| name.as_str())
        .collect();
    let gone = document.made_with.keys().filter(|name| !now.contains_key(*name)).map(String::as_str);
    let names: Vec<&str> = changed.into_iter().chain(gone).collect();
    let problem = format!("{} changed since flights taught what is in it", names.join(" and "));
    (!names.is_empty()).then_some(("made_with", problem))
}

fn learnt(document: Document, setup: &Setup) -> Result<Learnt, Wrong> {
    let index = |id: &str| setup.markers.iter().position(|marker| marker.id == id);
    let sigmas = DVector::from_iterator(document.unknowns.len(), document.unknowns.iter().map(|u| u.sigma));
    if !sigmas.iter().all(|sigma| sigma.is_finite() && *sigma > 0.0) {
        return Err(("unknowns", "have a sigma that is no positive number".into()));
    }
    let unknown = |unknown: Unknown| {
        let Unknown { term, index: of_term, marker, .. } = unknown;
        let found = marker.as_deref().map(|id| index(id).ok_or(id));
        let marker =
            found.transpose().map_err(|id| ("unknowns", format!("marker \"{id}\" is not in the survey")))?;
        Ok(InvariantParameter { term: term.into(), index: of_term, marker })
    };
    let unknowns: Vec<InvariantParameter> =
        document.unknowns.into_iter().map(unknown).collect::<Result<_, Wrong>>()?;
    let source = |entry: Entry| {
        let normals = normals(&unknowns, &sigmas, &entry).ok_or_else(|| {
            ("sources", format!("{} has other than one number for each unknown", entry.flight))
        })?;
        let Entry { store, flight, program, frames, .. } = entry;
        Ok(Source { store, flight, program, frames, normals })
    };
    let sources = document.sources.into_iter().map(source).collect::<Result<_, Wrong>>()?;
    Learnt::of(sources, setup).map_err(|error| ("sources", error.to_string()))
}

fn normals(unknowns: &[InvariantParameter], sigmas: &DVector<f64>, entry: &Entry) -> Option<ReducedNormals> {
    let n = unknowns.len();
    let finite = entry.normal.iter().chain(&entry.right).all(|value| value.is_finite());
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

/// Writes `flight_prior.json`, whole or not at all. The flights have the same unknowns ([`Learnt::of`]).
///
/// # Errors
/// Where it cannot be written.
pub fn write_learnt(installation: &Installation, learnt: &Learnt) -> std::io::Result<()> {
    let id = |marker: usize| installation.setup.markers.get(marker).map(|m: &SurveyMarker| m.id.clone());
    let unknown = |(lasting, sigma): (&InvariantParameter, &f64)| Unknown {
        term: lasting.term.to_string(),
        index: lasting.index,
        marker: lasting.marker.and_then(id),
        sigma: *sigma,
    };
    let first = learnt.sources.first().map(|source| &source.normals);
    let unknowns = first.into_iter().flat_map(|first| first.unknowns.iter().zip(first.sigmas.iter()));
    let entry = |source: &Source| {
        let n = source.normals.right.len();
        let row = |i: usize| (i..n).map(move |j| source.normals.normal[(i, j)]);
        Entry {
            store: source.store.clone(),
            flight: source.flight.clone(),
            program: source.program.clone(),
            frames: source.frames.clone(),
            normal: (0..n).flat_map(row).collect(),
            right: source.normals.right.as_slice().to_vec(),
        }
    };
    let document = Document {
        format: FORMAT,
        made_with: bound_to(&installation.sources, &installation.digests),
        unknowns: unknowns.map(unknown).collect(),
        sources: learnt.sources.iter().map(entry).collect(),
    };
    let text = serde_json::to_string(&document)?;
    write_whole(&installation.directory.join(LEARNT_FILE), &(text + "\n"))
}
