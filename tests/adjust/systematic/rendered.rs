//! Systematic errors on wings of the renderer.

use nalgebra::{Matrix2, Rotation3, Vector3};
use rand::rngs::StdRng;
use wingd::measure::adjust::{self, Estimate, GlobalTest, Observation, Options};
use wingd::measure::setup::{Orientation, Setup, SetupUncertainty, Width};
use wingd_simulate::render::{
    FrameTruth, Light, MarkerTruth, Scene, SceneOptions as RenderOptions, SceneSide,
};

use super::{ErrorSource, KINDS, PRIORS, fit_to_ground_frame, misconfigure};
use crate::common::beam_truth::{normal2, normal3, remounted, rms, rng};

/// A wing of the renderer without its images: observed marker positions on the ground and in one flight frame, with noise.
struct Rendered {
    scene: Scene,
    orientation: Orientation,
    flight: FrameTruth,
    mount: Vector3<f64>,
}

const NOISE_PX: f64 = 0.05;

impl Rendered {
    fn new(seed: u64, rng: &mut StdRng) -> Self {
        let side = if seed.is_multiple_of(2) {
            SceneSide::Left
        } else {
            SceneSide::Right
        };
        let scene = Scene::random(seed, &RenderOptions::random(seed, side));
        let truth = scene.truth(&scene.ground_shot(seed));
        let covariance_px2 = Matrix2::identity() * (NOISE_PX * NOISE_PX);
        let seen = truth.markers.iter().enumerate().filter(|(_, m)| m.visible);
        let ground = seen
            .map(|(marker, m)| Observation {
                marker,
                pixel: m.pixel.unwrap() + normal2(rng) * NOISE_PX,
                covariance_px2,
            })
            .collect();
        let orientation = Orientation {
            camera_from_survey: truth.camera_from_survey,
            covariance_rad2: Some(nalgebra::Matrix3::identity() * 1e-9),
            ground,
            templates: vec![],
        };
        let flight =
            scene.truth(&scene.flight_shot(0.07 * scene.wing.beam.length_m, Light::Plain, seed));
        let mount = remounted(rng, &scene.setup);
        Self {
            scene,
            orientation,
            flight,
            mount,
        }
    }

    /// Observations of the camera in flight after a rotation and shift.
    fn frame(&self, rng: &mut StdRng, shift_m: Vector3<f64>) -> Vec<Observation> {
        let rotation = Rotation3::new(self.mount) * self.flight.camera_from_survey;
        let centre = self.scene.frame.survey_point(&Vector3::zeros()) + shift_m;
        let visible = self
            .flight
            .markers
            .iter()
            .enumerate()
            .filter(|(_, m)| m.visible);
        let see = |(marker, m): (usize, &MarkerTruth)| {
            let pixel = self
                .scene
                .setup
                .lens
                .project(&(rotation * (m.position_m - centre)))?;
            let covariance_px2 = Matrix2::identity() * (NOISE_PX * NOISE_PX);
            Some(Observation {
                marker,
                pixel: pixel + normal2(rng) * NOISE_PX,
                covariance_px2,
            })
        };
        visible.filter_map(see).collect()
    }

    /// Normalised errors of all deflections, and whether the test passed.
    fn errors(&self, setup: &Setup, frame: &[Observation]) -> (Vec<f64>, bool) {
        let orientation = fit_to_ground_frame(setup, self.orientation.clone());
        let solution =
            adjust::solve_spatial(setup, &orientation, frame, &Options::default()).unwrap();
        let deflections = solution
            .markers
            .iter()
            .filter(|m| m.used)
            .filter_map(|m| Some((m.marker, m.deflection_m?)));
        let error = |(k, deflection): (usize, Estimate)| {
            (deflection.value - self.flight.markers[k].deflection_m) / deflection.sigma.unwrap()
        };
        (
            deflections.map(error).collect(),
            solution.global_test != Some(GlobalTest::Rejected),
        )
    }
}

#[test]
fn configured_uncertainties_are_in_the_sigma_of_rendered_wings() {
    let mut rng = rng(31);
    let wings: Vec<Rendered> = (500..600)
        .map(|seed| Rendered::new(seed, &mut rng))
        .collect();
    for wrong in KINDS {
        let mut all = vec![];
        for wing in &wings {
            let setup = misconfigure(&mut rng, wing.scene.setup.clone(), wrong);
            let shift =
                normal3(&mut rng) * (wrong.factor(ErrorSource::Shift) * PRIORS[Width::MountShift]);
            all.extend(wing.errors(&setup, &wing.frame(&mut rng, shift)).0);
        }
        println!(
            "rendered, {wrong:?}: normalised deflection rms {:.2}",
            rms(&all)
        );
        assert!(rms(&all) < 1.3, "{wrong:?}: {}", rms(&all));
        assert!(
            rms(&all) > 0.63,
            "{wrong:?} has too large a sigma: {}",
            rms(&all)
        );
    }
}

#[test]
fn a_shifted_camera_is_in_the_sigma_of_rendered_wings_or_rejected() {
    let mut rng = rng(32);
    let wings: Vec<Rendered> = (600..630)
        .map(|seed| Rendered::new(seed, &mut rng))
        .collect();
    for shift_mm in [0.0, 0.5, 1.0, 2.0, 5.0] {
        let (mut all, mut passed) = (vec![], vec![]);
        for (k, wing) in wings.iter().enumerate() {
            let setup = Setup {
                uncertainty: SetupUncertainty::from_drawings().with_width(Width::MountShift, 0.002),
                ..wing.scene.setup.clone()
            };
            let shift = Vector3::ith(k % 3, 1e-3 * shift_mm);
            let (errors, good) = wing.errors(&setup, &wing.frame(&mut rng, shift));
            if good {
                passed.extend_from_slice(&errors);
            }
            all.extend(errors);
        }
        println!(
            "rendered, shift {shift_mm} mm: normalised deflection rms {:.2}, passed {:.2}",
            rms(&all),
            rms(&passed)
        );
        assert!(
            rms(&all) > 0.3
                && if shift_mm < 3.0 {
                    rms(&all) < 1.3
                } else {
                    rms(&passed) < 2.0
                },
            "{shift_mm} mm"
        );
    }
}
