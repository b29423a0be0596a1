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
//! # Crates
//!
//! | crate | subject |
//! |---|---|
//! | [`measure`] | pure: pixels and surveys in, shapes out |
//! | [`base`] | clock, faults of the user's files, text, output of commands |
//! | [`store`] | flights on disk |
//! | [`evaluation`] | installation, record, aircraft data, pipeline, numbers, tables, figures |
//! | [`pages`] | read-only pages of a store and of a running recorder |
//! | `desk` | commands of the workstation |
//! | this one | the program: [`camera`], [`daemon`], [`config`], [`cli`] |

#[macro_use]
pub extern crate wingd_base as base;
pub use wingd_base::clock;
#[cfg(feature = "desk")]
pub use wingd_desk as desk;
pub use wingd_evaluation as evaluation;
pub use wingd_evaluation::{aircraft, installation, pipeline, quantities, record};
pub use wingd_measure as measure;
pub use wingd_pages as pages;
pub use wingd_store as store;

pub mod camera;
pub mod cli;
pub mod config;
pub mod daemon;
