//! Files and directories as they are seen and as they are on the medium, and the steps between the two.

use std::collections::BTreeMap;
use std::io;
use std::path::{Component, Path};

use super::content::Content;

/// Place of a file or directory in [`State::nodes`].
pub(super) type Id = usize;

/// What goes wrong, and when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// From this step on, nothing reaches the disk and every call fails.
    PowerCut(u64),
    /// This step alone fails: a write half done, a sync with its bytes given up, the rest undone.
    Error(u64),
    /// This step is done, and reported as failed.
    Late(u64),
    /// From this step on the disk is full.
    Full(u64),
    /// Syncs are answered and not done, from this step on: a medium that lies. Nothing survives this;
    /// it shows that a test would notice.
    Lies(u64),
}

#[derive(Clone)]
pub(super) struct State {
    pub nodes: Vec<Node>,
    /// Changes of names that are not durable yet, in order.
    pub pending: Vec<Change>,
    pub steps: u64,
    pub faults: Vec<Fault>,
    pub free: u64,
}

impl Default for State {
    fn default() -> Self {
        Self {
            nodes: vec![Node::Directory(Names::default())],
            pending: Vec::new(),
            steps: 0,
            faults: Vec::new(),
            free: u64::MAX,
        }
    }
}

#[derive(Clone)]
pub(super) enum Node {
    File(Content),
    Directory(Names),
}

/// What a directory holds, by name.
#[derive(Clone, Default)]
pub(super) struct Names {
    /// As it is seen.
    pub now: BTreeMap<String, Id>,
    /// As it is on the medium.
    pub durable: BTreeMap<String, Id>,
}

/// A change of names.
#[derive(Clone, Debug)]
pub(super) struct Change {
    /// Taken away, where it was.
    pub from: Option<(Id, String)>,
    /// Put in place.
    pub to: Option<(Id, String, Id)>,
}

impl Change {
    pub fn touches(&self, directory: Id) -> bool {
        self.from.as_ref().is_some_and(|(id, _)| *id == directory)
            || self.to.as_ref().is_some_and(|(id, _, _)| *id == directory)
    }

    /// The place that it fills.
    pub fn put(&self) -> Option<(Id, String)> {
        self.to.as_ref().map(|(directory, name, _)| (*directory, name.clone()))
    }

    /// In one of the two states of the directories.
    pub fn apply(&self, nodes: &mut [Node], side: fn(&mut Names) -> &mut BTreeMap<String, Id>) {
        if let Some((directory, name)) = &self.from
            && let Some(Node::Directory(names)) = nodes.get_mut(*directory)
        {
            side(names).remove(name);
        }
        if let Some((directory, name, id)) = &self.to
            && let Some(Node::Directory(names)) = nodes.get_mut(*directory)
        {
            side(names).insert(name.clone(), *id);
        }
    }
}

impl State {
    /// Counts a step. `Err`: it is not done. `Ok(Err)`: it is done, and reported as failed. `writing`
    /// says that it needs space.
    pub fn step(&mut self, writing: bool) -> io::Result<io::Result<()>> {
        self.steps += 1;
        let broken = || io::Error::other("input/output error");
        for fault in &self.faults {
            match *fault {
                Fault::PowerCut(at) if self.steps >= at => {
                    return Err(io::Error::other("the power is cut"));
                }
                Fault::Error(at) if self.steps == at => return Err(broken()),
                Fault::Late(at) if self.steps == at => return Ok(Err(broken())),
                Fault::Full(at) if self.steps >= at && writing => {
                    return Err(io::ErrorKind::StorageFull.into());
                }
                _ => {}
            }
        }
        Ok(Ok(()))
    }

    pub fn lies(&self) -> bool {
        self.faults.iter().any(|fault| matches!(*fault, Fault::Lies(at) if self.steps >= at))
    }

    pub fn powered(&self) -> io::Result<()> {
        let cut = |fault: &Fault| matches!(*fault, Fault::PowerCut(at) if self.steps >= at);
        if self.faults.iter().any(cut) { Err(io::Error::other("the power is cut")) } else { Ok(()) }
    }

    pub fn find(&self, path: &Path) -> io::Result<Id> {
        let mut id = 0;
        for part in path.components() {
            let Component::Normal(name) = part else { continue };
            let Some(Node::Directory(names)) = self.nodes.get(id) else {
                return Err(io::ErrorKind::NotADirectory.into());
            };
            let name = name.to_string_lossy();
            id = *names.now.get(name.as_ref()).ok_or(io::Error::from(io::ErrorKind::NotFound))?;
        }
        Ok(id)
    }

    /// The directory that holds `path`, and the name in it.
    pub fn place(&self, path: &Path) -> io::Result<(Id, String)> {
        let name = path.file_name().ok_or(io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok((self.find(path.parent().unwrap_or(Path::new("")))?, name.to_string_lossy().into_owned()))
    }

    pub fn change(&mut self, change: Change) {
        change.apply(&mut self.nodes, |names| &mut names.now);
        self.pending.push(change);
    }

    pub fn add(&mut self, path: &Path, node: Node) -> io::Result<Id> {
        let (directory, name) = self.place(path)?;
        self.nodes.push(node);
        let id = self.nodes.len() - 1;
        self.change(Change { from: None, to: Some((directory, name, id)) });
        Ok(id)
    }

    pub fn file(&mut self, id: Id) -> io::Result<&mut Content> {
        match self.nodes.get_mut(id) {
            Some(Node::File(content)) => Ok(content),
            _ => Err(io::ErrorKind::IsADirectory.into()),
        }
    }

    /// Changes a file's bytes, then syncs them; half the bytes are there where the change fails.
    pub fn put(&mut self, path: &Path, from: Option<usize>, bytes: &[u8]) -> io::Result<()> {
        let outcome = self.step(from.is_none_or(|length| length == 0));
        self.powered()?;
        let id = match self.find(path) {
            Ok(id) => id,
            Err(_) => self.add(path, Node::File(Content::default()))?,
        };
        let (written, outcome) = match outcome {
            Ok(late) => (bytes, late),
            Err(error) => (bytes.get(..bytes.len() / 2).unwrap_or_default(), Err(error)),
        };
        self.file(id)?.put(from, written);
        outcome?;
        let outcome = self.step(false);
        if self.lies() {
            return Ok(());
        }
        match outcome {
            Ok(late) => {
                self.file(id)?.sync();
                late
            }
            Err(error) => {
                self.file(id)?.sync_failed();
                Err(error)
            }
        }
    }
}
