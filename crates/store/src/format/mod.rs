//! Encoding and decoding of the store's files: names, lines, blocks, digests. No disk access.

pub mod aircraft;
pub(crate) mod append_file_kinds;
pub mod chain;
pub mod columns;
mod digest;
pub mod jsonl;
pub mod layout;
pub mod manifest;
pub(crate) mod manual_marks;
pub mod result_summary;
pub(crate) mod sums;

pub use digest::{Inputs, sha256_hex};
