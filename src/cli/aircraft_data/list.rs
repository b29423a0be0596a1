//! `wingd aircraft-data --list` lists the aircraft data sources of a flight.

use std::collections::BTreeMap;

use serde_json::json;

use super::{AircraftDataArgs, Completion, Failure, print_line, store_failure};
use crate::aircraft::{AircraftTrack, Quantity};
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;
use crate::report::aircraft::{self, AircraftSource};
use crate::report::number::count_text;
use crate::store::{FlightRef, RealDisk};

/// Number of frames that use a source, by source number and quantity.
pub(super) type FrameCounts = BTreeMap<(usize, Quantity), usize>;

/// Counts the frames that use each source for each quantity.
pub(super) fn count_frames_by_source(track: &AircraftTrack, frames: &[(Stamp, Option<Exposure>)]) -> FrameCounts {
    let mut counts = BTreeMap::new();
    for (stamp, exposure) in frames {
        for (quantity, joined) in track.state_at(stamp, exposure.as_ref()) {
            *counts.entry((joined.source, quantity)).or_default() += 1;
        }
    }
    counts
}

pub(super) fn list_sources(args: &AircraftDataArgs, flight: &FlightRef) -> Result<Completion, Failure> {
    let (disk, root) = (&RealDisk, &args.store);
    let (sources, _) = aircraft::read_sources(disk, root, flight).map_err(store_failure)?;
    let (track, notes) = aircraft::read_track(disk, root, flight).map_err(store_failure)?;
    notes.iter().for_each(|note| eprintln!("wingd: {note}"));
    let frames = aircraft::read_frame_times(disk, flight).map_err(store_failure)?;
    let counts = count_frames_by_source(&track, &frames);
    let quantities_of = |source: &AircraftSource| -> Vec<(Quantity, usize)> {
        counts.iter().filter(|((n, _), _)| *n == source.number).map(|((_, q), frames)| (*q, *frames)).collect()
    };
    if args.json {
        let one = |source: &AircraftSource| {
            let quantity = |(q, frames): (Quantity, usize)| json!({"quantity": q.name(), "frames": frames});
            json!({
                "source": source.number,
                "name": source.name(),
                "lines": source.lines.len(),
                "withdrawn": source.withdrawn,
                "quantities": quantities_of(source).into_iter().map(quantity).collect::<Vec<_>>(),
            })
        };
        let sources: Vec<_> = sources.iter().map(one).collect();
        print_line(&json!({"flight": flight.id, "frames": frames.len(), "sources": sources}).to_string())?;
        return Ok(Completion::All);
    }
    let (frames, number) = (count_text(frames.len(), "frame"), count_text(sources.len(), "source"));
    print_line(&format!("{}: {frames}, {number} of aircraft data", flight.id))?;
    for source in &sources {
        let counts: Vec<String> =
            quantities_of(source).iter().map(|(q, n)| format!("{} {}", q.name(), count_text(*n, "frame"))).collect();
        let state = match (source.withdrawn, counts.is_empty()) {
            (Some(at), _) => format!("withdrawn {at:.0}"),
            (None, true) => "not used by any frame".to_owned(),
            (None, false) => counts.join(", "),
        };
        let lines = count_text(source.lines.len(), "line");
        print_line(&format!("{:>3}  {}  {lines}  {state}", source.number, source.name()))?;
    }
    Ok(Completion::All)
}
