//! Orientation and identification of one frame with false candidates and hidden markers.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;

use common::synthetic::{Conditions, World};
use criterion::{Criterion, criterion_group, criterion_main};
use wingd::measure::identify::{MAX_DEFLECTION_CHANGE_M, WingView, estimate_orientation};
use wingd::measure::setup::Orientation;

fn stages(c: &mut Criterion) {
    let conditions = Conditions {
        noise_px: 0.1,
        hidden: 0.1,
        false_ones: 10,
        mount_px: 20.0,
        deflection_m: (2.0, 2.0),
    };
    let world = World::random(5, &conditions);
    let ground = vec![world.ground_view(5, &conditions).detections];
    let flight = world.flight_view(2.0, 5, &conditions).detections;
    let setup = &world.setup;
    let known = Orientation::from_rotation(world.camera_from_survey);
    c.bench_function("orient", |b| {
        b.iter(|| estimate_orientation(black_box(setup), black_box(&ground)).unwrap())
    });
    c.bench_function("identify", |b| {
        b.iter(|| {
            WingView::in_flight(black_box(setup), &known)
                .identify_markers(black_box(&flight))
                .unwrap()
        })
    });
    let identities = WingView::in_flight(setup, &known)
        .identify_markers(&flight)
        .unwrap();
    c.bench_function("remove_perspective_bias", |b| {
        b.iter(|| {
            WingView::in_flight(black_box(setup), &known)
                .remove_perspective_bias(black_box(&flight), &identities)
        })
    });
    c.bench_function("predict", |b| {
        b.iter(|| {
            WingView::in_flight(black_box(setup), &known).predict_next_frame(
                black_box(&flight),
                &identities,
                MAX_DEFLECTION_CHANGE_M,
            )
        })
    });
}

criterion_group!(benches, stages);
criterion_main!(benches);
