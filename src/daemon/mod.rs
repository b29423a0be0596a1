//! The recorder: it takes series by a timetable and, in live mode, frames between them; it makes each frame durable and has
//! it solved; it says how it is and stops in good order.
//!
//! | thread | does | waits for |
//! |---|---|---|
//! | recorder | schedule, series, store | the clock, commands, the camera up to its hard limit |
//! | camera | the driver's calls | the hardware; given up where it does not return |
//! | processing | solves what the store says is unsolved | the end of a series, the solver up to its deadline |
//! | solver | one frame; given up where it does not return | |
//! | power | looks at the supply | |
//! | aircraft-feed, aircraft-store | the aircraft's data | the feed; the disk |
//! | live, live-solver, live-store, live-frames | frames between the series ([`live`]) | see there |
//! | main | signals, the status socket, the service manager | all of these |
//!
//! A file uses only those of the lines above its own:
//!
//! | files | subject |
//! |---|---|
//! | `schedule`, `config`, `halt`, `command`, `pulse`, `machine`, `endpoint`, `lasting`, `event`, `solver` | vocabulary: when, how long, what is asked, what is said |
//! | `status` | the state in words and numbers, and the one definition of health |
//! | `core`, `worker` | what all threads work with; a call on a thread, with a deadline, given up and counted |
//! | `capture` | the camera, and of each frame whether it is good and when it was exposed |
//! | `keep`, `notes` | a frame becomes a stored frame; what becomes of it is said |
//! | `aircraft`, `live`, `processing` | what happens beside the series |
//! | `recorder`, `power`, `socket` | the series, the supply, questions from outside |
//! | `run` | begins and ends the threads |

mod aircraft;
mod capture;
mod command;
mod config;
mod core;
mod endpoint;
mod event;
mod event_log;
mod frame_storage;
pub mod live;
pub mod machine;
pub mod power;
mod processing;
mod recorder;
mod run;
pub mod schedule;
mod shutdown;
mod socket;
mod solver;
mod status;
mod tcp_keepalive;
mod watchdog;
mod worker;

pub use aircraft::AircraftConfig;
pub use config::SeriesConfig;
pub use event::{Event, Observer};
pub use live::LiveConfig;
pub use power::PowerConfig;
pub use run::{DaemonError, Parts, run};
pub use schedule::Align;
pub use socket::{StatusConfig, ask};
pub use solver::{Solve, Solver, Track, Tracking};
pub use status::{
    Activity, AircraftStatus, CameraStatus, Counts, Health, LiveStatus, Noted, Recent, Status, StatusBoard,
    StoreStatus, span,
};
pub use tcp_keepalive::keep_alive;
