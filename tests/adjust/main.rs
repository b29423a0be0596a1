//! Promises of orientation, identification, adjustment and planning, for wings that differ from the models.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

// The tables use more of these (tests/validation/tables).
#[allow(dead_code)]
mod aircraft;
mod aircraft_join;
mod budget;
mod builds;
#[path = "../common/mod.rs"]
mod common;
mod common_displacement;
mod coverage;
mod diagnosis;
#[allow(dead_code)]
mod effect_kinds;
mod flight;
mod flight_effect_cases;
mod identification;
mod image_scale;
mod joint_shape;
mod learning;
mod live;
mod live_start;
mod long_flights;
#[allow(dead_code)]
mod modes;
mod mountings;
mod plan;
mod profile_figures;
mod spatial;
mod stress;
mod systematic;
mod variance_components;
mod window;
mod wings_as_built;
