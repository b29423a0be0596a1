use nalgebra::{Matrix2, Vector2};

use super::*;
use crate::adjust::example::{orientation, setup};
use crate::adjust::flight::flight_problem::FlightProblem;
use crate::setup::{SetupUncertainty, Width, WingBreak};
use crate::widths::Unknown;

/// Names of the unknowns that have a prior in a flight of one frame.
fn unknowns_with_prior(uncertainty: SetupUncertainty) -> Vec<&'static str> {
    let breaks = vec![WingBreak {
        span_m: 9.5,
        sweep_rad: Some(0.05),
    }];
    let (setup, orientation) = (
        Setup {
            breaks,
            uncertainty,
            ..setup()
        },
        orientation(),
    );
    let scene = WingScene::new(&setup, &orientation).unwrap();
    let options = Options::default();
    let input = AdjustmentInput {
        setup: &setup,
        orientation: &orientation,
        scene: &scene,
        options: &options,
    };
    let observation = |marker| Observation {
        marker,
        pixel: Vector2::new(1900.0, 1500.0),
        covariance_px2: Matrix2::identity(),
    };
    let frames = [(0..9).map(observation).collect()];
    let mountings = FrameMountings::undetermined(None);
    let hyperparameters = FlightHyperparameters::initial(&input, frames.len(), mountings);
    let flight = Flight::new(input, &frames, hyperparameters).unwrap();
    let problem = FlightProblem::new(&flight, None).problem;
    let of_frames = problem.groups.iter().flat_map(|group| &group.priors);
    problem
        .priors
        .iter()
        .chain(of_frames)
        .map(|prior| prior.name.unknown)
        .collect()
}

#[test]
fn each_width_is_the_prior_of_its_unknowns() {
    // The prior of the surface and the mount's repeatability remain.
    let always = [Unknown::AxisHeight, Unknown::MountingRotation];
    // Lenses and sensors are not stabilised by default.
    let usual = SetupUncertainty::DEFAULT.with_width(Width::Stabilisation, 1.0);
    let defaults = unknowns_with_prior(usual);
    for row in Width::ROWS {
        let without = unknowns_with_prior(usual.with_width(row.width, 0.0));
        for unknown in row.unknowns {
            assert!(
                defaults.contains(&unknown.name()),
                "{unknown:?} has no prior"
            );
            let gone = !without.contains(&unknown.name());
            assert!(
                gone != always.contains(unknown),
                "{:?} {unknown:?}",
                row.width
            );
        }
        let kept = defaults
            .iter()
            .filter(|name| !row.unknowns.iter().any(|unknown| unknown.name() == **name));
        assert!(
            kept.into_iter().all(|name| without.contains(name)),
            "{:?}",
            row.width
        );
    }
}
