//! A disk in memory that behaves as badly as disks do when the power goes: it forgets what was not
//! synced, tears writes, leaves names out of order, fails or is full at a chosen step. For tests.
//!
//! Every call that changes something is one or two *steps* (writing, then syncing). A plan says at
//! which step the power goes; [`FakeDisk::power_up`] then gives the disk as the next boot finds it.

use std::collections::BTreeMap;
use std::io;
use std::path::{Component, Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::disk::{Disk, Entry, Lock};

type Id = usize;

/// What goes wrong, and when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// From this step on, nothing reaches the disk and every call fails.
    PowerCut(u64),
    /// This step alone fails, half done.
    Error(u64),
    /// From this step on the disk is full.
    Full(u64),
}

/// The disk.
pub struct FakeDisk {
    state: Mutex<State>,
}

#[derive(Clone)]
struct State {
    nodes: Vec<Node>,
    /// Changes of names that are not durable yet, in order.
    pending: Vec<Change>,
    steps: u64,
    faults: Vec<Fault>,
    random: u64,
    free: u64,
}

#[derive(Clone)]
enum Node {
    /// `cut_off`: the last change was a truncation.
    File {
        now: Vec<u8>,
        durable: Vec<u8>,
        cut_off: bool,
    },
    Directory {
        now: BTreeMap<String, Id>,
        durable: BTreeMap<String, Id>,
    },
}

#[derive(Clone, Debug)]
struct Change {
    /// Taken away, where it was.
    from: Option<(Id, String)>,
    /// Put in place.
    to: Option<(Id, String, Id)>,
}

impl Change {
    fn touches(&self, directory: Id) -> bool {
        self.from.as_ref().is_some_and(|(id, _)| *id == directory)
            || self.to.as_ref().is_some_and(|(id, _, _)| *id == directory)
    }

    /// The place that it fills.
    fn put(&self) -> Option<(Id, String)> {
        self.to.as_ref().map(|(directory, name, _)| (*directory, name.clone()))
    }

    fn apply(&self, nodes: &mut [Node], side: fn(&mut Node) -> Option<&mut BTreeMap<String, Id>>) {
        if let Some((directory, name)) = &self.from
            && let Some(map) = nodes.get_mut(*directory).and_then(side)
        {
            map.remove(name);
        }
        if let Some((directory, name, id)) = &self.to
            && let Some(map) = nodes.get_mut(*directory).and_then(side)
        {
            map.insert(name.clone(), *id);
        }
    }
}

fn now(node: &mut Node) -> Option<&mut BTreeMap<String, Id>> {
    match node {
        Node::Directory { now, .. } => Some(now),
        Node::File { .. } => None,
    }
}

fn durable(node: &mut Node) -> Option<&mut BTreeMap<String, Id>> {
    match node {
        Node::Directory { durable, .. } => Some(durable),
        Node::File { .. } => None,
    }
}

impl FakeDisk {
    /// Empty, with a root directory. `seed` decides what survives a power cut.
    pub fn new(seed: u64, faults: Vec<Fault>) -> Self {
        let root = Node::Directory { now: BTreeMap::new(), durable: BTreeMap::new() };
        let random = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let state =
            State { nodes: vec![root], pending: Vec::new(), steps: 0, faults, random, free: u64::MAX };
        Self { state: Mutex::new(state) }
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

    /// The disk as the next boot finds it: what was synced, and of the rest any part.
    pub fn power_up(&self, faults: Vec<Fault>) -> Self {
        let mut state = self.state().clone();
        for change in std::mem::take(&mut state.pending) {
            if state.toss() {
                change.apply(&mut state.nodes, durable);
            }
        }
        for index in 0..state.nodes.len() {
            let roll = state.next_random();
            if let Some(node) = state.nodes.get_mut(index) {
                node.survive(roll);
            }
        }
        state.steps = 0;
        state.faults = faults;
        Self { state: Mutex::new(state) }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Node {
    /// Of bytes that were not synced, nothing, a part, zeros or all may be there.
    fn survive(&mut self, roll: u64) {
        match self {
            Node::Directory { now, durable } => *now = durable.clone(),
            Node::File { now, durable, cut_off } => {
                if now != durable {
                    // Appending and cutting off do not touch the bytes before; writing anew does.
                    let safe = match () {
                        () if now.starts_with(durable) => durable.len(),
                        () if *cut_off && durable.starts_with(now) => now.len(),
                        () => 0,
                    };
                    let cut = safe + usize::try_from(roll / 4).unwrap_or(0) % (now.len() - safe + 1);
                    *now = match roll % 4 {
                        0 => durable.clone(),
                        1 => now.get(..cut).unwrap_or_default().to_vec(),
                        2 => {
                            let zeros = |(i, byte): (usize, &u8)| if i < cut { *byte } else { 0 };
                            now.iter().enumerate().map(zeros).collect()
                        }
                        _ => std::mem::take(now),
                    };
                    *durable = now.clone();
                }
            }
        }
    }
}

impl State {
    fn next_random(&mut self) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random >> 8
    }

    fn toss(&mut self) -> bool {
        self.next_random().is_multiple_of(2)
    }

    /// Counts a step; `Err` where it is the one that fails. `writing` says that it needs space.
    fn step(&mut self, writing: bool) -> io::Result<()> {
        self.steps += 1;
        for fault in &self.faults {
            match *fault {
                Fault::PowerCut(at) if self.steps >= at => {
                    return Err(io::Error::other("the power is cut"));
                }
                Fault::Error(at) if self.steps == at => return Err(io::Error::other("input/output error")),
                Fault::Full(at) if self.steps >= at && writing => {
                    return Err(io::ErrorKind::StorageFull.into());
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn powered(&self) -> io::Result<()> {
        let cut = |fault: &Fault| matches!(*fault, Fault::PowerCut(at) if self.steps >= at);
        if self.faults.iter().any(cut) { Err(io::Error::other("the power is cut")) } else { Ok(()) }
    }

    fn find(&self, path: &Path) -> io::Result<Id> {
        let mut id = 0;
        for part in path.components() {
            let Component::Normal(name) = part else { continue };
            let Some(Node::Directory { now, .. }) = self.nodes.get(id) else {
                return Err(io::ErrorKind::NotADirectory.into());
            };
            let name = name.to_string_lossy();
            id = *now.get(name.as_ref()).ok_or(io::Error::from(io::ErrorKind::NotFound))?;
        }
        Ok(id)
    }

    /// The directory that holds `path`, and the name in it.
    fn place(&self, path: &Path) -> io::Result<(Id, String)> {
        let name = path.file_name().ok_or(io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok((self.find(path.parent().unwrap_or(Path::new("")))?, name.to_string_lossy().into_owned()))
    }

    fn change(&mut self, change: Change) {
        change.apply(&mut self.nodes, now);
        self.pending.push(change);
    }

    fn add(&mut self, path: &Path, node: Node) -> io::Result<Id> {
        let (directory, name) = self.place(path)?;
        self.nodes.push(node);
        let id = self.nodes.len() - 1;
        self.change(Change { from: None, to: Some((directory, name, id)) });
        Ok(id)
    }

    fn file(&mut self, id: Id) -> io::Result<(&mut Vec<u8>, &mut Vec<u8>)> {
        match self.nodes.get_mut(id) {
            Some(Node::File { now, durable, .. }) => Ok((now, durable)),
            _ => Err(io::ErrorKind::IsADirectory.into()),
        }
    }

    /// Changes a file's bytes, then syncs them; half the bytes are there where the change fails.
    fn put(&mut self, path: &Path, from: Option<usize>, bytes: &[u8]) -> io::Result<()> {
        let outcome = self.step(true);
        self.powered()?;
        let id = match self.find(path) {
            Ok(id) => id,
            Err(_) => self.add(path, Node::File { now: Vec::new(), durable: Vec::new(), cut_off: false })?,
        };
        let written = if outcome.is_ok() { bytes } else { bytes.get(..bytes.len() / 2).unwrap_or_default() };
        if let Some(Node::File { cut_off, .. }) = self.nodes.get_mut(id) {
            *cut_off = from.is_some_and(|length| length > 0) && bytes.is_empty();
        }
        let (now, _) = self.file(id)?;
        now.truncate(from.unwrap_or(now.len()));
        now.extend_from_slice(written);
        outcome?;
        self.step(false)?;
        let (now, durable) = self.file(id)?;
        durable.clone_from(now);
        Ok(())
    }
}

impl Disk for FakeDisk {
    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        let mut state = self.state();
        state.powered()?;
        let id = state.find(path)?;
        Ok(state.file(id)?.0.clone())
    }

    fn list(&self, directory: &Path) -> io::Result<Vec<Entry>> {
        let state = self.state();
        state.powered()?;
        let Some(Node::Directory { now, .. }) = state.nodes.get(state.find(directory)?) else {
            return Err(io::ErrorKind::NotADirectory.into());
        };
        let entry = |(name, id): (&String, &Id)| match state.nodes.get(*id) {
            Some(Node::File { now, .. }) => {
                Entry { name: name.clone(), is_dir: false, is_link: false, length: now.len() as u64 }
            }
            _ => Entry { name: name.clone(), is_dir: true, is_link: false, length: 0 },
        };
        Ok(now.iter().map(entry).collect())
    }

    fn exists(&self, path: &Path) -> bool {
        let state = self.state();
        state.powered().is_ok() && state.find(path).is_ok()
    }

    fn create_dir(&self, path: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.step(true)?;
        if state.find(path).is_ok() {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        let node = Node::Directory { now: BTreeMap::new(), durable: BTreeMap::new() };
        state.add(path, node).map(|_| ())
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
        state.step(false)?;
        let id = state.find(from)?;
        let (old, new) = (state.place(from)?, state.place(to)?);
        let target = state.find(to).ok().and_then(|id| state.nodes.get(id));
        if matches!(target, Some(Node::Directory { now, .. }) if !now.is_empty()) {
            return Err(io::ErrorKind::DirectoryNotEmpty.into());
        }
        state.change(Change { from: Some(old), to: Some((new.0, new.1, id)) });
        Ok(())
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.step(false)?;
        state.find(path)?;
        let place = state.place(path)?;
        state.change(Change { from: Some(place), to: None });
        Ok(())
    }

    fn remove_dir(&self, path: &Path) -> io::Result<()> {
        if !self.list(path)?.is_empty() {
            return Err(io::ErrorKind::DirectoryNotEmpty.into());
        }
        self.remove_file(path)
    }

    fn sync_dir(&self, directory: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.step(false)?;
        let id = state.find(directory)?;
        let all = std::mem::take(&mut state.pending);
        for change in all {
            if change.touches(id) {
                // A name that was taken away durably does not come back by an older change.
                let undone = |old: &Change| change.from.is_some() && old.put() == change.from;
                state.pending.retain(|old| !undone(old));
                change.apply(&mut state.nodes, durable);
            } else {
                state.pending.push(change);
            }
        }
        Ok(())
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
