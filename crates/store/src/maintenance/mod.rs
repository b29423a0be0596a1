//! Maintenance of a store: verification, copies, upgrade, and deletion of flights that are stored elsewhere.

pub mod prune;
pub mod receive;
pub(crate) mod upgrade;
pub mod verify;
