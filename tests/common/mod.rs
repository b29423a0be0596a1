//! Simulated worlds with known truth and small stores, shared by tests and benches; each uses a part.
#![allow(
    dead_code,
    unused_imports,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic
)]

pub mod attitude;
pub mod beam_truth;
pub mod disc_image;
pub mod drawn;
pub mod fake_disk;
pub mod random;
pub mod report_store;
pub mod shape_difference;
pub mod statistics;
pub mod store_reading;
pub mod store_work;
pub mod synthetic;
