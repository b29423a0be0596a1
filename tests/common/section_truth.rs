//! Truth of the renderer's wing as a surface: poses of its sections, and points of both skins on the ground and in flight.

use nalgebra::{Matrix3, Rotation3, Vector3};
use wingd::measure::deformation::SectionPose;
use wingd::measure::render::{DeformedWing, Scene, SceneShot, SceneState};

/// A rendered wing on the ground and in one shot.
pub struct SectionTruth {
    scene: Scene,
    ground: DeformedWing,
    flight: DeformedWing,
}

/// Height of the lower skin below the axis over that of the upper skin above it; the renderer draws the upper one alone.
const LOWER_OVER_UPPER: f64 = -0.7;

impl SectionTruth {
    pub fn new(scene: &Scene, shot: &SceneShot) -> Self {
        let wing = &scene.wing;
        let ground = wing.deform(&SceneState::ground(shot.state.load));
        Self {
            scene: scene.clone(),
            ground,
            flight: wing.deform(&shot.state),
        }
    }

    pub fn length_m(&self) -> f64 {
        self.scene.wing.beam.length_m
    }

    /// Leading and trailing edge at a station, m from the axis along the chord.
    pub fn edges_m(&self, s: f64) -> (f64, f64) {
        let (low, high) = self.scene.wing.edges(s);
        if self.scene.wing.side.aft_sign() > 0.0 {
            (low, high)
        } else {
            (high, low)
        }
    }

    /// Axis and axes (along, up, chord) of a section, survey frame.
    fn section(&self, wing: &DeformedWing, s: f64) -> (Vector3<f64>, Matrix3<f64>) {
        let at = wing.section_at(s);
        let axis = Vector3::new(at.x, at.y, wing.wing.axis_z_m) - wing.cabin_m;
        let slope = Matrix3::new(at.cos, -at.sin, 0.0, at.sin, at.cos, 0.0, 0.0, 0.0, 1.0);
        let (cos, sin) = (at.twist_cos, at.twist_sin);
        let twist = Matrix3::new(1.0, 0.0, 0.0, 0.0, cos, -sin, 0.0, sin, cos);
        let survey = self.scene.frame.wing_from_survey.inverse();
        (
            self.scene.frame.survey_point(&axis),
            survey.matrix() * slope * twist,
        )
    }

    /// Poses of equally spaced sections from the root to the tip.
    pub fn poses(&self, count: usize) -> Vec<SectionPose> {
        let pose = |k: usize| {
            let arc_m = self.length_m() * k as f64 / (count - 1) as f64;
            let (ground_m, ground) = self.section(&self.ground, arc_m);
            let (flight_m, flight) = self.section(&self.flight, arc_m);
            let rotation = Rotation3::from_matrix_eps(
                &(flight * ground.transpose()),
                1e-12,
                100,
                Rotation3::identity(),
            );
            SectionPose {
                arc_m,
                ground_m,
                displacement_m: flight_m - ground_m,
                rotation,
            }
        };
        (0..count).map(pose).collect()
    }

    /// A point of the upper or lower skin on the ground and in flight, survey frame, m.
    pub fn skin(&self, upper: bool, s: f64, z: f64) -> [Vector3<f64>; 2] {
        let height = self.scene.wing.skin_height(s, z) * if upper { 1.0 } else { LOWER_OVER_UPPER };
        [&self.ground, &self.flight].map(|wing| {
            let (axis, axes) = self.section(wing, s);
            axis + axes * Vector3::new(0.0, height, z) * wing.scale
        })
    }
}
