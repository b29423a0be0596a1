//! A disk in memory that behaves as badly as disks do when the power goes or a cable is loose: it
//! forgets what was not synced, tears it, leaves it out of order, fails or is full at a chosen step. For tests.
//!
//! Every call that changes something is one or two *steps* (writing, then syncing). A fault says at
//! which step it happens; [`FakeDisk::power_up`] gives the disk as the next boot finds it. What it
//! takes a medium to promise is in docs/store/durability.md.

mod content;
mod state;

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

pub use content::Bytes;
use content::Random;
pub use state::Fault;
use state::{Change, Id, Names, Node, State};

use super::{Disk, Entry, Lock};

/// What a power cut leaves of all that was not synced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Survival {
    /// Bit i: the i-th of the [`FakeDisk::unsynced_names`] is there. A rename is there as a whole or not at all.
    pub names: u64,
    /// In every file; of each file's own where it is none.
    pub bytes: Option<Bytes>,
    /// Decides where `bytes` is none.
    pub seed: u64,
}

impl Survival {
    /// Any part of it.
    pub fn random(seed: u64) -> Self {
        Self { names: Random::new(seed).next(), bytes: None, seed }
    }

    fn of_file(self, index: usize) -> Bytes {
        let mut random = Random::new(self.seed.wrapping_add(index as u64 * 7919));
        let seed = random.next();
        self.bytes.unwrap_or(match random.next() % 6 {
            0 => Bytes::Lost,
            1 => Bytes::Whole,
            2 => Bytes::Half,
            3 => Bytes::Zeros,
            4 => Bytes::Garbage(seed),
            _ => Bytes::Sectors(seed),
        })
    }
}

/// The disk.
#[derive(Default)]
pub struct FakeDisk {
    state: Mutex<State>,
}

impl FakeDisk {
    /// Empty, with a root directory.
    pub fn new(faults: Vec<Fault>) -> Self {
        let disk = Self::default();
        disk.set_faults(faults);
        disk
    }

    /// Steps so far.
    pub fn steps(&self) -> u64 {
        self.state().steps
    }

    /// Sets what [`Disk::free_bytes`] says.
    pub fn set_free(&self, bytes: u64) {
        self.state().free = bytes;
    }

    /// Sets the faults to come; steps go on counting.
    pub fn set_faults(&self, faults: Vec<Fault>) {
        self.state().faults = faults;
    }

    /// Changes of names that no sync of their directory has made durable.
    pub fn unsynced_names(&self) -> usize {
        self.state().pending.len()
    }

    /// The same disk once more, without faults; steps count from 0.
    pub fn fork(&self) -> Self {
        let state = State { steps: 0, faults: Vec::new(), ..self.state().clone() };
        Self { state: Mutex::new(state) }
    }

    /// The disk as the next boot finds it: what was synced, and of the rest a part.
    pub fn power_up(&self, left: Survival) -> Self {
        let mut state = State { steps: 0, faults: Vec::new(), ..self.state().clone() };
        for (index, change) in std::mem::take(&mut state.pending).into_iter().enumerate() {
            if left.names >> (index % 64) & 1 == 1 {
                change.apply(&mut state.nodes, |names| &mut names.durable);
            }
        }
        for (index, node) in state.nodes.iter_mut().enumerate() {
            match node {
                Node::Directory(names) => names.now.clone_from(&names.durable),
                Node::File(content) => content.survive(left.of_file(index)),
            }
        }
        Self { state: Mutex::new(state) }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Disk for FakeDisk {
    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        let mut state = self.state();
        state.powered()?;
        let id = state.find(path)?;
        Ok(state.file(id)?.now.clone())
    }

    fn list(&self, directory: &Path) -> io::Result<Vec<Entry>> {
        let state = self.state();
        state.powered()?;
        let Some(Node::Directory(names)) = state.nodes.get(state.find(directory)?) else {
            return Err(io::ErrorKind::NotADirectory.into());
        };
        let entry = |(name, id): (&String, &Id)| match state.nodes.get(*id) {
            Some(Node::File(content)) => {
                let length = content.now.len() as u64;
                Entry { name: name.clone(), is_dir: false, is_link: false, length }
            }
            _ => Entry { name: name.clone(), is_dir: true, is_link: false, length: 0 },
        };
        Ok(names.now.iter().map(entry).collect())
    }

    fn exists(&self, path: &Path) -> bool {
        let state = self.state();
        state.powered().is_ok() && state.find(path).is_ok()
    }

    fn create_dir(&self, path: &Path) -> io::Result<()> {
        let mut state = self.state();
        let late = state.step(true)?;
        if state.find(path).is_ok() {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        state.add(path, Node::Directory(Names::default()))?;
        late
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.state().put(path, Some(0), bytes)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.state().put(path, None, bytes)
    }

    fn truncate(&self, path: &Path, length: u64) -> io::Result<()> {
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        self.state().put(path, Some(length), &[])
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut state = self.state();
        let late = state.step(false)?;
        let id = state.find(from)?;
        let (old, new) = (state.place(from)?, state.place(to)?);
        let target = state.find(to).ok().and_then(|id| state.nodes.get(id));
        if matches!(target, Some(Node::Directory(names)) if !names.now.is_empty()) {
            return Err(io::ErrorKind::DirectoryNotEmpty.into());
        }
        state.change(Change { from: Some(old), to: Some((new.0, new.1, id)) });
        late
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        let mut state = self.state();
        let late = state.step(false)?;
        state.find(path)?;
        let place = state.place(path)?;
        state.change(Change { from: Some(place), to: None });
        late
    }

    fn remove_dir(&self, path: &Path) -> io::Result<()> {
        if !self.list(path)?.is_empty() {
            return Err(io::ErrorKind::DirectoryNotEmpty.into());
        }
        self.remove_file(path)
    }

    fn sync_dir(&self, directory: &Path) -> io::Result<()> {
        let mut state = self.state();
        let late = state.step(false)?;
        let id = state.find(directory)?;
        if state.lies() {
            return Ok(());
        }
        let all = std::mem::take(&mut state.pending);
        for change in all {
            if change.touches(id) {
                // A name that was taken away durably does not come back by an older change.
                let undone = |old: &Change| change.from.is_some() && old.put() == change.from;
                state.pending.retain(|old| !undone(old));
                change.apply(&mut state.nodes, |names| &mut names.durable);
            } else {
                state.pending.push(change);
            }
        }
        late
    }

    fn free_bytes(&self, _path: &Path) -> io::Result<u64> {
        let state = self.state();
        state.powered()?;
        Ok(state.free)
    }

    fn lock(&self, _path: &Path) -> io::Result<Option<Lock>> {
        Ok(Some(Box::new(())))
    }
}

/// Every file with its bytes, for comparing.
pub fn files(disk: &dyn Disk, directory: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in disk.list(directory).unwrap_or_default() {
        let path = directory.join(&entry.name);
        if entry.is_dir {
            found.extend(files(disk, &path));
        } else if let Ok(bytes) = disk.read(&path) {
            found.insert(path, bytes);
        }
    }
    found
}
