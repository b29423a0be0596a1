//! Rainflow cycles compared with two public packages, moments compared with a beam of known stiffness that differs from the model.

use std::fmt::Write;

use crate::common::beam_truth::{Truth, normal, random_wing, remounted, rms, rng};
use nalgebra::{DMatrix, DVector};
use sha2::{Digest, Sha256};
use wingd::measure::adjust::{self, Options, SigmaKind, Solution};
use wingd::measure::setup::{SetupUncertainty, StiffnessSection, Width};
use wingd::measure::stress::{
    BendingCurvature, BendingMoment, analyse_sampling, bending_length_m, count_flight_cycles,
    ground_air_ground, rainflow, relative_damage,
};

/// Results of `rainflow` and `pylife` (tests/rainflow/README.md).
const CYCLES: &str = include_str!("../rainflow/cycles.csv");

struct SplitMix64(u64);

impl SplitMix64 {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }
}

/// Random history, as in tests/validation/cycles.py.
fn history(number: u64) -> Vec<f64> {
    let mut draw = SplitMix64(number);
    let length = 2 + draw.next() % 399;
    let (walks, plateaus) = (number % 2 == 1, number % 4 >= 2);
    let mut values: Vec<f64> = vec![];
    for _ in 0..length {
        let step = (draw.next() % 2_000_001) as f64 - 1e6;
        let stays = draw.next() % 10 < 3;
        values.push(match values.last() {
            Some(last) if plateaus && stays => *last,
            Some(last) if walks => last + step,
            _ => step,
        });
    }
    values
}

#[test]
fn rainflow_counts_as_two_public_packages_do() {
    let mut compared = 0;
    for line in CYCLES.lines().skip(2) {
        let cells: Vec<&str> = line.split(',').collect();
        let values = history(cells[0].parse().unwrap());
        assert_eq!(values.len(), cells[1].parse::<usize>().unwrap(), "{line}");
        let cycles = rainflow::count_cycles(&values);
        let count: f64 = cycles.iter().map(|c| c.count).sum();
        assert_eq!(count, cells[2].parse::<f64>().unwrap(), "{line}");
        let mut lines: Vec<String> = cycles
            .iter()
            .map(|c| format!("{} {} {}", c.range, 2.0 * c.mean, 2.0 * c.count))
            .collect();
        lines.sort();
        let digest = Sha256::digest(lines.join("\n").as_bytes());
        let hex = digest.iter().take(8).fold(String::new(), |mut text, byte| {
            write!(text, "{byte:02x}").unwrap();
            text
        });
        assert_eq!(hex, cells[3], "{line}");
        compared += 1;
    }
    assert_eq!(compared, 1000);
}

const SHARES: [f64; 9] = [0.02, 0.1, 0.2, 0.35, 0.5, 0.6, 0.7, 0.8, 0.9];
const ROOT_EI_N_M2: f64 = 2e9;
/// 600 beams know the normalised error to 0.02; 150 know it to 0.04.
const BEAMS: usize = 600;

fn curvature(s: &Solution, length_m: f64, root_sigma_m: f64) -> BendingCurvature {
    let p = s
        .parameters
        .iter()
        .find(|p| p.kind.name() == "curvature_per_m")
        .unwrap();
    let n = p.values.len();
    let sigma = |k: usize| p.values[k].sigma.unwrap();
    let covariance = DMatrix::from_fn(n, n, |i, j| s.correlation[(i, j)] * sigma(i) * sigma(j));
    let coefficients_per_m = DVector::from_iterator(n, p.values.iter().map(|v| v.value));
    // These beams have no steps.
    BendingCurvature {
        coefficients_per_m,
        covariance,
        length_m,
        root_sigma_m,
        steps: 0.0,
    }
}

/// Normalised errors of the moments, per fraction of the length.
fn errors(
    seed: u64,
    runs: usize,
    priors: Option<SetupUncertainty>,
    stiffness_sigma: f64,
) -> Vec<Vec<f64>> {
    let mut rng = rng(seed);
    let options = Options {
        sigma: SigmaKind::Prior,
        snooping_alpha: 0.0,
        ..Options::default()
    };
    let mut errors = vec![vec![]; SHARES.len()];
    for _ in 0..runs {
        let truth = Truth::new(random_wing(&mut rng), 21);
        let deflection_m = 2.4 + 0.4 * normal(&mut rng).clamp(-2.0, 2.0);
        let flight = truth.positions_in_flight(deflection_m, truth.fuel());
        let bent = truth.curvature_per_m(deflection_m, truth.fuel(), &SHARES);
        let mount = remounted(&mut rng, &truth.setup);
        let mut setup = truth.surveyed(&mut rng, 0.002, 0.002);
        let orientation = truth.orientation(&mut rng, 0.05, true);
        let seen = truth.observations(&mut rng, &flight, mount, 0.05);
        if let Some(priors) = priors {
            setup.root_offset_m += priors[Width::RootOffset] * normal(&mut rng);
            setup.uncertainty = priors;
        }
        let s = adjust::solve_spatial(&setup, &orientation, &seen, &options).unwrap();
        let length_m = bending_length_m(&setup, &orientation).unwrap();
        let line = curvature(&s, length_m, setup.uncertainty[Width::RootOffset]);
        let wrong = 1.0 + stiffness_sigma * normal(&mut rng);
        for (k, share) in SHARES.iter().enumerate() {
            let ei = ROOT_EI_N_M2 * truth.stiffness_share(*share);
            let section = StiffnessSection {
                s_m: share * truth.length_m(),
                ei_n_m2: ei * wrong,
                sigma_ei_n_m2: stiffness_sigma * ei * wrong,
                ground_n_m: 0.0,
                ultimate_n_m: None,
            };
            let moment = line.bending_moment(&section);
            errors[k].push((moment.value - ei * bent[k]) / moment.sigma);
        }
    }
    errors
}

fn ratio(title: &str, errors: &[Vec<f64>]) -> f64 {
    let each: Vec<f64> = errors.iter().map(|e| rms(e)).collect();
    let all = rms(&errors.concat());
    println!("{title}: all {all:.2}; at {SHARES:?} of the length: {each:.2?}");
    all
}

#[test]
fn moments_of_beams_of_known_stiffness_keep_their_sigma() {
    for (title, stiffness_sigma) in [("stiffness fixed", 0.0), ("stiffness 3 %", 0.03)] {
        let all = ratio(title, &errors(91, BEAMS, None, stiffness_sigma));
        assert!((0.8..1.25).contains(&all), "{title}: {all}");
    }
}

#[test]
fn moments_keep_their_sigma_with_an_unknown_root() {
    let priors = SetupUncertainty::from_drawings().with_width(Width::RootOffset, 0.3);
    let all = ratio("root 0.3 m", &errors(92, BEAMS, Some(priors), 0.03));
    assert!((0.8..1.25).contains(&all), "{all}");
}

/// Moments of gusts about a slowly changing load, N m: a wing with a 1 Hz bending mode, excited once per second on average.
fn gusts(seed: u64, step_s: f64, lasting_s: f64) -> Vec<f64> {
    let mut rng = rng(seed);
    let omega = std::f64::consts::TAU;
    let (mut place, mut speed, mut struck) = (0.0, 0.0, 0.0_f64);
    let count = (lasting_s / step_s) as usize;
    (0..count)
        .map(|k| {
            let at_s = step_s * k as f64;
            struck += (normal(&mut rng) * (2.0 * step_s / 0.3_f64).sqrt()) - struck * step_s / 0.3;
            speed += step_s * (omega * omega * (0.6 * struck - place) - 2.0 * 0.05 * omega * speed);
            place += step_s * speed;
            10.0 + 0.5 * (omega * at_s / 200.0).sin() + place
        })
        .collect()
}

/// Damage and its standard deviation for an S-N slope, from some samples of the history.
fn damage(history: &[f64], step_s: f64, kept: &[usize], slope: f64) -> (f64, f64, bool) {
    let moment = |k: &usize| BendingMoment {
        value: history[*k],
        sigma: 0.01,
        sigma_by_curvature: 0.01,
        sigma_by_stiffness: 0.0,
    };
    let moments: Vec<BendingMoment> = kept.iter().map(moment).collect();
    let times: Vec<f64> = kept.iter().map(|k| *k as f64 * step_s).collect();
    let sampled = analyse_sampling(&times, 1.0);
    let (flight, whole) = (
        count_flight_cycles(&moments),
        ground_air_ground(&moments).unwrap(),
    );
    let found = relative_damage(
        &flight,
        &whole,
        slope,
        None,
        (0.0, sampled.unseen_fractions()),
    );
    (
        found.relative,
        found.sigma_relative,
        sampled.has_countable_cycles(),
    )
}

#[test]
fn damage_of_sampled_histories_is_that_of_the_dense_one_within_its_sigma() {
    const STEP_S: f64 = 0.005;
    type Kept = fn(usize) -> bool;
    let all: Kept = |_| true;
    // 3 % of the frames are skipped irregularly; a gap takes 20 % of the time.
    let skipped: Kept = |k| k.wrapping_mul(2_654_435_761) % 1000 >= 30;
    let hole: Kept = |k| !(2000..3200).contains(&k);
    for (title, keeps) in [("10 Hz", all), ("3 % skipped", skipped), ("a hole", hole)] {
        for slope in [3.0, 5.0, 10.0] {
            let one = |seed: u64| {
                let history = gusts(seed, STEP_S, 600.0);
                let dense: Vec<usize> = (0..history.len()).collect();
                // A period of 0.1 s, which a camera keeps to a few ms.
                let kept: Vec<usize> = (1..5999)
                    .filter(|k| keeps(*k))
                    .map(|k| 20 * k + (k * 7919) % 3)
                    .collect();
                let (truth, _, _) = damage(&history, STEP_S, &dense, slope);
                let (found, sigma, counted) = damage(&history, STEP_S, &kept, slope);
                assert!(counted, "{title}");
                (found - truth) / sigma
            };
            let ratios: Vec<f64> = (0..12).map(|seed| one(40 + seed)).collect();
            println!("{title}, slope {slope}: {ratios:.2?}");
            // The sigma covers twice the loss of cycles; at slope 10 nearly none are lost.
            assert!(
                rms(&ratios) <= 1.0 && (slope > 5.0 || rms(&ratios) > 0.2),
                "{title}, slope {slope}: {ratios:?}"
            );
        }
    }
}
