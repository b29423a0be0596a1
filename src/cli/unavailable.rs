//! Stand-ins for commands that this program was built without.

use std::ffi::OsString;

use super::{Completion, Failure};

/// Arguments of a command that is not in this build.
#[derive(clap::Args)]
pub struct UnavailableArgs {
    /// Any arguments
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _given: Vec<OsString>,
}

/// Declares a stand-in with the name of the command's module.
macro_rules! stand_in {
    ($module:ident, $args:ident, $part:literal, $feature:literal) => {
        #[cfg(not(feature = $feature))]
        pub(super) mod $module {
            use super::{Completion, Failure};

            pub use super::UnavailableArgs as $args;

            pub fn run(_: &$args) -> Result<Completion, Failure> {
                let how = concat!("cargo build --release --locked --features ", $feature);
                Err(Failure::Usage(format!(
                    "this wingd was built without {}; build it with `{how}`",
                    $part
                )))
            }
        }
    };
}

stand_in!(
    calibrate,
    CalibrateArgs,
    "calibrate, like the demonstration build",
    "boards"
);
stand_in!(
    upload,
    UploadArgs,
    "upload, like the on-board build",
    "upload"
);
