//! What changes a store: each step made durable in its order (docs/store/durability.md).
//!
//! Recovering belongs here: it finishes what a writer began, with the same steps, and every opening begins with it.

mod append_files;
pub(crate) mod chain;
pub(crate) mod evidence;
pub mod flight;
mod index;
pub(crate) mod installations;
pub(crate) mod opening;
pub(crate) mod recover;
pub(crate) mod results;
pub(crate) mod root;
mod segment;
pub(crate) mod series;
pub mod signing;
mod solving;
pub(crate) mod store;
