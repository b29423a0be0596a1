//! Changes to a store, each step made durable in its order (docs/store/durability.md).
//!
//! Recovery is part of this: it finishes an interrupted write with the same steps, and runs at every opening.

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
