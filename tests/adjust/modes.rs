//! Promise: live results of a vibrating wing are precise enough for its modes (docs/fleet/modes.md). Two modes of known
//! frequency, damping and shape, randomly excited, ten frames per second, exact geometry, observations with the detector's
//! noise, a drifting mounting. `python/tests/fleet/test_modes.py`
//! estimates the modes from five minutes of such results, which `make table TABLE=modes` writes.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use rand::rngs::StdRng;
use wingd::measure::adjust::{LiveAdjustment, MarkerSolution, Observation, Options, Solution};
use wingd::measure::setup::{SetupUncertainty, Width};

use crate::common::beam_truth::{
    ModeShape, SecondMode, Truth, median, normal, normal3, random_wing, remounted, rms, rng,
};

pub const RATE_HZ: f64 = 10.0;
/// Frequency, Hz; damping; rms of the tip, m.
pub const FIRST: (f64, f64, f64) = (1.3, 0.03, 0.10);
pub const SECOND: (f64, f64, f64) = (3.7, 0.02, 0.006);
/// Standard deviation of the detector, px.
const NOISE_PX: f64 = 0.05;
const LEVEL_M: f64 = 2.0;

/// Steady-state response of an oscillator driven by white noise.
fn oscillation(rng: &mut StdRng, (hz, damping, rms_m): (f64, f64, f64), frames: usize) -> Vec<f64> {
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
    (0..2000 + frames).map(|_| next()).skip(2000).collect()
}

/// A live result, its observations, and the true marker positions.
pub struct Frame {
    solution: Solution,
    /// Read by the tables of modes alone.
    #[allow(dead_code)]
    pub seen: Vec<Observation>,
    points: Vec<Vector3<f64>>,
}

impl Frame {
    pub fn used(&self) -> impl Iterator<Item = &MarkerSolution> {
        self.solution.markers.iter().filter(|m| m.used)
    }

    fn tip_sigma_m(&self) -> f64 {
        self.used()
            .filter_map(|m| m.deflection_m?.sigma)
            .fold(0.0, f64::max)
    }
}

/// A wing that vibrates in two modes, and the live results of its frames.
pub struct VibratingFlight {
    pub truth: Truth,
    mode: SecondMode,
    /// Tip amplitude of both vibrations, per frame, m.
    vibrations: [Vec<f64>; 2],
    pub results: Vec<Frame>,
}

impl VibratingFlight {
    pub fn new(rng: &mut StdRng, second_m: f64, vibrations: ModeShape, frames: usize) -> Self {
        let truth = Truth::new(random_wing(rng), 21);
        let mode = truth.second_mode(vibrations);
        let mut setup = truth.surveyed(rng, 0.002, 0.002);
        setup.uncertainty = SetupUncertainty::from_drawings()
            .with_width(Width::MountShift, 0.002)
            .with_width(Width::MountDrift, 2e-5);
        let orientation = truth.orientation(rng, NOISE_PX, true);
        let walk = setup.uncertainty[Width::MountDrift] * (1.0 / (60.0 * RATE_HZ)).sqrt();
        let mut turn = remounted(rng, &truth.setup);
        let shift = normal3(rng) * 0.002;
        let modes = [FIRST, (SECOND.0, SECOND.1, second_m)];
        let vibrations = modes.map(|mode| oscillation(rng, mode, frames));
        let mut live = LiveAdjustment::new(setup, orientation, Options::default()).unwrap();
        let mut flight = Self {
            truth,
            mode,
            vibrations,
            results: vec![],
        };
        for k in 0..frames {
            turn += normal3(rng) * walk;
            let points = flight.deflections_at(flight.vibrations[0][k], flight.vibrations[1][k]);
            let seen: Vec<_> = points.iter().map(|p| p - shift).collect();
            let seen = flight.truth.observations(rng, &seen, turn, NOISE_PX);
            let solution = live.adjust_frame(&seen, 1.0 / RATE_HZ).unwrap();
            flight.results.push(Frame {
                solution,
                seen,
                points,
            });
        }
        flight
    }

    fn deflections_at(&self, first_m: f64, second_m: f64) -> Vec<Vector3<f64>> {
        self.truth
            .vibrating_positions(LEVEL_M + first_m, self.truth.fuel(), &self.mode, second_m)
    }

    /// Marker deflections for a unit vibration at the tip.
    pub fn shape(&self, first_m: f64, second_m: f64) -> Vec<f64> {
        self.deflections_at(first_m, second_m)
            .into_iter()
            .zip(self.deflections_at(0.0, 0.0))
            .map(|(a, b)| a.z - b.z)
            .collect()
    }

    /// Normalised deflection errors of the markers, frame by frame.
    pub fn normalised(&self, from: usize) -> Vec<f64> {
        let of = |frame: &Frame| -> Vec<f64> {
            let one = |m: &MarkerSolution| {
                let deflection = m.deflection_m?;
                let truth_m = frame.points[m.marker].z - self.truth.ground_m[m.marker].z;
                Some((deflection.value - truth_m) / deflection.sigma?)
            };
            frame.used().filter_map(one).collect()
        };
        self.results[from..].iter().flat_map(of).collect()
    }

    /// Regression of a marker's solved deflection on both vibrations: least squares with a constant.
    fn mode_response(&self, marker: usize, from: usize) -> [f64; 2] {
        let rows = self
            .results
            .iter()
            .enumerate()
            .skip(from)
            .filter_map(|(k, frame)| {
                let deflection = frame.used().find(|m| m.marker == marker)?.deflection_m?;
                Some((
                    Vector3::new(1.0, self.vibrations[0][k], self.vibrations[1][k]),
                    deflection.value,
                ))
            });
        let (mut normal, mut right) = (nalgebra::Matrix3::zeros(), Vector3::zeros());
        for (row, deflection_m) in rows {
            normal += row * row.transpose();
            right += row * deflection_m;
        }
        let found = normal.try_inverse().unwrap() * right;
        [found[1], found[2]]
    }

    /// Modal assurance criterion of both estimated mode shapes with the true ones.
    pub fn assurance(&self, from: usize) -> [f64; 2] {
        let found: Vec<[f64; 2]> = (0..self.truth.ground_m.len())
            .map(|i| self.mode_response(i, from))
            .collect();
        let truths = [self.shape(0.01, 0.0), self.shape(0.0, 0.01)];
        std::array::from_fn(|k| {
            let dot = |a: &dyn Fn(usize) -> f64, b: &dyn Fn(usize) -> f64| -> f64 {
                (0..found.len()).map(|i| a(i) * b(i)).sum()
            };
            let (f, t) = (|i: usize| found[i][k], |i: usize| truths[k][i]);
            dot(&f, &t).powi(2) / (dot(&f, &f) * dot(&t, &t))
        })
    }
}

/// Deflections keep their sigma and both modes their shapes, for different second modes of the wing. `WINGS=20` for a table.
#[test]
fn both_modes_have_their_shapes_and_deflections_keep_their_sigma() {
    const LEARNT: usize = 100;
    let wings: usize = std::env::var("WINGS")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(4);
    for (vibrations, second_m) in [
        (ModeShape::Uniform, 0.003),
        (ModeShape::AsItIs, 0.003),
        (ModeShape::Uniform, 0.006),
        (ModeShape::AsItIs, 0.006),
        (ModeShape::AsItIs, 0.03),
    ] {
        let mut rng = rng(512);
        let flights: Vec<VibratingFlight> = (0..wings)
            .map(|_| VibratingFlight::new(&mut rng, second_m, vibrations, 300))
            .collect();
        let of = |from: usize| {
            rms(&flights
                .iter()
                .flat_map(|flight| flight.normalised(from))
                .collect::<Vec<_>>())
        };
        let (all, settled) = (of(1), of(LEARNT));
        let tips: Vec<f64> = flights
            .iter()
            .filter_map(|r| r.results.last())
            .map(|f| f.tip_sigma_m())
            .collect();
        let least = |k: usize| {
            flights
                .iter()
                .map(|flight| flight.assurance(LEARNT)[k])
                .fold(1.0, f64::min)
        };
        let [first, second] = [least(0), least(1)];
        println!(
            "{vibrations:?}, {:2.0} mm: deflections {all:.2} normalised, {settled:.2} after 10 s; sigma of the tip {:.1} mm; least MAC {first:.4}, {second:.4}",
            1e3 * second_m,
            1e3 * median(&tips)
        );
        assert!((0.35..1.3).contains(&all) && (0.35..1.3).contains(&settled));
        assert!(first > 0.999 && second > 0.99, "{vibrations:?} {second_m}");
    }
}
