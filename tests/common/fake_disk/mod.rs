//! Simulated disk in memory with the failures of real disks at power cuts and loose cables: it loses unsynced data, tears
//! it, reorders it, fails or is full at a chosen step. For tests.
//!
//! Every call that changes something is one or two *steps* (writing, then syncing). A [`DiskFault`] names the step at which
//! it happens; [`FakeDisk::power_up`] returns the disk as the next boot finds it. docs/store/durability.md lists the
//! guarantees expected of a medium.

mod content;
mod state;

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use content::FaultRandom;
pub use content::UnsyncedBytes;
pub use state::DiskFault;
use state::{DirectoryNames, DiskNode, DiskState, NameChange, NodeId};

use wingd::store::disk::{DirectoryEntry, Disk, Lock};

/// Remains of all unsynced changes after a power cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Survival {
    /// Bit i: the i-th of the [`FakeDisk::unsynced_names`] survived. A rename survives completely or not at all.
    pub names: u64,
    /// Remains of unsynced bytes in every file; `None` chooses for each file at random.
    pub bytes: Option<UnsyncedBytes>,
    /// Seed of the random choice if `bytes` is `None`.
    pub seed: u64,
}

impl Survival {
    /// Returns random remains.
    pub fn random(seed: u64) -> Self {
        Self {
            names: FaultRandom::new(seed).next(),
            bytes: None,
            seed,
        }
    }

    fn bytes_for_file(self, index: usize) -> UnsyncedBytes {
        let mut random = FaultRandom::new(self.seed.wrapping_add(index as u64 * 7919));
        let seed = random.next();
        self.bytes.unwrap_or(match random.next() % 6 {
            0 => UnsyncedBytes::Lost,
            1 => UnsyncedBytes::Whole,
            2 => UnsyncedBytes::Half,
            3 => UnsyncedBytes::Zeros,
            4 => UnsyncedBytes::Garbage(seed),
            _ => UnsyncedBytes::Sectors(seed),
        })
    }
}

/// Simulated disk.
#[derive(Default)]
pub struct FakeDisk {
    state: Mutex<DiskState>,
    /// Time that each call takes which makes something durable.
    sync_time: Duration,
}

impl FakeDisk {
    /// Creates an empty disk with a root directory and the given faults.
    pub fn new(faults: Vec<DiskFault>) -> Self {
        let disk = Self::default();
        disk.set_faults(faults);
        disk
    }

    /// Creates an empty disk on which each call that makes something durable takes this time.
    pub fn slow(sync_time: Duration) -> Self {
        Self {
            sync_time,
            ..Self::new(vec![])
        }
    }

    /// Returns the number of steps so far.
    pub fn steps(&self) -> u64 {
        self.lock_state().steps
    }

    /// Sets the result of [`Disk::free_bytes`].
    pub fn set_free_bytes(&self, bytes: u64) {
        self.lock_state().free = bytes;
    }

    /// Sets the coming faults; the step count continues.
    pub fn set_faults(&self, faults: Vec<DiskFault>) {
        self.lock_state().faults = faults;
    }

    /// Returns the number of name changes that no directory sync has made durable.
    pub fn unsynced_names(&self) -> usize {
        self.lock_state().pending.len()
    }

    /// Returns a copy of the disk without faults; its steps count from 0.
    pub fn fork(&self) -> Self {
        let state = DiskState {
            steps: 0,
            faults: Vec::new(),
            ..self.lock_state().clone()
        };
        Self {
            state: Mutex::new(state),
            ..Self::default()
        }
    }

    /// Returns the disk as the next boot finds it: synced data, and the given remains of the rest.
    pub fn power_up(&self, left: Survival) -> Self {
        let mut state = DiskState {
            steps: 0,
            faults: Vec::new(),
            ..self.lock_state().clone()
        };
        for (index, change) in std::mem::take(&mut state.pending).into_iter().enumerate() {
            if left.names >> (index % 64) & 1 == 1 {
                change.apply(&mut state.nodes, |names| &mut names.durable);
            }
        }
        for (index, node) in state.nodes.iter_mut().enumerate() {
            match node {
                DiskNode::Directory(names) => names.current.clone_from(&names.durable),
                DiskNode::File(content) => content.apply_power_cut(left.bytes_for_file(index)),
            }
        }
        Self {
            state: Mutex::new(state),
            ..Self::default()
        }
    }

    fn lock_state(&self) -> MutexGuard<'_, DiskState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Disk for FakeDisk {
    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        let mut state = self.lock_state();
        state.check_power()?;
        let id = state.find_node(path)?;
        Ok(state.file_mut(id)?.current.clone())
    }

    fn list(&self, directory: &Path) -> io::Result<Vec<DirectoryEntry>> {
        let state = self.lock_state();
        state.check_power()?;
        let Some(DiskNode::Directory(names)) = state.nodes.get(state.find_node(directory)?) else {
            return Err(io::ErrorKind::NotADirectory.into());
        };
        let entry = |(name, id): (&String, &NodeId)| match state.nodes.get(*id) {
            Some(DiskNode::File(content)) => {
                let length = content.current.len() as u64;
                DirectoryEntry {
                    name: name.clone(),
                    is_dir: false,
                    is_link: false,
                    length,
                }
            }
            _ => DirectoryEntry {
                name: name.clone(),
                is_dir: true,
                is_link: false,
                length: 0,
            },
        };
        Ok(names.current.iter().map(entry).collect())
    }

    fn exists(&self, path: &Path) -> bool {
        let state = self.lock_state();
        state.check_power().is_ok() && state.find_node(path).is_ok()
    }

    fn create_dir(&self, path: &Path) -> io::Result<()> {
        let mut state = self.lock_state();
        let late = state.begin_step(true)?;
        if state.find_node(path).is_ok() {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        state.add_node(path, DiskNode::Directory(DirectoryNames::default()))?;
        late
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        std::thread::sleep(self.sync_time);
        self.lock_state().write_file(path, Some(0), bytes)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        std::thread::sleep(self.sync_time);
        self.lock_state().write_file(path, None, bytes)
    }

    fn truncate(&self, path: &Path, length: u64) -> io::Result<()> {
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        self.lock_state().write_file(path, Some(length), &[])
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut state = self.lock_state();
        let late = state.begin_step(false)?;
        let id = state.find_node(from)?;
        let (old, new) = (state.parent_and_name(from)?, state.parent_and_name(to)?);
        let target = state.find_node(to).ok().and_then(|id| state.nodes.get(id));
        if matches!(target, Some(DiskNode::Directory(names)) if !names.current.is_empty()) {
            return Err(io::ErrorKind::DirectoryNotEmpty.into());
        }
        state.apply_change(NameChange {
            from: Some(old),
            to: Some((new.0, new.1, id)),
        });
        late
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        let mut state = self.lock_state();
        let late = state.begin_step(false)?;
        state.find_node(path)?;
        let place = state.parent_and_name(path)?;
        state.apply_change(NameChange {
            from: Some(place),
            to: None,
        });
        late
    }

    fn remove_dir(&self, path: &Path) -> io::Result<()> {
        if !self.list(path)?.is_empty() {
            return Err(io::ErrorKind::DirectoryNotEmpty.into());
        }
        self.remove_file(path)
    }

    fn sync_dir(&self, directory: &Path) -> io::Result<()> {
        std::thread::sleep(self.sync_time);
        let mut state = self.lock_state();
        let late = state.begin_step(false)?;
        let id = state.find_node(directory)?;
        if state.ignores_syncs() {
            return Ok(());
        }
        let all = std::mem::take(&mut state.pending);
        for change in all {
            if change.touches(id) {
                // An older change does not restore a name that was removed durably.
                let undone =
                    |old: &NameChange| change.from.is_some() && old.target_name() == change.from;
                state.pending.retain(|old| !undone(old));
                change.apply(&mut state.nodes, |names| &mut names.durable);
            } else {
                state.pending.push(change);
            }
        }
        late
    }

    fn free_bytes(&self, _path: &Path) -> io::Result<u64> {
        let state = self.lock_state();
        state.check_power()?;
        Ok(state.free)
    }

    fn lock(&self, _path: &Path) -> io::Result<Option<Lock>> {
        Ok(Some(Box::new(())))
    }
}

/// Reads all files below a directory, for comparison.
pub fn read_all_files(disk: &dyn Disk, directory: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in disk.list(directory).unwrap_or_default() {
        let path = directory.join(&entry.name);
        if entry.is_dir {
            found.extend(read_all_files(disk, &path));
        } else if let Ok(bytes) = disk.read(&path) {
            found.insert(path, bytes);
        }
    }
    found
}
