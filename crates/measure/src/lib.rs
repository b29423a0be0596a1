//! Measurement as pure functions: pixels and surveys in, deflection out. No files, clocks, network or logs here.
//!
//! Units: metres, radians, pixels, kelvin; `f64`. Frames and symbols: `docs/conventions.md`.

pub mod adjust;
pub mod calibrate;
pub mod detect;
mod dispatch;
pub mod environment;
pub mod estimation;
pub mod geometry;
pub mod identify;
pub mod jpeg;
pub mod mount;
pub mod observation;
pub mod ordering;
pub mod plan;
pub mod points;
pub mod raster;
pub mod samples;
pub mod setup;
pub mod stress;
pub mod tiles;
mod uncertainty;
pub mod view;
pub mod widths;
