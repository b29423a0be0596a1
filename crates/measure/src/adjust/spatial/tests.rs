use nalgebra::{DVector, Matrix2, SMatrix, Vector2};

use super::*;
use crate::adjust::example::{orientation, setup};
use crate::estimation::GroupPoint;
use crate::setup::{SetupUncertainty, Width};

#[test]
fn derivatives_match_differences() {
    check_derivatives(setup());
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
    check_derivatives(all);
}

fn check_derivatives(setup: Setup) {
    let orientation = orientation();
    let scene = WingScene::new(&setup, &orientation).unwrap();
    let options = Options {
        curvature_terms: Some(5),
        ..Options::default()
    };
    let observation = |marker| Observation {
        marker,
        pixel: Vector2::new(1900.0, 1500.0),
        covariance_px2: Matrix2::identity(),
    };
    let observations: Vec<_> = (0..9).map(observation).collect();
    let frame_observations = order_by_marker(&setup, &observations).unwrap();
    let input = AdjustmentInput {
        setup: &setup,
        orientation: &orientation,
        scene: &scene,
        options: &options,
    };
    let single = SingleFrame {
        input,
        observations: frame_observations,
        usage: flight::FlightUsage::all_used(1, 9),
        prior_scales: PriorScales::default(),
        widened: WidenedPriors::default(),
        common_displacement: None,
    };
    let frame = FrameProblem::new(
        &single,
        &FrameStart {
            amplitude_per_m: 0.005,
            from: None,
        },
    );
    let p = frame.problem.start.len();
    let global = DVector::from_fn(p, |k, _| match k {
        0..5 => 0.004 / (1.0 + k as f64),
        5..8 => 0.03,
        _ => 2e-3 * (1.0 + (k % 3) as f64),
    });
    let local = DVector::zeros(0);
    let observed: Vec<_> = frame.problem.groups[0]
        .blocks
        .iter()
        .map(|b| b.observed.clone())
        .collect();
    let at = |global: &DVector<f64>, observed: &[DVector<f64>]| {
        let mut blocks = vec![];
        frame
            .linearise(
                &GroupPoint {
                    group: 0,
                    global,
                    local: &local,
                    observed,
                },
                &mut blocks,
            )
            .unwrap();
        blocks
    };
    let here = at(&global, &observed);
    for column in 0..p {
        let mut step = DVector::zeros(p);
        step[column] = 1e-6;
        let (up, down) = (
            at(&(&global + &step), &observed),
            at(&(&global - &step), &observed),
        );
        for (b, block) in here.iter().enumerate() {
            let difference = (&up[b].misclosure - &down[b].misclosure) / 2e-6;
            let at = block.columns.iter().position(|c| *c == column);
            let derivative = at.map_or_else(
                || 0.0 * &difference,
                |at| block.global.column(at).into_owned(),
            );
            let error = (&difference - &derivative).norm();
            assert!(
                error < 1e-5 * (1.0 + difference.norm()),
                "column {column} block {b}: {difference} {derivative}"
            );
        }
    }
    for k in 0..7 {
        let shifted = |d: f64| {
            let mut list = observed.clone();
            list.iter_mut().for_each(|o| o[k] += d);
            at(&global, &list)
        };
        let (up, down) = (shifted(1e-6), shifted(-1e-6));
        for (b, block) in here.iter().enumerate() {
            let difference = (&up[b].misclosure - &down[b].misclosure) / 2e-6;
            let error = (&difference - block.observations.column(k)).norm();
            assert!(
                error < 1e-5 * (1.0 + difference.norm()),
                "observation {k} block {b}"
            );
        }
    }
}
