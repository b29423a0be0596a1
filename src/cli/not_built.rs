//! A command that this program was built without.

use std::ffi::OsString;

use super::{Done, Failure};

/// Not in this program.
#[derive(clap::Args)]
pub struct Args {
    /// Whatever is given
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _given: Vec<OsString>,
}

/// Says which feature brings `part`.
pub(super) fn refused(part: &str, feature: &str) -> Result<Done, Failure> {
    let how = format!("cargo build --release --locked --features {feature}");
    Err(Failure::Usage(format!("this wingd was built without {part}; build it with `{how}`")))
}
