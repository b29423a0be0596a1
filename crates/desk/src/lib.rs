//! Work beside the recorder, on images and stores: calibration, plans, import, manual marks, learning, reports, exports,
//! downloads, with their commands.
//!
//! It does not know the recorder. `README.md` lists where to begin.

#[macro_use]
extern crate wingd_base;

pub mod aircraft_table;
#[cfg(feature = "boards")]
pub mod calibration;
pub mod commands;
pub mod compare;
pub mod download;
pub mod export;
pub mod flight_shape;
pub mod import;
pub mod learning;
pub mod mark;
pub mod plan;
pub mod report;
