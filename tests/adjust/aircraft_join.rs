//! Promise: aircraft data joined to a frame are within their standard deviation in climbs and turns, with lines 1 to 30 s
//! apart, late and jumping; impossible time tags are not joined.

use jiff::Timestamp;
use rand::Rng;
use rand::rngs::StdRng;
use wingd::aircraft::{AircraftTrack, Layout, Quantity, QuantityColumn};
use wingd::clock::Stamp;
use wingd::clock::exposure::Exposure;
use wingd::clock::quality::ClockQuality;
use wingd::store::aircraft::AircraftLine;

use crate::common::random::{normal, rng};

/// 2026-06-01T08:00:00Z.
const BEGIN_S: f64 = 1_780_300_800.0;
const LASTING_S: usize = 1200;
/// Quantities of the feed, with the standard deviation of the instrument's bias, which is constant during a flight.
const FEED_SIGMAS: [(Quantity, f64); 5] = [
    (Quantity::PressureAltitudeM, 20.0),
    (Quantity::Mach, 0.005),
    (Quantity::StaticTemperatureC, 1.0),
    (Quantity::StaticPressureHpa, 1.0),
    (Quantity::LoadFactor, 0.02),
];

/// A flight, second by second: climbs and descents with level-offs, accelerations, turns.
struct Truth(Vec<[f64; FEED_SIGMAS.len()]>);

impl Truth {
    fn random(rng: &mut StdRng) -> Self {
        let (mut height_m, mut climb_m_s, mut mach, mut bank) = (3000.0, 0.0_f64, 0.5, 0.0_f64);
        let (mut wanted_m_s, mut faster, mut wanted_bank) = (0.0_f64, 0.0, 0.0_f64);
        let mut all = vec![];
        for second in 0..LASTING_S {
            if second % 60 == 0 {
                wanted_m_s = [0.0, 0.0, 8.0, 12.0, -8.0, -12.0][rng.random_range(0..6)];
                faster = [0.0, 0.0, 0.001, -0.001][rng.random_range(0..4)];
            }
            if second % 45 == 0 {
                wanted_bank = [0.0, 0.0, 0.44, 0.52][rng.random_range(0..4)];
            }
            climb_m_s += (wanted_m_s - climb_m_s).clamp(-0.5, 0.5);
            bank += (wanted_bank - bank).clamp(-0.1, 0.1);
            height_m = f64::clamp(height_m + climb_m_s, 1000.0, 10_500.0);
            mach = f64::clamp(mach + faster, 0.4, 0.8);
            let pressure = 1013.25 * (1.0 - 2.255_77e-5 * height_m).powf(5.255_88);
            all.push([
                height_m,
                mach,
                15.0 - 0.0065 * height_m,
                pressure,
                1.0 / bank.cos(),
            ]);
        }
        Self(all)
    }

    fn values_at(&self, time_s: f64) -> [f64; FEED_SIGMAS.len()] {
        let (k, part) = (time_s as usize, time_s.fract());
        let of = |k: usize| self.0[k.min(LASTING_S - 1)];
        std::array::from_fn(|i| of(k)[i] + part * (of(k + 1)[i] - of(k)[i]))
    }
}

fn stamp(time_s: f64) -> Stamp {
    let utc = Timestamp::from_microsecond(((BEGIN_S + time_s) * 1e6) as i64).unwrap();
    Stamp {
        utc,
        utc_synchronised: true,
        boot_id: "b".into(),
        since_boot_s: 50.0 + time_s,
    }
}

fn layout() -> Layout {
    let column = |(k, (quantity, _)): (usize, &(Quantity, f64))| QuantityColumn {
        field: k + 2,
        quantity: *quantity,
        scale: 1.0,
        offset: 0.0,
    };
    Layout::separated(',', 1, FEED_SIGMAS.iter().enumerate().map(column).collect())
}

/// A feed line with this tag and the true values of another moment.
fn line(truth: &Truth, (tag_s, true_s, came_s): (f64, f64, f64), errors: &[f64]) -> AircraftLine {
    let mut text = format!("{:.3}", BEGIN_S + tag_s);
    for (value, error) in truth.values_at(true_s).iter().zip(errors) {
        text.push_str(&format!(",{:.5}", value + error));
    }
    AircraftLine {
        at: Some(stamp(came_s)),
        line: text,
    }
}

/// A feed with one line per `every_s`, up to 6 s late; one in `jumps` tags is wrong.
fn feed(rng: &mut StdRng, truth: &Truth, every_s: f64, jumps: Option<u32>) -> Vec<AircraftLine> {
    let errors: Vec<f64> = FEED_SIGMAS
        .iter()
        .map(|(_, sigma)| sigma * normal(rng))
        .collect();
    let mut lines = vec![];
    let mut at_s = 0.0;
    while at_s < LASTING_S as f64 - 1.0 {
        let jump_s = match jumps {
            Some(one_in) if rng.random_range(0..one_in) == 0 => {
                [3600.0, -3600.0, 40.0, 15.0, -15.0, -40.0][rng.random_range(0..6)]
            }
            _ => 0.0,
        };
        let late_s = 0.3 + 5.7 * rng.random::<f64>();
        lines.push((
            at_s + late_s,
            line(truth, (at_s + jump_s, at_s, at_s + late_s), &errors),
        ));
        at_s += every_s;
    }
    lines.sort_by(|a, b| a.0.total_cmp(&b.0));
    lines.into_iter().map(|(_, line)| line).collect()
}

/// Each flight has its own instrument errors.
const FLIGHTS: u64 = 80;
const FRAMES: usize = 100;

/// Error over standard deviation for each quantity, over all flights.
fn ratios(seed: u64, every_s: f64, jumps: Option<u32>) -> Vec<Vec<f64>> {
    let mut all = vec![vec![]; FEED_SIGMAS.len()];
    for flight in 0..FLIGHTS {
        let rng = &mut rng(seed + flight);
        let truth = Truth::random(rng);
        let mut track = AircraftTrack::default();
        track.add_lines(&layout(), &feed(rng, &truth, every_s, jumps));
        for _ in 0..FRAMES {
            let at_s = 1.0 + (LASTING_S as f64 - 3.0) * rng.random::<f64>();
            let exposure = Exposure::from_request(&stamp(at_s), 50.0 + at_s, ClockQuality::exact());
            let state = track.state_at(&stamp(at_s), Some(&exposure));
            for (k, (quantity, _)) in FEED_SIGMAS.iter().enumerate() {
                if let Some(joined) = state.get(quantity) {
                    all[k].push((joined.value - truth.values_at(at_s)[k]) / joined.sigma);
                }
            }
        }
    }
    all
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn joined_values_have_consistent_sigmas() {
    for (seed, every_s, jumps) in [
        (100, 1.0, None),
        (200, 2.0, Some(30)),
        (300, 5.0, None),
        (400, 8.0, Some(20)),
        (500, 10.0, None),
        (600, 15.0, Some(20)),
        (700, 30.0, None),
    ] {
        let all = ratios(seed, every_s, jumps);
        let each: Vec<f64> = all.iter().map(|ratios| rms(ratios)).collect();
        let share = all[0].len() as f64 / (FLIGHTS as usize * FRAMES) as f64;
        println!("lines {every_s} s apart, jumps {jumps:?}: {each:.2?}; {share:.2} of the frames");
        assert!(each.iter().all(|rms| *rms <= 1.3), "{every_s} s: {each:?}");
        assert!(share > (9.0 / every_s).min(0.95), "{every_s} s: {share}");
    }
}

#[test]
fn impossible_tags_are_joined_with_no_frame() {
    let rng = &mut rng(9);
    let truth = Truth::random(rng);
    for ahead_s in [40.0, 3600.0, -3600.0] {
        let lines: Vec<AircraftLine> = (60..900)
            .map(|k| {
                line(
                    &truth,
                    (f64::from(k) + ahead_s, f64::from(k), f64::from(k) + 1.0),
                    &[0.0; 5],
                )
            })
            .collect();
        let mut track = AircraftTrack::default();
        track.add_lines(&layout(), &lines);
        assert_eq!(
            (track.len(), track.unused.jumped),
            (0, lines.len()),
            "{ahead_s}"
        );
        assert!(track.state_at(&stamp(500.0), None).is_empty());
    }
}
