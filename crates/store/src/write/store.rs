//! Store opened for writing.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use super::index::StoreIndex;
use super::recover::{self, Recovery};
use super::root::StoreRoot;
use super::segment::{self, AppendFile};
use super::series::{ActiveSeries, OpenSeries};
use super::{evidence, flight, installations, opening, signing};
use crate::config::StoreConfig;
use crate::disk::{Disk, Lock, StoreError, StoreResult};
use crate::format::append_file_kinds::{
    AIRCRAFT_DATA, APPEND_FILE_KINDS, LIVE_RESULTS, MANUAL_MARKS,
};
use crate::format::manifest::{
    FlightManifest, JournalHead, RefusedSeries, SeriesCause, SeriesManifest, SeriesState,
};
use crate::format::{jsonl, layout};
use crate::read::catalogue;
use crate::read::catalogue::FlightRef;
use crate::read::installations::InstallationFile;
use wingd_base::clock::Stamp;

/// Request for a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SeriesPlan {
    pub cause: SeriesCause,
    /// Number of shots; 0 for a concurrent series with an open number ([`SeriesCause::is_concurrent`]).
    pub shots: u32,
}

/// Store opened for writing, by one process at a time.
pub struct Store {
    disk: Arc<dyn Disk>,
    root: PathBuf,
    config: StoreConfig,
    index: Mutex<StoreIndex>,
    signer: OnceLock<signing::Signer>,
    pub(super) aircraft: AppendFile,
    pub(super) live: AppendFile,
    pub(super) marks: AppendFile,
    under_way: ActiveSeries,
    _lock: Lock,
}

impl Store {
    /// Opens a store, creating it if the directory is empty or does not exist, and recovers the remains of a crash.
    pub fn open(disk: Arc<dyn Disk>, config: StoreConfig) -> StoreResult<(Self, Recovery)> {
        let path = config.path.clone();
        let root = StoreRoot {
            disk: disk.as_ref(),
            path: &path,
        };
        catalogue::refuse_links(disk.as_ref(), &path)?;
        let rebuilt = opening::rebuild_format_file(root)?;
        if !disk.exists(&root.join(layout::STORE_FILE)) {
            opening::create_store(root)?;
        }
        catalogue::check_format_file(disk.as_ref(), &path)?;
        let lock = opening::lock_store(root)?;
        root.ensure_folders()?;
        let mut recovery = recover::recover_incoming(root, &ActiveSeries::default())?;
        recovery.remarks.extend(rebuilt);
        segment::settle_append_files(root, &APPEND_FILE_KINDS, &mut recovery);
        let index = opening::scan_store(root, &mut recovery)?;
        let store = Self {
            disk,
            root: path,
            config,
            index: Mutex::new(index),
            signer: OnceLock::new(),
            aircraft: AppendFile::new(&AIRCRAFT_DATA),
            live: AppendFile::new(&LIVE_RESULTS),
            marks: AppendFile::new(&MANUAL_MARKS),
            under_way: ActiveSeries::default(),
            _lock: lock,
        };
        recovery.remarks.extend(store.signing_fault());
        if store.store_root().has_evidence() {
            for flight in catalogue::list_flights(store.disk(), &store.root)? {
                let sealed = store.seal_flight(&flight.folder);
                recovery
                    .remarks
                    .extend(sealed.err().map(|error| error.to_string()));
            }
        }
        Ok((store, recovery))
    }

    /// Returns the root directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Returns the root directory with its disk.
    pub(crate) fn store_root(&self) -> StoreRoot<'_> {
        StoreRoot {
            disk: self.disk(),
            path: &self.root,
        }
    }

    /// Returns the signer of the flights, if there is a key.
    ///
    /// # Errors
    /// Returns an error if the key cannot be used; recording continues without signatures, and it is tried again.
    pub fn signer(&self) -> StoreResult<Option<&signing::Signer>> {
        match (&self.config.signing_key, self.signer.get()) {
            (Some(path), None) => {
                let loaded = signing::Signer::load_or_create(path)?;
                Ok(Some(self.signer.get_or_init(|| loaded)))
            }
            (_, signer) => Ok(signer),
        }
    }

    /// Returns a sentence if the key of the flights cannot be used, or proves nothing.
    pub fn signing_fault(&self) -> Option<String> {
        match self.signer() {
            Ok(signer) => signing::exposure(signer?.path()),
            Err(error) => Some(format!("flights are not signed: {error}")),
        }
    }

    /// Returns the file system of the store.
    pub fn disk(&self) -> &dyn Disk {
        self.disk.as_ref()
    }

    /// Returns the free space, MB.
    pub fn free_mb(&self) -> StoreResult<u64> {
        let free = self
            .disk
            .free_bytes(&self.root)
            .map_err(StoreError::io(&self.root, "measure"))?;
        Ok(free / 1_000_000)
    }

    /// Returns the reserved space, MB.
    pub fn reserve_mb(&self) -> u64 {
        self.config.reserve_mb
    }

    /// Returns the length of the aircraft data of all flights on the disk, bytes.
    pub fn aircraft_bytes(&self) -> StoreResult<u64> {
        segment::recorded_bytes(self.store_root(), &AIRCRAFT_DATA)
    }

    /// Returns the length of the newest flight's frames of live mode and of events, bytes.
    pub fn raw_frame_bytes(&self) -> u64 {
        let manifests = self.newest_manifests();
        let raw = manifests.iter().filter(|m| m.cause.is_concurrent());
        raw.flat_map(SeriesManifest::frames).map(|f| f.bytes).sum()
    }

    /// Returns the name of the newest flight.
    pub fn current_flight(&self) -> Option<String> {
        self.lock_index().flight.clone()
    }

    /// Returns the last time recorded in the newest flight.
    pub fn last_moment(&self) -> Option<Stamp> {
        self.lock_index().last_moment.clone()
    }

    /// Makes the next series begin a new flight.
    pub fn request_new_flight(&self) {
        self.lock_index().new_flight_requested = true;
    }

    /// Returns the start times of the newest flight's scheduled series in this boot, since boot, in order.
    pub fn series_starts_in_boot(&self, boot_id: &str) -> Vec<Duration> {
        let scheduled = self
            .newest_manifests()
            .into_iter()
            .filter(|m| m.cause == SeriesCause::Scheduled);
        let began = scheduled
            .filter_map(|m| m.started)
            .filter(|stamp| stamp.boot_id == boot_id);
        began
            .filter_map(|stamp| Duration::try_from_secs_f64(stamp.since_boot_s).ok())
            .collect()
    }

    /// Returns the number of series in `incoming/` that are not under way: their last step failed, or they could not be
    /// recovered.
    pub fn stranded_series(&self) -> usize {
        let entries = self
            .disk
            .list(&self.root.join(layout::INCOMING))
            .unwrap_or_default();
        let series = entries
            .iter()
            .filter(|entry| layout::series_number(&entry.name).is_some());
        series
            .filter(|entry| !self.under_way.contains(&entry.name))
            .count()
    }

    /// Returns the readable manifests of the newest flight, in order.
    pub fn newest_manifests(&self) -> Vec<SeriesManifest> {
        let Some(id) = self.current_flight() else {
            return Vec::new();
        };
        let flight = FlightRef {
            folder: self.store_root().flight_folder(&id),
            id,
        };
        let series = catalogue::list_series(self.disk(), &flight).unwrap_or_default();
        series
            .iter()
            .filter_map(|series| catalogue::read_series_manifest(self.disk(), series).ok())
            .collect()
    }

    /// Begins a series, after recovering an abandoned one. Several series may be open at a time: each has its own folder
    /// and does not depend on the others. A refusal is recorded.
    pub fn begin_series(
        &self,
        plan: SeriesPlan,
        now: &Stamp,
    ) -> StoreResult<(OpenSeries, Recovery)> {
        self.open_series(None, plan, now)
    }

    /// Begins a series in a given flight, regardless of the pause: for images taken without a recorder.
    pub fn begin_series_in(
        &self,
        flight: &str,
        plan: SeriesPlan,
        now: &Stamp,
    ) -> StoreResult<(OpenSeries, Recovery)> {
        self.open_series(Some(flight), plan, now)
    }

    fn open_series(
        &self,
        flight: Option<&str>,
        plan: SeriesPlan,
        now: &Stamp,
    ) -> StoreResult<(OpenSeries, Recovery)> {
        let mut index = self.lock_index();
        let mut recovery = recover::recover_incoming(self.store_root(), &self.under_way)?;
        // What remains in incoming/ is reported once, not with each series.
        recovery
            .remarks
            .retain(|remark| index.reported.insert(remark.clone()));
        self.refuse_below_reserve()
            .inspect_err(|error| self.note_refusal(error, now))?;
        let flight = match flight {
            Some(flight) => flight.to_owned(),
            None => self.current_or_new_flight(&mut index, now)?,
        };
        let id = layout::series_id(index.counter.next_series);
        index.counter.advance_past(&id);
        opening::save_counter(self.store_root(), &index.counter)?;
        let head = JournalHead {
            flight,
            started: now.clone(),
            cause: plan.cause,
            planned_shots: plan.shots,
        };
        index.note_moment(now);
        let name = self.under_way.register(&id);
        let open = OpenSeries::begin(self.disk.clone(), &self.root, name, head)?;
        Ok((open, recovery))
    }

    /// Closes a series: writes its manifest, then moves it to its flight by one rename.
    pub fn close_series(
        &self,
        series: OpenSeries,
        state: SeriesState,
        now: &Stamp,
        remarks: Vec<String>,
    ) -> StoreResult<()> {
        let mut index = self.lock_index();
        index.note_moment(now);
        index.unsealed.insert(series.flight().to_owned());
        series.close(state, now, remarks)?;
        self.seal_unsealed_flights(&mut index);
        Ok(())
    }

    /// Signs the chains and updates SHA256SUMS to the recorded data. Best effort: a failure is retried at the next call or
    /// opening, and the chain is complete in the meantime.
    pub fn seal(&self) {
        self.seal_unsealed_flights(&mut self.lock_index());
    }

    pub(crate) fn seal_unsealed_flights(&self, index: &mut StoreIndex) {
        if self.store_root().has_evidence() {
            index.unsealed.retain(|flight| {
                self.seal_flight(&self.store_root().flight_folder(flight))
                    .is_err()
            });
        }
    }

    /// Signs the chain, if there is a key, and updates the sums to it.
    fn seal_flight(&self, flight: &Path) -> StoreResult<()> {
        let signer = self.signer().ok().flatten();
        let signed = signer.map_or(Ok(()), |signer| {
            signer.sign_chain(self.store_root(), flight)
        });
        signed.and(evidence::update_sums(self.disk(), flight))
    }

    /// Stores an installation by its digest, so that its results can be computed again. Does nothing in a store without
    /// evidence.
    pub fn keep_installation(&self, files: &[InstallationFile]) -> StoreResult<()> {
        let _one_writer = self.lock_index();
        if self.store_root().has_evidence() {
            installations::keep_installation(self.store_root(), files).map(drop)
        } else {
            Ok(())
        }
    }

    /// Returns the flight to which current data belong.
    pub(crate) fn flight_for_recording(&self, now: &Stamp) -> StoreResult<String> {
        let mut index = self.lock_index();
        let flight = self.current_or_new_flight(&mut index, now)?;
        index.note_moment(now);
        Ok(flight)
    }

    /// Returns an error if the free space is below the reserve. For data with lower priority than frames and their results.
    pub(crate) fn refuse_below_reserve(&self) -> StoreResult<()> {
        let (free_mb, reserve_mb) = (self.free_mb()?, self.config.reserve_mb);
        let path = self.root.clone();
        if free_mb < reserve_mb {
            Err(StoreError::BelowReserve {
                path,
                free_mb,
                reserve_mb,
            })
        } else {
            Ok(())
        }
    }

    /// Records that a series was refused, and why. Best effort: the caller gets the refusal in any case.
    fn note_refusal(&self, error: &StoreError, now: &Stamp) {
        if !matches!(error, StoreError::BelowReserve { .. }) {
            return;
        }
        let refusal = RefusedSeries {
            stamp: now.clone(),
            reason: error.to_string(),
        };
        let path = self.root.join(layout::REFUSED_FILE);
        let torn = self
            .disk
            .read(&path)
            .is_ok_and(|bytes| bytes.last().is_some_and(|last| *last != b'\n'));
        let lead: &[u8] = if torn { b"\n" } else { b"" };
        let line = jsonl::encode_line(&refusal).map(|line| [lead, &line].concat());
        let written = line.and_then(|line| self.disk.append(&path, &line));
        let _ = written.and_then(|()| self.disk.sync_dir(&self.root));
    }

    fn current_or_new_flight(&self, index: &mut StoreIndex, now: &Stamp) -> StoreResult<String> {
        let by_command = index.new_flight_requested.then(|| "by command".to_owned());
        let rule = (self.config.new_flight_after, self.config.new_flight_at_boot);
        let because = by_command
            .or_else(|| flight::new_flight_reason(index.last_moment.as_ref(), now, rule.0, rule.1))
            .or_else(|| self.unwritable_flight_reason(index.flight.as_deref()?));
        match (because, &index.flight) {
            (None, Some(flight)) => Ok(flight.clone()),
            (because, _) => {
                let because =
                    because.unwrap_or_else(|| "the last flight is no longer here".to_owned());
                self.make_flight(index, now, because, None)
            }
        }
    }

    /// Returns a reason for a new flight if the files of this one belong to another user, so that no series can be added.
    fn unwritable_flight_reason(&self, flight: &str) -> Option<String> {
        let folder = self.store_root().flight_folder(flight);
        let permitted = |path: &Path| self.disk.is_permitted(path);
        let refused = !permitted(&folder) || !permitted(&folder.join(layout::CHAIN_FILE));
        refused.then(|| format!("this user cannot write to {flight}"))
    }

    /// Begins a flight for data recorded elsewhere, with the user's name for it if there is one.
    pub fn begin_flight(
        &self,
        now: &Stamp,
        because: String,
        name: Option<String>,
    ) -> StoreResult<String> {
        self.make_flight(&mut self.lock_index(), now, because, name)
    }

    fn make_flight(
        &self,
        index: &mut StoreIndex,
        now: &Stamp,
        because: String,
        name: Option<String>,
    ) -> StoreResult<String> {
        let flight = layout::flight_id(index.counter.next_flight);
        index.counter.advance_past(&flight);
        opening::save_counter(self.store_root(), &index.counter)?;
        let manifest = FlightManifest {
            flight: flight.clone(),
            started: now.clone(),
            because,
            name,
        };
        recover::make_flight(self.store_root(), &manifest)?;
        index.flight = Some(flight.clone());
        index.new_flight_requested = false;
        Ok(flight)
    }

    pub(crate) fn lock_index(&self) -> MutexGuard<'_, StoreIndex> {
        self.index.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
