//! Promise: a surface moved by the measured shape is that of the wing in flight: both skins of rendered wings to 8 mm (rms),
//! the twist between leading and trailing edge to 0.1 degrees, with standard deviations that cover the errors.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use wingd::desk::simulation::with_default_priors;
use wingd::measure::adjust::{self, JointShape, Observation, Options, SigmaKind, StationChoice};
use wingd::measure::deformation::{BLEND_FRACTION, SampledPoses, WingDeformation, sample_sigma_m};
use wingd::measure::render::{
    Light, MarkerTruth, SampledAircraft, Scene, SceneOptions, SceneShot, SceneSide, SeededRandom,
};
use wingd::measure::setup::{Orientation, Setup, Width};

use crate::common::section_truth::SectionTruth;
use crate::common::statistics::rms;

const NOISE_PX: f64 = 0.05;
const FRAMES: usize = 5;

fn observe(random: &mut SeededRandom, scene: &Scene, shot: &SceneShot) -> Vec<Observation> {
    let mut see = |(marker, m): (usize, MarkerTruth)| {
        let noise = Vector2::new(random.normal(), random.normal()) * NOISE_PX;
        let covariance_px2 = Matrix2::identity() * (NOISE_PX * NOISE_PX);
        Observation {
            marker,
            pixel: m.pixel.unwrap() + noise,
            covariance_px2,
        }
    };
    scene
        .truth(shot)
        .markers
        .into_iter()
        .enumerate()
        .filter(|(_, m)| m.visible)
        .map(&mut see)
        .collect()
}

/// Joint shape of a flight whose tip deflections rise to the largest that stays in the picture, with its shots. `scene.setup`
/// is the truth, `specified` what the installation says.
fn measure_flight(
    random: &mut SeededRandom,
    (scene, specified): (&Scene, &Setup),
    aircraft: Option<&SampledAircraft>,
    tip_deflection_m: f64,
) -> (JointShape, Vec<SceneShot>) {
    let ground = scene.ground_shot(1);
    let ground = aircraft.map_or(ground.clone(), |aircraft| aircraft.ground_shot(ground));
    let orientation = Orientation {
        camera_from_survey: scene.camera_from_survey,
        covariance_rad2: Some(Matrix3::identity() * 1e-9),
        ground: observe(random, scene, &ground),
        templates: vec![],
    };
    let mount = scene.remount(random);
    let mut fly = |k: usize| {
        let shot = scene.flight_shot(tip_deflection_m * (0.6 + 0.1 * k as f64), Light::Plain, 1);
        match aircraft {
            Some(aircraft) => aircraft.flight_shot(shot, random),
            None => SceneShot { mount, ..shot },
        }
    };
    let shots: Vec<SceneShot> = (0..FRAMES).map(&mut fly).collect();
    let frames: Vec<_> = shots
        .iter()
        .map(|shot| observe(random, scene, shot))
        .collect();
    let options = Options {
        sigma: SigmaKind::Prior,
        ..Options::default()
    };
    let shape = adjust::solve_flight_shape(
        specified,
        &orientation,
        &frames,
        &options,
        &StationChoice::Standard,
    );
    (shape.unwrap(), shots)
}

/// Errors of a frame's surface, mm; those over their standard deviations; errors of the edges' twist, degrees.
#[derive(Default)]
struct SurfaceErrors {
    skin_mm: Vec<f64>,
    normalised: Vec<f64>,
    twist_deg: Vec<f64>,
}

impl SurfaceErrors {
    fn add_frame(&mut self, scene: &Scene, shot: &SceneShot, shape: &JointShape, frame: usize) {
        let truth = SectionTruth::new(scene, shot);
        let poses = SampledPoses::new(shape, &[frame], 100, 7);
        let wing = WingDeformation::new(&poses.mean).unwrap();
        let samples: Vec<_> = poses
            .samples
            .iter()
            .map(|one| WingDeformation::new(one).unwrap())
            .collect();
        for k in 1..=60 {
            let s = truth.length_m() * f64::from(k) / 60.0;
            let (leading, trailing) = truth.edges_m(s);
            let chord = |from: Vector3<f64>, to: Vector3<f64>| {
                ((to - from).z / (to - from).norm()).asin().to_degrees()
            };
            for upper in [true, false] {
                let points = [0.0, 0.25, 0.5, 0.75, 1.0]
                    .map(|f| truth.skin(upper, s, leading + f * (trailing - leading)));
                let moved = points.map(|[ground, _]| wing.move_point(&ground));
                for ([ground, flight], moved) in points.iter().zip(&moved) {
                    let error = moved - flight;
                    self.skin_mm.push(1e3 * error.norm());
                    if s > BLEND_FRACTION * truth.length_m() {
                        self.normalised
                            .push(error.z / sample_sigma_m(&samples, ground).unwrap().z);
                    }
                }
                self.twist_deg
                    .push(chord(moved[0], moved[4]) - chord(points[0][1], points[4][1]));
            }
        }
    }

    fn add(&mut self, name: &str, other: Self) {
        other.print(name);
        self.skin_mm.extend(other.skin_mm);
        self.normalised.extend(other.normalised);
        self.twist_deg.extend(other.twist_deg);
    }

    fn print(&self, name: &str) {
        let [skin_mm, normalised, twist_deg] =
            [&self.skin_mm, &self.normalised, &self.twist_deg].map(|v| rms(v));
        println!(
            "{name}: skins {skin_mm:.1} mm, heights {normalised:.2} sigma, twist {twist_deg:.3} deg (rms)"
        );
    }
}

fn random_scene(seed: u64) -> (Scene, f64) {
    let side = if seed.is_multiple_of(2) {
        SceneSide::Left
    } else {
        SceneSide::Right
    };
    let options = SceneOptions::random(seed, side);
    (Scene::random(seed, &options), options.tip_deflection_m)
}

#[test]
fn surfaces_moved_by_the_measured_shape_are_those_in_flight() {
    let mut all = SurfaceErrors::default();
    for seed in 900..908 {
        let (scene, tip_deflection_m) = random_scene(seed);
        let mut random = SeededRandom::new(seed, 41);
        let (shape, shots) =
            measure_flight(&mut random, (&scene, &scene.setup), None, tip_deflection_m);
        let mut own = SurfaceErrors::default();
        shots
            .iter()
            .enumerate()
            .for_each(|(k, shot)| own.add_frame(&scene, shot, &shape, k));
        all.add(&format!("wing {seed}"), own);
    }
    all.print("all wings");
    assert!(rms(&all.skin_mm) < 8.0 && rms(&all.twist_deg) < 0.1 && rms(&all.normalised) < 1.2);
}

#[test]
fn standard_deviations_of_surfaces_cover_the_errors_of_sampled_aircraft() {
    let mut all = SurfaceErrors::default();
    for seed in 920..944 {
        let (mut scene, tip_deflection_m) = random_scene(seed);
        scene.setup = with_default_priors(&scene.setup);
        // A survey that leans moves the surface given in it, too.
        scene.setup.uncertainty[Width::Vertical] = 0.0;
        let mut random = SeededRandom::new(seed, 42);
        let aircraft = SampledAircraft::new(&scene, &mut random);
        let specified = SampledAircraft::perturbed_setup(&scene, &mut random);
        let (shape, shots) = measure_flight(
            &mut random,
            (&scene, &specified),
            Some(&aircraft),
            tip_deflection_m,
        );
        let mut own = SurfaceErrors::default();
        own.add_frame(&scene, &shots[FRAMES - 1], &shape, FRAMES - 1);
        all.add(&format!("aircraft {seed}"), own);
    }
    all.print("all aircraft");
    assert!((0.6..1.3).contains(&rms(&all.normalised)));
}
