//! Promises of store, recorder, pages, reports and the command line, most of them through the real binary.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, missing_docs)]

mod aircraft_feed;
mod bad_input;
mod calibrate_command;
mod camera_mutations;
mod check_command;
#[path = "../common/mod.rs"]
mod common;
mod daemon_replay;
mod fixed_marks;
mod foreign_cameras;
mod foreign_tables;
mod http_access;
mod http_downloads;
mod http_fetch;
mod http_pages;
mod installation_faults;
mod installation_geometry;
mod kill9;
mod live;
mod live_page;
mod mount_check_command;
mod mutations;
mod other_pictures;
mod output;
mod pages;
mod phone_pictures;
mod plan_command;
mod power_fails;
mod power_of_the_seat;
mod program;
mod report_html;
mod same_verdict;
mod shipped_configuration;
mod solve_again;
mod store_copy;
mod store_durability;
mod store_evidence;
mod store_faults;
mod store_live;
mod store_live_figures;
mod store_speed;
mod store_verify;
mod survey_typo;
mod table_mutations;
mod thirty_hours;
