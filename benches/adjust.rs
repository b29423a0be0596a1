//! Speed of the adjustments: 21 markers, default priors; the spatial problem without in-flight effects is also that of
//! `benches/scipy_peer.py`.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "../tests/common/mod.rs"]
mod common;

use common::beam_truth::{Truth, Wing, remounted, rng};
use criterion::{Criterion, criterion_group, criterion_main};
use wingd::measure::adjust::{self, LiveAdjustment, Observation, Options};
use wingd::measure::setup::{Setup, SetupUncertainty};

fn adjustments(c: &mut Criterion) {
    let mut rng = rng(1);
    let truth = Truth::new(Wing::default(), 21);
    let mount = remounted(&mut rng, &truth.setup);
    let laboratory = truth.surveyed(&mut rng, 0.002, 0.002);
    let setup = Setup {
        uncertainty: SetupUncertainty::DEFAULT,
        ..laboratory.clone()
    };
    let orientation = truth.orientation(&mut rng, 0.05, true);
    let options = Options::default();
    let mut frame = |k: usize, n: usize| -> Vec<Observation> {
        let points = truth.positions_in_flight(3.0 - 1.2 * k as f64 / n as f64, truth.fuel());
        truth.observations(&mut rng, &points, mount, 0.05)
    };
    let one = frame(0, 1);
    c.bench_function("profile, 21 markers", |b| {
        b.iter(|| adjust::solve_profile(&setup, &orientation, &one, &options).unwrap())
    });
    c.bench_function("spatial, 21 markers", |b| {
        b.iter(|| adjust::solve_spatial(&setup, &orientation, &one, &options).unwrap())
    });
    c.bench_function("spatial without in-flight effects, 21 markers", |b| {
        b.iter(|| adjust::solve_spatial(&laboratory, &orientation, &one, &options).unwrap())
    });
    let mut live =
        LiveAdjustment::new(setup.clone(), orientation.clone(), options.clone()).unwrap();
    c.bench_function("live, 21 markers", |b| {
        b.iter(|| live.adjust_frame(&one, 0.1).unwrap())
    });
    for n in [10, 85] {
        let frames: Vec<_> = (0..n).map(|k| frame(k, n)).collect();
        let mut group = c.benchmark_group("flight");
        group.sample_size(10);
        group.bench_function(format!("{n} frames"), |b| {
            b.iter(|| adjust::solve_flight(&setup, &orientation, &frames, &options).unwrap())
        });
    }
}

criterion_group!(benches, adjustments);
criterion_main!(benches);
