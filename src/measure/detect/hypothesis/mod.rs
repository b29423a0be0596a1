//! What may be a marker, with what is known of it beforehand.

pub mod candidate;
pub mod neighbours;
pub mod prior;
