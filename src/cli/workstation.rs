//! The workstation's part of the program: commands, reports, downloads, plans. The on-board program has `on_board.rs` in
//! place of this file.

#[path = "demo.rs"]
mod demo;

use clap::Subcommand;

use wingd_base::failure::{Completion, TaskResult};
use wingd_base::listed_command::ListedCommand;
use wingd_desk::commands;
pub use wingd_desk::download::Download;
use wingd_evaluation::results::ReportBuilder;
use wingd_measure::plan::{NarrowWidth, find_narrow_widths};
use wingd_measure::setup::Setup;

/// Builder of reports.
pub const REPORT_BUILDER: Option<ReportBuilder> = Some(wingd_desk::report::REPORT_BUILDER);

// Only one value exists per run: its size does not matter.
#[allow(clippy::large_enum_variant)]
/// Commands of the workstation and the demonstration.
#[derive(Subcommand)]
pub enum DeskCommand {
    #[command(flatten)]
    Demo(DemoCommand),
    #[command(flatten)]
    Desk(commands::DeskCommand),
}

commands! {
    DemoCommand()
    /// Run a bundled flight through the real recorder
    Demo(demo::DemoArgs) => demo::run, Utility ["wingd demo --output demo"];
}

/// Lists the commands of the workstation.
pub fn listed_commands() -> Vec<ListedCommand> {
    [commands::DeskCommand::LISTED, DemoCommand::LISTED].concat()
}

/// Runs a command of the workstation.
pub fn run(command: &DeskCommand) -> TaskResult<Completion> {
    match command {
        DeskCommand::Demo(command) => command.run(),
        DeskCommand::Desk(command) => command.run(),
    }
}

/// Describes the prior standard deviations of a setup that are smaller than images support.
pub fn describe_small_priors(setup: &Setup) -> Vec<String> {
    let describe = |narrow: NarrowWidth| {
        let NarrowWidth {
            key,
            unit,
            values,
            tip_sigmas_m,
        } = narrow;
        let [given_mm, default_mm] = tip_sigmas_m.map(|sigma_m| 1e3 * sigma_m);
        format!(
            "{key} = {} (default {} {unit}). With the default, the tip sigma of one frame is {default_mm:.0} mm instead of \
             {given_mm:.0} mm. Keep your value only if a measurement supports it",
            values[0], values[1]
        )
    };
    find_narrow_widths(setup)
        .into_iter()
        .map(describe)
        .collect()
}
