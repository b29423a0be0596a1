//! Maintenance of a store: verification, copies, and deletion of flights that are stored elsewhere.

pub mod prune;
pub mod receive;
pub mod verify;
