//! `wingd aircraft-data` adds a table of the aircraft's own data to a recorded flight, or lists or withdraws such sources.

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::aircraft_table::{QuantityFrames, TableImport, count_frames_by_source};
use wingd_base::clock::{Clock, SystemClock};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line, print_notes};
use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::inputs::stored_flights::{open_store, select_flights};
use wingd_evaluation::number::count_text;
use wingd_evaluation::results::aircraft;
use wingd_evaluation::results::aircraft::{AircraftSource, Withdrawal};
use wingd_store::{FlightRef, RealDisk};

/// Add a table of the aircraft's own data to a flight; its lines are kept unchanged, in addition to existing sources.
#[derive(clap::Args)]
pub struct AircraftDataArgs {
    /// Store
    store: PathBuf,
    /// Table: CSV with a column utc and columns named as quantities (docs/aircraft-data.md), or lines of IWG1
    #[arg(required_unless_present_any = ["list", "withdraw"], conflicts_with_all = ["list", "withdraw"])]
    table: Option<PathBuf>,
    /// Flight, for example f0001
    #[arg(long)]
    flight: String,
    /// List the flight's sources of aircraft data, and the number of frames that use each
    #[arg(long, conflicts_with = "withdraw")]
    list: bool,
    /// Stop using a source, by its number in --list; its data stay in the flight
    #[arg(long, value_name = "SOURCE")]
    withdraw: Option<usize>,
    /// Print one JSON object: flight, source, lines, read, repeated, frames, quantities; with --list flight,
    /// sources
    #[arg(long)]
    json: bool,
}

/// Imports a table of aircraft data into a flight, lists its sources, or withdraws one.
pub(super) fn run(args: &AircraftDataArgs) -> TaskResult<Completion> {
    let found = select_flights(&args.store, Some(&args.flight))?;
    let flight = found
        .first()
        .ok_or_else(|| Failure::Failed(format!("there is no flight {}", args.flight)))?;
    match (args.withdraw, &args.table) {
        (Some(source), _) => withdraw_source(args, flight, source),
        (None, Some(table)) => import_table(args, flight, table),
        _ => list_sources(args, flight),
    }
}

/// Imports a table; exit status 1 if a quantity has no frame, or a line no time.
fn import_table(
    args: &AircraftDataArgs,
    flight: &FlightRef,
    file: &Path,
) -> TaskResult<Completion> {
    let import = TableImport::read(&args.store, flight, file)?;
    if import.no_value_because.is_none() {
        import.store_lines(&open_store(&args.store)?.0, flight, file)?;
    }
    print_line(&if args.json {
        import_json(flight, &import)
    } else {
        import_text(flight, &import)
    })?;
    let unread = &import.contents.unread;
    print_notes(unread.first().map(|(line, tag)| {
        format!(
            "{} lines without a time, first line {line} (\"{tag}\")",
            unread.len()
        )
    }));
    if let Some(cause) = import.no_value_because {
        let flight = &flight.id;
        let what =
            format!("the table gives no frame of {flight} a value, so nothing was stored: {cause}");
        return Err(Failure::Failed(what));
    }
    print_notes(import.empty_columns());
    let complete = unread.is_empty() && import.quantities.iter().all(|r| r.frames > 0);
    Ok(Completion::from_success(complete))
}

fn import_json(flight: &FlightRef, import: &TableImport) -> String {
    let quantity = |reached: &QuantityFrames| {
        let QuantityFrames { tally, .. } = reached;
        json!({
            "quantity": tally.quantity.name(),
            "values": tally.values,
            "invalid": tally.invalid,
            "frames": reached.frames,
        })
    };
    json!({
        "flight": flight.id,
        "source": import.no_value_because.is_none().then_some(import.source),
        "lines": import.table.lines.len(),
        "read": import.contents.timed,
        "repeated": import.repeated,
        "frames": import.frames,
        "quantities": import.quantities.iter().map(quantity).collect::<Vec<_>>(),
        "reason": import.no_value_because,
    })
    .to_string()
}

fn import_text(flight: &FlightRef, import: &TableImport) -> String {
    let as_source = match import.no_value_because {
        None => format!("stored as source {}", import.source),
        Some(_) => "not stored".into(),
    };
    let (lines, read) = (import.table.lines.len(), import.contents.timed);
    let mut text = format!(
        "{}: {lines} lines {as_source}, {read} with a time, {} repeated",
        flight.id, import.repeated
    );
    for reached in &import.quantities {
        let QuantityFrames { tally, frames, .. } = reached;
        text += &format!("\n  {}: {} values", tally.quantity.name(), tally.values);
        if tally.invalid > 0 {
            text += &format!(", {} invalid", tally.invalid);
        }
        text += &format!("; {frames} of {} frames", import.frames);
    }
    text
}

fn list_sources(args: &AircraftDataArgs, flight: &FlightRef) -> TaskResult<Completion> {
    let (disk, root) = (&RealDisk, &args.store);
    let (sources, _) = aircraft::read_sources(disk, root, flight)?;
    let (track, notes) = aircraft::read_track(disk, root, flight)?;
    print_notes(notes);
    let frames = aircraft::read_frame_times(disk, flight)?;
    let counts = count_frames_by_source(&track, &frames);
    let quantities_of = |source: &AircraftSource| -> Vec<(Quantity, usize)> {
        counts
            .iter()
            .filter(|((n, _), _)| *n == source.number)
            .map(|((_, q), frames)| (*q, *frames))
            .collect()
    };
    if args.json {
        let one = |source: &AircraftSource| {
            let quantity =
                |(q, frames): (Quantity, usize)| json!({"quantity": q.name(), "frames": frames});
            json!({
                "source": source.number,
                "name": source.name(),
                "lines": source.lines.len(),
                "withdrawn": source.withdrawn,
                "quantities": quantities_of(source).into_iter().map(quantity).collect::<Vec<_>>(),
            })
        };
        let sources: Vec<_> = sources.iter().map(one).collect();
        print_json(&json!({"flight": flight.id, "frames": frames.len(), "sources": sources}))?;
        return Ok(Completion::All);
    }
    let (frames, number) = (
        count_text(frames.len(), "frame"),
        count_text(sources.len(), "source"),
    );
    print_line(&format!(
        "{}: {frames}, {number} of aircraft data",
        flight.id
    ))?;
    for source in &sources {
        let counts: Vec<String> = quantities_of(source)
            .iter()
            .map(|(q, n)| format!("{} {}", q.name(), count_text(*n, "frame")))
            .collect();
        let state = match (source.withdrawn, counts.is_empty()) {
            (Some(at), _) => format!("withdrawn {at:.0}"),
            (None, true) => "not used by any frame".to_owned(),
            (None, false) => counts.join(", "),
        };
        let lines = count_text(source.lines.len(), "line");
        print_line(&format!(
            "{:>3}  {}  {lines}  {state}",
            source.number,
            source.name()
        ))?;
    }
    Ok(Completion::All)
}

fn withdraw_source(
    args: &AircraftDataArgs,
    flight: &FlightRef,
    number: usize,
) -> TaskResult<Completion> {
    let (store, _) = open_store(&args.store)?;
    let (sources, _) = aircraft::read_sources(store.disk(), store.root(), flight)?;
    let name = match sources.iter().find(|source| source.number == number) {
        None => {
            let known = format!(
                "{} has {} sources of aircraft data",
                flight.id,
                sources.len()
            );
            return Err(Failure::Failed(format!(
                "there is no source {number}: {known}; see --list"
            )));
        }
        Some(source) if source.withdrawn.is_some() => {
            return Err(Failure::Failed(format!(
                "source {number} is already withdrawn; see --list"
            )));
        }
        Some(source) => source.name(),
    };
    let withdrawal = Withdrawal {
        withdraws: number,
        at: SystemClock::new().stamp().utc,
    };
    let head = serde_json::to_value(withdrawal).map_err(Failure::from_error)?;
    store.add_aircraft_lines_to(&flight.id, &head, &[])?;
    store.close_aircraft_file()?;
    print_line(&match args.json {
        true => json!({"flight": flight.id, "withdrawn": number}).to_string(),
        false => format!(
            "{}: source {number} ({name}) is no longer used; run `wingd solve {} --flight {}` for results without it",
            flight.id,
            args.store.display(),
            flight.id
        ),
    })?;
    Ok(Completion::All)
}
