//! What is published of a flight: whose it is, each file with its digest, and where each lies.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::store::bundle::{FlightBundle, BundleContent, BundleFile};
use crate::store::{Disk, FlightRef, RealDisk, StoreError, catalogue, installations, layout, sha256_hex};

/// Of the manifest's own fields.
const FORMAT: u32 = 2;
/// Characters of a name in a key.
const MAX_NAME_LENGTH: usize = 64;
/// Bytes of an object at most: longer files are parts, so that what a break costs is bounded. At 0.25 MB/s a part
/// takes 17 s.
pub(super) const PART_BYTES: usize = 4 << 20;
/// Where a record's own digest stands until it is known.
const EMPTY_SEAL: &str = "0000000000000000000000000000000000000000000000000000000000000000";
/// Characters of a recorder's id that name an aircraft nobody has named.
const SHORT_ID_LENGTH: usize = 8;

/// Whose wing it is: what can be corrected later, and identifies nothing. `None`: not said.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WingLabels {
    /// Registration; [`About::is_name`] holds.
    pub aircraft: Option<String>,
    /// Kind of aircraft.
    pub aircraft_type: Option<String>,
    /// Which wing of it: `left`, `right`, or another name.
    pub wing: Option<String>,
}

impl WingLabels {
    /// Letters, digits, `.`, `_`, `-`, at most 64: what every object store, file system and table engine
    /// takes without quoting. Not `.` first, which would be hidden, or lead up.
    pub fn is_valid_name(text: &str) -> bool {
        let plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        (1..=MAX_NAME_LENGTH).contains(&text.len()) && text.chars().all(plain) && !text.starts_with('.')
    }
}

/// `manifests/recorder=R/flight=F/manifest.json`: the flight exists, and this is all of it. What of it has arrived
/// is said by the marks beside it, [`Stage`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UploadManifest {
    /// Of this file.
    pub format: u32,
    /// The store's id. With the flight's name it is the flight's identity.
    pub recorder: String,
    /// The flight's name in its store.
    pub flight: String,
    /// Registration as first said; of a recorder that nobody named one of its own.
    pub aircraft: String,
    /// Kind of aircraft; `null` where it was not said.
    pub aircraft_type: Option<String>,
    /// Which wing; `null` where neither the call nor the installation says it.
    pub wing: Option<String>,
    /// When it began, UTC as the recorder knew it.
    pub started: String,
    /// Over all files.
    pub digest: String,
    /// Bytes of all files.
    pub bytes: u64,
    /// From the flight's folder: together they are a store.
    pub files: Vec<PublishedFile>,
    /// SHA-256 of this text with the 64 digits of this field as zeros.
    pub seal: String,
}

/// A file of a published flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PublishedFile {
    /// With `/`.
    pub name: String,
    /// Bytes.
    pub length: u64,
    /// Hex.
    pub sha256: String,
    /// Of a file that lies in several objects, `NAME.part-0000` and on: each one's SHA-256.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<String>,
}

/// What arrives one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UploadStage {
    /// All that is no frame.
    Results,
    /// The frames.
    Frames,
}

/// An object of a flight.
#[derive(Clone, Debug)]
pub(super) struct UploadObject {
    pub key: String,
    pub stage: UploadStage,
    /// Bytes before it in its file.
    pub offset: u64,
    pub length: u64,
    pub sha256: String,
    /// Its file.
    pub file: BundleFile,
}

/// A mark: everything of a stage is there.
#[derive(Serialize)]
struct CompletionRecord<'a> {
    format: u32,
    stage: &'a str,
    /// SHA-256 of the manifest that it speaks of.
    manifest: String,
    seal: &'a str,
}

impl UploadStage {
    /// As files name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Results => "results",
            Self::Frames => "frames",
        }
    }

    /// Frames lie below a prefix of their own, which a rule of the bucket can age.
    fn key_prefix(self) -> &'static str {
        match self {
            Self::Results => "flights",
            Self::Frames => "frames",
        }
    }

    fn from_file_name(name: &str) -> Self {
        match name.split('/').collect::<Vec<_>>().as_slice() {
            [layout::FLIGHTS, _, _, file] if layout::is_frame_name(file) => Self::Frames,
            _ => Self::Results,
        }
    }
}

impl UploadManifest {
    /// Of a flight as it is here; files that lie in parts are read for their digests.
    pub(super) fn from_bundle(
        root: &Path,
        flight: &FlightRef,
        about: &WingLabels,
        bundle: &FlightBundle,
    ) -> Result<Self, StoreError> {
        let recorder = catalogue::store_id(&RealDisk, root).ok_or_else(|| missing_id_error(root))?;
        let files: Vec<PublishedFile> = bundle.items.iter().map(published_file).collect::<Result<_, _>>()?;
        let short = recorder.get(..SHORT_ID_LENGTH).unwrap_or(&recorder);
        let mut manifest = Self {
            format: FORMAT,
            aircraft: about.aircraft.clone().unwrap_or_else(|| format!("recorder-{short}")),
            aircraft_type: about.aircraft_type.clone(),
            wing: about.wing.clone().or(wing_side(root, flight)?),
            recorder,
            flight: flight.id.clone(),
            started: catalogue::read_flight_manifest(&RealDisk, flight)?.started.utc.to_string(),
            digest: bundle.digest.clone(),
            bytes: files.iter().map(|file| file.length).sum(),
            files,
            seal: EMPTY_SEAL.to_owned(),
        };
        manifest.update_seal();
        Ok(manifest)
    }

    fn update_seal(&mut self) {
        EMPTY_SEAL.clone_into(&mut self.seal);
        self.seal = sha256_hex(self.json_text().as_bytes());
    }

    /// A manifest that its seal fits.
    pub(super) fn parse_sealed(bytes: &[u8]) -> Option<Self> {
        let found: Self = serde_json::from_slice(bytes).ok()?;
        let text = std::str::from_utf8(bytes).ok()?;
        let open = text.replacen(&found.seal, EMPTY_SEAL, 1);
        (sha256_hex(open.as_bytes()) == found.seal).then_some(found)
    }

    /// With whose it is as another one says it, where the call does not say it; `None` where the call contradicts.
    pub(super) fn adopt_labels(mut self, there: &Self, about: &WingLabels) -> Option<Self> {
        let fits = |said: &Option<String>, there: Option<&String>| said.is_none() || said.as_ref() == there;
        let all = fits(&about.aircraft, Some(&there.aircraft))
            && fits(&about.aircraft_type, there.aircraft_type.as_ref())
            && fits(&about.wing, there.wing.as_ref());
        self.aircraft.clone_from(&there.aircraft);
        self.aircraft_type.clone_from(&there.aircraft_type);
        self.wing.clone_from(&there.wing);
        self.update_seal();
        all.then_some(self)
    }

    fn flight_path(&self) -> String {
        format!("recorder={}/flight={}", self.recorder, self.flight)
    }

    /// Its own key.
    pub fn key(&self) -> String {
        format!("manifests/{}/manifest.json", self.flight_path())
    }

    /// Key and text of the mark of a stage.
    pub(super) fn completion_object(&self, stage: UploadStage) -> (String, String) {
        let manifest = sha256_hex(self.json_text().as_bytes());
        let text = |seal: &str| {
            let mark = CompletionRecord { format: FORMAT, stage: stage.name(), manifest: manifest.clone(), seal };
            serde_json::to_string_pretty(&mark).unwrap_or_default() + "\n"
        };
        let key = format!("manifests/{}/{}.json", self.flight_path(), stage.name());
        (key, text(&sha256_hex(text(EMPTY_SEAL).as_bytes())))
    }

    /// What all keys of its files begin with.
    pub fn key_prefixes(&self) -> [String; 2] {
        [UploadStage::Results, UploadStage::Frames].map(|stage| format!("{}/{}", stage.key_prefix(), self.flight_path()))
    }

    /// Every object of its files, in the order in which they are sent.
    pub(super) fn upload_objects(&self, bundle: &FlightBundle) -> Vec<UploadObject> {
        let mut pieces: Vec<UploadObject> =
            self.files.iter().zip(&bundle.items).flat_map(|(file, item)| self.file_objects(file, item)).collect();
        pieces.sort_by_key(|piece| piece.stage == UploadStage::Frames);
        pieces
    }

    fn file_objects(&self, file: &PublishedFile, item: &BundleFile) -> Vec<UploadObject> {
        let stage = UploadStage::from_file_name(&file.name);
        let whole = format!("{}/{}/{}", stage.key_prefix(), self.flight_path(), file.name);
        let piece = |key: String, offset: u64, length: u64, sha256: &String| UploadObject {
            key,
            stage,
            offset,
            length,
            sha256: sha256.clone(),
            file: item.clone(),
        };
        if file.parts.is_empty() {
            return vec![piece(whole, 0, file.length, &file.sha256)];
        }
        let part = |(number, sha256)| {
            let offset = (number * PART_BYTES) as u64;
            let length = (file.length - offset.min(file.length)).min(PART_BYTES as u64);
            piece(format!("{whole}.part-{number:04}"), offset, length, sha256)
        };
        file.parts.iter().enumerate().map(part).collect()
    }

    /// The same flight gives the same bytes: there is nothing of the moment or the machine in it.
    pub(super) fn json_text(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

fn published_file(item: &BundleFile) -> Result<PublishedFile, StoreError> {
    let parts = if item.length > PART_BYTES as u64 {
        read_verified(item)?.chunks(PART_BYTES).map(sha256_hex).collect()
    } else {
        Vec::new()
    };
    Ok(PublishedFile { name: item.name.clone(), length: item.length, sha256: item.sha256.clone(), parts })
}

/// A file's bytes, of the state that the bundle is; they are the ones that the chain knows, or none.
pub(super) fn read_verified(item: &BundleFile) -> Result<Vec<u8>, StoreError> {
    let (bytes, path) = match &item.content {
        BundleContent::Bytes(bytes) => (bytes.clone(), item.name.clone().into()),
        BundleContent::File(path) => {
            let mut bytes = RealDisk.read(path).map_err(StoreError::io(path, "read"))?;
            bytes.truncate(usize::try_from(item.length).unwrap_or(usize::MAX));
            (bytes, path.clone())
        }
    };
    if sha256_hex(&bytes) == item.sha256 {
        return Ok(bytes);
    }
    let what = "has other bytes than its SHA-256 is of, and the flight is not sent".to_owned();
    Err(StoreError::Damaged { path, problem: what, remedy: "take it from a copy; `wingd verify` says what else" })
}

/// Which wing, as the installation that the flight's results came from last has it.
fn wing_side(root: &Path, flight: &FlightRef) -> Result<Option<String>, StoreError> {
    let last = installations::flight_installations(&RealDisk, flight)?.pop();
    let file = last.map(|digest| installations::installation_folder(root, &digest).join("installation.toml"));
    let text = file.and_then(|file| RealDisk.read(&file).ok());
    let table = text.and_then(|text| std::str::from_utf8(&text).ok()?.parse::<toml::Table>().ok());
    let side = table.and_then(|table| Some(table.get("wing")?.get("side")?.as_str()?.to_owned()));
    Ok(side.filter(|side| WingLabels::is_valid_name(side)))
}

fn missing_id_error(root: &Path) -> StoreError {
    StoreError::Damaged {
        path: root.to_owned(),
        problem: "is of format 1 and has no id that would tell its flights from those of other recorders".into(),
        remedy: "`wingd verify --upgrade` gives it one",
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn manifest() -> UploadManifest {
        let mut manifest = UploadManifest {
            format: FORMAT,
            recorder: "ab12".into(),
            flight: "f0001".into(),
            aircraft: "recorder-ab12".into(),
            aircraft_type: None,
            wing: None,
            started: "2026-06-01T08:00:00Z".into(),
            digest: "d".into(),
            bytes: 9,
            files: Vec::new(),
            seal: String::new(),
        };
        manifest.update_seal();
        manifest
    }

    #[test]
    fn any_changed_byte_breaks_the_seal() {
        let text = manifest().json_text();
        assert_eq!(UploadManifest::parse_sealed(text.as_bytes()), Some(manifest()));
        for place in 0..text.len() {
            let mut bytes = text.clone().into_bytes();
            *bytes.get_mut(place).unwrap() ^= 1;
            assert_eq!(UploadManifest::parse_sealed(&bytes), None, "byte {place}");
        }
    }

    #[test]
    fn whose_it_is_stays_as_first_said_and_is_not_contradicted() {
        let mut there = manifest();
        there.aircraft = "D-A".into();
        there.update_seal();
        let about = |name: &str| WingLabels { aircraft: Some(name.into()), ..WingLabels::default() };
        assert_eq!(manifest().adopt_labels(&there, &WingLabels::default()), Some(there.clone()));
        assert_eq!(manifest().adopt_labels(&there, &about("D-A")), Some(there.clone()));
        assert_eq!(manifest().adopt_labels(&there, &about("DA")), None);
    }

    #[test]
    fn frames_alone_go_below_their_prefix_and_long_files_in_parts() {
        assert_eq!(UploadStage::from_file_name("flights/f0001/s000001/0001.jpg"), UploadStage::Frames);
        for name in ["flights/f0001/s000001/results.jsonl", "store.toml", "flights/f0001/live-000001.rows"] {
            assert_eq!(UploadStage::from_file_name(name), UploadStage::Results, "{name}");
        }
        let bytes = vec![7; 2 * PART_BYTES + 1];
        let item = BundleFile {
            name: "flights/f0001/s000001/0001.tif".into(),
            length: bytes.len() as u64,
            sha256: sha256_hex(&bytes),
            content: BundleContent::Bytes(bytes),
        };
        let pieces = manifest().file_objects(&published_file(&item).unwrap(), &item);
        assert_eq!(pieces.iter().map(|p| p.length).sum::<u64>(), item.length);
        let last = pieces.last().unwrap();
        assert_eq!((pieces.len(), last.length, last.offset), (3, 1, 2 * PART_BYTES as u64));
        assert!(last.key.ends_with("0001.tif.part-0002"), "{}", last.key);
    }
}
