//! Rendered frames: the truth is complete and plausible, and images do not depend on the number of threads.

use wingd::measure::geometry::Lens;
use wingd::measure::setup::Shape;
use wingd_simulate::render::{Light, Scene, SceneOptions, SceneSide, SeededRandom};

fn scene(seed: u64, side: SceneSide) -> Scene {
    let mut options = SceneOptions::random(seed, side);
    options.lens = Lens {
        k1: -0.04,
        ..Lens::pinhole(800, 600, 1600.0, 401.0, 297.0)
    };
    Scene::random(seed, &options)
}

#[test]
fn one_thread_and_two_render_the_same_image() {
    let scene = scene(3, SceneSide::Right);
    for light in Light::ALL {
        let shot = scene.flight_shot(2.0, light, 17);
        let draw = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| scene.render(&shot)).unwrap()
        };
        assert!(draw(1) == draw(2), "{}", light.name());
    }
}

#[test]
fn the_truth_is_consistent_in_itself() {
    for (seed, side) in [
        (1, SceneSide::Left),
        (2, SceneSide::Right),
        (3, SceneSide::Left),
    ] {
        let scene = scene(seed, side);
        let mut shot = scene.flight_shot(2.2, Light::Plain, 5);
        shot.mount = scene.remount(&mut SeededRandom::new(seed, 5));
        shot.hidden = vec![3];
        let (ground, flight) = (scene.truth(&scene.ground_shot(4)), scene.truth(&shot));
        assert!(
            ground
                .markers
                .iter()
                .all(|m| m.deflection_m == 0.0 && m.visible)
        );
        assert_eq!(ground.torsion_rad, Some(0.0));
        // Markers that no frame would show completely are omitted: 18 to 27 are requested.
        assert!(
            (12..=27).contains(&scene.markers.len()),
            "seed {seed}: {} markers",
            scene.markers.len()
        );
        assert!(scene.markers.iter().any(|m| m.shape == Shape::Circle));
        for (marker, survey) in ground.markers.iter().zip(&scene.setup.markers) {
            assert_eq!(marker.id, survey.id);
            assert!((marker.position_m - survey.position_m).norm() < 6.0 * survey.sigma_m);
        }
        // The projection of the true position by the true camera is the pixel.
        for marker in &flight.markers {
            let arm = flight.camera_from_survey * (marker.position_m - scene.frame.origin_m);
            let pixel = scene.setup.lens.project(&arm).unwrap();
            assert!((pixel - marker.pixel.unwrap()).norm() < 1e-6);
        }
        assert!(!flight.markers[3].visible);
        let highest = flight
            .markers
            .iter()
            .map(|m| m.deflection_m)
            .fold(0.0, f64::max);
        assert!(highest > 1.5 && highest < 2.3, "{highest}");
        assert!(flight.torsion_rad.unwrap().abs() > 1e-3);
    }
}

#[test]
fn glare_hides_only_covered_parts() {
    let scene = scene(2, SceneSide::Right);
    let seen = |light| {
        let truth = scene.truth(&scene.flight_shot(2.0, light, 8));
        truth.markers.iter().filter(|m| m.visible).count()
    };
    assert!(seen(Light::Glare) <= seen(Light::Plain));
    assert!(seen(Light::Glare) * 2 > seen(Light::Plain));
}

#[test]
fn an_installation_gives_a_wing_through_its_markers() {
    let original = scene(6, SceneSide::Left);
    let attitude = original.camera_from_survey;
    let fitted = Scene::from_setup(&original.setup, Some(attitude), 9, 2.5).unwrap();
    assert_eq!(fitted.wing.side, SceneSide::Left);
    let truth = fitted.truth(&fitted.ground_shot(1));
    for (marker, survey) in truth.markers.iter().zip(&original.setup.markers) {
        assert!(
            (marker.position_m - survey.position_m).norm() < 1e-6,
            "{}",
            marker.id
        );
        assert!(marker.visible, "{}", marker.id);
    }
    let mut odd = original.setup.clone();
    odd.markers[2].position_m.z += 1.0;
    assert!(Scene::from_setup(&odd, Some(attitude), 9, 2.5).is_err());
}
