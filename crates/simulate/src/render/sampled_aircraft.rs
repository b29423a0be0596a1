//! Errors of an installation and in-flight effects, sampled from the installation's own prior standard deviations, so that
//! errors over standard deviations are meaningful.
//!
//! Not sampled, because the scene does not model it: a bend unrelated to the load, in-plane bending, the torque of a
//! control surface, motion of the skin, rotation of the root in the wing's plane, a rolling shutter.
//! [`SampledAircraft::without_unsampled`] returns the priors without them.

use nalgebra::{Rotation3, Vector2, Vector3};

use super::random::SeededRandom;
use super::scene::{Scene, SceneShot};
use super::wing::SceneMotion;
use wingd_measure::setup::{
    DEFAULT_SCALE_SIGMA, Setup, SetupUncertainty, SkinHeight, SurveyMarker, Thermal, Width,
};

/// Aircraft sampled from an installation's priors, in one flight.
#[derive(Clone, Debug)]
pub struct SampledAircraft {
    /// Bend of the wing in the ground frame, at the tip, m.
    ground_bend_m: f64,
    /// Length in flight over that of the installation.
    length: f64,
    moved: SceneMotion,
    mount: Rotation3<f64>,
    /// Rotation between two frames, standard deviation about each axis, rad.
    drift_rad: f64,
    lens_change: (f64, Vector2<f64>),
    /// Displacement of each marker of the survey, m; 0 except for fixed targets.
    target_shifts_m: Vec<Vector3<f64>>,
}

impl SampledAircraft {
    /// Samples an aircraft of the scene's installation.
    pub fn new(scene: &Scene, random: &mut SeededRandom) -> Self {
        let priors = &scene.setup.uncertainty;
        let mut normal = |sigma: f64| sigma * random.normal();
        let moved = SceneMotion {
            camera_m: Vector3::from_fn(|_, _| normal(priors[Width::MountShift])),
            root_m: Vector3::from_fn(|_, _| normal(priors[Width::RootTranslation])),
            root_pitch_rad: normal(priors[Width::RootRotation]),
            root_slope_rad: normal(priors[Width::RootRotation]),
        };
        let length = 1.0
            + normal(
                scene
                    .setup
                    .thermal
                    .as_ref()
                    .map_or(DEFAULT_SCALE_SIGMA, Thermal::scale_sigma),
            );
        let scale = 1.0 + normal(priors[Width::FlightScale]);
        let off = Vector2::from_fn(|_, _| normal(priors[Width::PrincipalPoint]));
        let ground_bend_m = normal(priors[Width::GroundBend]);
        let motion_sigma = |marker: &SurveyMarker| {
            if marker.fixed {
                marker.flight_motion_m
            } else {
                0.0
            }
        };
        let sigmas: Vec<f64> = scene.setup.markers.iter().map(motion_sigma).collect();
        let target_shifts_m = sigmas
            .into_iter()
            .map(|sigma| Vector3::from_fn(|_, _| normal(sigma)))
            .collect();
        let mount = scene.remount(random);
        Self {
            ground_bend_m,
            length,
            moved,
            mount,
            drift_rad: priors[Width::MountDrift],
            lens_change: (scale, off),
            target_shifts_m,
        }
    }

    /// Returns the ground frame's shot, with the wing bent since the survey.
    pub fn ground_shot(&self, mut shot: SceneShot) -> SceneShot {
        shot.state.tip_deflection_m += self.ground_bend_m;
        shot
    }

    /// Returns a shot in flight.
    pub fn flight_shot(&self, mut shot: SceneShot, random: &mut SeededRandom) -> SceneShot {
        let drift = Vector3::from_fn(|_, _| self.drift_rad * random.normal());
        shot.mount = Rotation3::new(drift) * self.mount * shot.mount;
        shot.state.thermal_scale *= self.length;
        shot.state.motion = self.moved;
        shot.lens_change = self.lens_change;
        shot.target_shifts_m.clone_from(&self.target_shifts_m);
        shot
    }

    /// Samples the setup that a user has: with the sampled errors, and the priors of the sampled quantities only.
    pub fn perturbed_setup(scene: &Scene, random: &mut SeededRandom) -> Setup {
        let mut setup = scene.setup.clone();
        let priors = setup.uncertainty;
        let mut normal = |sigma: f64| sigma * random.normal();
        let tilt = priors[Width::Vertical];
        let tilt = Rotation3::new(Vector3::new(normal(tilt), normal(tilt), 0.0));
        for marker in &mut setup.markers {
            let error = Vector3::from_fn(|_, _| normal(marker.sigma_m));
            marker.position_m = tilt * (marker.position_m + error);
        }
        let error = Vector3::from_fn(|_, _| normal(setup.projection_centre_sigma_m));
        setup.projection_centre_m = tilt * (setup.projection_centre_m + error);
        let (sin, cos) = normal(priors[Width::SpanDirection]).sin_cos();
        let span = setup.span_direction;
        setup.span_direction =
            Vector2::new(cos * span.x - sin * span.y, sin * span.x + cos * span.y);
        setup.root_offset_m += normal(priors[Width::RootOffset]);
        setup.axis_chord_offset_m = Some(scene.wing.axis_z_m + normal(priors[Width::ChordOffset]));
        let off = normal(priors[Width::SkinHeight]);
        let skin = scene.wing.skin_m;
        let tip_span_m = scene.wing.beam.length_m;
        setup.skin_height = Some(SkinHeight {
            root_m: skin.root + off,
            tip_m: skin.tip + off,
            tip_span_m,
        });
        setup.uncertainty = Self::without_unsampled(priors);
        setup
    }

    /// Removes the priors of quantities that are never sampled.
    pub fn without_unsampled(mut priors: SetupUncertainty) -> SetupUncertainty {
        let unsampled = [
            Width::ConstantBend,
            Width::SkinMotion,
            Width::InPlane,
            Width::Torque,
            Width::Readout,
        ];
        unsampled.into_iter().for_each(|width| priors[width] = 0.0);
        let SetupUncertainty {
            vibration, shake, ..
        } = SetupUncertainty::from_drawings();
        SetupUncertainty {
            skin_scaled_by_frames: false,
            vibration,
            shake,
            ..priors
        }
    }
}
