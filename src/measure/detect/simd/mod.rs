//! Loops in wide registers: numbers side by side, the functions that they need, and how the processor is asked.

pub mod batch;
pub mod dispatch;
pub mod functions;
pub mod lanes;
