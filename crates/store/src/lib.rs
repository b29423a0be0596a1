//! Durable storage of frames and results: data that a call has acknowledged survives crashes, power cuts and full
//! disks.
//!
//! A store is one directory of plain files, and the only source of truth: everything kept in memory can be rebuilt
//! by scanning it. Frames and results are opaque bytes and JSON here. `docs/store.md` specifies the layout and the
//! invariants, `docs/store/durability.md` the order of every write, and [`verify`] checks all of it.
//!
//! ```
//! use std::sync::Arc;
//! use wingd_base::clock::Stamp;
//! use wingd_store::manifest::{SeriesCause, SeriesState, Shot};
//! use wingd_store::{NewFrame, RealDisk, SeriesPlan, Store, StoreConfig, verify};
//!
//! let folder = tempfile::tempdir()?;
//! let config = StoreConfig { reserve_mb: 0, ..StoreConfig::new(folder.path()) };
//! let (store, _recovery) = Store::open(Arc::new(RealDisk), config)?;
//!
//! // A series is open until it is closed; each frame is durable when `add_shot` returns.
//! let utc = "2026-03-01T08:00:00Z".parse()?;
//! let now = Stamp { utc, utc_synchronised: true, boot_id: "boot".into(), since_boot_s: 60.0 };
//! let (mut series, _) = store.begin_series(SeriesPlan { cause: SeriesCause::Scheduled, shots: 1 }, &now)?;
//! let shot = Shot { shot: 1, stamp: now.clone(), duration_s: None, exposure: None, frame: None, failures: vec![] };
//! let (format, settings) = (serde_json::json!("jpeg"), serde_json::Map::new());
//! series.add_shot(shot, Some(NewFrame { bytes: b"as delivered", extension: "jpg", format, settings }))?;
//! store.close_series(series, SeriesState::Complete, &now, vec![])?;
//!
//! assert!(folder.path().join("flights/f0001/s000001/0001.jpg").exists());
//! assert!(verify::verify_path(store.disk(), store.root()).is_sound());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Modules, lowest layer first; each uses only those before it: [`disk`] calls the file system, `format` encodes
//! and decodes files, `read` reads a store without a lock, `write` makes new data durable, `maintenance` verifies,
//! copies and prunes.

mod config;
pub mod disk;
mod format;
mod maintenance;
mod read;
mod write;

pub use config::{BootPolicy, StoreConfig};
pub use disk::owner::{Owner, service_owner};
pub use disk::{Disk, RealDisk, StoreError, StoreResult};
pub use format::columns::{LiveColumn, LiveRow, LiveTable, ValueKind};
pub use format::{Inputs, chain, columns, jsonl, layout, manifest, result_summary, sha256_hex};
pub use maintenance::{prune, receive, verify};
pub use read::catalogue::{FlightRef, SeriesRef};
pub use read::frames::{FrameRef, read_frame, series_frames};
pub use read::{aircraft, bundle, catalogue, installations, live, manual_marks, result_sets};
pub use write::opening::random_id;
pub use write::opening::{is_vacant, unwritable_reason};
pub use write::recover::Recovery;
pub use write::series::{NewFrame, OpenSeries};
pub use write::signing;
pub use write::store::{SeriesPlan, Store};
