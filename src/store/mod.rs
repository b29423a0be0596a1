//! Safe keeping: layout, commit, recovery, verification, space. docs/store.md states the invariants.
//!
//! One directory is the only truth; what is kept in memory can be rebuilt by scanning. The store
//! knows frames and results as bytes and JSON, not what they mean.
//!
//! Folders, lowest first; each uses only those before it: [`disk`] calls the file system, `format` reads and writes
//! bytes, `read` finds what is there without a lock, `write` makes what is new durable, `care` checks, copies and deletes.

mod care;
mod config;
pub mod disk;
mod format;
mod read;
mod write;

pub use care::upgrade::upgrade;
pub use care::{prune, receive, verify};
pub use config::{AtBoot, StoreConfig};
pub use disk::{Disk, RealDisk, StoreError, fake};
pub use format::columns::{Column, Kind, LiveTable, Row};
pub use format::{Inputs, chain, columns, heads, jsonl, layout, manifest, sha256};
pub use read::catalogue::{FlightRef, SeriesRef};
pub use read::frames::{FrameRef, frames, read_frame};
pub use read::{aircraft, bundle, catalogue, installations, live, sets};
pub use write::opening::{is_vacant, unwritable};
pub use write::recover::Recovery;
pub use write::series::{NewFrame, OpenSeries};
pub use write::signing;
pub use write::store::{Plan, Store};
