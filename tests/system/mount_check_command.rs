//! `wingd mount-check` through the real binary: frames of a static wing before and after known movements of the camera.

use std::path::Path;

use nalgebra::{Rotation3, Vector2, Vector3};
use serde_json::Value;
use wingd::installation;
use wingd::measure::raster::Raster;
use wingd_simulate::render::{Scene, SceneShot};

use crate::program::{fixture, outcome, run};

/// Image scale relative to the development set: a quarter of the pixels take a quarter of the time.
const SCALE: f64 = 0.5;

/// The development set's installation with a camera of half the pixels, in a folder.
fn installation(directory: &Path) -> String {
    let to = directory.join("installation");
    std::fs::create_dir(&to).unwrap();
    for name in ["installation.toml", "survey.csv"] {
        std::fs::copy(fixture("dev/installation").join(name), to.join(name)).unwrap();
    }
    let camera = std::fs::read_to_string(fixture("dev/installation/camera.toml")).unwrap();
    let scaled = |line: &str| {
        let (key, value) = line.split_once(" = ").unwrap();
        match (key, value.parse::<f64>().unwrap()) {
            ("width" | "height", v) => format!("{key} = {}", (v * SCALE) as u32),
            ("fx" | "fy", v) => format!("{key} = {:?}", v * SCALE),
            ("cx" | "cy", v) => format!("{key} = {:?}", (v + 0.5) * SCALE - 0.5),
            _ => line.to_owned(),
        }
    };
    let lines: Vec<String> = camera.lines().map(scaled).collect();
    std::fs::write(to.join("camera.toml"), lines.join("\n")).unwrap();
    to.display().to_string()
}

fn written(directory: &Path, name: &str, raster: &Raster) -> String {
    let file = directory.join(name);
    let grey = image::GrayImage::from_raw(
        raster.width() as u32,
        raster.height() as u32,
        raster.luma().to_vec(),
    );
    grey.unwrap().save(&file).unwrap();
    file.display().to_string()
}

/// A movement of the camera about and along its axes.
struct Movement {
    rotation_mrad: Vector3<f64>,
    shift_mm: Vector3<f64>,
    verdict: &'static str,
}

/// The scene as the moved camera sees it: a shift of the camera shifts the wing in the opposite direction.
fn moved(scene: &Scene, movement: &Movement, seed: u64) -> (Scene, SceneShot) {
    let wing_from_camera = scene.frame.wing_from_survey * scene.camera_from_survey.inverse();
    let shift = wing_from_camera * (movement.shift_mm * 1e-3);
    let mut after = scene.clone();
    after.wing.root_x_m -= shift.x;
    after.wing.root_y_m -= shift.y;
    after.wing.axis_z_m -= shift.z;
    let shot = SceneShot {
        mount: Rotation3::new(-movement.rotation_mrad * 1e-3),
        ..scene.ground_shot(seed)
    };
    (after, shot)
}

fn vector(found: &Value, key: &str) -> Vector3<f64> {
    Vector3::from_fn(|k, _| found[key][k].as_f64().unwrap())
}

#[test]
fn known_movements_are_recovered_in_px_mrad_and_mm_within_their_standard_deviations() {
    let directory = tempfile::tempdir().unwrap();
    let folder = installation(directory.path());
    let setup = installation::load_without_orientation(Path::new(&folder))
        .unwrap()
        .setup;
    let scene = Scene::from_setup(&setup, None, 7, 1.0).unwrap();
    let before = scene.ground_shot(100);
    let picture = |scene: &Scene, shot: &SceneShot, name: &str| {
        written(directory.path(), name, &scene.render(shot).unwrap())
    };
    let first = picture(&scene, &before, "before.png");
    let movements = [
        (
            Vector3::new(0.0, 0.0, 0.0),
            Vector3::new(0.0, 0.0, 0.0),
            "one mounting",
        ),
        (
            Vector3::new(0.6, -0.4, 0.3),
            Vector3::new(0.0, 0.0, 0.0),
            "remounted",
        ),
        (
            Vector3::new(0.0, 0.0, 0.0),
            Vector3::new(20.0, -12.0, 10.0),
            "moved",
        ),
        (
            Vector3::new(-5.0, 8.0, 2.0),
            Vector3::new(-8.0, 15.0, 5.0),
            "moved",
        ),
    ]
    .map(|(rotation_mrad, shift_mm, verdict)| Movement {
        rotation_mrad,
        shift_mm,
        verdict,
    });
    let mut squares = vec![];
    for (k, movement) in movements.iter().enumerate() {
        let (after, shot) = moved(&scene, movement, 101 + k as u64);
        let second = picture(&after, &shot, &format!("after{k}.png"));
        let (code, printed) = outcome(&[
            "mount-check",
            "--json",
            "--installation",
            &folder,
            &first,
            &second,
        ]);
        assert_eq!(code, Some(0), "{printed}");
        let found: Value = serde_json::from_str(&printed).unwrap();
        assert_eq!(found["verdict"], movement.verdict, "{found}");
        assert_eq!(found["stabilised"], false, "{found}");
        for (value, sigma, truth) in [
            (
                "rotation_mrad",
                "sigma_rotation_mrad",
                movement.rotation_mrad,
            ),
            ("shift_mm", "sigma_shift_mm", movement.shift_mm),
        ] {
            let normalised = (vector(&found, value) - truth).component_div(&vector(&found, sigma));
            // One of 24 beyond four sigma is significant.
            assert!(
                normalised.amax() < 4.0,
                "{value} in standard deviations {normalised:?}: {found}"
            );
            squares.extend(normalised.map(|n| n * n).iter());
        }
        let (from, to) = (scene.truth(&before).markers, after.truth(&shot).markers);
        let pixels = from.iter().zip(&to).filter(|(a, b)| a.visible && b.visible);
        let by: Vec<f64> = pixels
            .map(|(a, b)| (b.pixel.unwrap() - a.pixel.unwrap()).norm_squared())
            .collect();
        let moved_px = (by.iter().sum::<f64>() / by.len() as f64).sqrt();
        let (printed, left) = (
            found["moved_px"].as_f64().unwrap(),
            found["left_px"].as_f64().unwrap(),
        );
        assert!(
            (printed - moved_px).abs() < 0.1 + 0.02 * moved_px,
            "{printed} px, in truth {moved_px} px"
        );
        assert!(left < 0.25, "{left} px left over");
    }
    // Stabilisation moves the image, not the camera.
    let shot = SceneShot {
        lens_change: (1.0, Vector2::new(30.0, -20.0)),
        ..scene.ground_shot(109)
    };
    let second = picture(&scene, &shot, "stabilised.png");
    for (at, stabilised) in [(second, true), (first.clone(), false)] {
        let (_, printed) = outcome(&[
            "mount-check",
            "--json",
            "--installation",
            &folder,
            &first,
            &at,
        ]);
        let found: Value = serde_json::from_str(&printed).unwrap();
        assert_eq!(found["stabilised"], stabilised, "{found}");
    }
    // 24 values determine a mean square to 0.29.
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    println!(
        "mean squared normalised error of {} values: {mean:.2}",
        squares.len()
    );
    assert!(
        (0.3..1.9).contains(&mean),
        "mean squared normalised error {mean}: {squares:?}"
    );
}

#[test]
fn one_frame_twice_is_one_mounting_and_a_frame_that_cannot_be_read_is_named() {
    let folder = fixture("dev/installation").display().to_string();
    let ground = fixture("dev/frames/ground.jpg").display().to_string();
    let done = run(&[
        "mount-check",
        "--json",
        "--installation",
        &folder,
        &ground,
        &ground,
    ]);
    assert!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    let same: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(same["verdict"], "one mounting");
    assert!(
        same["moved_px"].as_f64().unwrap() < 1e-6 && same["markers"].as_u64().unwrap() > 8,
        "{same}"
    );
    let (code, printed) = outcome(&[
        "mount-check",
        "--installation",
        &folder,
        &ground,
        "/nowhere.jpg",
    ]);
    assert_eq!(code, Some(1));
    assert!(printed.contains("nowhere.jpg"), "{printed}");
}
