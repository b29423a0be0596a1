//! The predicted covariance compared with sampled errors, and the tests with their levels. Wings, loads, sides, mountings,
//! survey and images are sampled again in every run.

use crate::common::beam_truth::{Truth, Wing, normal, random_wing, remounted, rms, rng};
use nalgebra::{DMatrix, DVector, Matrix2, Vector2, Vector3};
use rand::rngs::StdRng;
use wingd::measure::adjust::{self, GlobalTest, Options, SigmaKind, Solution};
use wingd::measure::estimation::quality::global_test;
use wingd::measure::estimation::{Block, Group, Linearised, Problem, solve};

const RUNS: usize = 500;

/// Normalised errors.
#[derive(Default)]
struct Errors {
    position: Vec<f64>,
    deflection: Vec<f64>,
    torsion: Vec<f64>,
}

impl Errors {
    fn add(&mut self, truth: &Truth, flight: &[Vector3<f64>], s: &Solution) {
        let risen = |k: usize| flight[k].z - truth.ground_m[k].z;
        for m in s.markers.iter().filter(|m| m.used) {
            let (p, c, l) = (
                m.position_m.unwrap(),
                m.covariance_m2.unwrap(),
                m.deflection_m.unwrap(),
            );
            let d = p - flight[m.marker];
            self.position
                .extend((0..3).map(|k| d[k] / c[(k, k)].sqrt()));
            self.deflection
                .push((l.value - risen(m.marker)) / l.sigma.unwrap());
        }
        let base = (truth.ground_m[19] - truth.ground_m[20]).xy().norm();
        if let Some(angle) = s.torsion[0].angle_rad {
            let expected = (risen(19) - risen(20)).atan2(base);
            self.torsion
                .push((angle.value - expected) / angle.sigma.unwrap());
        }
    }

    fn ratios(&self) -> [f64; 3] {
        [
            rms(&self.position),
            rms(&self.deflection),
            rms(&self.torsion),
        ]
    }
}

#[test]
fn predicted_covariance_covers_sampled_errors() {
    let mut rng = rng(77);
    let (mut errors, mut twist, mut rejected) = (Errors::default(), vec![], 0);
    let options = Options {
        sigma: SigmaKind::Prior,
        snooping_alpha: 0.0,
        ..Options::default()
    };
    for _ in 0..RUNS {
        let truth = Truth::new(random_wing(&mut rng), 21);
        let tip_deflection_m = 2.4 + 0.4 * normal(&mut rng).clamp(-2.0, 2.0);
        let flight = truth.positions_in_flight(tip_deflection_m, truth.fuel());
        let mount = remounted(&mut rng, &truth.setup);
        let setup = truth.surveyed(&mut rng, 0.002, 0.002);
        let orientation = truth.orientation(&mut rng, 0.05, true);
        let seen = truth.observations(&mut rng, &flight, mount, 0.05);
        let s = adjust::solve_spatial(&setup, &orientation, &seen, &options).unwrap();
        rejected += usize::from(s.global_test == Some(GlobalTest::Rejected));
        errors.add(&truth, &flight, &s);
        let section = s.torsion[0].twist_rad.unwrap();
        twist.push(
            (section.value - truth.pair_twist_rad(tip_deflection_m)) / section.sigma.unwrap(),
        );
    }
    let rate = rejected as f64 / RUNS as f64;
    println!(
        "sampled over predicted: position {:.2}, deflection {:.2}, torsion {:.2}, twist {:.2}; global test rejects {:.1} %",
        rms(&errors.position),
        rms(&errors.deflection),
        rms(&errors.torsion),
        rms(&twist),
        1e2 * rate
    );
    for ratio in errors.ratios().into_iter().chain([rms(&twist)]) {
        assert!((0.8..1.25).contains(&ratio), "{ratio}");
    }
    assert!(rate < 0.03);
}

/// Standard deviations of a detector, px: quadrants near the root, flat discs towards the tip.
fn detector_sigma_px(marker: usize) -> (f64, f64) {
    if marker < 10 {
        (0.015, 0.0045)
    } else {
        (0.085, 0.0145)
    }
}

fn detected(rng: &mut StdRng, marker: usize, pixel: &mut Vector2<f64>) -> Matrix2<f64> {
    let (u, v) = detector_sigma_px(marker);
    *pixel += Vector2::new(u * normal(rng), v * normal(rng));
    Matrix2::new(u * u, 0.0, 0.0, v * v)
}

/// Images far more precise than the model: the reported standard deviations must not become too small.
#[test]
fn covariance_holds_where_the_images_are_sharper_than_the_model() {
    let mut rng = rng(78);
    let mut errors = Errors::default();
    let options = Options {
        sigma: SigmaKind::Prior,
        ..Options::default()
    };
    for _ in 0..200 {
        let truth = Truth::new(random_wing(&mut rng), 21);
        let tip_deflection_m = 2.4 + 0.4 * normal(&mut rng).clamp(-2.0, 2.0);
        let flight = truth.positions_in_flight(tip_deflection_m, truth.fuel());
        let mount = remounted(&mut rng, &truth.setup);
        let setup = truth.surveyed(&mut rng, 0.002, 0.002);
        let mut orientation = truth.orientation(&mut rng, 0.0, true);
        for sight in &mut orientation.ground {
            sight.covariance_px2 = detected(&mut rng, sight.marker, &mut sight.pixel);
        }
        let mut seen = truth.observations(&mut rng, &flight, mount, 0.0);
        for o in &mut seen {
            o.covariance_px2 = detected(&mut rng, o.marker, &mut o.pixel);
        }
        let s = adjust::solve_spatial(&setup, &orientation, &seen, &options).unwrap();
        errors.add(&truth, &flight, &s);
    }
    let ratios = errors.ratios();
    println!("sharp images: sampled over predicted: position, deflection, torsion {ratios:.2?}");
    assert!(errors.torsion.len() > 180);
    for ratio in ratios {
        assert!((0.8..1.25).contains(&ratio), "{ratio}");
    }
}

#[test]
fn the_global_test_rejects_at_its_level() {
    let mut rng = rng(3);
    let (runs, alpha) = (4000, 0.05);
    let mut rejected = 0;
    for _ in 0..runs {
        let group = |x: f64, r: &mut _| Group {
            local: DVector::zeros(0),
            priors: vec![],
            blocks: vec![Block {
                observed: DVector::from_element(1, 1.0 + 0.5 * x + 0.1 * normal(r)),
                covariance: DMatrix::from_element(1, 1, 0.01),
            }],
        };
        let problem = Problem {
            start: DVector::zeros(2),
            missing: vec!["a", "b"],
            priors: vec![],
            known: None,
            groups: (0..12).map(|k| group(k as f64, &mut rng)).collect(),
        };
        let fit = solve(&problem, |at| {
            let x = at.group as f64;
            Ok(Linearised {
                misclosure: DVector::from_element(
                    1,
                    at.global[0] + at.global[1] * x - at.observed[0],
                ),
                columns: vec![0, 1],
                global: DMatrix::from_row_slice(1, 2, &[1.0, x]),
                local: DMatrix::zeros(1, 0),
                observations: DMatrix::from_element(1, 1, -1.0),
            })
        })
        .unwrap();
        rejected += usize::from(
            global_test(fit.omega, fit.redundancy, alpha) == Some(GlobalTest::Rejected),
        );
    }
    let rate = rejected as f64 / runs as f64;
    println!("rejects {:.2} % at 5 %", 1e2 * rate);
    assert!((rate - alpha).abs() < 0.011, "{rate}");
}

#[test]
fn a_wrong_survey_point_of_twice_its_minimal_detectable_bias_is_found() {
    let mut rng = rng(9);
    let (mut found, mut runs) = (0, 0);
    for marker in [3, 8, 12, 16] {
        for _ in 0..15 {
            let truth = Truth::new(Wing::default(), 21);
            let flight = truth.positions_in_flight(2.6, truth.fuel());
            let mount = remounted(&mut rng, &truth.setup) * 0.5;
            let mut setup = truth.surveyed(&mut rng, 0.002, 0.002);
            let orientation = truth.orientation(&mut rng, 0.05, true);
            let seen = truth.observations(&mut rng, &flight, mount, 0.05);
            let clean =
                adjust::solve_spatial(&setup, &orientation, &seen, &Options::default()).unwrap();
            let Some(bias) = clean.markers[marker].minimal_detectable_bias_m else {
                continue;
            };
            // Y of the wing frame is up, z of the survey.
            setup.markers[marker].position_m.z += 2.0 * bias.y;
            let solution =
                adjust::solve_spatial(&setup, &orientation, &seen, &Options::default()).unwrap();
            runs += 1;
            found += usize::from(!solution.markers[marker].used);
        }
    }
    println!("found {found} of {runs}");
    assert!(runs >= 55 && found as f64 >= 0.9 * runs as f64);
}
