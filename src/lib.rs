//! `wingd`: the shape of a wing in flight, measured with one camera at a cabin window.
//!
//! The layers, lowest first. A module imports only from layers below its own, and modules of one
//! layer do not know each other (`tests/layers.rs` keeps this).
//!
//! | layer | modules | subject |
//! |---|---|---|
//! | 1 | [`measure`] | pure: pixels and surveys in, deflection out |
//! | 2 | [`installation`], [`clock`], [`record`] | the prepared directory; time; the result as written |
//! | 3 | [`aircraft`] | the aircraft's own data, joined by time tag |
//! | 4 | [`camera`], [`store`] | shots; safe keeping |
//! | 5 | [`pipeline`] | from frame bytes and an installation to a record |
//! | 6 | [`report`], [`daemon`] | figures and tables; the recorder |
//! | 7 | [`http`], `upload` | read-only download page; flights into an object store (a feature) |
//! | 8 | [`config`] | composes every module's own section |
//! | 9 | [`cli`] | one file per command |

pub mod aircraft;
pub mod camera;
pub mod cli;
pub mod clock;
pub mod config;
pub mod daemon;
pub mod http;
pub mod installation;
pub mod measure;
pub mod pipeline;
pub mod record;
pub mod report;
pub mod store;
#[cfg(feature = "upload")]
pub mod upload;
