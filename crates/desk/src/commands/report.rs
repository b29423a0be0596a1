//! `wingd report` writes a flight's figures and tables as one HTML file.

use std::path::PathBuf;

use serde_json::{Value, json};

use crate::report as html;
use wingd_base::failure::{Completion, TaskResult};
use wingd_base::output::{print_json, print_line, print_notes, write_output};
use wingd_evaluation::inputs::default_paths::load_setup;
use wingd_evaluation::inputs::stopping::run_long_task;
use wingd_evaluation::record::variant_name;
use wingd_evaluation::results::source;
use wingd_evaluation::results::source::ResultChoice;
use wingd_evaluation::results::summary::SeriesSummary;
use wingd_evaluation::results::{ReportData, summary, table};

/// Write a flight's figures and tables as one HTML file.
#[derive(clap::Args)]
pub struct ReportArgs {
    /// Store
    store: PathBuf,
    /// Flight, for example f0001 [default: the newest]
    #[arg(long)]
    flight: Option<String>,
    /// Results to use if a flight was solved with several inputs: first characters of their key [default: newest complete
    /// solve]
    #[arg(long, value_name = "KEY")]
    inputs: Option<String>,
    /// Installation, for the ground shape [default: the one kept in the store]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Number of frames shown as images, those with warnings first; each adds about 200 kB to the page
    #[arg(long, value_name = "COUNT", default_value_t = source::DEFAULT_PICTURES)]
    pictures: usize,
    /// Text in the head of the page, for example --field author="A. Engineer"; can be given several times
    #[arg(long, value_name = "NAME=TEXT", value_parser = parse_field)]
    field: Vec<(String, String)>,
    /// Show all columns of the table [default: those that fit 80 characters]
    #[arg(long)]
    wide: bool,
    /// Print one JSON object per series instead of the table
    #[arg(long)]
    json: bool,
    /// File for the page
    #[arg(long, short, value_name = "FILE", default_value = "report.html")]
    output: PathBuf,
}

pub(super) fn run(args: &ReportArgs) -> TaskResult<Completion> {
    let setup = load_setup(args.installation.as_deref())?;
    let choice = ResultChoice {
        flight: args.flight.as_deref(),
        inputs: args.inputs.as_deref(),
    };
    let mut data = run_long_task("reading the store", || {
        source::read_flight_with_pictures(&args.store, choice, setup.as_ref(), args.pictures)
    })?;
    data.fields.clone_from(&args.field);
    print_notes(data.warnings.iter().chain(&data.notes));
    let page = run_long_task("writing the report", || html::report_page(&data));
    write_output(&args.output, page, OTHER_OUTPUT)?;
    if args.json {
        print_series_json(&data)?;
    } else {
        let summaries = summary::summarise_series(&data.series);
        print_line(table::series_text(&summaries, args.wide).trim_end())?;
        print_line(&format!("\nReport: {}", args.output.display()))?;
    }
    Ok(Completion::from_success(data.notes.is_empty()))
}

fn print_series_json(data: &ReportData) -> TaskResult<()> {
    let summaries = summary::summarise_series(&data.series);
    let lines = data.series.iter().zip(&summaries);
    lines
        .map(|(series, summary)| series_json(&series.flight, summary))
        .try_for_each(|line| print_json(&line))
}

fn series_json(flight: &str, series: &SeriesSummary) -> Value {
    let mean = series.tip_deflection_m;
    json!({
        "flight": flight, "series": series.name, "start": series.begun.as_ref().map(|begun| begun.utc),
        "frames": series.shots, "solved": series.solved,
        "reference": variant_name(series.reference),
        "tip_deflection_m": mean.map(|mean| mean.value),
        "sigma_tip_deflection_m": mean.and_then(|mean| mean.sigma),
        "scatter_m": mean.and_then(|mean| mean.scatter),
        "tests_passed": series.tests_passed, "tests_made": series.tests_made,
    })
}

fn parse_field(text: &str) -> Result<(String, String), String> {
    let (name, value) = text.split_once('=').ok_or("write NAME=TEXT")?;
    Ok((name.trim().to_owned(), value.trim().to_owned()))
}

/// Remedy for a page that cannot be written.
const OTHER_OUTPUT: &str = "choose another file with --output";
