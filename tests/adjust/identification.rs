//! Identities are never wrong, orientation needs no initial value, and ambiguity is reported.

use crate::common::synthetic::{Conditions, View, World, normal};
use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use wingd::measure::detect::Detection;
use wingd::measure::identify::{
    IdentifyError, Identities, MAX_DEFLECTION_CHANGE_M, WingView, estimate_orientation,
};
use wingd::measure::setup::{Orientation, Setup, Shape};

const HARD: Conditions = Conditions {
    noise_px: 0.1,
    hidden: 0.33,
    false_ones: 10,
    mount_px: 40.0,
    deflection_m: (-1.0, 4.0),
};
const PLAIN: Conditions = Conditions {
    noise_px: 0.05,
    hidden: 0.0,
    false_ones: 0,
    mount_px: 10.0,
    deflection_m: (0.5, 3.0),
};

/// Visible, correctly identified, wrongly identified.
#[derive(Default, Debug)]
struct Tally {
    visible: usize,
    right: usize,
    wrong: usize,
}

impl Tally {
    fn add(&mut self, view: &View, identities: &Identities) {
        self.visible += view.visible.iter().filter(|v| **v).count();
        for (truth, named) in view.truth.iter().zip(&identities.marker_of) {
            match (truth, named) {
                (t, Some(_)) if t == named => self.right += 1,
                (_, Some(_)) => self.wrong += 1,
                _ => {}
            }
        }
    }

    fn recall(&self) -> f64 {
        self.right as f64 / self.visible.max(1) as f64
    }
}

fn deflection(seed: u64, range: (f64, f64)) -> f64 {
    StdRng::seed_from_u64(seed ^ 0xa1).random_range(range.0..range.1)
}

fn known(world: &World) -> Orientation {
    Orientation::from_rotation(world.camera_from_survey)
}

/// Whether every marker is either identified or missing with a reason, and none twice.
fn is_complete(setup: &Setup, detections: &[Detection], identities: &Identities) {
    assert_eq!(identities.marker_of.len(), detections.len());
    for j in 0..setup.markers.len() {
        let found = identities
            .marker_of
            .iter()
            .filter(|m| **m == Some(j))
            .count();
        let missing = identities
            .missing
            .iter()
            .filter(|m| m.0 == j && !m.1.is_empty())
            .count();
        assert_eq!(found + missing, 1, "marker {j}");
    }
}

#[test]
fn ground_frames_are_oriented_without_a_guess_and_none_is_misidentified() {
    let (mut tally, mut failed, mut errors, mut normalised) = (Tally::default(), 0, vec![], 0.0);
    let cases = 200;
    for seed in 0..cases {
        let conditions = Conditions {
            false_ones: 10,
            hidden: 0.33,
            ..HARD
        };
        let world = World::random(seed, &conditions);
        let view = world.ground_view(seed, &conditions);
        match estimate_orientation(&world.setup, std::slice::from_ref(&view.detections)) {
            Ok(fit) => {
                is_complete(&world.setup, &view.detections, &fit.identities[0]);
                tally.add(&view, &fit.identities[0]);
                let off = (world.camera_from_survey * fit.orientation.camera_from_survey.inverse())
                    .scaled_axis();
                errors.push(off.norm());
                let covariance = fit.orientation.covariance_rad2.unwrap();
                normalised += off.dot(&(covariance.try_inverse().unwrap() * off)) / 3.0;
            }
            Err(e) => {
                eprintln!("seed {seed}: {e}");
                failed += 1;
            }
        }
    }
    errors.sort_by(f64::total_cmp);
    let count = errors.len() as f64;
    eprintln!(
        "ground: {tally:?}, recall {:.4}, failed {failed}; error median {:.3} mrad, p95 {:.3}, max {:.3}; normalised {:.3}",
        tally.recall(),
        1e3 * errors[errors.len() / 2],
        1e3 * errors[errors.len() * 95 / 100],
        1e3 * errors.last().unwrap(),
        (normalised / count).sqrt(),
    );
    assert_eq!(tally.wrong, 0);
    assert!(failed <= 2);
    assert!(tally.recall() > 0.97);
    assert!(errors[errors.len() * 95 / 100] < 1e-3);
    assert!((0.8..1.25).contains(&(normalised / count).sqrt()));
}

#[test]
fn frames_in_flight_are_never_misidentified() {
    let (mut tally, mut failed, mut refused) = (Tally::default(), 0, 0);
    for seed in 0..500 {
        let noise_px = [0.05, 0.2, 1.0][seed as usize % 3];
        let conditions = Conditions { noise_px, ..HARD };
        let world = World::random(seed, &conditions);
        let deflection_m = deflection(seed, conditions.deflection_m);
        let view = world.flight_view(deflection_m, seed, &conditions);
        match WingView::in_flight(&world.setup, &known(&world)).identify_markers(&view.detections) {
            Ok(identities) => {
                is_complete(&world.setup, &view.detections, &identities);
                let before = tally.wrong;
                tally.add(&view, &identities);
                if tally.wrong > before {
                    eprintln!(
                        "seed {seed}: wrong at deflection {deflection_m:.2}, reported {:.2}",
                        identities.tip_deflection_m
                    );
                }
            }
            Err(e) => {
                // Four points do not check eight unknowns: a refusal is correct.
                let visible = view.visible.iter().filter(|v| **v).count();
                failed += usize::from(visible >= 6);
                refused += usize::from(visible < 6);
                tally.visible += visible;
                eprintln!("seed {seed}: deflection {deflection_m:.2}, {visible} visible: {e}");
            }
        }
    }
    eprintln!(
        "flight: {tally:?}, recall {:.4}, failed {failed}, refused {refused}",
        tally.recall()
    );
    assert_eq!(tally.wrong, 0);
    assert_eq!(failed, 0);
    assert!(tally.recall() > 0.98);
}

#[test]
fn plain_frames_lose_no_marker() {
    let mut tally = Tally::default();
    for seed in 1000..1100 {
        let world = World::random(seed, &PLAIN);
        let view = world.flight_view(deflection(seed, PLAIN.deflection_m), seed, &PLAIN);
        let identities = WingView::in_flight(&world.setup, &known(&world))
            .identify_markers(&view.detections)
            .unwrap();
        tally.add(&view, &identities);
    }
    eprintln!("plain: {tally:?}");
    assert_eq!(tally.wrong, 0);
    assert!(tally.recall() > 0.995);
}

#[test]
fn the_perspective_bias_is_removed() {
    let (mut before, mut after, mut count) = (0.0, 0.0, 0.0);
    for seed in 0..60 {
        let conditions = Conditions {
            noise_px: 0.01,
            ..PLAIN
        };
        let world = World::random(seed, &conditions);
        let view = world.flight_view(deflection(seed, conditions.deflection_m), seed, &conditions);
        let identities = WingView::in_flight(&world.setup, &known(&world))
            .identify_markers(&view.detections)
            .unwrap();
        let corrected = WingView::in_flight(&world.setup, &known(&world))
            .remove_perspective_bias(&view.detections, &identities);
        for ((raw, new), j) in view
            .detections
            .iter()
            .zip(&corrected)
            .zip(&identities.marker_of)
        {
            let Some(truth) = j.and_then(|j| view.centres_px[j]) else {
                continue;
            };
            if raw.shape == Shape::Quadrant {
                assert_eq!(raw, new);
                continue;
            }
            before += (raw.centre_px - truth).norm_squared();
            after += (new.centre_px - truth).norm_squared();
            count += 1.0;
        }
    }
    let (before, after) = ((before / count).sqrt(), (after / count).sqrt());
    eprintln!("bias: rms {before:.4} px before, {after:.4} px after");
    assert!(after < 0.03 && after < 0.3 * before);
}

#[test]
fn the_next_frame_is_predicted_within_the_search_radius() {
    for seed in 0..40 {
        let world = World::random(seed, &PLAIN);
        let now = world.flight_view(
            2.0,
            seed,
            &Conditions {
                hidden: 0.2,
                ..PLAIN
            },
        );
        let next = world.flight_view(2.1, seed + 1, &PLAIN);
        let identities = WingView::in_flight(&world.setup, &known(&world))
            .identify_markers(&now.detections)
            .unwrap();
        let predictions = WingView::in_flight(&world.setup, &known(&world)).predict_next_frame(
            &now.detections,
            &identities,
            MAX_DEFLECTION_CHANGE_M,
        );
        for detection in &next.detections {
            let hit = predictions.iter().any(|p| {
                p.shape == detection.shape
                    && (p.centre_px - detection.centre_px).norm() < p.search_px.x
                    && (p.semi_major_px / detection.semi_major_px - 1.0).abs() < 0.15
            });
            assert!(hit, "seed {seed}: {detection:?}");
        }
    }
}

/// A setup whose directions are symmetric under a half turn about the camera's axis.
fn symmetric_world() -> (Setup, Vec<Detection>) {
    let world = World::random(2, &PLAIN);
    let mut setup = world.setup.clone();
    let rotation = world.camera_from_survey;
    let lens = wingd::measure::geometry::Lens::pinhole(4000, 3000, 7800.0, 2000.0, 1500.0);
    setup.lens = lens;
    let offsets = [
        (-800.0, -500.0),
        (-300.0, 200.0),
        (500.0, -350.0),
        (900.0, 150.0),
    ];
    let both = offsets.iter().flat_map(|(u, v)| [(*u, *v), (-u, -v)]);
    let mut detections = Vec::new();
    setup.markers.truncate(8);
    for (marker, (u, v)) in setup.markers.iter_mut().zip(both) {
        let pixel = Vector2::new(2000.0 + u, 1500.0 + v);
        marker.shape = Shape::Circle;
        marker.diameter_m = 0.3;
        marker.position_m =
            setup.projection_centre_m + rotation.inverse() * lens.ray(&pixel).unwrap() * 20.0;
        detections.push(Detection {
            shape: Shape::Circle,
            centre_px: pixel,
            covariance_px2: (Matrix2::identity() * 0.01).into(),
            semi_major_px: 58.5,
            semi_minor_px: 20.0,
            angle_rad: 0.0,
            fit_rms: 1.0,
            contrast: 100.0,
            marker: None,
        });
    }
    (setup, detections)
}

#[test]
fn a_layout_that_fits_two_ways_is_reported() {
    let (setup, detections) = symmetric_world();
    let answer = estimate_orientation(&setup, &[detections]);
    assert!(
        matches!(answer, Err(IdentifyError::Ambiguous { solutions: 2 })),
        "{answer:?}"
    );
}

#[test]
fn too_few_markers_and_clutter_alone_are_refused() {
    let world = World::random(4, &PLAIN);
    let view = world.ground_view(4, &PLAIN);
    assert!(matches!(
        estimate_orientation(&world.setup, &[]),
        Err(IdentifyError::TooFew { .. })
    ));
    let three = view.detections[..3].to_vec();
    assert!(matches!(
        estimate_orientation(&world.setup, std::slice::from_ref(&three)),
        Err(IdentifyError::TooFew { found: 3, .. })
    ));
    let refused = WingView::in_flight(&world.setup, &known(&world)).identify_markers(&three);
    assert!(matches!(refused, Err(IdentifyError::TooFew { .. })));
    for seed in 0..20 {
        let mut rng = StdRng::seed_from_u64(seed);
        let mut clutter = view.detections.clone();
        for d in &mut clutter {
            d.centre_px =
                Vector2::new(rng.random_range(0.0..4000.0), rng.random_range(0.0..3000.0));
        }
        let on_ground = estimate_orientation(&world.setup, &[clutter.clone()]);
        assert!(on_ground.is_err(), "seed {seed}");
        let in_flight =
            WingView::in_flight(&world.setup, &known(&world)).identify_markers(&clutter);
        assert!(in_flight.is_err(), "seed {seed}: {in_flight:?}");
    }
}

#[test]
fn non_finite_values_do_no_harm() {
    let world = World::random(6, &PLAIN);
    let mut view = world.flight_view(1.0, 6, &PLAIN);
    let identities = WingView::in_flight(&world.setup, &known(&world))
        .identify_markers(&view.detections)
        .unwrap();
    view.detections[0].centre_px.x = f64::NAN;
    view.detections[3].covariance_px2 = Matrix2::zeros().into();
    view.detections[5].semi_major_px = f64::INFINITY;
    let again = WingView::in_flight(&world.setup, &known(&world))
        .identify_markers(&view.detections)
        .unwrap();
    for (i, (a, b)) in identities
        .marker_of
        .iter()
        .zip(&again.marker_of)
        .enumerate()
    {
        let expected = if [0, 3, 5].contains(&i) { None } else { *a };
        assert_eq!(*b, expected);
    }
    let corrected = WingView::in_flight(&world.setup, &known(&world))
        .remove_perspective_bias(&view.detections, &again);
    assert_eq!(corrected.len(), view.detections.len());
}

#[test]
fn several_ground_frames_are_one_orientation() {
    let conditions = Conditions {
        noise_px: 0.5,
        hidden: 0.2,
        false_ones: 5,
        ..PLAIN
    };
    let world = World::random(8, &conditions);
    let frames: Vec<_> = (0..4)
        .map(|k| world.ground_view(100 + k, &conditions).detections)
        .collect();
    let one = estimate_orientation(&world.setup, &frames[..1]).unwrap();
    let four = estimate_orientation(&world.setup, &frames).unwrap();
    assert_eq!(four.identities.len(), 4);
    let trace = |f: &wingd::measure::identify::OrientationFit| {
        f.orientation.covariance_rad2.unwrap().trace()
    };
    assert!(trace(&four) < trace(&one));
    // The survey errors are common: four frames do not halve the standard deviation.
    assert!(trace(&four) > 0.3 * trace(&one));
}

#[test]
fn a_wrong_survey_point_is_excluded_and_named() {
    let world = World::random(10, &PLAIN);
    let view = world.ground_view(10, &PLAIN);
    let mut setup = world.setup.clone();
    setup.markers[4].position_m += Vector3::new(0.05, -0.03, 0.04);
    let fit = estimate_orientation(&setup, &[view.detections]).unwrap();
    assert!(fit.identities[0].missing.iter().any(|(j, _)| *j == 4));
    let off = world
        .camera_from_survey
        .angle_to(&fit.orientation.camera_from_survey);
    assert!(off < 1e-3, "{off}");
}

struct Dev {
    setup: Setup,
    frames: Vec<(String, View, Matrix3<f64>)>,
}

/// Simulated detections from the truth of the fixture, without an image.
fn dev() -> Dev {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev");
    let setup = wingd::installation::load_without_orientation(&root.join("installation"))
        .unwrap()
        .setup;
    let text = std::fs::read_to_string(root.join("truth.json")).unwrap();
    let truth: serde_json::Value = serde_json::from_str(&text).unwrap();
    let mut rng = StdRng::seed_from_u64(7);
    let frames = truth["frames"].as_array().unwrap().iter().map(|f| {
        let mut view = View {
            detections: vec![],
            truth: vec![],
            centres_px: vec![],
            visible: vec![],
        };
        for (j, m) in f["markers"].as_array().unwrap().iter().enumerate() {
            let number = |k: &str| m[k].as_f64().unwrap();
            let (width, height) = (number("width"), number("height"));
            let centre = Vector2::new(number("u"), number("v"));
            view.centres_px.push(Some(centre));
            let visible = m["visible"].as_bool().unwrap();
            view.visible.push(visible);
            if visible {
                view.truth.push(Some(j));
                view.detections.push(Detection {
                    shape: setup.markers[j].shape,
                    centre_px: centre + Vector2::new(normal(&mut rng), normal(&mut rng)) * 0.1,
                    covariance_px2: (Matrix2::identity() * 0.01).into(),
                    semi_major_px: 0.5 * width,
                    semi_minor_px: 0.35 * height,
                    angle_rad: 0.0,
                    fit_rms: 2.0,
                    contrast: 150.0,
                    marker: None,
                });
            }
        }
        let r = &f["camera_from_survey"];
        let rotation = Matrix3::from_fn(|a, b| r[a][b].as_f64().unwrap());
        (f["image"].as_str().unwrap().to_string(), view, rotation)
    });
    Dev {
        frames: frames.collect(),
        setup,
    }
}

#[test]
fn the_independent_set_is_oriented_and_identified() {
    let dev = dev();
    let (_, ground, rotation) = &dev.frames[0];
    let fit = estimate_orientation(&dev.setup, std::slice::from_ref(&ground.detections)).unwrap();
    let truth = Rotation3::from_matrix_unchecked(*rotation);
    let off = truth.angle_to(&fit.orientation.camera_from_survey);
    eprintln!(
        "dev: {:.3} mrad, variance factor {:.2}",
        1e3 * off,
        fit.variance_factor
    );
    // Error-free pixels leave 0.51 mrad in this set: the survey's 2 mm dominate.
    let sigma = fit.orientation.covariance_rad2.unwrap().trace().sqrt();
    assert!(off < 2.0 * sigma && sigma < 0.4e-3, "{off} {sigma}");
    assert_eq!(fit.identities[0].marker_of, ground.truth);
    for (name, view, _) in &dev.frames[1..] {
        let identities = WingView::in_flight(&dev.setup, &fit.orientation)
            .identify_markers(&view.detections)
            .unwrap();
        eprintln!(
            "{name}: tip {:.2} m, missing {:?}",
            identities.tip_deflection_m, identities.missing
        );
        assert_eq!(identities.marker_of, view.truth, "{name}");
    }
}

/// The ground frame of the fixture with error-free pixels, one detection per visible marker.
fn exact(view: &View) -> Vec<Detection> {
    let mut detections = view.detections.clone();
    for (detection, marker) in detections.iter_mut().zip(view.truth.iter().flatten()) {
        detection.centre_px = view.centres_px[*marker].unwrap();
        detection.covariance_px2 = (Matrix2::identity() * 0.02f64.powi(2)).into();
    }
    detections
}

/// The error comes from the survey, not from the image (docs/validation/detection.md).
#[test]
fn the_picture_orients_as_well_as_pixels_without_error() {
    let dev = dev();
    let (_, view, rotation) = &dev.frames[0];
    let truth = Rotation3::from_matrix(rotation);
    let file =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev/frames/ground.jpg");
    let picture =
        wingd::pipeline::decode::decode_image(&std::fs::read(file).unwrap(), None).unwrap();
    let found = wingd::measure::detect::detect(&picture).markers;
    let off = |detections: Vec<Detection>| {
        let fit = estimate_orientation(&dev.setup, &[detections]).unwrap();
        let turn = truth.inverse() * fit.orientation.camera_from_survey;
        (
            1e3 * turn.scaled_axis().norm(),
            fit.identities[0].marker_of.clone(),
        )
    };
    let (all, _) = off(exact(view));
    let (seen, markers) = off(found);
    let ids: Vec<usize> = markers.iter().flatten().copied().collect();
    let same = exact(view)
        .into_iter()
        .zip(&view.truth)
        .filter(|(_, m)| m.is_some_and(|m| ids.contains(&m)));
    let (same, _) = off(same.map(|(d, _)| d).collect());
    eprintln!(
        "orientation, mrad: exact pixels of all markers {all:.3}, of those found {same:.3}, image {seen:.3}"
    );
    assert!((seen - same).abs() < 0.03, "{seen} {same}");
    assert!(
        ids.len() + 1 >= view.truth.len(),
        "{} of {}",
        ids.len(),
        view.truth.len()
    );
}
