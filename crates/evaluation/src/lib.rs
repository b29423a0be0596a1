//! What board and workstation both need to evaluate frames: the installation, the record, aircraft data, the pipeline from
//! a frame's bytes to a record, and the numbers, tables and figures of results.
//!
//! It does not know the recorder, the pages and the commands of the workstation. `README.md` lists where to begin.

#[macro_use]
extern crate wingd_base;

pub mod aircraft;
pub mod boards;
pub mod exif;
pub mod figures;
pub mod frame_format;
pub mod grid;
pub mod inputs;
pub mod installation;
pub mod number;
pub mod pipeline;
pub mod quantities;
pub mod record;
pub mod results;
