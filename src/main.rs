//! argv -> command -> exit status.

use std::process::ExitCode;

fn main() -> ExitCode {
    wingd::cli::main()
}
