//! `wingd` measures the shape of a wing in flight with one camera at a cabin window.
//!
//! A prepared directory, the *installation*, describes the camera and the surveyed positions of the markers on the wing.
//! Images of the wing on the ground give the camera's attitude. From then on each image in flight gives the deflection and
//! twist of the wing, every number with its standard deviation. The program `wingd` is this library with a command line
//! ([`cli`]); `docs/reference/cli.md` lists the interfaces that scripts can rely on.
//!
//! Example from the files of an aircraft to the deflection of the wing tip:
//!
//! ```
//! use std::path::Path;
//! use wingd::measure::identify;
//! use wingd::measure::setup::Orientation;
//! use wingd::{installation, pipeline};
//!
//! let dev = Path::new("fixtures/dev");
//! let mut wing = installation::load(&dev.join("installation")).expect("every error names file, key and remedy");
//!
//! // The attitude, from an image on the ground.
//! let ground = std::fs::read(dev.join("frames/ground.jpg"))?;
//! let (seen, _) = pipeline::stages::detect_only("ground.jpg", &ground, None);
//! let frames = [seen.detections.markers];
//! let fit = identify::estimate_orientation(&wing.setup, &frames)?;
//! let ground = fit.ground_observations(&wing.setup, &frames);
//! wing.orientation = Some(Orientation { ground, ..fit.orientation });
//!
//! // The wing, from an image in flight, rendered with the outermost marker 2.615 m above its position on the ground.
//! let flight = std::fs::read(dev.join("frames/flight-1.jpg"))?;
//! let job = pipeline::SolveJob::default();
//! let result = pipeline::solve_frame("flight-1.jpg", &flight, None, &wing, wing.require_orientation()?, &job);
//! let tip = result.tip.expect("if a frame cannot be solved, the record has a reason");
//! let sigma_m = tip.sigma_deflection_m.expect("deflection is estimated, not fixed");
//! assert!((tip.deflection_m - 2.615).abs() < 4.0 * sigma_m, "{} m, sigma {sigma_m} m", tip.deflection_m);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Layers
//!
//! The layers, lowest first. A module imports only from layers below its own, and modules of one
//! layer do not import each other (`tests/layers.rs` checks this).
//!
//! | layer | modules | subject |
//! |---|---|---|
//! | 1 | [`measure`] | pure: pixels and surveys in, deflection out |
//! | 2 | [`installation`], [`clock`], [`record`] | installation directory; time; the written result |
//! | 3 | [`aircraft`], [`exchange`] | the aircraft's own data, assigned by time tag; camera and board files of other programs |
//! | 4 | [`camera`], [`store`] | shots; durable storage |
//! | 5 | [`pipeline`] | from frame bytes and an installation to a record |
//! | 6 | [`quantities`] | the quantities of the results, from which tables and live rows follow |
//! | 7 | [`report`], [`daemon`] | figures and tables; the recorder daemon |
//! | 8 | [`http`], `upload` | read-only download page; upload of flights to an object store (a feature) |
//! | 9 | [`config`] | configuration, composed of the modules' sections |
//! | 10 | [`desk`] | work beside the recorder: import, calibration, plans, learning, load evaluation, simulation |
//! | 11 | [`cli`] | one file per command: arguments, words, exit status |

pub use wingd_measure as measure;

pub mod aircraft;
pub mod camera;
pub mod cli;
pub mod clock;
pub mod config;
pub mod daemon;
pub mod desk;
pub mod exchange;
pub mod http;
pub mod installation;
pub mod pipeline;
pub mod quantities;
pub mod record;
pub mod report;
pub mod store;
#[cfg(feature = "upload")]
pub mod upload;
