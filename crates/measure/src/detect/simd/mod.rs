//! Loops in wide registers: lanes and batches, and elementary functions.

pub mod batch;
pub mod functions;
pub mod lanes;
