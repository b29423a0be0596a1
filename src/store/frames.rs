//! Frames of finished series: which are to be solved, their bytes, their results.

use serde_json::Value;

use super::catalogue::{self, FlightRef, SeriesRef};
use super::manifest::{FrameEntry, ResultLine, SeriesManifest, Solving};
use super::results::{self, Inputs, sha256};
use super::{Disk, Index, Store, StoreError, chain, installations, jsonl, layout};
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;

/// A stored frame that can be read and given a result.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameRef {
    /// Where.
    pub series: SeriesRef,
    /// What.
    pub entry: FrameEntry,
    /// When the camera was asked.
    pub stamp: Stamp,
    /// When it was exposed, where that is told.
    pub exposure: Option<Exposure>,
}

impl Store {
    /// The frames to solve of one series, newest series first: in the newest flight those without a
    /// result for these inputs, in older flights those without any result, because the camera may
    /// have been mounted anew since. Empty where nothing is left to do.
    pub fn unsolved(&self, inputs: &Inputs) -> Result<Vec<FrameRef>, StoreError> {
        let newest = self.current_flight();
        for flight in catalogue::flights(self.disk(), &self.root)?.iter().rev() {
            let any_result_will_do = Some(&flight.id) != newest.as_ref();
            for series in catalogue::series(self.disk(), flight)?.into_iter().rev() {
                let settled = (series.id.clone(), inputs.key(""));
                if self.index().settled.contains(&settled) {
                    continue;
                }
                let frames = self.unsolved_in(&series, inputs, any_result_will_do).unwrap_or_default();
                if !frames.is_empty() {
                    return Ok(frames);
                }
                self.index().settled.insert(settled);
            }
        }
        Ok(Vec::new())
    }

    /// The frames of a flight without a result for these inputs, in order.
    pub fn unsolved_of(&self, flight: &FlightRef, inputs: &Inputs) -> Result<Vec<FrameRef>, StoreError> {
        let series = catalogue::series(self.disk(), flight)?;
        let of = |series: &SeriesRef| self.unsolved_in(series, inputs, false);
        Ok(series.iter().map(of).collect::<Result<Vec<_>, _>>()?.concat())
    }

    /// A series whose manifest cannot be read has nothing to solve; `verify` reports it.
    fn unsolved_in(
        &self,
        series: &SeriesRef,
        inputs: &Inputs,
        any_result_will_do: bool,
    ) -> Result<Vec<FrameRef>, StoreError> {
        let manifest = catalogue::manifest(self.disk(), series)?;
        let keys = results::keys(self.disk(), &series.folder)?;
        let solved = |frame: &FrameEntry| {
            let key = inputs.key(&frame.sha256);
            keys.iter().any(|k| k.frame == frame.file && (any_result_will_do || k.inputs == key))
        };
        let mut frames = frames(series, manifest);
        frames.retain(|frame| !solved(&frame.entry));
        Ok(frames)
    }

    /// A frame's bytes, as delivered; an error where they are not what the manifest says.
    pub fn read_frame(&self, frame: &FrameRef) -> Result<Vec<u8>, StoreError> {
        read_frame(self.disk(), frame)
    }

    /// Says that a frame is about to be solved; returns how often in a row it was, this time included. More
    /// than one means that the program ended while it solved the frame.
    pub fn begin_solving(&self, frame: &FrameRef, inputs: &Inputs) -> Result<u32, StoreError> {
        let path = self.root.join(layout::SOLVING_FILE);
        let key = inputs.key(&frame.entry.sha256);
        let last = self.disk.read(&path).ok().and_then(|b| serde_json::from_slice::<Solving>(&b).ok());
        let before = last.filter(|last| last.inputs == key).map_or(0, |last| last.attempts);
        let now = Solving { inputs: key, attempts: before.saturating_add(1) };
        let text = jsonl::line(&now).map_err(StoreError::io(&path, "write"))?;
        self.disk.write(&path, &text).map_err(StoreError::io(&path, "write"))?;
        Ok(now.attempts)
    }

    /// Takes a beginning back: the frame was given up in good order, and is solved another time.
    pub fn forget_solving(&self) -> Result<(), StoreError> {
        let path = self.root.join(layout::SOLVING_FILE);
        self.disk.write(&path, b"").map_err(StoreError::io(&path, "write"))
    }

    /// Whether the newest flight holds a frame with these bytes.
    pub fn holds(&self, bytes: &[u8]) -> bool {
        let hash = sha256(bytes);
        let manifests = self.newest_manifests();
        manifests.iter().flat_map(|m| &m.shots).filter_map(|s| s.frame.as_ref()).any(|f| f.sha256 == hash)
    }

    /// Writes a result durably, once: `false` where this frame has one for these inputs already.
    pub fn add_result(&self, frame: &FrameRef, inputs: &Inputs, record: Value) -> Result<bool, StoreError> {
        let mut index = self.index();
        self.chain_installation(&mut index, &frame.series, inputs)?;
        index.unsealed.insert(frame.series.flight.clone());
        let line = ResultLine {
            frame: frame.entry.file.clone(),
            frame_sha256: frame.entry.sha256.clone(),
            inputs: inputs.key(&frame.entry.sha256),
            provenance: inputs.provenance.clone(),
            record,
        };
        results::append(self.disk(), &self.root, &frame.series, &line)
    }

    /// Names a kept installation in the flight's chain, once, before the first result that comes from it.
    fn chain_installation(
        &self,
        index: &mut Index,
        series: &SeriesRef,
        inputs: &Inputs,
    ) -> Result<(), StoreError> {
        let Some(digest) = installations::named(&inputs.provenance) else { return Ok(()) };
        let key = (series.flight.clone(), digest.clone());
        if index.installations.contains(&key)
            || !self.disk.exists(&installations::folder(&self.root, &digest))
            || catalogue::store_id(self.disk(), &self.root).is_none()
        {
            return Ok(());
        }
        let flight = self.root.join(layout::FLIGHTS).join(&series.flight);
        let known = chain::Chain::parse(&chain::read(self.disk(), &flight)?).state(usize::MAX);
        if !known.installations.contains(&digest) {
            let event = chain::Event::Installation { sha256: digest };
            chain::append(self.disk(), &self.root, &flight, event)?;
        }
        index.installations.insert(key);
        Ok(())
    }
}

/// A series' frames, in order.
pub fn frames(series: &SeriesRef, manifest: SeriesManifest) -> Vec<FrameRef> {
    let shots = manifest.shots.into_iter();
    shots
        .filter_map(|shot| {
            let entry = shot.frame.filter(|frame| layout::is_frame_name(&frame.file))?;
            Some(FrameRef { series: series.clone(), entry, stamp: shot.stamp, exposure: shot.exposure })
        })
        .collect()
}

/// A frame's bytes, as delivered; an error where they are not what the manifest says.
pub fn read_frame(disk: &dyn Disk, frame: &FrameRef) -> Result<Vec<u8>, StoreError> {
    let path = frame.series.folder.join(&frame.entry.file);
    let bytes = disk.read(&path).map_err(StoreError::io(&path, "read"))?;
    if sha256(&bytes) == frame.entry.sha256 {
        return Ok(bytes);
    }
    let what = "its bytes do not have the hash of series.json".to_owned();
    Err(StoreError::Damaged { path, what, mend: "take this frame from a backup or an export" })
}
