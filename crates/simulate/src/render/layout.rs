//! Random wings, cameras and marker layouts.

use nalgebra::{Rotation3, Vector2, Vector3};

use super::beam::{CantileverBeam, LoadShape};
use super::clutter::SkinClutter;
use super::light::Light;
use super::markers::SceneMarker;
use super::random::SeededRandom;
use super::scene::Scene;
use super::wing::{LinearTaper, SceneSide, SceneWing};
use wingd_measure::geometry::{Lens, WingFrame};
use wingd_measure::setup;
use wingd_measure::setup::{
    Setup, SetupUncertainty, Shape, SkinHeight, SurveyMarker, Thermal, TorsionPair, fixed_target,
};

/// Options of a random scene.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneOptions {
    pub side: SceneSide,
    pub lens: Lens,
    /// Quadrants near the fuselage; the rest are circles.
    pub quadrants: usize,
    /// Number of markers, including the torsion pair at the tip.
    pub markers: usize,
    /// Length of the wing, m.
    pub length_m: f64,
    /// Largest tip deflection that must stay in the frame, m.
    pub tip_deflection_m: f64,
    /// Noise of the survey and of the projection centre, m.
    pub survey_sigma_m: f64,
    /// Camera above the skin at the root, m.
    pub camera_height_m: f64,
    /// Diameter of the markers, m.
    pub diameter_m: f64,
    /// Density of the clutter; 1 is typical, 0 none.
    pub clutter: f64,
    /// Number of fixed targets, at most those of [`fixed_target::POSITIONS`].
    pub fixed_targets: usize,
    /// Number of points: salient structures without a decal.
    pub points: usize,
}

impl SceneOptions {
    /// Samples the options of a typical installation.
    pub fn random(seed: u64, side: SceneSide) -> Self {
        let mut random = SeededRandom::new(seed, 10);
        let (width, height) = (4000, 3000);
        let f = random.uniform(7200.0, 8600.0);
        let lens = Lens {
            fy: f * random.uniform(0.9990, 1.0010),
            k1: random.uniform(-0.12, 0.08),
            k2: random.uniform(-0.15, 0.15),
            k3: random.uniform(-0.05, 0.05),
            p1: random.uniform(-6e-4, 6e-4),
            p2: random.uniform(-6e-4, 6e-4),
            ..Lens::pinhole(
                width,
                height,
                f,
                2000.0 + random.uniform(-25.0, 25.0),
                1500.0 + random.uniform(-25.0, 25.0),
            )
        };
        let length_m: f64 = random.uniform(26.0, 37.0);
        Self {
            side,
            lens: round_lens(&lens),
            quadrants: random.integer(8, 12),
            markers: random.integer(18, 27),
            length_m,
            tip_deflection_m: length_m * random.uniform(0.08, 0.10),
            survey_sigma_m: 0.002,
            camera_height_m: random.uniform(1.6, 2.2),
            diameter_m: random.uniform(0.28, 0.38),
            clutter: 1.0,
            fixed_targets: 0,
            points: 0,
        }
    }
}

impl Scene {
    /// Samples a scene from a seed.
    pub fn random(seed: u64, options: &SceneOptions) -> Self {
        let mut random = SeededRandom::new(seed, 11);
        let wing = random_wing(&mut random, options);
        let heading = random.uniform(0.0, std::f64::consts::TAU);
        let span = round_vector(Vector3::new(heading.cos(), heading.sin(), 0.0), 8).xy();
        let origin = Vector3::new(
            random.uniform(-60.0, 60.0),
            random.uniform(-60.0, 60.0),
            random.uniform(2.0, 6.0),
        );
        let frame = WingFrame::new(origin, span);
        let camera_from_wing = aim_camera(&mut random, &wing, options);
        let load = LoadShape {
            triangular: random.uniform(0.15, 0.6),
            relief: random.uniform(0.05, 0.3),
        };
        let mut scene = Self {
            setup: setup_without_markers(&mut random, &wing, options, origin, span),
            clutter: SkinClutter::random(&mut random, &wing, options.clutter),
            wing,
            markers: Vec::new(),
            frame,
            camera_from_survey: camera_from_wing * frame.wing_from_survey,
            load,
            twist_rad_per_m: (random.uniform(0.2, 1.2)
                * if random.unit() < 0.3 { -1.0 } else { 1.0 })
            .to_radians(),
        };
        let fixed = scene.fixed_targets(options);
        scene.place_markers(&mut random, options, &fixed);
        scene.place_points(&mut SeededRandom::new(seed, 13), options);
        scene.markers.extend(fixed);
        scene.simulate_survey(&mut random, options);
        scene
    }

    /// Places markers one after another so that they are completely visible in the ground frame and at the highest
    /// deflection.
    fn place_markers(
        &mut self,
        random: &mut SeededRandom,
        options: &SceneOptions,
        fixed: &[SceneMarker],
    ) {
        let single = options.markers.saturating_sub(2);
        let length = self.wing.beam.length_m;
        let first = self.nearest_station(options);
        let rotation = |random: &mut SeededRandom| random.uniform(0.0, std::f64::consts::FRAC_PI_2);
        for i in 0..options.markers {
            for attempt in 0..80 {
                let spread = 1.0 - attempt as f64 / 100.0;
                let (s, outer) = match i.checked_sub(single) {
                    None => (
                        first + (0.975 * length - first) * i as f64 / (single.max(2) - 1) as f64,
                        i % 2 == 0,
                    ),
                    Some(k) => (0.93 * length + random.uniform(-0.5, 0.5), k == 0),
                };
                let (low, high) = self.wing.edges(s);
                let reach = (0.46 * options.lens.width as f64 / options.lens.fx) * s;
                let edge = if outer == (options.side == SceneSide::Left) {
                    high
                } else {
                    low
                };
                let z = edge.clamp(-reach, reach) * spread * random.uniform(0.5, 0.8);
                let marker = SceneMarker {
                    id: format!("M{:02}", i + 1),
                    shape: if i < options.quadrants {
                        Shape::Quadrant
                    } else {
                        Shape::Circle
                    },
                    diameter_m: (options.diameter_m * 100.0).round() / 100.0,
                    s_m: s + random.uniform(-0.25, 0.25),
                    z_m: z,
                    rotation_rad: rotation(random),
                    height_m: 0.0,
                    fixed_m: None,
                };
                self.markers.push(marker);
                if self.is_last_marker_visible_and_separate(options, fixed) {
                    break;
                }
                self.markers.pop();
            }
        }
        let last = self.markers.len();
        if last >= 2 {
            self.name_torsion_pair(last);
        }
    }

    /// Places points on salient structures, from the nearest station to the tip and alternately near the two edges.
    fn place_points(&mut self, random: &mut SeededRandom, options: &SceneOptions) {
        let (first, last) = (
            self.nearest_station(options) + 0.5,
            0.95 * self.wing.beam.length_m,
        );
        for i in 0..options.points {
            let share = i as f64 / (options.points.max(2) - 1) as f64;
            for attempt in 0..80 {
                let s = first + (last - first) * share + random.uniform(-0.4, 0.4);
                let (low, high) = self.wing.edges(s);
                let reach = (0.44 * options.lens.width as f64 / options.lens.fx) * s;
                let edge = if i % 2 == 0 { low } else { high };
                let z = edge.clamp(-reach, reach)
                    * (1.0 - f64::from(attempt) / 100.0)
                    * random.uniform(0.4, 0.75);
                self.markers
                    .push(SceneMarker::point(format!("P{:02}", i + 1), s, z));
                if self.is_last_marker_visible_and_separate(options, &[]) {
                    self.clutter.add_structure(random, i, s, z);
                    break;
                }
                self.markers.pop();
            }
        }
    }

    /// Makes the last two markers the torsion pair; the side determines which one leads.
    fn name_torsion_pair(&mut self, count: usize) {
        for (i, marker) in self.markers.iter_mut().enumerate() {
            marker.id = format!("M{:02}", i + 1);
        }
        let aft = |i: usize| self.markers[i].z_m * self.wing.side.aft_sign();
        let (a, b) = (count - 2, count - 1);
        let (leading, trailing) = if aft(a) < aft(b) { (a, b) } else { (b, a) };
        self.setup.torsion = vec![TorsionPair {
            name: "tip".into(),
            leading,
            trailing,
        }];
    }

    /// Returns the first station whose middle is well above the frame's lower edge.
    fn nearest_station(&self, options: &SceneOptions) -> f64 {
        let pose = self.wing.deform(&self.ground_shot(0).state);
        let camera_from_wing = self.camera_from_wing(&self.ground_shot(0));
        let inside = |s: &f64| {
            let pixel = options
                .lens
                .project(&(camera_from_wing * pose.skin_point(*s, 0.0)));
            pixel.is_some_and(|p| p.y < 0.86 * f64::from(options.lens.height))
        };
        (10..)
            .map(|i| 0.2 * f64::from(i))
            .take(200)
            .find(inside)
            .unwrap_or(6.0)
    }

    /// Returns fixed targets in the corners of the frame, the upper ones first: on brackets a few metres outboard.
    fn fixed_targets(&self, options: &SceneOptions) -> Vec<SceneMarker> {
        let wing_from_camera = self.camera_from_wing(&self.ground_shot(0)).inverse();
        let (width, height) = (
            f64::from(options.lens.width),
            f64::from(options.lens.height),
        );
        let mark = |(k, (u, v)): (usize, &(f64, f64))| {
            let ray = options
                .lens
                .ray(&Vector2::new(u * width, v * height))
                .ok()?;
            Some(SceneMarker {
                id: format!("F{}", k + 1),
                shape: Shape::Quadrant,
                diameter_m: fixed_target::DIAMETER_M,
                s_m: 0.0,
                z_m: 0.0,
                rotation_rad: std::f64::consts::FRAC_PI_4,
                height_m: 0.0,
                fixed_m: Some(wing_from_camera * ray * fixed_target::DISTANCE_M),
            })
        };
        fixed_target::POSITIONS
            .iter()
            .take(options.fixed_targets)
            .enumerate()
            .filter_map(mark)
            .collect()
    }

    fn is_last_marker_visible_and_separate(
        &self,
        options: &SceneOptions,
        fixed: &[SceneMarker],
    ) -> bool {
        let highest = self.flight_shot(options.tip_deflection_m, Light::Plain, 0);
        [self.ground_shot(0), highest].iter().all(|shot| {
            let pose = self.wing.deform(&shot.state);
            let seen: Vec<_> = self
                .marker_discs(&pose, &[])
                .iter()
                .map(|placed| self.marker_image(shot, &pose, placed))
                .collect();
            let Some((Some(pixel), size, visible)) = seen.last().copied() else {
                return false;
            };
            let margin = 40.0;
            let framed = pixel.x > margin + 0.5 * size.x
                && pixel.y > margin + 0.5 * size.y
                && pixel.x < f64::from(options.lens.width) - margin - 0.5 * size.x;
            let plates = fixed
                .iter()
                .map(|m| self.marker_image(shot, &pose, &m.disc_on_wing(&pose)));
            let plates: Vec<_> = plates
                .map(|(pixel, size, _)| (pixel, 2.0 * size, true))
                .collect();
            let is_separate =
                seen[..seen.len() - 1]
                    .iter()
                    .chain(&plates)
                    .all(|(other, other_size, _)| {
                        other.is_none_or(|other| {
                            let gap = (other - pixel).abs() - 0.5 * (other_size + size);
                            gap.x > 12.0 || gap.y > 6.0
                        })
                    });
            visible && framed && is_separate
        })
    }

    fn simulate_survey(&mut self, random: &mut SeededRandom, options: &SceneOptions) {
        let sigma = options.survey_sigma_m;
        let ground = self.wing.deform(&self.ground_shot(0).state);
        self.setup.markers = self
            .markers
            .iter()
            .map(|marker| {
                let noise = Vector3::from_fn(|_, _| sigma * random.normal());
                let position = self
                    .frame
                    .survey_point(&marker.disc_on_wing(&ground).centre_m)
                    + noise;
                SurveyMarker {
                    id: marker.id.clone(),
                    shape: marker.shape,
                    diameter_m: marker.diameter_m,
                    position_m: round_vector(position, 4),
                    sigma_m: sigma,
                    fixed: marker.fixed_m.is_some(),
                    flight_motion_m: 0.0,
                    part: None,
                }
            })
            .collect();
    }
}

fn random_wing(random: &mut SeededRandom, options: &SceneOptions) -> SceneWing {
    let root_chord = options.length_m * random.uniform(0.20, 0.25);
    let taper = random.uniform(0.25, 0.38);
    let forward = random.uniform(0.45, 0.55);
    let skin = LinearTaper {
        root: random.uniform(0.35, 0.55),
        tip: random.uniform(0.08, 0.16),
    };
    let slope = random.uniform(0.065, 0.095);
    SceneWing {
        side: options.side,
        root_x_m: random.uniform(0.4, 0.9),
        root_y_m: -(options.camera_height_m + skin.root),
        axis_z_m: random.uniform(-0.25, 0.25),
        slope_rad: LinearTaper {
            root: slope,
            tip: slope + random.uniform(-0.005, 0.025),
        },
        edge_low_m: LinearTaper {
            root: -forward * root_chord,
            tip: -forward * root_chord * taper,
        },
        edge_high_m: LinearTaper {
            root: (1.0 - forward) * root_chord,
            tip: (1.0 - forward) * root_chord * taper,
        },
        skin_m: skin,
        crown: random.uniform(0.03, 0.055),
        wave_m: random.uniform(0.0, 0.001),
        beam: CantileverBeam {
            length_m: options.length_m,
            taper,
            stiffness_power: random.uniform(3.0, 4.0),
        },
    }
}

/// Aims the camera along the wing so that the highest tip is near the frame's upper edge.
pub(super) fn aim_camera(
    random: &mut SeededRandom,
    wing: &SceneWing,
    options: &SceneOptions,
) -> Rotation3<f64> {
    let load = LoadShape {
        triangular: 0.3,
        relief: 0.1,
    };
    let state = super::wing::SceneState {
        tip_deflection_m: options.tip_deflection_m,
        ..super::wing::SceneState::ground(load)
    };
    let tip = wing.deform(&state).skin_point(wing.beam.length_m, 0.0);
    let half = (0.5 * f64::from(options.lens.height) / options.lens.fy).atan();
    let pitch = (tip.y / tip.x).atan() - 0.93 * half;
    let yaw = (tip.z / tip.x).atan() + 0.012 * random.normal();
    // Camera axes at rest: x along Z, y along -Y, z along X.
    let level = nalgebra::Matrix3::new(0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0);
    let level = Rotation3::from_matrix_unchecked(level);
    Rotation3::from_axis_angle(&Vector3::z_axis(), 0.015 * random.normal())
        * Rotation3::from_axis_angle(&Vector3::x_axis(), -pitch)
        * Rotation3::from_axis_angle(&Vector3::y_axis(), -yaw)
        * level
}

fn setup_without_markers(
    random: &mut SeededRandom,
    wing: &SceneWing,
    options: &SceneOptions,
    origin: Vector3<f64>,
    span: Vector2<f64>,
) -> Setup {
    let noise = Vector3::from_fn(|_, _| options.survey_sigma_m * random.normal());
    let side = if wing.side == SceneSide::Left {
        "left"
    } else {
        "right"
    };
    Setup {
        name: format!("simulated {side} wing"),
        lens: options.lens,
        projection_centre_m: round_vector(origin + noise, 4),
        projection_centre_sigma_m: options.survey_sigma_m,
        mount_repeatability_px: 10.0,
        span_direction: span,
        flow_direction: None,
        configured_side: Some(match wing.side {
            SceneSide::Left => setup::WingSide::Left,
            SceneSide::Right => setup::WingSide::Right,
        }),
        root_offset_m: round_to(wing.root_x_m, 4),
        axis_chord_offset_m: Some(round_to(wing.axis_z_m, 4)),
        breaks: vec![],
        skin_height: Some(SkinHeight {
            root_m: round_to(wing.skin_m.root, 4),
            tip_m: round_to(wing.skin_m.tip, 4),
            tip_span_m: round_to(wing.beam.length_m, 4),
        }),
        uncertainty: SetupUncertainty::from_drawings(),
        thermal: Some(Thermal {
            expansion_per_k: 23.0e-6,
            ground_temperature_c: 15.0,
            flight_temperature_c: -55.0,
            ..Thermal::default()
        }),
        torsion: Vec::new(),
        markers: Vec::new(),
        window: None,
    }
}

fn round_to(value: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    (value * scale).round() / scale
}

fn round_vector(value: Vector3<f64>, digits: i32) -> Vector3<f64> {
    value.map(|x| round_to(x, digits))
}

/// Rounds a lens as a camera file does.
fn round_lens(lens: &Lens) -> Lens {
    Lens {
        fx: round_to(lens.fx, 1),
        fy: round_to(lens.fy, 1),
        cx: round_to(lens.cx, 1),
        cy: round_to(lens.cy, 1),
        k1: round_to(lens.k1, 4),
        k2: round_to(lens.k2, 4),
        k3: round_to(lens.k3, 4),
        p1: round_to(lens.p1, 6),
        p2: round_to(lens.p2, 6),
        ..*lens
    }
}
