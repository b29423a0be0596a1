//! `wingd export` writes a store's results for other tools.

mod live;
mod series;
mod shape;
mod sink;

use std::path::PathBuf;

use clap::ValueEnum;

use self::shape::export_shapes;
use self::sink::{ExportEnd, write_output, write_rows};
use crate::export;
use crate::export::ExportContext;
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::print_notes;
use wingd_evaluation::quantities::ResultTable;
use wingd_evaluation::record::TorsionRecord;
use wingd_evaluation::results::source;
use wingd_evaluation::results::source::ResultChoice;
use wingd_evaluation::results::{ReportData, SeriesData, distinct_values};
use wingd_store::{RealDisk, catalogue, layout, result_summary};

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum FormatName {
    /// Table with a header line
    Csv,
    /// The same table with typed columns and times as UTC timestamps
    Parquet,
    /// A JSON object per shot, with its complete record
    Jsonl,
    /// Arrays of the joint shape with its covariance (xarray, MATLAB)
    Netcdf,
}

/// Export a store's results for other tools.
#[derive(clap::Args)]
pub struct ExportArgs {
    /// Store
    store: PathBuf,
    /// Format of the output
    #[arg(long, value_enum)]
    format: FormatName,
    /// Rows of csv and parquet output
    #[arg(long, value_enum, default_value = "markers", default_value_ifs = [("format", "csv", "summary"), ("format", "netcdf", "shape")])]
    table: ResultTable,
    /// Stations of the shape as fractions of the length to the tip [default: those of the curves, and the tip]
    #[arg(long, value_name = "ETA,ETA", value_delimiter = ',')]
    eta: Option<Vec<f64>>,
    /// Write the factors of the covariance with all sources, in double precision [default: the sources that carry 99.99 % of
    /// the variance, in single precision]
    #[arg(long)]
    full_factors: bool,
    /// Flight, for example f0001 [default: all flights]
    #[arg(long)]
    flight: Option<String>,
    /// Results to use if a flight was solved with several inputs: first characters of their key [default: newest complete
    /// solve]
    #[arg(long, value_name = "KEY")]
    inputs: Option<String>,
    /// Installation, for the shape [default: the one kept in the store]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Output file [default: standard output for csv and jsonl, export.parquet]
    #[arg(long, short, value_name = "PATH")]
    output: Option<PathBuf>,
}

impl ExportArgs {
    fn result_choice(&self) -> ResultChoice<'_> {
        ResultChoice {
            flight: self.flight.as_deref(),
            inputs: self.inputs.as_deref(),
        }
    }
}

/// Exports results of a flight, of all flights or of live mode as a file of the chosen format.
pub(super) fn run(args: &ExportArgs) -> TaskResult<Completion> {
    let is_array = args.format == FormatName::Netcdf;
    let is_series = args.table == ResultTable::Series;
    let remedy = if is_array != (args.table == ResultTable::Shape) {
        Some("--table shape needs --format netcdf, which has no other table")
    } else if is_series && args.format == FormatName::Jsonl {
        Some("--table series needs --format csv or parquet")
    } else if args.eta.is_some() && !is_array && !is_series {
        Some("--eta is for --table shape and series")
    } else {
        let remedy = "--full-factors is for --format netcdf; omit it";
        Some(remedy).filter(|_| args.full_factors && !is_array)
    };
    if let Some(remedy) = remedy {
        return Err(Failure::Usage(remedy.into()));
    }
    let data = match args.format {
        FormatName::Netcdf => return export_shapes(args),
        _ if is_series => return series::export_series(args),
        _ if args.table == ResultTable::Live => return live::export_live_results(args),
        FormatName::Csv | FormatName::Parquet => export_rows(args)?,
        FormatName::Jsonl => export_jsonl(args)?,
    };
    print_notes(data.warnings.iter().chain(&data.notes));
    Ok(Completion::from_success(data.notes.is_empty()))
}

/// Collects the facts common to all rows. The names of torsion pairs need a first pass through the results.
fn read_common_facts(args: &ExportArgs) -> TaskResult<ExportContext> {
    let mut names: Vec<String> = Vec::new();
    for flight in source::selected_flights(&args.store, args.flight.as_deref())? {
        for series in catalogue::list_series(&RealDisk, &flight)? {
            // Damaged files are reported when their rows are read.
            let _ = catalogue::for_each_line(
                &RealDisk,
                &series.folder.join(layout::RESULTS_FILE),
                |_, line| {
                    let head = result_summary::parse_summary(line, &["torsion"]);
                    let torsion = head
                        .and_then(|head| head.record.into_values().next())
                        .map(serde_json::from_value);
                    let torsion: Vec<TorsionRecord> =
                        torsion.and_then(Result::ok).unwrap_or_default();
                    let known = std::mem::take(&mut names);
                    names = distinct_values(
                        known
                            .into_iter()
                            .chain(torsion.into_iter().map(|pair| pair.name)),
                    );
                },
            );
        }
    }
    Ok(ExportContext {
        store_id: catalogue::store_id(&RealDisk, &args.store),
        pairs: names,
    })
}

/// Exports a table, series by series.
fn export_rows(args: &ExportArgs) -> TaskResult<ReportData> {
    let common = read_common_facts(args)?;
    let empty = export::table_columns(args.table, &SeriesData::default(), &common);
    write_rows(args, empty, |rows| {
        source::for_each_series(&args.store, args.result_choice(), |series| {
            rows.add(export::table_columns(args.table, &series, &common))
                .map_err(ExportEnd::from)
        })
    })
}

fn export_jsonl(args: &ExportArgs) -> TaskResult<ReportData> {
    let id = catalogue::store_id(&RealDisk, &args.store);
    write_output(args, |output| {
        source::for_each_series(&args.store, args.result_choice(), |series| {
            export::write_json_lines(output, &series, id.as_deref()).map_err(ExportEnd::from)
        })
    })
}
