//! Keeping a store: checked against its invariants, copied, upgraded, and its flights deleted once they are elsewhere.

pub mod prune;
pub mod receive;
pub(crate) mod upgrade;
pub mod verify;
