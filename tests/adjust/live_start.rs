//! Promise: the first live frames are solved although their unknowns are poorly separable.

use std::path::Path;

use nalgebra::{Matrix2, Vector2};
use wingd::measure::adjust::{LiveAdjustment, Observation, Options};
use wingd::measure::setup::SetupUncertainty;

#[test]
fn the_first_frames_are_solved_if_rounding_rejects_the_last_steps() {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/live-start");
    let installation = wingd::installation::load(&fixture.join("installation")).unwrap();
    let orientation = installation.require_orientation().unwrap().clone();
    let mut frames: Vec<(u32, Vec<Observation>)> = vec![];
    for row in csv::Reader::from_path(fixture.join("observations.csv"))
        .unwrap()
        .records()
    {
        let row = row.unwrap();
        let number = |k: usize| row[k].parse::<f64>().unwrap();
        let marker = installation
            .setup
            .markers
            .iter()
            .position(|m| m.id == row[1])
            .unwrap();
        let observation = Observation {
            marker,
            pixel: Vector2::new(number(2), number(3)),
            covariance_px2: Matrix2::new(number(4), number(5), number(5), number(6)),
        };
        let frame: u32 = row[0].parse().unwrap();
        match frames.last_mut().filter(|last| last.0 == frame) {
            Some((_, list)) => list.push(observation),
            None => frames.push((frame, vec![observation])),
        }
    }
    assert_eq!(frames.len(), 6);
    // As recorded, without in-flight effects, and with the default priors.
    for flight in [SetupUncertainty::from_drawings(), SetupUncertainty::DEFAULT] {
        let mut setup = installation.setup.clone();
        setup.uncertainty = setup.uncertainty.with_flight_effects(&flight);
        let mut live = LiveAdjustment::new(setup, orientation.clone(), Options::default()).unwrap();
        for (frame, observations) in &frames {
            let solution = live
                .adjust_frame(observations, 0.1)
                .unwrap_or_else(|e| panic!("frame {frame}: {e}"));
            assert!(
                solution.iterations < 200,
                "frame {frame}: {} iterations",
                solution.iterations
            );
        }
        assert_eq!(
            live.mounting_count(),
            1,
            "nothing was taken for a mount disturbance"
        );
    }
}
