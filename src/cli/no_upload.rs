//! `wingd upload` in a program that was built without it, as the one on board is.

use std::ffi::OsString;

use super::{Done, Failure};

/// Not in this program: build it with `--features upload`.
#[derive(clap::Args)]
pub struct Args {
    /// Whatever is given
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _given: Vec<OsString>,
}

pub(super) fn run(_: &Args) -> Result<Done, Failure> {
    let how = "cargo build --release --locked --features upload";
    Err(Failure::Usage(format!(
        "this wingd was built without upload, as for on board; build it with `{how}`"
    )))
}
