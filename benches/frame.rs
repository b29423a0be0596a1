//! The stages of one real 12 MP frame, compared with a plain read of its pixels; `make bench` runs it.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use wingd::installation;
use wingd::measure::detect;
use wingd::measure::identify::{self, MAX_DEFLECTION_CHANGE_M, WingView};
use wingd::pipeline::decode::decode_image;

fn benches(c: &mut Criterion) {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev");
    let read = |name: &str| std::fs::read(fixture.join("frames").join(name)).expect("a frame of the fixtures");
    let (ground, flight) = (read("ground.jpg"), read("flight-1.jpg"));
    let raster = decode_image(&flight, None).expect("decodes");
    let setup = installation::load_without_orientation(&fixture.join("installation")).expect("sound").setup;
    let on_ground = detect::detect(&decode_image(&ground, None).expect("decodes")).markers;
    let orientation =
        identify::estimate_orientation(&setup, std::slice::from_ref(&on_ground)).expect("orients").orientation;
    let markers = detect::detect(&raster).markers;
    let wing = WingView::in_flight(&setup, &orientation);
    let identities = wing.identify_markers(&markers).expect("identifies");
    let predictions = wing.predict_next_frame(&markers, &identities, MAX_DEFLECTION_CHANGE_M);
    let mut group = c.benchmark_group("frame");
    group.sample_size(20);
    group.bench_function("read", |b| {
        b.iter(|| raster.luma().chunks(64).map(|k| k.iter().map(|&v| u32::from(v)).sum::<u32>()).max());
    });
    group.bench_function("decode", |b| b.iter(|| decode_image(&flight, None)));
    group.bench_function("detect full", |b| b.iter(|| detect::detect(&raster)));
    group.bench_function("detect guided", |b| b.iter(|| detect::detect_guided(&raster, &predictions)));
    group.bench_function("orient", |b| {
        b.iter(|| identify::estimate_orientation(&setup, std::slice::from_ref(&on_ground)).is_ok());
    });
    group.bench_function("identify", |b| b.iter(|| wing.identify_markers(&markers).is_ok()));
    group.bench_function("remove perspective bias", |b| {
        b.iter(|| wing.remove_perspective_bias(&markers, &identities));
    });
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
