//! Wing with its camera, and one shot of it.

use nalgebra::{Rotation3, Vector2, Vector3};

use super::beam::LoadShape;
use super::clutter::SkinClutter;
use super::light::{Illumination, Light};
use super::markers::{MarkerDisc, SceneMarker};
use super::picture::RenderView;
use super::random::SeededRandom;
use super::sensor::SensorModel;
use super::wing::{DeformedWing, SceneMotion, SceneState, SceneWing};
use wingd_measure::geometry::{Lens, WingFrame};
use wingd_measure::raster::Raster;
use wingd_measure::setup::{Setup, Shape};

/// Installation together with the truth that its survey only approximates.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Setup that a user would have prepared, with the survey's noise.
    pub setup: Setup,
    /// The wing at rest.
    pub wing: SceneWing,
    /// True positions of the markers, in the survey's order.
    pub markers: Vec<SceneMarker>,
    /// True wing frame: its origin is the true projection centre.
    pub frame: WingFrame,
    /// True attitude of the camera when the ground frame was taken.
    pub camera_from_survey: Rotation3<f64>,
    /// Load in flight.
    pub load: LoadShape,
    /// Twist, nose up, rad per metre of tip deflection.
    pub twist_rad_per_m: f64,
    pub(super) clutter: SkinClutter,
}

/// Parameters of one frame to be rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneShot {
    /// Shape and temperature of the wing.
    pub state: SceneState,
    /// Kind of light; its details follow from `light_seed`.
    pub light: Light,
    /// Seed of the light; consecutive frames share it.
    pub light_seed: u64,
    /// Blur, noise, tone.
    pub sensor: SensorModel,
    /// Rotation of the mount: turns the camera frame, `exp([mount]x) * camera_from_survey`.
    pub mount: Rotation3<f64>,
    /// Focal length over that of the calibration, and shift of the principal point, px.
    pub lens_change: (f64, Vector2<f64>),
    /// Displacement of each marker in the survey's order, wing frame, m; 0 for markers beyond its end.
    pub target_shifts_m: Vec<Vector3<f64>>,
    /// Indices of absent markers.
    pub hidden: Vec<usize>,
    /// Seed of the noise.
    pub seed: u64,
}

impl Scene {
    /// Returns the wing at rest in even light.
    pub fn ground_shot(&self, seed: u64) -> SceneShot {
        SceneShot {
            state: SceneState::ground(self.load),
            light: Light::Plain,
            light_seed: seed,
            sensor: SensorModel::default(),
            mount: Rotation3::identity(),
            lens_change: (1.0, Vector2::zeros()),
            target_shifts_m: Vec::new(),
            hidden: Vec::new(),
            seed,
        }
    }

    /// Returns the wing in flight, its tip bent up by `tip_deflection_m`.
    pub fn flight_shot(&self, tip_deflection_m: f64, light: Light, seed: u64) -> SceneShot {
        let state = SceneState {
            tip_deflection_m,
            second_mode_m: 0.0,
            load: self.load,
            tip_twist_rad: self.twist_rad_per_m * tip_deflection_m,
            thermal_scale: self.setup.thermal.map_or(1.0, |thermal| thermal.scale()),
            motion: SceneMotion::default(),
        };
        SceneShot {
            state,
            light,
            ..self.ground_shot(seed)
        }
    }

    /// Samples a remount: pitch and yaw by the mount's repeatability, a little roll.
    pub fn remount(&self, random: &mut SeededRandom) -> Rotation3<f64> {
        let angle = self.setup.mount_repeatability_px / self.setup.lens.focal_px();
        Rotation3::from_euler_angles(
            angle * random.normal(),
            angle * random.normal(),
            0.3 * angle * random.normal(),
        )
    }

    /// Renders a shot; `None` for a lens without pixels.
    pub fn render(&self, shot: &SceneShot) -> Option<Raster> {
        let pose = self.wing.deform(&shot.state);
        let light = self.illumination(shot, &pose);
        let placed: Vec<MarkerDisc> = self
            .marker_discs(&pose, &shot.target_shifts_m)
            .into_iter()
            .enumerate()
            .filter(|(i, _)| {
                self.markers
                    .get(*i)
                    .is_some_and(|m| m.shape != Shape::Point)
                    && !shot.hidden.contains(i)
            })
            .map(|(_, marker)| marker)
            .collect();
        let lens = &self.lens(shot);
        let radiance = RenderView {
            pose: &pose,
            lens,
            wing_from_camera: self.camera_from_wing(shot).inverse(),
            markers: &placed,
            clutter: &self.clutter,
            light: &light,
        }
        .radiance();
        shot.sensor.develop(
            radiance,
            lens.width as usize,
            lens.height as usize,
            shot.seed,
        )
    }

    /// Returns the illumination of a shot.
    pub(super) fn illumination(&self, shot: &SceneShot, pose: &DeformedWing) -> Illumination {
        Illumination::random(shot.light, &mut SeededRandom::new(shot.light_seed, 1), pose)
    }

    /// Returns the discs of all markers in a shot, in the survey's order.
    pub(super) fn marker_discs(
        &self,
        pose: &DeformedWing,
        target_shifts_m: &[Vector3<f64>],
    ) -> Vec<MarkerDisc> {
        let mut all: Vec<MarkerDisc> = self
            .markers
            .iter()
            .map(|marker| marker.disc_on_wing(pose))
            .collect();
        all.iter_mut()
            .zip(target_shifts_m)
            .for_each(|(disc, shift)| disc.centre_m += shift);
        all
    }

    /// Returns the lens in a shot.
    pub(super) fn lens(&self, shot: &SceneShot) -> Lens {
        let (scale, off) = shot.lens_change;
        let lens = self.setup.lens;
        Lens {
            fx: scale * lens.fx,
            fy: scale * lens.fy,
            cx: lens.cx + off.x,
            cy: lens.cy + off.y,
            ..lens
        }
    }

    /// Returns the true attitude of the camera in a shot.
    pub fn camera_from_survey(&self, shot: &SceneShot) -> Rotation3<f64> {
        shot.mount * self.camera_from_survey
    }

    /// Returns the true attitude of the camera relative to the wing frame.
    pub(super) fn camera_from_wing(&self, shot: &SceneShot) -> Rotation3<f64> {
        self.camera_from_survey(shot) * self.frame.wing_from_survey.inverse()
    }
}
