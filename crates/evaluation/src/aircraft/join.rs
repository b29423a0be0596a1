//! Join of frames and samples by time tag.
//!
//! A feed is seconds late, comes in bursts, repeats lines and jumps: its own tags count, and the time of receipt only
//! identifies impossible tags.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::Quantity;
use super::interpolate;
use super::layout::{Layout, Sample};
use super::tags::TagFilter;
use super::times::unix_seconds;
use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;
use wingd_store::aircraft::AircraftLine;

/// Delay from the tag to its receipt and its standard deviation, s, if only the feed has UTC (an assumption: such feeds are
/// up to some seconds late).
const FEED_DELAY_S: (f64, f64) = (1.0, 1.0);
/// Standard deviation of a clock without a known error, s.
const DEFAULT_CLOCK_SIGMA_S: f64 = 1.0;

/// Numbers of unused lines, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnusedLines {
    /// Lines of another layout, or without a time.
    pub unread: usize,
    /// Lines with the tag of an earlier line.
    pub repeated: usize,
    /// Lines with a tag that is impossible at their time of receipt.
    pub jumped: usize,
}

/// Samples of a flight by source: a feed, a table imported later, a corrected table.
///
/// If several sources have a quantity at a frame, the latest counts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AircraftTrack {
    sources: Vec<SampleSource>,
    /// Unused lines.
    pub unused: UnusedLines,
    /// Median difference between the tags' UTC and the time since boot of their receipt, s, by boot.
    lead_s: BTreeMap<String, f64>,
}

/// Samples of a source, ordered by tag.
#[derive(Clone, Debug, Default, PartialEq)]
struct SampleSource {
    number: usize,
    samples: Vec<Sample>,
}

/// Value of a quantity at a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JoinedValue {
    /// Value in the unit that the quantity's name has as its suffix.
    pub value: f64,
    /// Standard deviation: instrument, time, and possible change between the tags.
    pub sigma: f64,
    /// Time from the frame to the nearest tag with a value, s.
    pub apart_s: f64,
    /// Number of the source, as `wingd aircraft-data --list` counts them; 0 in results that name none.
    #[serde(default)]
    pub source: usize,
}

/// Aircraft data at a frame.
pub type AircraftState = BTreeMap<Quantity, JoinedValue>;

impl AircraftTrack {
    /// Begins a source, to which the next lines are added.
    pub fn begin_source(&mut self, number: usize) {
        self.sources.push(SampleSource {
            number,
            samples: vec![],
        });
    }

    /// Adds lines of one layout to the current source. If two have the same tag the first counts; the second only fills
    /// missing values.
    pub fn add_lines(&mut self, layout: &Layout, lines: &[AircraftLine]) {
        let read = |line: &AircraftLine| Some((layout.read(&line.line)?, line.at.clone()));
        let tagged: Vec<_> = lines.iter().filter_map(read).collect();
        self.unused.unread += lines.len() - tagged.len();
        let mut judge = TagFilter::from_lines(&tagged);
        self.lead_s.extend(judge.leads_s());
        if self.sources.is_empty() {
            self.begin_source(1);
        }
        let Some(source) = self.sources.last_mut() else {
            return;
        };
        for (sample, at) in tagged {
            if !judge.accepts(sample.time_s, at.as_ref()) {
                self.unused.jumped += 1;
            } else if !source.insert(sample) {
                self.unused.repeated += 1;
            }
        }
    }

    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.sources.iter().map(|source| source.samples.len()).sum()
    }

    /// Returns whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns a frame's UTC for the join, seconds since 1970, and its standard deviation.
    ///
    /// If the recorder's clock was not synchronised and its error is unknown, UTC is taken from the feed's tags.
    fn frame_time(&self, stamp: &Stamp, exposure: Option<&Exposure>) -> Option<(f64, f64)> {
        let own_sigma_s = exposure.map_or(0.0, |e| e.exposure_sigma_s);
        let clock = exposure.and_then(|e| e.clock_sigma_s);
        if stamp.utc_synchronised || clock.is_some() {
            let utc = exposure.map_or(stamp.utc, |e| e.exposure_time);
            return Some((
                unix_seconds(utc),
                own_sigma_s.hypot(clock.unwrap_or(DEFAULT_CLOCK_SIGMA_S)),
            ));
        }
        let since_boot_s = exposure.map_or(stamp.since_boot_s, |e| e.exposure_since_boot_s);
        let lead = self.lead_s.get(&stamp.boot_id)?;
        Some((
            since_boot_s + lead + FEED_DELAY_S.0,
            own_sigma_s.hypot(FEED_DELAY_S.1),
        ))
    }

    /// Returns the aircraft data at a frame; empty if no tag is near enough.
    pub fn state_at(&self, stamp: &Stamp, exposure: Option<&Exposure>) -> AircraftState {
        let Some((time_s, sigma_s)) = self.frame_time(stamp, exposure) else {
            return AircraftState::new();
        };
        let latest = |quantity: Quantity| {
            let mut sources = self.sources.iter().rev();
            Some((
                quantity,
                sources.find_map(|source| source.value_at(quantity, time_s, sigma_s))?,
            ))
        };
        Quantity::ALL.into_iter().filter_map(latest).collect()
    }

    /// Returns a frame's UTC for the join, seconds since 1970; `None` if neither the recorder's clock nor a feed has UTC.
    pub fn time_s(&self, stamp: &Stamp, exposure: Option<&Exposure>) -> Option<f64> {
        self.frame_time(stamp, exposure).map(|(time_s, _)| time_s)
    }
}

impl SampleSource {
    /// Inserts a sample in order; returns `false` if an earlier one with its tag has all of its values.
    fn insert(&mut self, sample: Sample) -> bool {
        let place = self
            .samples
            .partition_point(|known| known.time_s < sample.time_s);
        match self
            .samples
            .get_mut(place)
            .filter(|known| known.time_s == sample.time_s)
        {
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

    /// Interpolates a quantity, with the standard deviations of the instrument, of the time, and of the change between the
    /// tags.
    fn value_at(&self, quantity: Quantity, time_s: f64, sigma_s: f64) -> Option<JoinedValue> {
        let index = quantity.index();
        let place = self
            .samples
            .partition_point(|sample| sample.time_s <= time_s);
        let value_of =
            |sample: &Sample| Some((sample.time_s, sample.values.get(index).copied().flatten()?));
        let before = self.samples.get(..place)?.iter().rev().filter_map(value_of);
        let after = self.samples.get(place..)?.iter().filter_map(value_of);
        let found = interpolate::interpolate_at(quantity, time_s, before, after)?;
        let sigma = quantity
            .sigma(found.value)
            .hypot(found.rate * sigma_s)
            .hypot(found.sigma);
        Some(JoinedValue {
            value: found.value,
            sigma,
            apart_s: found.apart_s,
            source: self.number,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::QuantityColumn;
    use super::*;
    use wingd_base::clock::quality::ClockQuality;

    const BEGIN_S: f64 = 1_772_344_800.0;

    fn layout() -> Layout {
        let columns = [(2, Quantity::Mach), (3, Quantity::FuelKg)];
        let column = |(field, quantity)| QuantityColumn {
            field,
            quantity,
            scale: 1.0,
            offset: 0.0,
        };
        Layout::separated(',', 1, columns.map(column).to_vec())
    }

    fn stamp(second: f64, synchronised: bool) -> Stamp {
        let utc = jiff::Timestamp::from_microsecond(((BEGIN_S + second) * 1e6) as i64).unwrap();
        let utc = if synchronised {
            utc
        } else {
            "1970-01-01T00:01:00Z".parse().unwrap()
        };
        Stamp {
            utc,
            utc_synchronised: synchronised,
            boot_id: "b".into(),
            since_boot_s: 100.0 + second,
        }
    }

    /// Creates a line tagged `tag` that is received `late` seconds later.
    fn line(tag: f64, mach: f64, late: f64) -> AircraftLine {
        AircraftLine {
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
        let smooth: Vec<AircraftLine> = (0..120)
            .map(|k| line(f64::from(k), mach(f64::from(k)), 0.2))
            .collect();
        let mut rough: Vec<AircraftLine> = (0..120)
            .map(|k| line(f64::from(k), mach(f64::from(k)), 2.0 + f64::from(k % 7)))
            .collect();
        rough.swap(10, 14);
        rough.extend([line(60.0, 0.99, 9.0), line(61.0, 0.98, 9.0)]);
        let jump = AircraftLine {
            at: Some(stamp(50.0, true)),
            line: format!("{},0.1,1", BEGIN_S + 50.5 - 3600.0),
        };
        rough.insert(50, jump);
        rough.push(AircraftLine {
            at: Some(stamp(90.0, true)),
            line: "noise".into(),
        });
        let (mut one, mut other) = (AircraftTrack::default(), AircraftTrack::default());
        one.add_lines(&layout(), &smooth);
        other.add_lines(&layout(), &rough);
        assert_eq!(
            other.unused,
            UnusedLines {
                unread: 1,
                repeated: 2,
                jumped: 1
            }
        );
        for second in [0.0, 12.3, 50.5, 60.6, 118.9] {
            let at = |track: &AircraftTrack| {
                track.state_at(&stamp(second, true), Some(&exposure(second)))
            };
            assert_eq!(at(&one), at(&other), "{second}");
            let joined = at(&other)[&Quantity::Mach];
            assert!(
                (joined.value - mach(second)).abs() < 1e-9 && joined.sigma < 0.0051,
                "{joined:?}"
            );
        }
    }

    #[test]
    fn values_end_at_the_longest_gap_and_sigma_grows_within_it() {
        let mut track = AircraftTrack::default();
        track.add_lines(
            &layout(),
            &(0..10)
                .map(|k| line(f64::from(k), 0.5 + 0.1 * f64::from(k), 1.0))
                .collect::<Vec<_>>(),
        );
        let at = |second: f64| track.state_at(&stamp(second, true), Some(&exposure(second)));
        let held = at(12.0)[&Quantity::Mach];
        assert_eq!((held.value, held.apart_s), (1.4, 3.0));
        // A change of 0.1 per second for 3 s, and its possible acceleration of 0.001 per s^2.
        assert!(
            (held.sigma - 0.005f64.hypot(0.1 * 3.0).hypot(0.001 * 3.0 * 2.0)).abs() < 1e-6,
            "{held:?}"
        );
        assert!(at(14.5).is_empty() && at(-6.0).is_empty());
    }

    #[test]
    fn the_latest_source_is_used_per_quantity_and_older_ones_fill_its_gaps() {
        let text = |tag: f64, mach: &str, fuel: &str| AircraftLine {
            at: None,
            line: format!("{},{mach},{fuel}", BEGIN_S + tag),
        };
        let mut track = AircraftTrack::default();
        track.begin_source(1);
        track.add_lines(
            &layout(),
            &[
                text(0.0, "0.70", ""),
                text(10.0, "0.70", ""),
                text(20.0, "0.70", "9000"),
            ],
        );
        track.begin_source(3);
        track.add_lines(
            &layout(),
            &[
                text(0.0, "", "8000"),
                text(10.0, "0.80", "8000"),
                text(10.0, "0.81", "1"),
            ],
        );
        let at = |second: f64| track.state_at(&stamp(second, true), Some(&exposure(second)));
        let found = |second: f64, quantity| at(second).get(&quantity).map(|j| (j.value, j.source));
        assert_eq!(found(0.0, Quantity::Mach), Some((0.70, 1)));
        assert_eq!(found(0.0, Quantity::FuelKg), Some((8000.0, 3)));
        assert_eq!(
            found(10.0, Quantity::Mach),
            Some((0.80, 3)),
            "the first of two with one tag"
        );
        assert_eq!(found(20.0, Quantity::FuelKg), Some((9000.0, 1)));
        assert_eq!((track.len(), track.unused.repeated), (5, 1));
    }

    #[test]
    fn a_recorder_in_1970_is_dated_by_the_feed() {
        let mut track = AircraftTrack::default();
        let late = |k: i32| {
            let mut line = line(f64::from(k), 0.5 + 0.001 * f64::from(k), 1.0);
            let at = line.at.as_mut().unwrap();
            (at.utc, at.utc_synchronised) = ("1970-01-01T00:00:00Z".parse().unwrap(), false);
            line
        };
        track.add_lines(&layout(), &(0..60).map(late).collect::<Vec<_>>());
        let joined = track.state_at(&stamp(30.5, false), None)[&Quantity::Mach];
        assert!((joined.value - 0.5305).abs() < 1e-9, "{joined:?}");
        // Contributions of the instrument, the time, and the change half-way between two tags 1 s apart.
        assert!((joined.sigma - 0.005f64.hypot(0.001).hypot(0.5 * 0.001 * 0.25)).abs() < 1e-9);
    }
}
