//! The spatial adjustment for wings that differ from its model: accuracy, outliers, signs.

use crate::common::beam_truth::{Truth, Wing, median, normal, random_wing, remounted, rms, rng};
use nalgebra::Vector3;
use wingd::measure::adjust::{self, Options, Solution};

/// Errors over many wings.
#[derive(Default)]
struct Errors {
    horizontal: Vec<f64>,
    vertical: Vec<f64>,
    deflection: Vec<f64>,
    normalised_deflection: Vec<f64>,
    torsion_deg: Vec<f64>,
    factor: Vec<f64>,
    unused: usize,
}

impl Errors {
    fn add(&mut self, truth: &Truth, flight: &[Vector3<f64>], solution: &Solution) {
        for m in &solution.markers {
            let (Some(p), Some(deflection)) = (m.position_m, m.deflection_m) else {
                self.unused += 1;
                continue;
            };
            let d = p - flight[m.marker];
            self.horizontal.push(d.xy().norm());
            self.vertical.push(d.z);
            let e = deflection.value - (flight[m.marker].z - truth.ground_m[m.marker].z);
            self.deflection.push(e);
            self.normalised_deflection
                .push(e / deflection.sigma.unwrap());
        }
        let n = flight.len();
        let (a, b) = (n - 2, n - 1);
        let deflection = |k: usize| flight[k].z - truth.ground_m[k].z;
        let base = (truth.ground_m[a] - truth.ground_m[b]).xy().norm();
        let angle = (deflection(a) - deflection(b)).atan2(base).to_degrees();
        if let Some(found) = solution.torsion[0].angle_rad {
            self.torsion_deg.push(found.value.to_degrees() - angle);
        }
        self.factor.push(solution.variance_factor.unwrap());
    }

    fn print(&self, what: &str) {
        println!(
            "{what}: horizontal {:.1} mm, vertical {:.1} mm, deflection {:.1} mm, normalised {:.2}, torsion {:.3} deg, factor {:.2}, unused {}",
            1e3 * rms(&self.horizontal),
            1e3 * rms(&self.vertical),
            1e3 * rms(&self.deflection),
            rms(&self.normalised_deflection),
            rms(&self.torsion_deg),
            median(&self.factor),
            self.unused
        );
    }
}

fn fleet(wings: usize, survey_m: f64, sigma_px: f64, sights: bool) -> Errors {
    let mut rng = rng(11);
    let mut errors = Errors::default();
    for _ in 0..wings {
        let truth = Truth::new(random_wing(&mut rng), 21);
        let deflection = 2.2 + normal(&mut rng).clamp(-2.0, 2.0) * 0.5;
        let flight = truth.positions_in_flight(deflection, truth.fuel());
        let mount = remounted(&mut rng, &truth.setup) * 0.7;
        let setup = truth.surveyed(&mut rng, survey_m, 0.002);
        let orientation = truth.orientation(&mut rng, sigma_px, sights);
        let seen = truth.observations(&mut rng, &flight, mount, sigma_px);
        let solution =
            adjust::solve_spatial(&setup, &orientation, &seen, &Options::default()).unwrap();
        errors.add(&truth, &flight, &solution);
    }
    errors
}

#[test]
fn single_frames_with_ground_observations_reach_millimetres() {
    let e = fleet(60, 0.002, 0.05, true);
    e.print("2 mm, 0.05 px, ground observations");
    assert!(rms(&e.horizontal) < 0.004 && rms(&e.vertical) < 0.006);
    assert!(rms(&e.torsion_deg) < 0.05);
    assert!((0.7..1.3).contains(&rms(&e.normalised_deflection)));
}

#[test]
fn single_frames_without_them_stay_within_the_bound_of_pitch_and_bending() {
    let e = fleet(60, 0.002, 0.05, false);
    e.print("2 mm, 0.05 px, rotation only");
    assert!(rms(&e.horizontal) < 0.006 && rms(&e.vertical) < 0.020);
    assert!((0.6..1.3).contains(&rms(&e.normalised_deflection)));
}

#[test]
fn at_the_papers_noise_spatial_is_far_closer_than_profile() {
    let mut rng = rng(5);
    let (mut spatial, mut profile) = (vec![], vec![]);
    for _ in 0..20 {
        let truth = Truth::new(Wing::default(), 21);
        let flight = truth.positions_in_flight(3.1, truth.fuel());
        let mount = remounted(&mut rng, &truth.setup) * 0.3;
        let setup = truth.surveyed(&mut rng, 0.005, 0.002);
        let orientation = truth.orientation(&mut rng, 5.0, false);
        let seen = truth.observations(&mut rng, &flight, mount, 5.0);
        let options = Options {
            snooping_alpha: 0.0,
            ..Options::default()
        };
        for (list, solution) in [
            (
                &mut spatial,
                adjust::solve_spatial(&setup, &orientation, &seen, &options).unwrap(),
            ),
            (
                &mut profile,
                adjust::solve_profile(&setup, &orientation, &seen, &options).unwrap(),
            ),
        ] {
            list.extend(
                solution
                    .markers
                    .iter()
                    .filter_map(|m| Some((m.position_m? - flight[m.marker]).norm())),
            );
        }
    }
    let ratio = rms(&profile) / rms(&spatial);
    println!(
        "5 px, 5 mm: spatial {:.1} mm, profile {:.1} mm",
        1e3 * rms(&spatial),
        1e3 * rms(&profile)
    );
    assert!(ratio > 8.0, "{ratio}");
}
