//! Selection of frames to solve, and storage of their results.

use std::collections::HashSet;

use serde_json::Value;

use super::chain;
use super::index::StoreIndex;
use super::results::ResultKey;
use super::store::Store;
use crate::disk::{StoreError, StoreResult};
use crate::format::chain::ChainEvent;
use crate::format::manifest::{ResultLine, SeriesManifest, SolvingAttempt};
use crate::format::{Inputs, jsonl, layout, sha256_hex};
use crate::read::catalogue::{self, FlightRef, SeriesRef};
use crate::read::frames::{FrameRef, read_frame, series_frames};
use crate::read::installations;

impl Store {
    /// Returns the frames to solve of one series, newest series first: in the newest flight those without a result for
    /// these inputs, in older flights those without any result, because the camera may have been remounted since. Empty if
    /// nothing is left to solve.
    pub fn unsolved_frames(&self, inputs: &Inputs) -> StoreResult<Vec<FrameRef>> {
        let newest = self.current_flight();
        for flight in catalogue::list_flights(self.disk(), self.root())?
            .iter()
            .rev()
        {
            let any_result_will_do = Some(&flight.id) != newest.as_ref();
            for series in catalogue::list_series(self.disk(), flight)?
                .into_iter()
                .rev()
            {
                let settled = (series.id.clone(), inputs.key(""));
                if self.lock_index().solved_series.contains(&settled) {
                    continue;
                }
                let frames = self
                    .unsolved_in_series(&series, inputs, any_result_will_do)
                    .unwrap_or_default();
                if !frames.is_empty() {
                    return Ok(frames);
                }
                self.lock_index().solved_series.insert(settled);
            }
        }
        Ok(Vec::new())
    }

    /// Returns the frames of a flight without a result for these inputs, in order.
    pub fn unsolved_in_flight(
        &self,
        flight: &FlightRef,
        inputs: &Inputs,
    ) -> StoreResult<Vec<FrameRef>> {
        let series = catalogue::list_series(self.disk(), flight)?;
        let unsolved = |series: &SeriesRef| self.unsolved_in_series(series, inputs, false);
        Ok(series
            .iter()
            .map(unsolved)
            .collect::<Result<Vec<_>, _>>()?
            .concat())
    }

    /// Returns the frames of a series without a result; an error if the manifest cannot be read, which `verify` reports.
    fn unsolved_in_series(
        &self,
        series: &SeriesRef,
        inputs: &Inputs,
        any_result_will_do: bool,
    ) -> StoreResult<Vec<FrameRef>> {
        let manifest = catalogue::read_series_manifest(self.disk(), series)?;
        let mut frames = series_frames(series, manifest);
        let mut solved = HashSet::new();
        let path = series.folder.join(layout::RESULTS_FILE);
        catalogue::for_each_line(self.disk(), &path, |_, line| {
            let key = serde_json::from_slice::<ResultKey>(line);
            solved.extend(key.ok().map(|key| (key.frame, key.inputs)));
        })?;
        if any_result_will_do {
            let any: HashSet<&str> = solved.iter().map(|(frame, _)| frame.as_str()).collect();
            frames.retain(|frame| !any.contains(frame.entry.file.as_str()));
        } else {
            frames.retain(|FrameRef { entry, .. }| {
                !solved.contains(&(entry.file.clone(), inputs.key(&entry.sha256)))
            });
        }
        Ok(frames)
    }

    /// Reads the bytes of a frame, as delivered by the camera.
    ///
    /// # Errors
    /// Returns an error if they do not have the digest in the manifest.
    pub fn read_frame(&self, frame: &FrameRef) -> StoreResult<Vec<u8>> {
        read_frame(self.disk(), frame)
    }

    /// Records that a frame is about to be solved; returns the number of consecutive attempts, including this one. More
    /// than one means that the program ended while solving the frame.
    pub fn begin_solving(&self, frame: &FrameRef, inputs: &Inputs) -> StoreResult<u32> {
        let path = self.root().join(layout::SOLVING_FILE);
        let key = inputs.key(&frame.entry.sha256);
        let last = self.disk().load_json::<SolvingAttempt>(&path);
        let before = last
            .filter(|last| last.inputs == key)
            .map_or(0, |last| last.attempts);
        let now = SolvingAttempt {
            inputs: key,
            attempts: before.saturating_add(1),
        };
        let text = jsonl::encode_line(&now).map_err(StoreError::io(&path, "write"))?;
        self.disk().save_file(&path, &text)?;
        Ok(now.attempts)
    }

    /// Withdraws an attempt: the frame was abandoned regularly and is solved another time.
    pub fn cancel_solving(&self) -> StoreResult<()> {
        self.disk()
            .save_file(&self.root().join(layout::SOLVING_FILE), b"")
    }

    /// Returns whether the newest flight has a frame with these bytes.
    pub fn contains_frame(&self, bytes: &[u8]) -> bool {
        let hash = sha256_hex(bytes);
        let manifests = self.newest_manifests();
        manifests
            .iter()
            .flat_map(SeriesManifest::frames)
            .any(|frame| frame.sha256 == hash)
    }

    /// Writes a result durably, once; returns `false` if the frame has one for these inputs already.
    pub fn add_result(
        &self,
        frame: &FrameRef,
        inputs: &Inputs,
        record: Value,
    ) -> StoreResult<bool> {
        let mut index = self.lock_index();
        self.chain_installation(&mut index, &frame.series, inputs)?;
        index.unsealed.insert(frame.series.flight.clone());
        let line = ResultLine {
            frame: frame.entry.file.clone(),
            frame_sha256: frame.entry.sha256.clone(),
            inputs: inputs.key(&frame.entry.sha256),
            provenance: inputs.provenance.clone(),
            record,
        };
        index
            .results
            .append(self.store_root(), &frame.series, &line)
    }

    /// Adds a stored installation to the flight's chain, once, before the first result that was computed from it.
    fn chain_installation(
        &self,
        index: &mut StoreIndex,
        series: &SeriesRef,
        inputs: &Inputs,
    ) -> StoreResult<()> {
        let Some(digest) = installations::digest_from_provenance(&inputs.provenance) else {
            return Ok(());
        };
        let key = (series.flight.clone(), digest.clone());
        let is_stored = || {
            self.disk()
                .exists(&installations::installation_folder(self.root(), &digest))
        };
        if index.installations.contains(&key) || !is_stored() || !self.store_root().has_evidence() {
            return Ok(());
        }
        let flight = self.store_root().flight_folder(&series.flight);
        let (_, known) = catalogue::read_chain(self.disk(), &flight)?;
        if !known.state_at(usize::MAX).installations.contains(&digest) {
            chain::append_event(
                self.store_root(),
                &flight,
                ChainEvent::Installation { sha256: digest },
            )?;
        }
        index.installations.insert(key);
        Ok(())
    }
}
