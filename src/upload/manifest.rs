//! The manifest is what is published of a flight: identities, and each file with its digest.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::store::bundle::Bundle;
use crate::store::receive::{Listed, Listing};
use crate::store::{Disk, FlightRef, RealDisk, StoreError, catalogue, installations};

/// Of the manifest's own fields.
const FORMAT: u32 = 1;
/// Characters of a name in a key.
const NAME_LENGTH: usize = 64;

/// Whose wing it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Aircraft {
    /// Its registration, or what stands for it; [`is_name`] holds.
    pub name: String,
    /// The kind of aircraft.
    pub kind: Option<String>,
}

impl Aircraft {
    /// Letters, digits, `.`, `_`, `-`, at most 64: what every object store, file system and table engine
    /// takes without quoting. Not `.` first, which would be hidden, or lead up.
    pub fn is_name(text: &str) -> bool {
        let plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        (1..=NAME_LENGTH).contains(&text.len()) && text.chars().all(plain) && !text.starts_with('.')
    }

    /// The name of the installation that the flight's results came from last, other characters as `-`;
    /// `unknown` where none is kept.
    pub fn of_installation(root: &Path, flight: &FlightRef) -> Result<String, StoreError> {
        let last = installations::of_flight(&RealDisk, flight)?.pop();
        let file = last.map(|digest| installations::folder(root, &digest).join("installation.toml"));
        let text = file.and_then(|file| RealDisk.read(&file).ok());
        let table = text.and_then(|text| std::str::from_utf8(&text).ok()?.parse::<toml::Table>().ok());
        let name = table.and_then(|table| Some(table.get("name")?.as_str()?.to_owned()));
        let plain = |c: char| if Self::is_name(&c.to_string()) { c } else { '-' };
        let name: String = name.unwrap_or_default().chars().map(plain).take(NAME_LENGTH).collect();
        let name = name.trim_matches('-').to_owned();
        Ok(if Self::is_name(&name) { name } else { "unknown".to_owned() })
    }
}

/// `manifests/aircraft=A/recorder=R/f0001.json`: a flight is published when this is there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Of this file.
    pub format: u32,
    /// Registration, or the installation's name.
    pub aircraft: String,
    /// Kind of aircraft; `null` where it was not said.
    pub aircraft_type: Option<String>,
    /// The store's id.
    pub recorder: String,
    /// The flight's name in its store.
    pub flight: String,
    /// When it began, UTC as the recorder knew it.
    pub started: String,
    /// Over all files.
    pub digest: String,
    /// Bytes of all files.
    pub bytes: u64,
    /// From the flight's folder: together they are a store.
    pub files: Vec<File>,
}

/// A file of a published flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct File {
    /// With `/`.
    pub name: String,
    /// Bytes.
    pub length: u64,
    /// Hex.
    pub sha256: String,
}

impl From<Listed> for File {
    fn from(item: Listed) -> Self {
        Self { name: item.name, length: item.length, sha256: item.sha256 }
    }
}

impl Manifest {
    pub(super) fn of(
        recorder: &str,
        aircraft: &Aircraft,
        flight: &FlightRef,
        bundle: &Bundle,
    ) -> Result<Self, StoreError> {
        let listing = Listing::of(&flight.id, bundle);
        Ok(Self {
            format: FORMAT,
            aircraft: aircraft.name.clone(),
            aircraft_type: aircraft.kind.clone(),
            recorder: recorder.to_owned(),
            flight: flight.id.clone(),
            started: catalogue::flight_manifest(&RealDisk, flight)?.started.utc.to_string(),
            digest: listing.digest.clone(),
            bytes: listing.bytes(),
            files: listing.items.into_iter().map(File::from).collect(),
        })
    }

    /// Its own key.
    pub fn key(&self) -> String {
        format!("manifests/{}/{}.json", self.owner(), self.flight)
    }

    /// What all keys of its files begin with.
    pub fn place(&self) -> String {
        format!("flights/{}/{}", self.owner(), self.flight)
    }

    /// Equal flight numbers of two recorders have other keys.
    fn owner(&self) -> String {
        format!("aircraft={}/recorder={}", self.aircraft, self.recorder)
    }

    pub(super) fn object(&self, name: &str) -> String {
        format!("{}/{name}", self.place())
    }

    /// Key and length of every file.
    pub(super) fn objects(&self) -> impl Iterator<Item = (String, u64)> {
        self.files.iter().map(|file| (self.object(&file.name), file.length))
    }

    /// The same flight gives the same bytes: there is nothing of the moment or the machine in it.
    pub(super) fn text(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}
