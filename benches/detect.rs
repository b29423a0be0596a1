//! Full and guided detection on a 12 MP image of 21 discs, full detection on a rendered wing in each light; `make bench` runs
//! it.
#![allow(missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use wingd::measure::detect::{MarkerPrediction, detect, detect_guided};
use wingd::measure::raster::Raster;
use wingd_simulate::render::{Light, Scene, SceneOptions, SceneSide};

/// Discs in rows on a shaded, noisy background.
fn picture() -> Raster {
    const WIDTH: usize = 4000;
    const HEIGHT: usize = 3000;
    let mut luma: Vec<u8> = (0..WIDTH * HEIGHT)
        .map(|i| (170 + (i % WIDTH) / 200 + (i.wrapping_mul(2_654_435_761) >> 7) % 4) as u8)
        .collect();
    for k in 0..21 {
        let (cx, cy) = (
            500.3 + 500.0 * f64::from(k % 7),
            700.6 + 700.0 * f64::from(k / 7),
        );
        let (a, b) = (45.0 + 5.0 * f64::from(k), 4.0 + f64::from(k));
        for y in (cy - b - 6.0) as usize..(cy + b + 6.0) as usize {
            for x in (cx - a - 6.0) as usize..(cx + a + 6.0) as usize {
                let (s, t) = ((x as f64 - cx) / a, (y as f64 - cy) / b);
                let r = s.hypot(t).max(1e-9);
                let distance = (r - 1.0) * r / (s / a).hypot(t / b).max(1e-9);
                let value = f64::from(luma[y * WIDTH + x]);
                luma[y * WIDTH + x] = (value - 115.0 / (1.0 + (2.2 * distance).exp())) as u8;
            }
        }
    }
    Raster::new(WIDTH, HEIGHT, luma).unwrap_or_else(|| unreachable!("the sizes agree"))
}

fn benches(c: &mut Criterion) {
    let image = picture();
    let predictions: Vec<MarkerPrediction> = (detect(&image).markers.iter())
        .map(|m| MarkerPrediction {
            shape: m.shape,
            centre_px: m.centre_px,
            semi_major_px: m.semi_major_px,
            semi_minor_px: m.semi_minor_px,
            angle_rad: m.angle_rad,
            search_px: nalgebra::Vector2::repeat(12.0),
            seen: true,
        })
        .collect();
    let mut group = c.benchmark_group("detect");
    group.sample_size(20);
    group.bench_function("full", |b| b.iter(|| detect(&image)));
    group.bench_function("guided", |b| b.iter(|| detect_guided(&image, &predictions)));
    group.finish();
    // A wing with clutter; shadow, glare, back light and haze take longer than plain light.
    let scene = Scene::random(51, &SceneOptions::random(51, SceneSide::Left));
    let mut group = c.benchmark_group("detect rendered");
    group.sample_size(20);
    for light in Light::ALL {
        let shot = scene.flight_shot(2.0, light, 17);
        let frame = scene
            .render(&shot)
            .unwrap_or_else(|| unreachable!("the frame has a size"));
        group.bench_function(light.name(), |b| b.iter(|| detect(&frame)));
    }
    group.finish();
}

criterion_group!(all, benches);
criterion_main!(all);
