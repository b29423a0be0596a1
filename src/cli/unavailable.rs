//! Stand-in for a command that this program was built without.

use std::ffi::OsString;

use super::{Completion, Failure};

/// Arguments of a command that is not in this build.
#[derive(clap::Args)]
pub struct UnavailableArgs {
    /// Any arguments
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _given: Vec<OsString>,
}

/// Returns the failure that names the cargo feature for `part`.
pub(super) fn refuse_command(part: &str, feature: &str) -> Result<Completion, Failure> {
    let how = format!("cargo build --release --locked --features {feature}");
    Err(Failure::Usage(format!("this wingd was built without {part}; build it with `{how}`")))
}
