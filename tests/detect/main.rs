//! Promises of detection, rendering and calibration.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod background;
mod bad_light;
mod board_accuracy;
mod board_cases;
mod board_pane;
mod calibration;
#[path = "../common/mod.rs"]
mod common;
mod decals;
mod dirt;
mod fixtures;
mod glare;
mod guided;
mod installation_guided;
mod jpeg_kinds;
mod motion;
mod near;
mod paint;
mod points;
mod render_truth;
mod robustness;
mod second_pass;
mod sharpened;
mod sweep;
