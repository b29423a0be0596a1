//! Errors of what an installation states and what flight does to wing, cabin and camera, drawn by the installation's own widths:
//! so that errors over standard deviations mean something.
//!
//! Not drawn, because no scene shows it: a bend that does not go with the load, bending in the wing's plane, a control surface's
//! torque, the skin's motion, turns of the root in the wing's plane, a rolling shutter. [`Drawn::undrawn`] gives the widths
//! without them.

use nalgebra::{Rotation3, Vector2, Vector3};

use super::random::SeededRandom;
use super::scene::{Scene, SceneShot};
use super::wing::SceneMotion;
use crate::setup::{
    FlightEffectPriors, Setup, SkinHeight, SurveyMarker, Thermal, UNSTATED_SCALE_SIGMA, Uncertainty,
};

/// One aircraft of those that an installation allows, in one flight.
#[derive(Clone, Debug)]
pub struct SampledAircraft {
    /// Bend of the wing in the ground frame, at the tip, m.
    ground_bend_m: f64,
    /// Length in flight over what the installation says.
    length: f64,
    moved: SceneMotion,
    mount: Rotation3<f64>,
    /// Rotation between two frames, standard deviation about each axis, rad.
    drift_rad: f64,
    lens_change: (f64, Vector2<f64>),
    /// Of each marker of the survey: only fixed marks move by themselves, m.
    marks_m: Vec<Vector3<f64>>,
}

impl SampledAircraft {
    /// Draws an aircraft of the scene's installation.
    pub fn new(scene: &Scene, random: &mut SeededRandom) -> Self {
        let widths = &scene.setup.uncertainty;
        let flight = &widths.in_flight;
        let mut normal = |sigma: f64| sigma * random.normal();
        let moved = SceneMotion {
            camera_m: Vector3::from_fn(|_, _| normal(widths.mount_shift_m)),
            root_m: Vector3::from_fn(|_, _| normal(flight.root_translation_m)),
            root_pitch_rad: normal(flight.root_rotation_rad),
            root_slope_rad: normal(flight.root_rotation_rad),
        };
        let length =
            1.0 + normal(scene.setup.thermal.as_ref().map_or(UNSTATED_SCALE_SIGMA, Thermal::scale_sigma));
        let scale = 1.0 + normal(flight.scale);
        let off = Vector2::from_fn(|_, _| normal(flight.principal_point_px));
        let ground_bend_m = normal(flight.ground_bend_m);
        let own = |marker: &SurveyMarker| if marker.fixed { marker.flight_motion_m } else { 0.0 };
        let sigmas: Vec<f64> = scene.setup.markers.iter().map(own).collect();
        let marks_m = sigmas.into_iter().map(|sigma| Vector3::from_fn(|_, _| normal(sigma))).collect();
        let mount = scene.remount(random);
        Self {
            ground_bend_m,
            length,
            moved,
            mount,
            drift_rad: widths.mount_drift_rad,
            lens_change: (scale, off),
            marks_m,
        }
    }

    /// The ground frame's shot: the wing may stand otherwise than it was surveyed.
    pub fn ground_shot(&self, mut shot: SceneShot) -> SceneShot {
        shot.state.tip_deflection_m += self.ground_bend_m;
        shot
    }

    /// A shot in flight.
    pub fn flight_shot(&self, mut shot: SceneShot, random: &mut SeededRandom) -> SceneShot {
        let drift = Vector3::from_fn(|_, _| self.drift_rad * random.normal());
        shot.mount = Rotation3::new(drift) * self.mount * shot.mount;
        shot.state.thermal_scale *= self.length;
        shot.state.moved = self.moved;
        shot.lens_change = self.lens_change;
        shot.marks_m.clone_from(&self.marks_m);
        shot
    }

    /// What a user states of the scene: off by what was drawn, with the widths of what is drawn alone.
    pub fn perturbed_setup(scene: &Scene, random: &mut SeededRandom) -> Setup {
        let mut setup = scene.setup.clone();
        let widths = setup.uncertainty;
        let mut normal = |sigma: f64| sigma * random.normal();
        let tilt = widths.in_flight.vertical_rad;
        let tilt = Rotation3::new(Vector3::new(normal(tilt), normal(tilt), 0.0));
        for marker in &mut setup.markers {
            let error = Vector3::from_fn(|_, _| normal(marker.sigma_m));
            marker.position_m = tilt * (marker.position_m + error);
        }
        let error = Vector3::from_fn(|_, _| normal(setup.projection_centre_sigma_m));
        setup.projection_centre_m = tilt * (setup.projection_centre_m + error);
        let (sin, cos) = normal(widths.span_direction_rad).sin_cos();
        let span = setup.span_direction;
        setup.span_direction = Vector2::new(cos * span.x - sin * span.y, sin * span.x + cos * span.y);
        setup.root_offset_m += normal(widths.root_offset_m);
        setup.axis_chord_offset_m = Some(scene.wing.axis_z_m + normal(widths.axis_chord_offset_m));
        let off = normal(widths.skin_height_sigma_m);
        let skin = scene.wing.skin_m;
        let tip_span_m = scene.wing.beam.length_m;
        setup.skin_height = Some(SkinHeight { root_m: skin.root + off, tip_m: skin.tip + off, tip_span_m });
        setup.uncertainty = Self::without_unsampled(widths);
        setup
    }

    /// Widths without what is never drawn.
    pub fn without_unsampled(widths: Uncertainty) -> Uncertainty {
        let none = FlightEffectPriors::NONE.vibration;
        let in_flight = FlightEffectPriors {
            constant_bend_m: 0.0,
            skin_motion_m: 0.0,
            skin_by_frames: false,
            in_plane_m: 0.0,
            torque_rad: 0.0,
            readout_s: 0.0,
            vibration: none,
            shake: none,
            ..widths.in_flight
        };
        Uncertainty { in_flight, ..widths }
    }
}
