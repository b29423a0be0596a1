//! The store's files as bytes and values: names, lines, blocks, digests. Nothing here touches a disk.

pub mod aircraft;
pub mod chain;
pub mod columns;
mod digest;
pub mod jsonl;
pub(crate) mod kinds;
pub mod layout;
pub mod manifest;
pub(crate) mod marks;
pub mod result_summary;
pub(crate) mod sums;

pub use digest::{Inputs, sha256};
