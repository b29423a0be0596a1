//! Promise: what live frames tell of a swinging wing is good enough for its modes (docs/fleet/modes.md). Two modes of known
//! frequency, damping and shape, excited at random, ten frames a second for five minutes, observations with the detector's noise,
//! a mounting that walks. `fleet/tests/test_modes.py` finds the modes in what is written here.

use std::f64::consts::TAU;
use std::fmt::Write;

use nalgebra::Vector3;
use rand::rngs::StdRng;
use serde_json::json;
use wingd::measure::adjust::{Live, Options};
use wingd::measure::setup::Uncertainty;

use crate::common::beam_truth::{Truth, normal, normal3, random_wing, remounted, rms, rng};

const RATE_HZ: f64 = 10.0;
const FRAMES: usize = 3000;
/// Frequency, Hz; damping; rms of the tip, m.
const MODES: [(f64, f64, f64); 2] = [(1.3, 0.03, 0.10), (3.7, 0.02, 0.003)];
/// The detector's standard deviation, px.
const NOISE_PX: f64 = 0.05;

/// Poles of the oscillator, driven by white noise, in its steady state.
fn swing(rng: &mut StdRng, (hz, damping, rms_m): (f64, f64, f64)) -> Vec<f64> {
    let omega = TAU * hz / RATE_HZ;
    let decay = (-damping * omega).exp();
    let first = 2.0 * decay * (omega * (1.0 - damping * damping).sqrt()).cos();
    let second = decay * decay;
    let gain = (1.0 - second) * ((1.0 + second).powi(2) - first * first) / (1.0 + second);
    let (mut last, mut before) = (0.0, 0.0);
    let mut next = || {
        let now = first * last - second * before + rms_m * gain.sqrt() * normal(rng);
        (last, before) = (now, last);
        now
    };
    (0..2000 + FRAMES).map(|_| next()).skip(2000).collect()
}

/// A uniform cantilever's second mode, 1 at the tip.
fn second(share: f64) -> f64 {
    const ROOT: f64 = 4.694_091_133;
    let free = (ROOT.cosh() + ROOT.cos()) / (ROOT.sinh() + ROOT.sin());
    let at = |b: f64| b.cosh() - b.cos() - free * (b.sinh() - b.sin());
    at(ROOT * share) / at(ROOT)
}

/// `MODES=folder cargo test --release --test adjust -- --ignored modes`.
#[test]
#[ignore = "writes five minutes of live results, for the fleet's test"]
fn modes_of_five_minutes_are_written() {
    let folder =
        std::path::PathBuf::from(std::env::var("MODES").unwrap_or_else(|_| "target/modes".to_owned()));
    std::fs::create_dir_all(&folder).unwrap();
    let mut rng = rng(511);
    let truth = Truth::new(random_wing(&mut rng), 21);
    let mut setup = truth.surveyed(&mut rng, 0.002, 0.002);
    setup.uncertainty =
        Uncertainty { mount_shift_m: 0.002, mount_drift_rad: 2e-5, ..Uncertainty::of_drawings() };
    let orientation = truth.orientation(&mut rng, NOISE_PX, true);
    let walk = setup.uncertainty.mount_drift_rad * (1.0 / (60.0 * RATE_HZ)).sqrt();
    let mut turn = remounted(&mut rng, &truth.setup);
    let shift = normal3(&mut rng) * 0.002;
    let mut modes = MODES;
    if let Some(rms_m) = std::env::var("SECOND_M").ok().and_then(|text| text.parse().ok()) {
        modes[1].2 = rms_m;
    }
    let [first, second_mode] = modes.map(|mode| swing(&mut rng, mode));
    let mut live = Live::begin(setup, orientation, Options::default()).unwrap();
    let level_m = 2.0;
    let at = |first_m: f64, second_m: f64| -> Vec<Vector3<f64>> {
        let mut points = truth.in_flight(level_m + first_m, truth.fuel());
        points.iter_mut().enumerate().for_each(|(i, p)| p.z += second_m * second(truth.share(i)));
        points
    };
    let ids: Vec<String> = truth.setup.markers.iter().map(|m| m.id.clone()).collect();
    let mut csv = String::from("recorder_id,flight,boot_id,since_boot_s,exposure_time");
    ids.iter().for_each(|id| write!(csv, ",u_{id}_px,lift_{id}_m,sigma_lift_{id}_m").unwrap());
    csv.push('\n');
    let mut normalised = vec![];
    for (k, (first_m, second_m)) in first.iter().zip(&second_mode).enumerate() {
        turn += normal3(&mut rng) * walk;
        let points = at(*first_m, *second_m);
        let seen: Vec<_> = points.iter().map(|p| p - shift).collect();
        let observations = truth.observations(&mut rng, &seen, turn, NOISE_PX);
        let solution = live.frame(&observations, 1.0 / RATE_HZ).unwrap();
        let s = 1000.0 + k as f64 / RATE_HZ;
        let moment = jiff::Timestamp::from_microsecond(1_772_000_000_000_000 + (1e6 * s) as i64).unwrap();
        write!(csv, "ab,f0001,boot,{s},{moment}").unwrap();
        for (i, observation) in observations.iter().enumerate() {
            let lift = solution.markers.iter().find(|m| m.marker == i && m.used).and_then(|m| m.lift_m);
            // One that was left out has no lift in this frame.
            let Some((value, sigma)) = lift.and_then(|lift| Some((lift.value, lift.sigma?))) else {
                write!(csv, ",{:.2},,", observation.pixel.x).unwrap();
                continue;
            };
            write!(csv, ",{:.2},{value},{sigma}", observation.pixel.x).unwrap();
            normalised.push((value - (points[i].z - truth.ground_m[i].z)) / sigma);
        }
        csv.push('\n');
    }
    std::fs::write(folder.join("live.csv"), csv).unwrap();
    let shape = |first_m: f64, second_m: f64| {
        let moved = at(first_m, second_m).into_iter().zip(at(0.0, 0.0)).map(|(a, b)| a.z - b.z);
        ids.iter().cloned().zip(moved).map(|(id, z)| (id, json!(z))).collect::<serde_json::Map<_, _>>()
    };
    let shapes = [shape(0.01, 0.0), shape(0.0, 0.01)];
    let said: Vec<_> = MODES
        .iter()
        .zip(shapes)
        .map(|((hz, damping, _), shape)| json!({"hz": hz, "damping": damping, "shape": shape}))
        .collect();
    std::fs::write(folder.join("truth.json"), json!(said).to_string()).unwrap();
    println!("lifts {:.2} normalised; {}", rms(&normalised), folder.display());
    assert!(rms(&normalised) < 1.3);
}
