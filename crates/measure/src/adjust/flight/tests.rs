use nalgebra::{DVector, Matrix2, SMatrix, Vector2};

use super::frames::Flight;
use super::hyperparameters::FlightHyperparameters;
use super::knowledge::Knowledge;
use super::*;
use crate::adjust::example::{orientation, setup};
use crate::adjust::flight::flight_problem::FlightProblem;
use crate::estimation::{GroupPoint, Linearised};
use crate::setup::{SetupUncertainty, Width, WingBreak};
use crate::widths::Unknown;

/// Problem of a flight of one frame, and its scene.
fn single_frame_problem(setup: &Setup, knowledge: Knowledge) -> (FlightProblem, WingScene) {
    let orientation = orientation();
    let scene = WingScene::new(setup, &orientation).unwrap();
    let options = Options::default();
    let input = AdjustmentInput {
        setup,
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
    let mountings = mountings::FrameMountings::undetermined(None);
    let hyperparameters = FlightHyperparameters::initial(&input, frames.len(), mountings);
    let flight = Flight::new(input, &frames, hyperparameters, knowledge).unwrap();
    (FlightProblem::new(&flight, None), scene)
}

/// Names of the unknowns that have a prior in a flight of one frame.
fn unknowns_with_prior(uncertainty: SetupUncertainty) -> Vec<&'static str> {
    let breaks = vec![WingBreak {
        span_m: 9.5,
        sweep_rad: Some(0.05),
    }];
    let setup = Setup {
        breaks,
        uncertainty,
        ..setup()
    };
    let problem = single_frame_problem(&setup, Knowledge::Shared).0.problem;
    let of_frames = problem.groups.iter().flat_map(|group| &group.priors);
    problem
        .priors
        .iter()
        .chain(of_frames)
        .map(|prior| prior.name.unknown)
        .collect()
}

#[test]
fn derivatives_match_differences() {
    // All terms that an installation may have except the panes', which the scene's tests cover.
    let lens = Some(SMatrix::identity() * 1e-8);
    let uncertainty = SetupUncertainty {
        lens,
        ..SetupUncertainty::DEFAULT.with_width(Width::Stabilisation, 1e-3)
    };
    let mut all = Setup {
        uncertainty,
        ..setup()
    };
    (all.markers[0].fixed, all.markers[0].flight_motion_m) = (true, 5e-4);
    (3..5).for_each(|k| all.markers[k].part = Some("aileron".into()));
    for knowledge in [Knowledge::Alone, Knowledge::Shared] {
        check_derivatives(&setup(), knowledge);
        check_derivatives(&all, knowledge);
    }
}

fn check_derivatives(setup: &Setup, knowledge: Knowledge) {
    let (flight_problem, scene) = single_frame_problem(setup, knowledge);
    let problem = &flight_problem.problem;
    let layout = &flight_problem.layouts[0];
    for (group, data) in problem.groups.iter().enumerate() {
        let observed: Vec<_> = data.blocks.iter().map(|b| b.observed.clone()).collect();
        let global = problem.start.map_with_location(|k, _, start| {
            let survey = start.abs() > 0.1;
            if survey {
                start
            } else {
                2e-3 * (1.0 + (k % 3) as f64)
            }
        });
        let curvatures = layout.curvature_terms;
        let local = DVector::from_fn(data.local.len(), |k, _| match k {
            _ if k < curvatures => 0.004 / (1.0 + k as f64),
            _ if k < curvatures + layout.twist_terms => 0.03,
            _ => 2e-3,
        });
        let at = |global: &DVector<f64>, local: &DVector<f64>, observed: &[DVector<f64>]| {
            let mut blocks = vec![];
            let point = GroupPoint {
                group,
                global,
                local,
                observed,
            };
            flight_problem
                .linearise(&scene, &point, &mut blocks)
                .unwrap();
            blocks
        };
        let here = at(&global, &local, &observed);
        let check = |ends: [Vec<Linearised>; 2], by: &dyn Fn(&Linearised) -> DVector<f64>| {
            let [up, down] = ends;
            for (b, block) in here.iter().enumerate() {
                let difference = (&up[b].misclosure - &down[b].misclosure) / 2e-6;
                let derivative = by(block);
                let error = (&difference - &derivative).norm();
                assert!(
                    error < 1e-5 * (1.0 + difference.norm()),
                    "group {group} block {b}: {difference} {derivative}"
                );
            }
        };
        let step = |count: usize, k: usize, size: f64| {
            let mut step = DVector::zeros(count);
            step[k] = size;
            step
        };
        for k in 0..global.len() {
            let moved = |size| at(&(&global + step(global.len(), k, size)), &local, &observed);
            check([1e-6, -1e-6].map(moved), &|block| {
                let own = block.columns.iter().position(|column| *column == k);
                let none = 0.0 * &block.misclosure;
                own.map_or(none, |own| block.global.column(own).into_owned())
            });
        }
        for k in 0..local.len() {
            let moved = |size| at(&global, &(&local + step(local.len(), k, size)), &observed);
            check([1e-6, -1e-6].map(moved), &|block| {
                block.local.column(k).into_owned()
            });
        }
        for k in 0..2 {
            let moved = |size| {
                let mut list = observed.clone();
                list.iter_mut().for_each(|o| o[k] += size);
                at(&global, &local, &list)
            };
            check([1e-6, -1e-6].map(moved), &|block| {
                block.observations.column(k).into_owned()
            });
        }
    }
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
