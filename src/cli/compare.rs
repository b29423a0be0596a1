//! `wingd compare` says what changed between two solves of a store, or between two stores.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::stores::flights;
use super::{Done, Failure, print};
use crate::report::compare::{self, Change, Side, Summary};
use crate::report::grid::Grid;
use crate::report::number::{NONE, fields, fixed};
use crate::store::sets::{self, ResultSet, Sets};
use crate::store::{FlightRef, RealDisk};

/// What changed between two solves of a store, or between two stores.
#[derive(clap::Args)]
pub struct Args {
    /// The store
    store: PathBuf,
    /// Another store with the same frames; without it, two solves of the one are compared
    #[arg(value_name = "OTHER")]
    other: Option<PathBuf>,
    /// One flight, for example f0001 [default: all of them]
    #[arg(long)]
    flight: Option<String>,
    /// The old results, by the beginning of their inputs' key [default: the solve before the newest]
    #[arg(long, value_name = "KEY")]
    from: Option<String>,
    /// The new results [default: the newest solve]
    #[arg(long, value_name = "KEY")]
    to: Option<String>,
    /// One JSON object per frame
    #[arg(long)]
    json: bool,
    /// Every column of the tables, however wide [default: those that fit 80 characters]
    #[arg(long)]
    wide: bool,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let ours = flights(&args.store, args.flight.as_deref())?;
    let mut compared = 0;
    for flight in &ours {
        let Some((old, new)) = sides(args, flight)? else { continue };
        compared += 1;
        let changes = compare::changes(&RealDisk, &old, &new);
        show(args, &old, &new, &changes?)?;
    }
    if compared == 0 {
        let store = args.store.display();
        return Err(Failure::Failed(format!(
            "{store}: no flight has results of two inputs; `wingd solve {store}` adds some, or name another store"
        )));
    }
    Ok(Done::All)
}

/// The two sides; `None` where a flight has only one.
fn sides(args: &Args, flight: &FlightRef) -> Result<Option<(Side, Side)>, Failure> {
    let sets = sets::of_flight(&RealDisk, flight)?;
    if let Some(other) = &args.other {
        let Some(there) = there(other, flight)? else { return Ok(None) };
        let theirs = sets::of_flight(&RealDisk, &there)?;
        let old = chosen(&sets, args.from.as_deref(), flight)?;
        let new = chosen(&theirs, args.to.as_deref(), &there)?;
        let side = |(flight, set): (&FlightRef, Option<ResultSet>)| {
            set.map(|set| Side { flight: flight.clone(), set })
        };
        return Ok(side((flight, old)).zip(side((&there, new))));
    }
    let newest = |wanted: &Option<String>, from_end: usize| match wanted {
        Some(key) => chosen(&sets, Some(key), flight),
        None => Ok(sets.sets.iter().rev().nth(from_end).cloned()),
    };
    let (old, new) = (newest(&args.from, 1)?, newest(&args.to, 0)?);
    let side = |set| Side { flight: flight.clone(), set };
    Ok(old.zip(new).map(|(old, new)| (side(old), side(new))))
}

fn there(other: &Path, flight: &FlightRef) -> Result<Option<FlightRef>, Failure> {
    Ok(flights(other, None)?.into_iter().find(|there| there.id == flight.id))
}

fn chosen(sets: &Sets, wanted: Option<&str>, flight: &FlightRef) -> Result<Option<ResultSet>, Failure> {
    let found = sets.chosen(wanted).cloned();
    if let (None, Some(key)) = (&found, wanted) {
        let known: Vec<String> = sets.sets.iter().map(ResultSet::text).collect();
        let (flight, known) = (&flight.id, known.join(", "));
        return Err(Failure::Failed(format!("{flight}: no results have the key {key}; there are: {known}")));
    }
    Ok(found)
}

fn show(args: &Args, old: &Side, new: &Side, changes: &[Change]) -> Result<(), Failure> {
    if args.json {
        for change in changes {
            let mut line = fields(&json!({"flight": new.flight.id, "from": old.set.key, "to": new.set.key}));
            line.extend(fields(change));
            print(&json!(line).to_string())?;
        }
        return Ok(());
    }
    print(&format!("Flight {}: from {}, to {}", new.flight.id, old.set.text(), new.set.text()))?;
    for (name, was, is) in compare::inputs(&old.set, &new.set) {
        print(&format!("  {name}: {was} -> {is}"))?;
    }
    print(table(changes).text_at(args.wide).trim_end())?;
    print(&summary(&Summary::of(changes)))
}

fn table(changes: &[Change]) -> Grid {
    let largest = |c: &Change| c.marker.as_ref().map(|(id, m)| format!("{id} {}", fixed(Some(*m), 4)));
    Grid::each(changes).columns(&[
        ("<frame", &|c| format!("{}/{}", c.series, c.frame)),
        ("~<status", &|c| c.status_text()),
        ("tip deflection / m", &|c| fixed(c.tip_deflection_m.0, 4)),
        ("now / m", &|c| fixed(c.tip_deflection_m.1, 4)),
        ("change / m", &|c| fixed(c.change_m, 4)),
        ("sigma / m", &|c| fixed(c.sigma_m, 4)),
        ("change / sigma", &|c| fixed(c.change_sigmas, 2)),
        ("largest of a marker / m", &|c| largest(c).unwrap_or_else(|| NONE.to_owned())),
    ])
}

fn summary(s: &Summary) -> String {
    format!(
        "{} frames with a tip deflection (against the survey) on both sides: largest change {} m ({} sigma), root mean square {} m; \
         {} solved now and not before, {} before and not now; {} frames on one side only",
        s.both,
        fixed(s.largest_m, 4),
        fixed(s.largest_sigmas, 2),
        fixed(s.root_mean_square_m, 4),
        s.gained,
        s.lost,
        s.one_side
    )
}
