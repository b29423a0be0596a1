//! `wingd compare` shows the differences between two solves of a store, or between two stores.

use std::path::PathBuf;

use serde_json::json;

use crate::compare;
use crate::compare::{ChangeSummary, ComparedFlight, FrameChange};
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

/// Compare the results of two solves of a store, or of two stores.
#[derive(clap::Args)]
pub struct CompareArgs {
    /// Store
    store: PathBuf,
    /// Second store with the same frames; without it, two solves of the first store are compared
    #[arg(value_name = "OTHER")]
    other: Option<PathBuf>,
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
        let Some((old, new)) = select_sides(args, flight)? else {
            continue;
        };
        compared += 1;
        let changes = compare::compare_frames(&RealDisk, &old, &new);
        print_comparison(args, &old, &new, &changes?)?;
    }
    if compared == 0 {
        let remedy = format!(
            "run `wingd solve {}` to add results, or name a second store",
            args.store.display()
        );
        let what = format!("no flight has results of two different inputs; {remedy}");
        return Err(Failure::from_path_error(&args.store, what));
    }
    Ok(Completion::All)
}

/// Selects the two result sets to compare; `None` if a flight has only one.
fn select_sides(
    args: &CompareArgs,
    flight: &FlightRef,
) -> TaskResult<Option<(ComparedFlight, ComparedFlight)>> {
    let sets = result_sets::flight_result_sets(&RealDisk, flight)?;
    if let Some(other) = &args.other {
        let there = select_flights(other, None)?
            .into_iter()
            .find(|there| there.id == flight.id);
        let Some(there) = there else { return Ok(None) };
        let theirs = result_sets::flight_result_sets(&RealDisk, &there)?;
        let old = select_result_set(&sets, args.from.as_deref(), flight)?;
        let new = select_result_set(&theirs, args.to.as_deref(), &there)?;
        let side = |(flight, set): (&FlightRef, Option<ResultSet>)| {
            set.map(|set| ComparedFlight {
                flight: flight.clone(),
                set,
            })
        };
        return Ok(side((flight, old)).zip(side((&there, new))));
    }
    let newest = |wanted: &Option<String>, from_end: usize| match wanted {
        Some(key) => select_result_set(&sets, Some(key), flight),
        None => Ok(sets.sets.iter().rev().nth(from_end).cloned()),
    };
    let (old, new) = (newest(&args.from, 1)?, newest(&args.to, 0)?);
    let side = |set| ComparedFlight {
        flight: flight.clone(),
        set,
    };
    Ok(old.zip(new).map(|(old, new)| (side(old), side(new))))
}

fn select_result_set(
    sets: &ResultSets,
    wanted: Option<&str>,
    flight: &FlightRef,
) -> TaskResult<Option<ResultSet>> {
    let found = sets.choose_set(wanted).cloned();
    if let (None, Some(key)) = (&found, wanted) {
        let known: Vec<String> = sets.sets.iter().map(ResultSet::description).collect();
        let (flight, known) = (&flight.id, known.join(", "));
        return Err(Failure::Failed(format!(
            "{flight}: no results with the key {key}; available: {known}"
        )));
    }
    Ok(found)
}

fn print_comparison(
    args: &CompareArgs,
    old: &ComparedFlight,
    new: &ComparedFlight,
    changes: &[FrameChange],
) -> TaskResult<()> {
    if args.json {
        for change in changes {
            let mut line = json_fields(
                &json!({"flight": new.flight.id, "from": old.set.key, "to": new.set.key}),
            );
            line.extend(json_fields(change));
            print_json(&line)?;
        }
        return Ok(());
    }
    print_line(&format!(
        "Flight {}: from {}, to {}",
        new.flight.id,
        old.set.description(),
        new.set.description()
    ))?;
    for (name, was, is) in compare::differing_inputs(&old.set, &new.set) {
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
