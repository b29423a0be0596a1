//! A wing with its camera, and one shot of it.

use nalgebra::{Rotation3, Vector2, Vector3};

use super::beam::LoadShape;
use super::decals::SkinClutter;
use super::light::{Illumination, Light};
use super::markers::{SceneMarker, MarkerDisc};
use super::picture::RenderView;
use super::random::SeededRandom;
use super::sensor::SensorModel;
use super::wing::{SceneMotion, DeformedWing, SceneState, SceneWing};
use crate::geometry::{Lens, WingFrame};
use crate::raster::Raster;
use crate::setup::Setup;

/// An installation together with the truth that its survey only approximates.
#[derive(Clone, Debug)]
pub struct Scene {
    /// What the user would have prepared: with the survey's noise.
    pub setup: Setup,
    /// The wing at rest.
    pub wing: SceneWing,
    /// True places of the markers, in the survey's order.
    pub markers: Vec<SceneMarker>,
    /// True wing frame: its origin is the true projection centre.
    pub frame: WingFrame,
    /// True attitude of the camera when the ground frame was taken.
    pub camera_from_survey: Rotation3<f64>,
    /// Load in flight.
    pub load: LoadShape,
    /// Nose up, rad per metre of tip deflection.
    pub twist_rad_per_m: f64,
    pub(super) clutter: SkinClutter,
}

/// One frame to be rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneShot {
    /// Shape and temperature of the wing.
    pub state: SceneState,
    /// Kind of light; its details follow from `light_seed`.
    pub light: Light,
    /// Frames that are shot right after one another share it.
    pub light_seed: u64,
    /// Blur, noise, tone.
    pub sensor: SensorModel,
    /// Shift of the mount: rotates the camera frame, `exp([mount]x) * camera_from_survey`.
    pub mount: Rotation3<f64>,
    /// Camera constant over that of the calibration, and shift of the principal point, px.
    pub lens_change: (f64, Vector2<f64>),
    /// By how much each marker has moved by itself, in the survey's order, wing frame, m; those beyond its end have not.
    pub marks_m: Vec<Vector3<f64>>,
    /// Indices of markers that are not there.
    pub hidden: Vec<usize>,
    /// Of the noise.
    pub seed: u64,
}

impl Scene {
    /// The wing at rest in even light.
    pub fn ground_shot(&self, seed: u64) -> SceneShot {
        SceneShot {
            state: SceneState::ground(self.load),
            light: Light::Plain,
            light_seed: seed,
            sensor: SensorModel::default(),
            mount: Rotation3::identity(),
            lens_change: (1.0, Vector2::zeros()),
            marks_m: Vec::new(),
            hidden: Vec::new(),
            seed,
        }
    }

    /// The wing in flight, its tip bent up by `tip_deflection_m`.
    pub fn flight_shot(&self, tip_deflection_m: f64, light: Light, seed: u64) -> SceneShot {
        let state = SceneState {
            tip_deflection_m,
            second_mode_m: 0.0,
            load: self.load,
            tip_twist_rad: self.twist_rad_per_m * tip_deflection_m,
            thermal_scale: self.setup.thermal.map_or(1.0, |thermal| thermal.scale()),
            moved: SceneMotion::default(),
        };
        SceneShot { state, light, ..self.ground_shot(seed) }
    }

    /// A remount: pitch and yaw by the mount's repeatability, a little roll.
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
            .marker_discs(&pose, &shot.marks_m)
            .into_iter()
            .enumerate()
            .filter_map(|(i, marker)| (!shot.hidden.contains(&i)).then_some(marker))
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
        shot.sensor.develop(radiance, lens.width as usize, lens.height as usize, shot.seed)
    }

    pub(super) fn illumination(&self, shot: &SceneShot, pose: &DeformedWing) -> Illumination {
        Illumination::random(shot.light, &mut SeededRandom::new(shot.light_seed, 1), pose)
    }

    pub(super) fn marker_discs(&self, pose: &DeformedWing, marks_m: &[Vector3<f64>]) -> Vec<MarkerDisc> {
        let mut all: Vec<MarkerDisc> = self.markers.iter().map(|marker| marker.disc_on_wing(pose)).collect();
        all.iter_mut().zip(marks_m).for_each(|(placed, by)| placed.centre_m += by);
        all
    }

    /// The lens in a shot.
    pub(super) fn lens(&self, shot: &SceneShot) -> Lens {
        let (scale, off) = shot.lens_change;
        let lens = self.setup.lens;
        Lens { fx: scale * lens.fx, fy: scale * lens.fy, cx: lens.cx + off.x, cy: lens.cy + off.y, ..lens }
    }

    /// True attitude of the camera in a shot.
    pub fn camera_from_survey(&self, shot: &SceneShot) -> Rotation3<f64> {
        shot.mount * self.camera_from_survey
    }

    pub(super) fn camera_from_wing(&self, shot: &SceneShot) -> Rotation3<f64> {
        self.camera_from_survey(shot) * self.frame.wing_from_survey.inverse()
    }
}
