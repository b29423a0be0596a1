//! Safe keeping of frames and results: what a call has acknowledged survives crashes, power cuts and full disks.
//!
//! A store is one directory of plain files, and the only truth; what is kept in memory can be rebuilt by scanning it.
//! Frames and results are bytes and JSON here, whatever they mean. `docs/store.md` states the layout and the invariants,
//! `docs/store/durability.md` the order of every write, and [`verify`] checks all of it.
//!
//! ```
//! use std::sync::Arc;
//! use wingd::clock::Stamp;
//! use wingd::store::manifest::{Cause, Shot, State};
//! use wingd::store::{NewFrame, Plan, RealDisk, Store, StoreConfig, verify};
//!
//! let folder = tempfile::tempdir()?;
//! let config = StoreConfig { reserve_mb: 0, ..StoreConfig::at(folder.path()) };
//! let (store, _recovery) = Store::open(Arc::new(RealDisk), config)?;
//!
//! // A series is under way until it is closed; each frame is durable when `add_shot` returns.
//! let utc = "2026-03-01T08:00:00Z".parse()?;
//! let now = Stamp { utc, utc_synchronised: true, boot_id: "boot".into(), since_boot_s: 60.0 };
//! let (mut series, _) = store.begin_series(Plan { cause: Cause::Scheduled, shots: 1 }, &now)?;
//! let shot = Shot { shot: 1, stamp: now.clone(), duration_s: None, exposure: None, frame: None, failures: vec![] };
//! let (format, settings) = (serde_json::json!("jpeg"), serde_json::Map::new());
//! series.add_shot(shot, Some(NewFrame { bytes: b"as delivered", extension: "jpg", format, settings }))?;
//! store.close_series(series, State::Complete, &now, vec![])?;
//!
//! assert!(folder.path().join("flights/f0001/s000001/0001.jpg").exists());
//! assert!(verify::verify(store.disk(), store.root()).is_sound());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
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
pub use format::{Inputs, chain, columns, jsonl, layout, manifest, result_summary, sha256};
pub use read::catalogue::{FlightRef, SeriesRef};
pub use read::frames::{FrameRef, frames, read_frame};
pub use read::{aircraft, bundle, catalogue, installations, live, marks, sets};
pub use write::opening::{is_vacant, unwritable};
pub use write::recover::Recovery;
pub use write::series::{NewFrame, OpenSeries};
pub use write::signing;
pub use write::store::{Plan, Store};
