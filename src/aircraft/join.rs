//! Frames and samples joined by time tag. A feed comes seconds late, in bursts, repeats lines and jumps: its own tags count,
//! the time of receipt only tells which tags cannot be true.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::interpolate;
use super::layout::{Layout, Sample};
use super::tags::Judge;
use super::times::seconds;
use super::{QUANTITIES, Quantity};
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;

/// Where only the feed tells UTC: from the tag to its receipt, and that one's standard deviation, s (an assumption: such
/// feeds are up to some seconds late).
const LATE_S: (f64, f64) = (1.0, 1.0);
/// A clock whose error nobody states is taken to be off by this, s.
const UNSTATED_CLOCK_S: f64 = 1.0;

/// A line with the moment of its receipt; none for a file that came after the flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// When it came.
    pub at: Option<Stamp>,
    /// As it came.
    pub line: String,
}

/// Lines that say nothing, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Unused {
    /// Not of the layout, or without a time.
    pub unread: usize,
    /// With a tag that was there before.
    pub repeated: usize,
    /// With a tag that cannot be true by when they came.
    pub jumped: usize,
}

/// A flight's samples, source by source: a feed, a table taken in later, a corrected one. Of several that tell a quantity
/// at a frame the latest counts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    sources: Vec<Source>,
    /// Lines that say nothing.
    pub unused: Unused,
    /// By boot: the tags' UTC less the time since boot of receipt, median, s.
    lead_s: BTreeMap<String, f64>,
}

/// The samples of a source in the order of their tags.
#[derive(Clone, Debug, Default, PartialEq)]
struct Source {
    number: usize,
    samples: Vec<Sample>,
}

/// A quantity at a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Joined {
    /// In the unit that its name bears.
    pub value: f64,
    /// Its standard deviation: instrument, time, and what lies between the tags.
    pub sigma: f64,
    /// From the frame to the nearest tag with a value, s.
    pub apart_s: f64,
    /// The source that tells it, as `wingd aircraft-data --list` counts them; 0 in results that name none.
    #[serde(default)]
    pub source: usize,
}

/// What the aircraft's data say of a frame.
pub type State = BTreeMap<Quantity, Joined>;

impl Track {
    /// Begins a source: the lines that are added next are its own.
    pub fn begin_source(&mut self, number: usize) {
        self.sources.push(Source { number, samples: vec![] });
    }

    /// Takes lines of one layout in, to the source begun last. Of two with one tag the first counts, but for what it does
    /// not tell.
    pub fn add(&mut self, layout: &Layout, lines: &[Received]) {
        let read = |line: &Received| Some((layout.read(&line.line)?, line.at.clone()));
        let tagged: Vec<_> = lines.iter().filter_map(read).collect();
        self.unused.unread += lines.len() - tagged.len();
        let mut judge = Judge::of(&tagged);
        self.lead_s.extend(judge.leads_s());
        if self.sources.is_empty() {
            self.begin_source(1);
        }
        let Some(source) = self.sources.last_mut() else { return };
        for (sample, at) in tagged {
            if !judge.believes(sample.time_s, at.as_ref()) {
                self.unused.jumped += 1;
            } else if !source.take(sample) {
                self.unused.repeated += 1;
            }
        }
    }

    /// Samples.
    pub fn len(&self) -> usize {
        self.sources.iter().map(|source| source.samples.len()).sum()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A frame's UTC for the join, seconds since 1970, and its standard deviation. Where this machine's clock was not
    /// synchronised, and nobody states how far off it was, the feed's own tags tell it.
    fn instant(&self, stamp: &Stamp, exposure: Option<&Exposure>) -> Option<(f64, f64)> {
        let own_sigma_s = exposure.map_or(0.0, |e| e.exposure_sigma_s);
        let clock = exposure.and_then(|e| e.clock_sigma_s);
        if stamp.utc_synchronised || clock.is_some() {
            let utc = exposure.map_or(stamp.utc, |e| e.exposure_time);
            return Some((seconds(utc), own_sigma_s.hypot(clock.unwrap_or(UNSTATED_CLOCK_S))));
        }
        let since_boot_s = exposure.map_or(stamp.since_boot_s, |e| e.exposure_since_boot_s);
        let lead = self.lead_s.get(&stamp.boot_id)?;
        Some((since_boot_s + lead + LATE_S.0, own_sigma_s.hypot(LATE_S.1)))
    }

    /// The state at a frame; empty where no tag is near enough.
    pub fn at(&self, stamp: &Stamp, exposure: Option<&Exposure>) -> State {
        let Some((time_s, sigma_s)) = self.instant(stamp, exposure) else { return State::new() };
        let latest = |quantity: Quantity| {
            let mut sources = self.sources.iter().rev();
            Some((quantity, sources.find_map(|source| source.quantity(quantity, time_s, sigma_s))?))
        };
        Quantity::ALL.into_iter().filter_map(latest).collect()
    }

    /// A frame's UTC for the join, seconds since 1970; `None` where neither this machine's clock nor a feed tells it.
    pub fn time_s(&self, stamp: &Stamp, exposure: Option<&Exposure>) -> Option<f64> {
        self.instant(stamp, exposure).map(|(time_s, _)| time_s)
    }
}

impl Source {
    /// Takes a sample in its place; `false` where one with its tag tells all that it does.
    fn take(&mut self, sample: Sample) -> bool {
        let place = self.samples.partition_point(|known| known.time_s < sample.time_s);
        match self.samples.get_mut(place).filter(|known| known.time_s == sample.time_s) {
            Some(known) => {
                let mut more = false;
                for (own, other) in known.values.iter_mut().zip(sample.values) {
                    more |= own.is_none() && other.is_some();
                    *own = own.or(other);
                }
                more
            }
            None => {
                self.samples.insert(place, sample);
                true
            }
        }
    }

    /// What the tags about an instant tell, with the standard deviations of the instrument, of the instant and of what is
    /// between the tags.
    fn quantity(&self, quantity: Quantity, time_s: f64, sigma_s: f64) -> Option<Joined> {
        let index = quantity.index();
        let place = self.samples.partition_point(|sample| sample.time_s <= time_s);
        let value_of = |sample: &Sample| Some((sample.time_s, sample.values.get(index).copied().flatten()?));
        let before = self.samples.get(..place)?.iter().rev().filter_map(value_of);
        let after = self.samples.get(place..)?.iter().filter_map(value_of);
        let told = interpolate::at(quantity, time_s, before, after)?;
        let sigma = quantity.sigma(told.value).hypot(told.rate * sigma_s).hypot(told.sigma);
        Some(Joined { value: told.value, sigma, apart_s: told.apart_s, source: self.number })
    }
}

/// Values of a state by name, for files.
pub fn named(state: &State) -> serde_json::Map<String, serde_json::Value> {
    let one = |(q, joined): (&Quantity, &Joined)| {
        (q.name().to_owned(), serde_json::to_value(joined).unwrap_or_default())
    };
    state.iter().map(one).collect()
}

const _: () = assert!(QUANTITIES == Quantity::ALL.len());

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::Column;
    use super::*;
    use crate::clock::quality::ClockQuality;

    const BEGIN_S: f64 = 1_772_344_800.0;

    fn layout() -> Layout {
        let columns = [(2, Quantity::Mach), (3, Quantity::FuelKg)];
        let column = |(field, quantity)| Column { field, quantity, scale: 1.0, offset: 0.0 };
        Layout::text(',', 1, columns.map(column).to_vec())
    }

    fn stamp(second: f64, synchronised: bool) -> Stamp {
        let utc = jiff::Timestamp::from_microsecond(((BEGIN_S + second) * 1e6) as i64).unwrap();
        let utc = if synchronised { utc } else { "1970-01-01T00:01:00Z".parse().unwrap() };
        Stamp { utc, utc_synchronised: synchronised, boot_id: "b".into(), since_boot_s: 100.0 + second }
    }

    /// A line tagged `tag` that came `late` seconds after.
    fn line(tag: f64, mach: f64, late: f64) -> Received {
        Received {
            at: Some(stamp(tag + late, true)),
            line: format!("{},{mach},{}", BEGIN_S + tag, 9000.0 - tag),
        }
    }

    fn exposure(second: f64) -> Exposure {
        let at = stamp(second, true);
        Exposure::from_request(&at, at.since_boot_s, ClockQuality::exact())
    }

    #[test]
    fn late_bursts_repeats_and_jumps_change_nothing() {
        let mach = |tag: f64| 0.7 + 1e-4 * tag;
        let smooth: Vec<Received> = (0..120).map(|k| line(f64::from(k), mach(f64::from(k)), 0.2)).collect();
        let mut rough: Vec<Received> =
            (0..120).map(|k| line(f64::from(k), mach(f64::from(k)), 2.0 + f64::from(k % 7))).collect();
        rough.swap(10, 14);
        rough.extend([line(60.0, 0.99, 9.0), line(61.0, 0.98, 9.0)]);
        let jump =
            Received { at: Some(stamp(50.0, true)), line: format!("{},0.1,1", BEGIN_S + 50.5 - 3600.0) };
        rough.insert(50, jump);
        rough.push(Received { at: Some(stamp(90.0, true)), line: "noise".into() });
        let (mut one, mut other) = (Track::default(), Track::default());
        one.add(&layout(), &smooth);
        other.add(&layout(), &rough);
        assert_eq!(other.unused, Unused { unread: 1, repeated: 2, jumped: 1 });
        for second in [0.0, 12.3, 50.5, 60.6, 118.9] {
            let at = |track: &Track| track.at(&stamp(second, true), Some(&exposure(second)));
            assert_eq!(at(&one), at(&other), "{second}");
            let joined = at(&other)[&Quantity::Mach];
            assert!((joined.value - mach(second)).abs() < 1e-9 && joined.sigma < 0.0051, "{joined:?}");
        }
    }

    #[test]
    fn beyond_the_width_there_is_nothing_and_within_it_the_sigma_grows() {
        let mut track = Track::default();
        track.add(
            &layout(),
            &(0..10).map(|k| line(f64::from(k), 0.5 + 0.1 * f64::from(k), 1.0)).collect::<Vec<_>>(),
        );
        let at = |second: f64| track.at(&stamp(second, true), Some(&exposure(second)));
        let held = at(12.0)[&Quantity::Mach];
        assert_eq!((held.value, held.apart_s), (1.4, 3.0));
        // A change of 0.1 a second for 3 s, and what it may have turned by: 0.001 a second more in each.
        assert!((held.sigma - 0.005f64.hypot(0.1 * 3.0).hypot(0.001 * 3.0 * 2.0)).abs() < 1e-6, "{held:?}");
        assert!(at(14.5).is_empty() && at(-6.0).is_empty());
    }

    #[test]
    fn the_latest_source_counts_per_quantity_and_older_ones_fill_what_it_does_not_tell() {
        let text = |tag: f64, mach: &str, fuel: &str| Received {
            at: None,
            line: format!("{},{mach},{fuel}", BEGIN_S + tag),
        };
        let mut track = Track::default();
        track.begin_source(1);
        track.add(&layout(), &[text(0.0, "0.70", ""), text(10.0, "0.70", ""), text(20.0, "0.70", "9000")]);
        track.begin_source(3);
        track.add(&layout(), &[text(0.0, "", "8000"), text(10.0, "0.80", "8000"), text(10.0, "0.81", "1")]);
        let at = |second: f64| track.at(&stamp(second, true), Some(&exposure(second)));
        let told = |second: f64, quantity| at(second).get(&quantity).map(|j| (j.value, j.source));
        assert_eq!(told(0.0, Quantity::Mach), Some((0.70, 1)));
        assert_eq!(told(0.0, Quantity::FuelKg), Some((8000.0, 3)));
        assert_eq!(told(10.0, Quantity::Mach), Some((0.80, 3)), "the first of two with one tag");
        assert_eq!(told(20.0, Quantity::FuelKg), Some((9000.0, 1)));
        assert_eq!((track.len(), track.unused.repeated), (5, 1));
    }

    #[test]
    fn a_recorder_in_1970_is_dated_by_the_feed() {
        let mut track = Track::default();
        let late = |k: i32| {
            let mut line = line(f64::from(k), 0.5 + 0.001 * f64::from(k), 1.0);
            let at = line.at.as_mut().unwrap();
            (at.utc, at.utc_synchronised) = ("1970-01-01T00:00:00Z".parse().unwrap(), false);
            line
        };
        track.add(&layout(), &(0..60).map(late).collect::<Vec<_>>());
        let joined = track.at(&stamp(30.5, false), None)[&Quantity::Mach];
        assert!((joined.value - 0.5305).abs() < 1e-9, "{joined:?}");
        // Of the instrument, of the instant, and of what lies half-way between two tags a second apart.
        assert!((joined.sigma - 0.005f64.hypot(0.001).hypot(0.5 * 0.001 * 0.25)).abs() < 1e-9);
    }
}
