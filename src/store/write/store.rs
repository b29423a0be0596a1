//! A store open for writing.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::index::Index;
use super::recover::{self, Recovery};
use super::root::Root;
use super::segment::{self, Growing};
use super::series::{OpenSeries, UnderWay};
use super::{evidence, flight, installations, opening, signing};
use crate::clock::Stamp;
use crate::store::config::StoreConfig;
use crate::store::disk::{Disk, Lock, StoreError};
use crate::store::format::kinds::{AIRCRAFT, KINDS, LIVE, MARKS};
use crate::store::format::manifest::{Cause, FlightManifest, JournalHead, Refusal, SeriesManifest, State};
use crate::store::format::{jsonl, layout};
use crate::store::read::catalogue::{self, FlightRef};
use crate::store::read::installations::File;

/// What is asked for when a series begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Why.
    pub cause: Cause,
    /// Shots that are wanted; 0 for a series beside others whose number is open ([`Cause::is_beside`]).
    pub shots: u32,
}

/// A store open for writing, by one process at a time.
pub struct Store {
    disk: Arc<dyn Disk>,
    root: PathBuf,
    config: StoreConfig,
    index: Mutex<Index>,
    signer: Option<signing::Signer>,
    pub(super) aircraft: Growing,
    pub(super) live: Growing,
    pub(super) marks: Growing,
    under_way: UnderWay,
    _lock: Lock,
}

impl Store {
    /// Opens a store, making it where the directory is empty or missing, and recovers what a crash left.
    pub fn open(disk: Arc<dyn Disk>, config: StoreConfig) -> Result<(Self, Recovery), StoreError> {
        let path = config.path.clone();
        let root = Root { disk: disk.as_ref(), path: &path };
        if !disk.exists(&root.join(layout::STORE_FILE)) {
            opening::create(root)?;
        }
        catalogue::check_format(disk.as_ref(), &path)?;
        let lock = opening::lock(root)?;
        root.ensure_folders()?;
        let mut recovery = recover::recover(root, &UnderWay::default())?;
        segment::settle(root, &KINDS, &mut recovery);
        let index = opening::scan(root, &mut recovery)?;
        // Recording matters more than its signature.
        let signer = config.signing_key.as_deref().map(signing::Signer::load_or_make).transpose();
        recovery.remarks.extend(signer.as_ref().err().map(|error| format!("nothing is signed: {error}")));
        let store = Self {
            disk,
            root: path,
            config,
            index: Mutex::new(index),
            signer: signer.ok().flatten(),
            aircraft: Growing::new(&AIRCRAFT),
            live: Growing::new(&LIVE),
            marks: Growing::new(&MARKS),
            under_way: UnderWay::default(),
            _lock: lock,
        };
        if store.at().has_evidence() {
            for flight in catalogue::flights(store.disk(), &store.root)? {
                let sealed = store.seal_flight(&flight.folder);
                recovery.remarks.extend(sealed.err().map(|error| error.to_string()));
            }
        }
        Ok((store, recovery))
    }

    /// The directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The directory on its disk.
    pub(crate) fn at(&self) -> Root<'_> {
        Root { disk: self.disk(), path: &self.root }
    }

    /// What signs its flights.
    pub fn signer(&self) -> Option<&signing::Signer> {
        self.signer.as_ref()
    }

    /// The file system it is on.
    pub fn disk(&self) -> &dyn Disk {
        self.disk.as_ref()
    }

    /// Space left, MB.
    pub fn free_mb(&self) -> Result<u64, StoreError> {
        let free = self.disk.free_bytes(&self.root).map_err(StoreError::io(&self.root, "measure"))?;
        Ok(free / 1_000_000)
    }

    /// Space kept free, MB.
    pub fn reserve_mb(&self) -> u64 {
        self.config.reserve_mb
    }

    /// The newest flight's name.
    pub fn current_flight(&self) -> Option<String> {
        self.index().flight.clone()
    }

    /// The last moment recorded in the newest flight.
    pub fn last_moment(&self) -> Option<Stamp> {
        self.index().last.clone()
    }

    /// Makes the next series begin a new flight.
    pub fn want_new_flight(&self) {
        self.index().new_flight_wanted = true;
    }

    /// When the scheduled series of the newest flight began in this boot, since boot, in order.
    pub fn series_of_boot(&self, boot_id: &str) -> Vec<Duration> {
        let scheduled = self.newest_manifests().into_iter().filter(|m| m.cause == Cause::Scheduled);
        let began = scheduled.filter_map(|m| m.started).filter(|stamp| stamp.boot_id == boot_id);
        began.filter_map(|stamp| Duration::try_from_secs_f64(stamp.since_boot_s).ok()).collect()
    }

    /// The readable manifests of the newest flight, in order.
    pub(crate) fn newest_manifests(&self) -> Vec<SeriesManifest> {
        let Some(id) = self.current_flight() else { return Vec::new() };
        let flight = FlightRef { folder: self.at().flight(&id), id };
        let series = catalogue::series(self.disk(), &flight).unwrap_or_default();
        series.iter().filter_map(|series| catalogue::manifest(self.disk(), series).ok()).collect()
    }

    /// Begins a series; recovers first what an abandoned one left. Others may be under way: each has its own folder, and
    /// is whole with what it has whatever becomes of this one. A refusal is recorded.
    pub fn begin_series(&self, plan: Plan, now: &Stamp) -> Result<(OpenSeries, Recovery), StoreError> {
        self.begin_in(None, plan, now)
    }

    /// The same in a flight that is named, whatever the pause: for pictures that were taken without a recorder.
    pub fn begin_series_of(
        &self,
        flight: &str,
        plan: Plan,
        now: &Stamp,
    ) -> Result<(OpenSeries, Recovery), StoreError> {
        self.begin_in(Some(flight), plan, now)
    }

    fn begin_in(
        &self,
        flight: Option<&str>,
        plan: Plan,
        now: &Stamp,
    ) -> Result<(OpenSeries, Recovery), StoreError> {
        let mut index = self.index();
        let recovery = recover::recover(self.at(), &self.under_way)?;
        self.refuse_below_reserve().inspect_err(|error| self.note_refusal(error, now))?;
        let flight = match flight {
            Some(flight) => flight.to_owned(),
            None => self.flight_for(&mut index, now)?,
        };
        let id = layout::series_id(index.counter.next_series);
        index.counter.pass(&id);
        opening::save_counter(self.at(), &index.counter)?;
        let head = JournalHead { flight, started: now.clone(), cause: plan.cause, planned_shots: plan.shots };
        index.note(now);
        let name = self.under_way.enter(&id);
        let open = OpenSeries::begin(self.disk.clone(), &self.root, name, head)?;
        Ok((open, recovery))
    }

    /// Closes a series: its manifest, then one rename to its flight.
    pub fn close_series(
        &self,
        series: OpenSeries,
        state: State,
        now: &Stamp,
        remarks: Vec<String>,
    ) -> Result<(), StoreError> {
        let mut index = self.index();
        index.note(now);
        index.unsealed.insert(series.flight().to_owned());
        series.close(state, now, remarks)?;
        self.seal_all(&mut index);
        Ok(())
    }

    /// Brings SHA256SUMS up to what was recorded and solved. Best effort: what fails is done again with
    /// the next call or at the next opening, and the chain has it all meanwhile.
    pub fn seal(&self) {
        self.seal_all(&mut self.index());
    }

    pub(crate) fn seal_all(&self, index: &mut Index) {
        if self.at().has_evidence() {
            index.unsealed.retain(|flight| self.seal_flight(&self.at().flight(flight)).is_err());
        }
    }

    /// Signs the chain, where there is a key, and brings the sums up to it.
    fn seal_flight(&self, flight: &Path) -> Result<(), StoreError> {
        let signed = self.signer.as_ref().map_or(Ok(()), |signer| signer.sign(self.at(), flight));
        signed.and(evidence::seal(self.disk(), flight))
    }

    /// Keeps an installation by its digest, so that results that come from it can be computed again.
    /// A store without evidence keeps none.
    pub fn keep_installation(&self, files: &[File]) -> Result<(), StoreError> {
        let _one_writer = self.index();
        if self.at().has_evidence() { installations::keep(self.at(), files).map(drop) } else { Ok(()) }
    }

    /// The flight that what is recorded now belongs to.
    pub(crate) fn flight_at(&self, now: &Stamp) -> Result<String, StoreError> {
        let mut index = self.index();
        let flight = self.flight_for(&mut index, now)?;
        index.note(now);
        Ok(flight)
    }

    /// Refuses where less space is left than is kept: for frames and their results, of what can wait.
    pub(crate) fn refuse_below_reserve(&self) -> Result<(), StoreError> {
        let (free_mb, reserve_mb) = (self.free_mb()?, self.config.reserve_mb);
        let path = self.root.clone();
        if free_mb < reserve_mb {
            Err(StoreError::BelowReserve { path, free_mb, reserve_mb })
        } else {
            Ok(())
        }
    }

    /// Records that a series could not be taken, and why. Best effort: the refusal itself reaches the caller in any case.
    fn note_refusal(&self, error: &StoreError, now: &Stamp) {
        if !matches!(error, StoreError::BelowReserve { .. }) {
            return;
        }
        let refusal = Refusal { stamp: now.clone(), reason: error.to_string() };
        let path = self.root.join(layout::REFUSED_FILE);
        let torn = self.disk.read(&path).is_ok_and(|bytes| bytes.last().is_some_and(|last| *last != b'\n'));
        let lead: &[u8] = if torn { b"\n" } else { b"" };
        let line = jsonl::line(&refusal).map(|line| [lead, &line].concat());
        let written = line.and_then(|line| self.disk.append(&path, &line));
        let _ = written.and_then(|()| self.disk.sync_dir(&self.root));
    }

    fn flight_for(&self, index: &mut Index, now: &Stamp) -> Result<String, StoreError> {
        let by_command = index.new_flight_wanted.then(|| "by command".to_owned());
        let rule = (self.config.new_flight_after, self.config.new_flight_at_boot);
        let because = by_command.or_else(|| flight::begins(index.last.as_ref(), now, rule.0, rule.1));
        match (because, &index.flight) {
            (None, Some(flight)) => Ok(flight.clone()),
            (because, _) => {
                let because = because.unwrap_or_else(|| "the last flight is not here any more".to_owned());
                self.new_flight(index, now, because)
            }
        }
    }

    /// Begins a flight that no series of this machine belongs to, under the user's own name for it if there is one.
    pub fn begin_flight(
        &self,
        now: &Stamp,
        because: String,
        name: Option<String>,
    ) -> Result<String, StoreError> {
        self.make_flight(&mut self.index(), now, (because, name))
    }

    fn new_flight(&self, index: &mut Index, now: &Stamp, because: String) -> Result<String, StoreError> {
        self.make_flight(index, now, (because, None))
    }

    fn make_flight(
        &self,
        index: &mut Index,
        now: &Stamp,
        (because, name): (String, Option<String>),
    ) -> Result<String, StoreError> {
        let flight = layout::flight_id(index.counter.next_flight);
        index.counter.pass(&flight);
        opening::save_counter(self.at(), &index.counter)?;
        let manifest = FlightManifest { flight: flight.clone(), started: now.clone(), because, name };
        recover::make_flight(self.at(), &manifest)?;
        index.flight = Some(flight.clone());
        index.new_flight_wanted = false;
        Ok(flight)
    }

    pub(crate) fn index(&self) -> MutexGuard<'_, Index> {
        self.index.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
