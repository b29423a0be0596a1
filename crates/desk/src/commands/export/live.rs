//! `wingd export --table live` reads block by block, so that memory does not grow with the length of a recording.

use super::ExportArgs;
use super::sink::{ExportEnd, write_rows};
use crate::export::{LiveColumns, RowWriter};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{byte_progress, print_notes};
use wingd_evaluation::results::{aircraft, source};
use wingd_store::{FlightRef, RealDisk, StoreError, catalogue, live};

pub(super) fn export_live_results(args: &ExportArgs) -> TaskResult<Completion> {
    check_live_options(args)?;
    let flights = source::selected_flights(&args.store, args.flight.as_deref())?;
    let (mut tables, mut bytes) = (Vec::new(), 0);
    for flight in &flights {
        live::for_each_live_file(&RealDisk, &args.store, flight, |file| {
            bytes += file.length() as u64;
            if !tables.contains(&file.head.table) {
                tables.push(file.head.table);
            }
            Result::<usize, StoreError>::Ok(0)
        })?;
    }
    if tables.is_empty() {
        let what = "no live results; enable [live] in the configuration to record them";
        return Err(Failure::from_path_error(&args.store, what));
    }
    let store_id = catalogue::store_id(&RealDisk, &args.store);
    let columns = LiveColumns::from_tables(&tables, store_id);
    let bar = byte_progress(bytes, "live results");
    let written = write_rows(args, columns.empty_columns(), |rows| {
        let mut notes = Vec::new();
        for flight in &flights {
            let read = |bytes| bar.inc(bytes);
            notes.extend(write_flight_rows(args, flight, &columns, rows, read)?);
        }
        Ok(notes)
    });
    bar.finish_and_clear();
    let notes = written?;
    print_notes(&notes);
    Ok(Completion::from_success(notes.is_empty()))
}

/// Writes a flight's rows and returns notes on its files.
fn write_flight_rows(
    args: &ExportArgs,
    flight: &FlightRef,
    columns: &LiveColumns,
    sink: &mut dyn RowWriter,
    read: impl Fn(u64),
) -> Result<Vec<String>, ExportEnd> {
    let (track, mut notes) = aircraft::read_track(&RealDisk, &args.store, flight)?;
    let files = live::for_each_live_file(&RealDisk, &args.store, flight, |mut file| {
        read(file.length() as u64);
        let head = file.head.clone();
        while let Some(block) = file.next_block() {
            match columns.block_columns(&head, &block, &track) {
                Some(rows) => sink.add(rows)?,
                None => return Ok(file.torn_length().max(1)),
            }
        }
        Result::<usize, ExportEnd>::Ok(file.torn_length())
    })?;
    notes.extend(files);
    Ok(notes)
}

fn check_live_options(args: &ExportArgs) -> TaskResult<()> {
    if args.inputs.is_some() || args.installation.is_some() {
        let what = "--inputs and --installation cannot be used with live results, which are never solved again; omit them";
        return Err(Failure::Usage(what.to_owned()));
    }
    Ok(())
}
