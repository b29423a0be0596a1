//! The stages of one real 12 MP frame, compared with a plain read of its pixels; `make bench` runs it.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Matrix2;
use wingd::installation;
use wingd::measure::detect;
use wingd::measure::identify::{self, MAX_DEFLECTION_CHANGE_M, WingView};
use wingd::measure::observation::Observation;
use wingd::measure::points::cut_template;
use wingd::measure::setup::{Orientation, Shape};
use wingd::measure::view::process_frame;
use wingd::pipeline::decode::decode_image;
use wingd_simulate::render::{Light, Scene, SceneOptions, SceneSide};

fn benches(c: &mut Criterion) {
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev");
    let read = |name: &str| {
        std::fs::read(fixture.join("frames").join(name)).expect("a frame of the fixtures")
    };
    let (ground, flight) = (read("ground.jpg"), read("flight-1.jpg"));
    let raster = decode_image(&flight, None).expect("decodes");
    let setup = installation::load_without_orientation(&fixture.join("installation"))
        .expect("sound")
        .setup;
    let on_ground = detect::detect(&decode_image(&ground, None).expect("decodes")).markers;
    let orientation = identify::estimate_orientation(&setup, std::slice::from_ref(&on_ground))
        .expect("orients")
        .orientation;
    let markers = detect::detect(&raster).markers;
    let wing = WingView::in_flight(&setup, &orientation);
    let identities = wing.identify_markers(&markers).expect("identifies");
    let predictions = wing.predict_next_frame(&markers, &identities, MAX_DEFLECTION_CHANGE_M);
    let mut group = c.benchmark_group("frame");
    group.sample_size(20);
    group.bench_function("read", |b| {
        b.iter(|| {
            raster
                .luma()
                .chunks(64)
                .map(|k| k.iter().map(|&v| u32::from(v)).sum::<u32>())
                .max()
        });
    });
    group.bench_function("decode", |b| b.iter(|| decode_image(&flight, None)));
    group.bench_function("detect full", |b| b.iter(|| detect::detect(&raster)));
    group.bench_function("detect guided", |b| {
        b.iter(|| detect::detect_guided(&raster, &predictions))
    });
    group.bench_function("orient", |b| {
        b.iter(|| identify::estimate_orientation(&setup, std::slice::from_ref(&on_ground)).is_ok());
    });
    group.bench_function("identify", |b| {
        b.iter(|| wing.identify_markers(&markers).is_ok())
    });
    group.bench_function("remove perspective bias", |b| {
        b.iter(|| wing.remove_perspective_bias(&markers, &identities));
    });
    group.finish();
}

/// A frame with 16 decals and 12 points, and the same frame if the survey has the decals alone.
fn points(c: &mut Criterion) {
    let options = SceneOptions {
        markers: 16,
        quadrants: 8,
        points: 12,
        ..SceneOptions::random(31, SceneSide::Right)
    };
    let scene = Scene::random(31, &options);
    let shot = scene.ground_shot(31);
    let ground = scene.render(&shot).expect("renders");
    let image = scene
        .render(&scene.flight_shot(1.5, Light::Plain, 1))
        .expect("renders");
    let (mut marks, mut templates) = (vec![], vec![]);
    for (marker, truth) in scene.truth(&shot).markers.iter().enumerate() {
        let Some(pixel) = truth.pixel.filter(|_| truth.visible) else {
            continue;
        };
        marks.push(Observation {
            marker,
            pixel,
            covariance_px2: Matrix2::identity() * 0.03_f64.powi(2),
        });
        templates
            .extend(cut_template(&ground, marker, pixel).filter(|_| truth.shape == Shape::Point));
    }
    let camera_from_survey = scene.camera_from_survey;
    let with = Orientation {
        camera_from_survey,
        covariance_rad2: None,
        ground: marks,
        templates,
    };
    let (mut setup, mut without) = (scene.setup.clone(), with.clone());
    without.templates.clear();
    without.ground.retain(|mark| !setup.is_point(mark.marker));
    setup.markers.retain(|marker| marker.shape != Shape::Point);
    let mut group = c.benchmark_group("points");
    group.sample_size(20);
    for (name, setup, orientation) in [("none", &setup, &without), ("12", &scene.setup, &with)] {
        let wing = WingView::in_flight(setup, orientation);
        group.bench_function(name, |b| {
            b.iter(|| process_frame(&mut &image, Some(&wing), &mut |_| ()))
        });
    }
    group.finish();
}

criterion_group!(all, benches, points);
criterion_main!(all);
