//! Loops in wide registers: lanes and batches, elementary functions, and the choice of instruction set.

pub mod batch;
pub mod dispatch;
pub mod functions;
pub mod lanes;
