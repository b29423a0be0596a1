//! `wingd compare` shows the differences between two solves of a store.

use std::path::PathBuf;

use serde_json::json;

use crate::compare;
use crate::compare::{ChangeSummary, FrameChange};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line};
use wingd_evaluation::grid::ColumnDefinition::One;
use wingd_evaluation::grid::Grid;
use wingd_evaluation::inputs::stored_flights::select_flights;
use wingd_evaluation::number::{NONE, format_fixed};
use wingd_evaluation::record::json_fields;
use wingd_store::result_sets;
use wingd_store::result_sets::{ResultSet, ResultSets};
use wingd_store::{FlightRef, RealDisk};

/// Compare the results of two solves of a store.
#[derive(clap::Args)]
pub struct CompareArgs {
    /// Store
    store: PathBuf,
    /// Flight, for example f0001 [default: all flights]
    #[arg(long)]
    flight: Option<String>,
    /// Old results: first characters of their inputs key [default: the solve before the newest]
    #[arg(long, value_name = "KEY")]
    from: Option<String>,
    /// New results: first characters of their inputs key [default: the newest solve]
    #[arg(long, value_name = "KEY")]
    to: Option<String>,
    /// Print one JSON object per frame
    #[arg(long)]
    json: bool,
    /// Show all columns of the tables [default: those that fit 80 characters]
    #[arg(long)]
    wide: bool,
}

pub(super) fn run(args: &CompareArgs) -> TaskResult<Completion> {
    let ours = select_flights(&args.store, args.flight.as_deref())?;
    let mut compared = 0;
    for flight in &ours {
        let sets = result_sets::flight_result_sets(&RealDisk, flight)?;
        let old = select_result_set(&sets, args.from.as_deref(), 1, flight)?;
        let new = select_result_set(&sets, args.to.as_deref(), 0, flight)?;
        let Some((old, new)) = old.zip(new) else {
            continue;
        };
        compared += 1;
        let changes = compare::compare_frames(&RealDisk, flight, old, new)?;
        print_comparison(args, flight, (old, new), &changes)?;
    }
    if compared == 0 {
        let remedy = format!("run `wingd solve {}` to add results", args.store.display());
        let what = format!("no flight has results of two different inputs; {remedy}");
        return Err(Failure::from_path_error(&args.store, what));
    }
    Ok(Completion::All)
}

/// Selects the results whose key begins as wanted, or else those of the solve `from_end` before the newest.
fn select_result_set<'a>(
    sets: &'a ResultSets,
    wanted: Option<&str>,
    from_end: usize,
    flight: &FlightRef,
) -> TaskResult<Option<&'a ResultSet>> {
    let Some(key) = wanted else {
        return Ok(sets.sets.iter().rev().nth(from_end));
    };
    let found = sets.choose_set(wanted);
    found.map(Some).ok_or_else(|| {
        let known: Vec<String> = sets.sets.iter().map(ResultSet::description).collect();
        let (flight, known) = (&flight.id, known.join(", "));
        Failure::Failed(format!(
            "{flight}: no results with the key {key}; available: {known}"
        ))
    })
}

fn print_comparison(
    args: &CompareArgs,
    flight: &FlightRef,
    (old, new): (&ResultSet, &ResultSet),
    changes: &[FrameChange],
) -> TaskResult<()> {
    if args.json {
        for change in changes {
            let mut line =
                json_fields(&json!({"flight": flight.id, "from": old.key, "to": new.key}));
            line.extend(json_fields(change));
            print_json(&line)?;
        }
        return Ok(());
    }
    print_line(&format!(
        "Flight {}: from {}, to {}",
        flight.id,
        old.description(),
        new.description()
    ))?;
    for (name, was, is) in compare::differing_inputs(old, new) {
        print_line(&format!("  {name}: {was} -> {is}"))?;
    }
    print_line(change_table(changes).text_with_width(args.wide).trim_end())?;
    print_line(&summary_text(&ChangeSummary::from_changes(changes)))
}

fn change_table(changes: &[FrameChange]) -> Grid {
    let largest = |c: &FrameChange| {
        c.marker
            .as_ref()
            .map(|(id, m)| format!("{id} {}", format_fixed(Some(*m), 4)))
    };
    Grid::for_rows(changes).columns(&[
        One("<frame", &|c| format!("{}/{}", c.series, c.frame)),
        One("~<status", &|c| c.status_text()),
        One("tip deflection / m", &|c| {
            format_fixed(c.tip_deflection_m.0, 4)
        }),
        One("now / m", &|c| format_fixed(c.tip_deflection_m.1, 4)),
        One("change / m", &|c| format_fixed(c.change_m, 4)),
        One("sigma / m", &|c| format_fixed(c.sigma_m, 4)),
        One("change / sigma", &|c| format_fixed(c.change_sigmas, 2)),
        One("largest marker change / m", &|c| {
            largest(c).unwrap_or_else(|| NONE.to_owned())
        }),
    ])
}

fn summary_text(s: &ChangeSummary) -> String {
    format!(
        "{} frames with a tip deflection (relative to the survey) on both sides: largest change {} m ({} sigma), root mean square {} m; \
         {} solved only now, {} solved only before; {} frames on one side only",
        s.both,
        format_fixed(s.largest_m, 4),
        format_fixed(s.largest_sigmas, 2),
        format_fixed(s.root_mean_square_m, 4),
        s.gained,
        s.lost,
        s.one_side
    )
}
