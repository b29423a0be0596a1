//! The recorder takes scheduled series and, in live mode, frames between them. It makes each frame durable, has it solved,
//! reports its state, and shuts down in order.
//!
//! | thread | task | waits for |
//! |---|---|---|
//! | recorder | schedule, series, store | the clock, commands, the camera up to its hard limit |
//! | camera | calls of the driver | the hardware; abandoned if it does not return |
//! | processing | solves the frames that the store lists as unsolved | the end of a series, the solver up to its deadline |
//! | solver | one frame; abandoned if it does not return | |
//! | power | watches the supply | |
//! | aircraft-feed, aircraft-store | aircraft data | the feed; the disk |
//! | live, live-solver, live-store, live-frames | frames between the series ([`live`]) | see [`live`] |
//! | main | signals, the status socket, the service manager | all of these |
//!
//! A file uses only files of the rows above its own:
//!
//! | files | subject |
//! |---|---|
//! | `schedule`, `config`, `shutdown`, `command`, `watchdog`, `memory`, `radios`, `endpoint`, `tcp_keepalive`, `event`, `solver` | basic types: times, durations, commands, events |
//! | `status` | the state in words and numbers, and the only definition of health |
//! | `core`, `worker`, `budget` | objects shared by all threads; calls on a thread with a deadline, abandoned and counted; limits of data with a lower priority than series |
//! | `capture` | the camera, with the checks of each frame and its time of exposure |
//! | `frame_storage`, `event_log` | storing frames and reporting their events |
//! | `aircraft`, `live`, `processing` | tasks that run in parallel to the series |
//! | `recorder`, `power`, `socket` | the series, the supply, queries from outside |
//! | `run` | starts and ends the threads |

mod aircraft;
mod budget;
mod capture;
mod command;
mod config;
mod core;
mod endpoint;
mod event;
mod event_log;
mod frame_storage;
pub mod live;
pub mod memory;
pub mod power;
mod processing;
pub mod radios;
mod recorder;
mod run;
pub mod schedule;
mod shutdown;
mod socket;
mod solver;
mod status;
mod watchdog;
mod worker;

pub use aircraft::AircraftConfig;
pub use config::SeriesConfig;
pub use endpoint::occupied_socket_reason;
pub use event::{Event, Observer};
pub use live::LiveConfig;
pub use power::PowerConfig;
pub use run::{DaemonError, DaemonParts, run};
pub use schedule::Align;
pub use socket::{StatusConfig, query_daemon};
pub use solver::{FrameSolver, FrameTracker, FrameTrackerFactory, Solver, SolverSource};
pub use status::{
    Activity, AircraftStatus, CameraStatus, Counts, DaemonStatus, FaultNote, Health, LiveStatus,
    RecentShares, StatusBoard, StoreStatus, format_span,
};
pub(crate) use status::{PAGE_PART, SOLVER_PART};
