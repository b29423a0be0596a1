//! Hypotheses from blobs, complete or hidden, blurred or cut.

pub mod blurred_quadrants;
pub mod decal_cut;
pub mod gather;
pub mod glare_cut;
pub mod moments;
pub mod options;
pub mod quadrant_edges;
pub mod quadrant_outline;
pub mod reduced;
