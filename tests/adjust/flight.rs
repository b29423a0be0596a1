//! Joint adjustment of the frames of a flight, for wings that differ from the model.

use crate::common::beam_truth::{Truth, random_wing, remounted, rms, rng};
use wingd::measure::adjust::{self, Options};

struct Outcome {
    vertical: Vec<f64>,
    horizontal: Vec<f64>,
    normalised: Vec<f64>,
    worst_flight_mm: f64,
    mountings_found: Vec<bool>,
}

/// Flights of 7 frames, the deflection falling from 3.0 m; after two frames the camera is remounted. With `burning`, the fuel
/// fraction falls from the wing's own to 40 % of it, which changes the shape.
fn flights(count: usize, burning: bool, sights: bool) -> Outcome {
    let mut rng = rng(21);
    let mut out = Outcome {
        vertical: vec![],
        horizontal: vec![],
        normalised: vec![],
        worst_flight_mm: 0.0,
        mountings_found: vec![],
    };
    for _ in 0..count {
        let truth = Truth::new(random_wing(&mut rng), 21);
        let setup = truth.surveyed(&mut rng, 0.002, 0.002);
        let orientation = truth.orientation(&mut rng, 0.05, sights);
        let mounts = [
            remounted(&mut rng, &truth.setup) * 0.7,
            remounted(&mut rng, &truth.setup) * 0.7,
        ];
        let mut frames = vec![];
        let mut points = vec![];
        for k in 0..7 {
            let t = k as f64 / 6.0;
            let fuel = truth.fuel() * if burning { 1.0 - 0.6 * t } else { 1.0 };
            let flight = truth.positions_in_flight(3.0 - 1.2 * t, fuel);
            frames.push(truth.observations(&mut rng, &flight, mounts[usize::from(k >= 2)], 0.05));
            points.push(flight);
        }
        let solutions =
            adjust::solve_flight(&setup, &orientation, &frames, &Options::default()).unwrap();
        let before = out.vertical.len();
        for (solution, flight) in solutions.iter().zip(&points) {
            for m in &solution.markers {
                let (Some(p), Some(deflection)) = (m.position_m, m.deflection_m) else {
                    continue;
                };
                let d = p - flight[m.marker];
                out.vertical.push(d.z);
                out.horizontal.push(d.xy().norm());
                let e = deflection.value - (flight[m.marker].z - truth.ground_m[m.marker].z);
                out.normalised.push(e / deflection.sigma.unwrap());
            }
        }
        out.worst_flight_mm = out.worst_flight_mm.max(1e3 * rms(&out.vertical[before..]));
        out.mountings_found
            .push(solutions[6].remarks[0].contains("in 2 mounting(s)"));
    }
    out
}

fn print(what: &str, o: &Outcome) {
    println!(
        "{what}: horizontal {:.1} mm, vertical {:.1} mm (worst flight {:.1}), normalised deflection {:.2}, mountings found {}/{}",
        1e3 * rms(&o.horizontal),
        1e3 * rms(&o.vertical),
        o.worst_flight_mm,
        rms(&o.normalised),
        o.mountings_found.iter().filter(|f| **f).count(),
        o.mountings_found.len()
    );
}

#[test]
fn joint_adjustment_reduces_the_errors_of_shared_shapes() {
    let o = flights(20, false, true);
    print("shared shape", &o);
    assert!(rms(&o.vertical) < 0.004 && rms(&o.horizontal) < 0.005);
    assert!((0.6..1.3).contains(&rms(&o.normalised)));
    assert!(o.mountings_found.iter().filter(|f| **f).count() >= 19);
}

#[test]
fn burning_fuel_changes_the_shape() {
    let o = flights(20, true, true);
    print("burning fuel", &o);
    assert!(rms(&o.vertical) < 0.010);
    assert!((0.6..1.3).contains(&rms(&o.normalised)));
}

#[test]
fn flights_without_ground_observations_keep_their_sigma() {
    let shared = flights(20, false, false);
    print("shared shape, rotation only", &shared);
    assert!(rms(&shared.vertical) < 0.008 && (0.5..1.3).contains(&rms(&shared.normalised)));
    let burning = flights(40, true, false);
    print("burning fuel, rotation only", &burning);
    assert!(rms(&burning.vertical) < 0.008 && (0.7..1.25).contains(&rms(&burning.normalised)));
}
