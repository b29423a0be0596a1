//! The program `wingd`: runs a command and returns its exit status.

use std::process::ExitCode;

fn main() -> ExitCode {
    wingd::cli::main()
}
