//! Layouts proposed by `wingd plan --want`, with aircraft sampled from the priors: the same as `tests/validation/planned_wings.py`
//! does with rendered frames, but with points, so that more aircraft can be sampled.

use std::path::Path;

use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2};
use wingd::installation;
use wingd::measure::adjust::{self, Observation, Options};
use wingd::measure::geometry::{PointPair, TransformFit};
use wingd::measure::plan::{self, PlanOptions};
use wingd::measure::setup::{Orientation, Setup, SurveyMarker};
use wingd_simulate::render::{Light, SampledAircraft, Scene, SceneShot, SeededRandom};

/// Precision of marker detection in a rendered frame, px.
const PIXEL_SIGMA: f64 = 0.08;
const TIP_DEFLECTION_M: f64 = 2.5;
const FRAMES: usize = 10;

/// Marker positions in a frame.
fn observations(scene: &Scene, shot: &SceneShot, random: &mut SeededRandom) -> Vec<Observation> {
    let covariance_px2 = Matrix2::identity() * PIXEL_SIGMA.powi(2);
    let truth = scene.truth(shot).markers;
    let seen = truth
        .iter()
        .enumerate()
        .filter(|(_, m)| m.visible)
        .filter_map(|(k, m)| Some((k, m.pixel?)));
    let mut noise = || Vector2::new(random.normal(), random.normal()) * PIXEL_SIGMA;
    seen.map(|(marker, pixel)| Observation {
        marker,
        pixel: pixel + noise(),
        covariance_px2,
    })
    .collect()
}

/// Rotation from the scene's survey frame to the configured one.
fn tilt(of: &Setup, configured: &Setup) -> Rotation3<f64> {
    let pair = |(m, s): (&SurveyMarker, &SurveyMarker)| PointPair {
        source_m: m.position_m,
        target_m: s.position_m,
        sigma_m: s.sigma_m,
    };
    let pairs: Vec<PointPair> = of
        .markers
        .iter()
        .zip(&configured.markers)
        .map(pair)
        .collect();
    TransformFit::estimate(&pairs, false)
        .unwrap()
        .transform
        .rotation
}

/// Normalised tip errors relative to survey and ground frame in the last frame of a flight, and standard deviations, m.
fn sampled_errors(planned: &Setup, seed: u64) -> [[f64; 2]; 2] {
    let options = PlanOptions {
        tip_deflection_m: TIP_DEFLECTION_M,
        ..PlanOptions::default()
    };
    let attitude = plan::assumed_attitude(planned, None, &options)
        .unwrap()
        .camera_from_survey;
    let scene = Scene::from_setup(planned, Some(attitude), seed, TIP_DEFLECTION_M).unwrap();
    let mut random = SeededRandom::new(seed, 21);
    let aircraft = SampledAircraft::new(&scene, &mut random);
    let configured = SampledAircraft::perturbed_setup(&scene, &mut random);
    let on_ground = aircraft.ground_shot(scene.ground_shot(seed));
    let orientation = Orientation {
        camera_from_survey: scene.truth(&on_ground).camera_from_survey
            * tilt(&scene.setup, &configured).inverse(),
        covariance_rad2: Some(Matrix3::identity() * 1e-9),
        ground: observations(&scene, &on_ground, &mut random),
        templates: vec![],
    };
    let deflection = |k: usize| TIP_DEFLECTION_M * (0.4 + 0.6 * k as f64 / (FRAMES - 1) as f64);
    let shots: Vec<SceneShot> = (0..FRAMES)
        .map(|k| {
            aircraft.flight_shot(
                scene.flight_shot(deflection(k), Light::Plain, seed),
                &mut random,
            )
        })
        .collect();
    let frames: Vec<Vec<Observation>> = shots
        .iter()
        .map(|shot| observations(&scene, shot, &mut random))
        .collect();
    let options = Options {
        sigma: adjust::SigmaKind::Prior,
        ..Options::default()
    };
    let solutions = adjust::solve_flight(&configured, &orientation, &frames, &options).unwrap();
    let last = solutions.last().unwrap();
    let truth = &scene.truth(&shots[FRAMES - 1]).markers;
    let before = &scene.truth(&on_ground).markers;
    let tip = truth
        .iter()
        .zip(&last.markers)
        .enumerate()
        .filter(|(_, (_, solved))| solved.deflection_m.is_some());
    let tip = tip
        .max_by(|(_, (a, _)), (_, (b, _))| a.deflection_m.abs().total_cmp(&b.deflection_m.abs()))
        .unwrap()
        .0;
    let of =
        |estimate: Option<adjust::Estimate>| estimate.map(|e| (e.value, e.sigma.unwrap())).unwrap();
    let (survey, ground) = (
        of(last.markers[tip].deflection_m),
        of(last.markers[tip].deflection_ground_m),
    );
    let of_truth = truth[tip].deflection_m;
    [
        [(survey.0 - of_truth) / survey.1, survey.1],
        [
            (ground.0 - of_truth + before[tip].deflection_m) / ground.1,
            ground.1,
        ],
    ]
}

/// Prints the errors of `AIRCRAFT=N` aircraft of the layout in `LAYOUT=DIR`, over their planned standard deviations.
pub fn print_layout() {
    let folder = std::env::var("LAYOUT").unwrap();
    let count = std::env::var("AIRCRAFT").unwrap().parse().unwrap();
    let setup = installation::load_without_orientation(Path::new(&folder))
        .unwrap()
        .setup;
    let all: Vec<_> = (0..count)
        .map(|seed| sampled_errors(&setup, 1000 + seed))
        .collect();
    let rms = |which: usize, of: usize| {
        (all.iter().map(|a| a[which][of].powi(2)).sum::<f64>() / count as f64).sqrt()
    };
    println!(
        "{folder}: normalised {:.2} against the survey (sigma {:.1} mm), {:.2} against the ground frame (sigma {:.1} mm)",
        rms(0, 0),
        1e3 * rms(0, 1),
        rms(1, 0),
        1e3 * rms(1, 1)
    );
}
