//! Current and durable state of simulated files and directories, and the steps between them.

use std::collections::BTreeMap;
use std::io;
use std::path::{Component, Path};

use super::content::FileContent;

/// Index of a file or directory in [`DiskState::nodes`].
pub(super) type NodeId = usize;

/// Failure of the simulated disk, with the step at which it happens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DiskFault {
    /// Nothing reaches the disk from this step on, and every call fails.
    PowerCut(u64),
    /// Only this step fails: a write is half done, a sync gives up its bytes, any other call has no effect.
    Error(u64),
    /// This step is done but reported as failed.
    FailedAfterwards(u64),
    /// The disk is full from this step on.
    Full(u64),
    /// Syncs are acknowledged but not done from this step on. No store survives this; it shows that a test would detect it.
    IgnoredSyncs(u64),
}

#[derive(Clone)]
pub(super) struct DiskState {
    pub nodes: Vec<DiskNode>,
    /// Name changes that are not durable yet, in order.
    pub pending: Vec<NameChange>,
    pub steps: u64,
    pub faults: Vec<DiskFault>,
    pub free: u64,
}

impl Default for DiskState {
    fn default() -> Self {
        Self {
            nodes: vec![DiskNode::Directory(DirectoryNames::default())],
            pending: Vec::new(),
            steps: 0,
            faults: Vec::new(),
            free: u64::MAX,
        }
    }
}

#[derive(Clone)]
pub(super) enum DiskNode {
    File(FileContent),
    Directory(DirectoryNames),
}

/// Entries of a directory, by name.
#[derive(Clone, Default)]
pub(super) struct DirectoryNames {
    /// Visible to callers.
    pub current: BTreeMap<String, NodeId>,
    /// State on the medium.
    pub durable: BTreeMap<String, NodeId>,
}

/// Change of directory entries.
#[derive(Clone, Debug)]
pub(super) struct NameChange {
    /// Removed entry: directory and name.
    pub from: Option<(NodeId, String)>,
    /// New entry: directory, name and node.
    pub to: Option<(NodeId, String, NodeId)>,
}

impl NameChange {
    /// Returns whether the change affects a directory.
    pub fn touches(&self, directory: NodeId) -> bool {
        self.from.as_ref().is_some_and(|(id, _)| *id == directory)
            || self.to.as_ref().is_some_and(|(id, _, _)| *id == directory)
    }

    /// Directory and name of the new entry.
    pub fn target_name(&self) -> Option<(NodeId, String)> {
        self.to
            .as_ref()
            .map(|(directory, name, _)| (*directory, name.clone()))
    }

    /// Applies the change to the current or the durable entries, as selected by `side`.
    pub fn apply(
        &self,
        nodes: &mut [DiskNode],
        side: fn(&mut DirectoryNames) -> &mut BTreeMap<String, NodeId>,
    ) {
        if let Some((directory, name)) = &self.from
            && let Some(DiskNode::Directory(names)) = nodes.get_mut(*directory)
        {
            side(names).remove(name);
        }
        if let Some((directory, name, id)) = &self.to
            && let Some(DiskNode::Directory(names)) = nodes.get_mut(*directory)
        {
            side(names).insert(name.clone(), *id);
        }
    }
}

impl DiskState {
    /// Counts a step. `Err`: the step is not done. `Ok(Err)`: it is done but reported as failed. `writing` marks a step
    /// that needs space.
    pub fn begin_step(&mut self, writing: bool) -> io::Result<io::Result<()>> {
        self.steps += 1;
        let broken = || io::Error::other("input/output error");
        for fault in &self.faults {
            match *fault {
                DiskFault::PowerCut(at) if self.steps >= at => {
                    return Err(io::Error::other("the power is cut"));
                }
                DiskFault::Error(at) if self.steps == at => return Err(broken()),
                DiskFault::FailedAfterwards(at) if self.steps == at => return Ok(Err(broken())),
                DiskFault::Full(at) if self.steps >= at && writing => {
                    return Err(io::ErrorKind::StorageFull.into());
                }
                _ => {}
            }
        }
        Ok(Ok(()))
    }

    /// Returns whether syncs have no effect at this step.
    pub fn ignores_syncs(&self) -> bool {
        self.faults
            .iter()
            .any(|fault| matches!(*fault, DiskFault::IgnoredSyncs(at) if self.steps >= at))
    }

    /// Returns an error if the power is cut at this step.
    pub fn check_power(&self) -> io::Result<()> {
        let cut = |fault: &DiskFault| matches!(*fault, DiskFault::PowerCut(at) if self.steps >= at);
        if self.faults.iter().any(cut) {
            Err(io::Error::other("the power is cut"))
        } else {
            Ok(())
        }
    }

    /// Finds the node of a path.
    pub fn find_node(&self, path: &Path) -> io::Result<NodeId> {
        let mut id = 0;
        for part in path.components() {
            let Component::Normal(name) = part else {
                continue;
            };
            let Some(DiskNode::Directory(names)) = self.nodes.get(id) else {
                return Err(io::ErrorKind::NotADirectory.into());
            };
            let name = name.to_string_lossy();
            id = *names
                .current
                .get(name.as_ref())
                .ok_or(io::Error::from(io::ErrorKind::NotFound))?;
        }
        Ok(id)
    }

    /// Returns the parent directory of `path` and the name in it.
    pub fn parent_and_name(&self, path: &Path) -> io::Result<(NodeId, String)> {
        let name = path
            .file_name()
            .ok_or(io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok((
            self.find_node(path.parent().unwrap_or(Path::new("")))?,
            name.to_string_lossy().into_owned(),
        ))
    }

    /// Applies a change of names that is not yet durable.
    pub fn apply_change(&mut self, change: NameChange) {
        change.apply(&mut self.nodes, |names| &mut names.current);
        self.pending.push(change);
    }

    /// Adds a node at a path.
    pub fn add_node(&mut self, path: &Path, node: DiskNode) -> io::Result<NodeId> {
        let (directory, name) = self.parent_and_name(path)?;
        self.nodes.push(node);
        let id = self.nodes.len() - 1;
        self.apply_change(NameChange {
            from: None,
            to: Some((directory, name, id)),
        });
        Ok(id)
    }

    /// Returns the content of a file.
    pub fn file_mut(&mut self, id: NodeId) -> io::Result<&mut FileContent> {
        match self.nodes.get_mut(id) {
            Some(DiskNode::File(content)) => Ok(content),
            _ => Err(io::ErrorKind::IsADirectory.into()),
        }
    }

    /// Changes the content of a file, then syncs it; if the change fails, half of the bytes are written.
    pub fn write_file(&mut self, path: &Path, from: Option<usize>, bytes: &[u8]) -> io::Result<()> {
        let outcome = self.begin_step(from.is_none_or(|length| length == 0));
        self.check_power()?;
        let id = match self.find_node(path) {
            Ok(id) => id,
            Err(_) => self.add_node(path, DiskNode::File(FileContent::default()))?,
        };
        let (written, outcome) = match outcome {
            Ok(late) => (bytes, late),
            Err(error) => (bytes.get(..bytes.len() / 2).unwrap_or_default(), Err(error)),
        };
        self.file_mut(id)?.write_at(from, written);
        outcome?;
        let outcome = self.begin_step(false);
        if self.ignores_syncs() {
            return Ok(());
        }
        match outcome {
            Ok(late) => {
                self.file_mut(id)?.sync();
                late
            }
            Err(error) => {
                self.file_mut(id)?.fail_sync();
                Err(error)
            }
        }
    }
}
