//! `wingd aircraft-data --list`: the sources of a flight.

use std::collections::BTreeMap;

use serde_json::json;

use super::{Args, Done, Failure, print, undone};
use crate::aircraft::{Quantity, Track};
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;
use crate::report::aircraft::{self, Source};
use crate::report::number::count;
use crate::store::{FlightRef, RealDisk};

/// Frames at which each source counts, by its number and the quantity.
pub(super) type Counts = BTreeMap<(usize, Quantity), usize>;

/// Of these frames.
pub(super) fn counts(track: &Track, frames: &[(Stamp, Option<Exposure>)]) -> Counts {
    let mut counts = BTreeMap::new();
    for (stamp, exposure) in frames {
        for (quantity, joined) in track.at(stamp, exposure.as_ref()) {
            *counts.entry((joined.source, quantity)).or_default() += 1;
        }
    }
    counts
}

pub(super) fn run(args: &Args, flight: &FlightRef) -> Result<Done, Failure> {
    let (disk, root) = (&RealDisk, &args.store);
    let (sources, _) = aircraft::sources(disk, root, flight).map_err(undone)?;
    let (track, notes) = aircraft::track(disk, root, flight).map_err(undone)?;
    notes.iter().for_each(|note| eprintln!("wingd: {note}"));
    let frames = aircraft::frames(disk, flight).map_err(undone)?;
    let counts = counts(&track, &frames);
    let of = |source: &Source| -> Vec<(Quantity, usize)> {
        counts
            .iter()
            .filter(|((n, _), _)| *n == source.number)
            .map(|((_, q), frames)| (*q, *frames))
            .collect()
    };
    if args.json {
        let one = |source: &Source| {
            let quantity = |(q, frames): (Quantity, usize)| json!({"quantity": q.name(), "frames": frames});
            json!({
                "source": source.number,
                "name": source.name(),
                "lines": source.lines.len(),
                "withdrawn": source.withdrawn,
                "quantities": of(source).into_iter().map(quantity).collect::<Vec<_>>(),
            })
        };
        let sources: Vec<_> = sources.iter().map(one).collect();
        print(&json!({"flight": flight.id, "frames": frames.len(), "sources": sources}).to_string())?;
        return Ok(Done::All);
    }
    let (number, from) = (count(frames.len(), "frame"), count(sources.len(), "source"));
    print(&format!("{}: {number}, {from} of aircraft data", flight.id))?;
    for source in &sources {
        let counts: Vec<String> =
            of(source).iter().map(|(q, n)| format!("{} {}", q.name(), count(*n, "frame"))).collect();
        let said = match (source.withdrawn, counts.is_empty()) {
            (Some(at), _) => format!("withdrawn {at:.0}"),
            (None, true) => "counts at no frame".to_owned(),
            (None, false) => counts.join(", "),
        };
        let lines = count(source.lines.len(), "line");
        print(&format!("{:>3}  {}  {lines}  {said}", source.number, source.name()))?;
    }
    Ok(Done::All)
}
