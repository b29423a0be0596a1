//! Manifest of a published flight: aircraft, wing, files with digests, and object keys.

use std::path::Path;

use serde::{Deserialize, Serialize};

use wingd_evaluation::record::variant_name;
use wingd_store::bundle::{BundleContent, BundleFile, FlightBundle};
use wingd_store::{
    Disk, FlightRef, RealDisk, StoreError, StoreResult, catalogue, installations, layout,
    sha256_hex,
};

/// Format of the manifest.
const FORMAT: u32 = 2;
/// Maximum length of a name in a key, characters.
const MAX_NAME_LENGTH: usize = 64;
/// Maximum length of an object, bytes: longer files are uploaded in parts, which bounds the cost of an interruption. A part
/// takes 17 s at 0.25 MB/s.
pub(super) const PART_BYTES: usize = 4 << 20;
/// Placeholder in the seal field while the digest is computed.
const EMPTY_SEAL: &str = "0000000000000000000000000000000000000000000000000000000000000000";
/// Length of the recorder id in the default aircraft name, characters.
const SHORT_ID_LENGTH: usize = 8;

/// Aircraft and wing of a flight: labels that can be corrected later and do not identify the flight. `None`: not given.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WingLabels {
    /// Registration, valid for [`WingLabels::is_valid_name`].
    pub aircraft: Option<String>,
    pub aircraft_type: Option<String>,
    /// Name of the wing: `left`, `right`, or another name.
    pub wing: Option<String>,
}

impl WingLabels {
    /// Returns whether a text is a valid name: 1 to 64 letters, digits, `.`, `_`, `-`, which every object store, file
    /// system and table engine takes without quoting; no leading `.`, which would hide a file or lead up.
    pub fn is_valid_name(text: &str) -> bool {
        let plain = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        (1..=MAX_NAME_LENGTH).contains(&text.len())
            && text.chars().all(plain)
            && !text.starts_with('.')
    }
}

/// Manifest of a flight, `manifests/recorder=R/flight=F/manifest.json`: announces the flight with all its files. Completion
/// objects next to it show the stages that have arrived ([`UploadStage`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct UploadManifest {
    /// Format of the manifest.
    pub format: u32,
    /// Id of the store; together with the flight's name it identifies the flight.
    pub recorder: String,
    /// Name of the flight in its store.
    pub flight: String,
    /// Registration as first published; by default a name derived from the recorder's id.
    pub aircraft: String,
    /// Type of aircraft; `null` if not given.
    pub aircraft_type: Option<String>,
    /// Name of the wing; `null` if neither the call nor the installation gives it.
    pub wing: Option<String>,
    /// Beginning of the flight, UTC by the recorder's clock.
    pub started: String,
    /// Digest of all files.
    pub digest: String,
    /// Total length of all files.
    pub bytes: u64,
    /// Files of the flight; together they are a store.
    pub files: Vec<PublishedFile>,
    /// SHA-256 of this text with 64 zeros in this field.
    pub seal: String,
}

/// File of a published flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PublishedFile {
    /// Path with `/`.
    pub name: String,
    /// Length, bytes.
    pub length: u64,
    /// SHA-256 of the file, hex.
    pub sha256: String,
    /// SHA-256 of each part, if the file is split into objects `NAME.part-0000`, ….
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<String>,
}

/// Stage of an upload, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum UploadStage {
    /// Everything except frames.
    Results,
    Frames,
}

/// Object of a flight.
#[derive(Clone, Debug)]
pub(super) struct UploadObject {
    pub key: String,
    pub stage: UploadStage,
    /// Offset in its file, bytes.
    pub offset: u64,
    pub length: u64,
    pub sha256: String,
    pub file: BundleFile,
}

/// Completion object: all objects of a stage have arrived.
#[derive(Serialize)]
struct CompletionRecord<'a> {
    format: u32,
    stage: UploadStage,
    /// SHA-256 of the manifest.
    manifest: String,
    seal: &'a str,
}

impl UploadStage {
    /// Returns the key prefix of the stage. Frames have their own prefix, so that a lifecycle rule of the bucket can delete
    /// them.
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
    /// Creates the manifest of a local flight; reads files that are uploaded in parts for their digests.
    pub(super) fn from_bundle(
        root: &Path,
        flight: &FlightRef,
        labels: &WingLabels,
        bundle: &FlightBundle,
    ) -> StoreResult<Self> {
        let recorder =
            catalogue::store_id(&RealDisk, root).ok_or_else(|| missing_id_error(root))?;
        let files: Vec<PublishedFile> = bundle
            .items
            .iter()
            .map(published_file)
            .collect::<Result<_, _>>()?;
        let short = recorder.get(..SHORT_ID_LENGTH).unwrap_or(&recorder);
        let mut manifest = Self {
            format: FORMAT,
            aircraft: labels
                .aircraft
                .clone()
                .unwrap_or_else(|| format!("recorder-{short}")),
            aircraft_type: labels.aircraft_type.clone(),
            wing: labels.wing.clone().or(wing_side(root, flight)?),
            recorder,
            flight: flight.id.clone(),
            started: catalogue::read_flight_manifest(&RealDisk, flight)?
                .started
                .utc
                .to_string(),
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

    /// Parses a manifest; `None` if its seal does not match.
    pub(super) fn parse_sealed(bytes: &[u8]) -> Option<Self> {
        let found: Self = serde_json::from_slice(bytes).ok()?;
        let text = std::str::from_utf8(bytes).ok()?;
        let open = text.replacen(&found.seal, EMPTY_SEAL, 1);
        (sha256_hex(open.as_bytes()) == found.seal).then_some(found)
    }

    /// Adopts the labels of the published manifest if the call does not give them; `None` if the call contradicts them.
    pub(super) fn adopt_labels(mut self, there: &Self, labels: &WingLabels) -> Option<Self> {
        let fits = |given: &Option<String>, there: Option<&String>| {
            given.is_none() || given.as_ref() == there
        };
        let all = fits(&labels.aircraft, Some(&there.aircraft))
            && fits(&labels.aircraft_type, there.aircraft_type.as_ref())
            && fits(&labels.wing, there.wing.as_ref());
        self.aircraft.clone_from(&there.aircraft);
        self.aircraft_type.clone_from(&there.aircraft_type);
        self.wing.clone_from(&there.wing);
        self.update_seal();
        all.then_some(self)
    }

    fn flight_path(&self) -> String {
        format!("recorder={}/flight={}", self.recorder, self.flight)
    }

    /// Returns the key of the manifest.
    pub fn key(&self) -> String {
        format!("manifests/{}/manifest.json", self.flight_path())
    }

    /// Returns key and text of the completion object of a stage.
    pub(super) fn completion_object(&self, stage: UploadStage) -> (String, String) {
        let manifest = sha256_hex(self.json_text().as_bytes());
        let text = |seal: &str| {
            let mark = CompletionRecord {
                format: FORMAT,
                stage,
                manifest: manifest.clone(),
                seal,
            };
            serde_json::to_string_pretty(&mark).unwrap_or_default() + "\n"
        };
        let key = format!(
            "manifests/{}/{}.json",
            self.flight_path(),
            variant_name(stage)
        );
        (key, text(&sha256_hex(text(EMPTY_SEAL).as_bytes())))
    }

    /// Returns the key prefixes of its files.
    pub fn key_prefixes(&self) -> [String; 2] {
        [UploadStage::Results, UploadStage::Frames]
            .map(|stage| format!("{}/{}", stage.key_prefix(), self.flight_path()))
    }

    /// Returns all objects of its files, in sending order.
    pub(super) fn upload_objects(&self, bundle: &FlightBundle) -> Vec<UploadObject> {
        let mut pieces: Vec<UploadObject> = self
            .files
            .iter()
            .zip(&bundle.items)
            .flat_map(|(file, item)| self.file_objects(file, item))
            .collect();
        pieces.sort_by_key(|piece| piece.stage == UploadStage::Frames);
        pieces
    }

    fn file_objects(&self, file: &PublishedFile, item: &BundleFile) -> Vec<UploadObject> {
        let stage = UploadStage::from_file_name(&file.name);
        let whole = format!(
            "{}/{}/{}",
            stage.key_prefix(),
            self.flight_path(),
            file.name
        );
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

    /// Returns the JSON text. The same flight always gives the same bytes: nothing depends on time or machine.
    pub(super) fn json_text(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }
}

fn published_file(item: &BundleFile) -> StoreResult<PublishedFile> {
    let parts = if item.length > PART_BYTES as u64 {
        read_verified(item)?
            .chunks(PART_BYTES)
            .map(sha256_hex)
            .collect()
    } else {
        Vec::new()
    };
    Ok(PublishedFile {
        name: item.name.clone(),
        length: item.length,
        sha256: item.sha256.clone(),
        parts,
    })
}

/// Reads a file's bytes in the state of the bundle; returns an error if they do not have the digest in the chain.
pub(super) fn read_verified(item: &BundleFile) -> StoreResult<Vec<u8>> {
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
    let problem = "does not match its SHA-256, so the flight is not uploaded".to_owned();
    Err(StoreError::Damaged {
        path,
        problem,
        remedy: "restore it from a copy; run `wingd verify` for other damage",
    })
}

/// Returns the wing side in the latest installation of the flight's results.
fn wing_side(root: &Path, flight: &FlightRef) -> StoreResult<Option<String>> {
    let last = installations::flight_installations(&RealDisk, flight)?.pop();
    let file = last
        .map(|digest| installations::installation_folder(root, &digest).join("installation.toml"));
    let text = file.and_then(|file| RealDisk.read(&file).ok());
    let table = text.and_then(|text| std::str::from_utf8(&text).ok()?.parse::<toml::Table>().ok());
    let side = table.and_then(|table| Some(table.get("wing")?.get("side")?.as_str()?.to_owned()));
    Ok(side.filter(|side| WingLabels::is_valid_name(side)))
}

fn missing_id_error(root: &Path) -> StoreError {
    StoreError::Damaged {
        path: root.to_owned(),
        problem:
            "has format 1 and no id that distinguishes its flights from those of other recorders"
                .into(),
        remedy: "run `wingd verify --upgrade` to add one",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest() -> UploadManifest {
        let mut manifest = UploadManifest {
            format: FORMAT,
            recorder: "ab12".into(),
            flight: "f0001".into(),
            aircraft: "recorder-ab12".into(),
            started: "2026-06-01T08:00:00Z".into(),
            digest: "d".into(),
            bytes: 9,
            ..UploadManifest::default()
        };
        manifest.update_seal();
        manifest
    }

    #[test]
    fn any_changed_byte_breaks_the_seal() {
        let text = manifest().json_text();
        assert_eq!(
            UploadManifest::parse_sealed(text.as_bytes()),
            Some(manifest())
        );
        for place in 0..text.len() {
            let mut bytes = text.clone().into_bytes();
            *bytes.get_mut(place).unwrap() ^= 1;
            assert_eq!(UploadManifest::parse_sealed(&bytes), None, "byte {place}");
        }
    }

    #[test]
    fn labels_stay_as_first_published_and_contradictions_are_refused() {
        let mut there = manifest();
        there.aircraft = "D-A".into();
        there.update_seal();
        let labels = |name: &str| WingLabels {
            aircraft: Some(name.into()),
            ..WingLabels::default()
        };
        assert_eq!(
            manifest().adopt_labels(&there, &WingLabels::default()),
            Some(there.clone())
        );
        assert_eq!(
            manifest().adopt_labels(&there, &labels("D-A")),
            Some(there.clone())
        );
        assert_eq!(manifest().adopt_labels(&there, &labels("DA")), None);
    }

    #[test]
    fn only_frames_go_below_their_prefix_and_long_files_in_parts() {
        assert_eq!(
            UploadStage::from_file_name("flights/f0001/s000001/0001.jpg"),
            UploadStage::Frames
        );
        for name in [
            "flights/f0001/s000001/results.jsonl",
            "store.toml",
            "flights/f0001/live-000001.rows",
        ] {
            assert_eq!(
                UploadStage::from_file_name(name),
                UploadStage::Results,
                "{name}"
            );
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
        assert_eq!(
            (pieces.len(), last.length, last.offset),
            (3, 1, 2 * PART_BYTES as u64)
        );
        assert!(last.key.ends_with("0001.tif.part-0002"), "{}", last.key);
    }
}
