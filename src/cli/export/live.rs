//! `wingd export --table live` goes block by block, so that an hour of results takes no more memory than a minute.

use serde_json::Value;

use super::sink::{Notes, Sink, Stop, ended};
use super::{Args, FormatName, recorder_notes};
use crate::cli::copy::bar;
use crate::cli::{Done, Failure};
use crate::report::export::{LiveColumns, LiveFacts};
use crate::report::{aircraft, source};
use crate::store::{FlightRef, Inputs, LiveTable, RealDisk, StoreError, catalogue, live};

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    usage(args)?;
    let flights = source::chosen(&args.store, args.flight.as_deref())?;
    let (mut tables, mut bytes) = (Vec::new(), 0);
    for flight in &flights {
        live::each_file(&RealDisk, &args.store, flight, |file| {
            bytes += file.length() as u64;
            if !tables.contains(&file.head.table) {
                tables.push(file.head.table);
            }
            Result::<usize, StoreError>::Ok(0)
        })?;
    }
    if tables.is_empty() {
        let what = format!(
            "{}: there are no live results; [live] in the configuration makes some",
            args.store.display()
        );
        return Err(Failure::Failed(what));
    }
    let store_id = catalogue::store_id(&RealDisk, &args.store);
    let columns = LiveColumns::of(&tables, store_id.clone());
    let bar = bar(bytes, "live results");
    let mut notes = Vec::new();
    let mut empty = columns.empty();
    empty.extend(LiveFacts::empty());
    let sink = Sink::begin(args, empty, || Ok(notes_of(&tables, store_id.as_deref())));
    let outcome = sink.and_then(|mut sink| {
        flights.iter().try_for_each(|flight| {
            notes.extend(write(args, flight, &columns, &mut sink, |bytes| bar.inc(bytes))?);
            Result::<(), Stop>::Ok(())
        })?;
        sink.end(args)
    });
    bar.finish_and_clear();
    ended(args, outcome)?;
    notes.iter().for_each(|note| eprintln!("wingd: {note}"));
    Ok(Done::all(notes.is_empty()))
}

/// Who recorded, and what the results follow from, by the key in column `inputs`.
fn notes_of(tables: &[LiveTable], store_id: Option<&str>) -> Notes {
    let mut notes = recorder_notes(store_id);
    for table in tables {
        let Some(inputs) = table.source.get(live::names::PROVENANCE).and_then(Value::as_object) else {
            continue;
        };
        let key = Inputs::new(inputs.clone()).key("");
        let note = (format!("inputs {key}"), Value::from(inputs.clone()).to_string());
        if !notes.contains(&note) {
            notes.push(note);
        }
    }
    notes
}

/// A flight's rows; what is to be said of its files comes back.
fn write(
    args: &Args,
    flight: &FlightRef,
    columns: &LiveColumns,
    sink: &mut Sink,
    read: impl Fn(u64),
) -> Result<Vec<String>, Stop> {
    let (track, mut notes) = aircraft::track(&RealDisk, &args.store, flight)?;
    let facts = LiveFacts { track };
    let files = live::each_file(&RealDisk, &args.store, flight, |mut file| {
        read(file.length() as u64);
        let head = file.head.clone();
        while let Some(block) = file.next_block() {
            match columns.rows(&head, &block) {
                Some(mut rows) => {
                    rows.extend(facts.rows(&head, &block));
                    sink.add(args, rows)?;
                }
                None => return Ok(file.torn().max(1)),
            }
        }
        Result::<usize, Stop>::Ok(file.torn())
    })?;
    notes.extend(files);
    Ok(notes)
}

fn usage(args: &Args) -> Result<(), Failure> {
    let wrong = match args.format {
        FormatName::Vtk => {
            Some("--format vtk has shapes of frames; take csv, parquet or jsonl for live results")
        }
        _ if args.inputs.is_some() => Some("--inputs: live results are not solved again; leave it out"),
        _ => args.installation.is_some().then_some("--installation is for vtk alone; leave it out"),
    };
    wrong.map_or(Ok(()), |what| Err(Failure::Usage(what.to_owned())))
}
