//! In-flight effects (docs/adjustment/installation.md), simulated with exact geometry: changes of wing, skin, root, fixed targets, survey and
//! camera between survey, ground frame and flight. It shares no code with the fitted
//! model.

use nalgebra::{Rotation3, Unit, Vector2, Vector3};
use rand::rngs::StdRng;
use wingd::measure::adjust::Observation;
use wingd::measure::geometry::Lens;
use wingd::measure::setup::{Orientation, Setup, fixed_target};

use super::{
    CameraMotion, Claims, STEPS, SpaceAxis, Structure, Truth, Wing, normal, normal3, value_at,
};

/// Precision of the projection centre from a tape measure at the lens, m.
const TAPE_M: f64 = 0.010;
/// Position of an engine, as a fraction of the length.
const ENGINE: f64 = 0.33;
/// Position of the aileron's torque.
const AILERON: f64 = 0.75;
/// Position of the joint that gives, beside the places at which moments are compared.
const JOINT: f64 = 0.79;
/// Distance from a marker on an aileron to its hinge, m.
const HINGE_M: f64 = 0.3;
/// Window normal relative to the span, rad: some 15 degrees forward and 8 degrees down.
const WINDOW: (f64, f64) = (0.26, -0.14);
/// (n - 1) t / n of 14.5 mm of acrylic, m: divided by the bow radius, the deflection of a ray.
const BOW_M: f64 = 0.0048;

/// Effects, each by its size; 0: absent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effects {
    /// Wing tip higher at the ground frame than at the survey, m.
    pub ground_bend_m: f64,
    /// Rotation of the root relative to the cabin since the ground frame, about X, Y, Z of the wing frame, rad.
    pub root_rotation_rad: Vector3<f64>,
    /// Translation of the root, m.
    pub root_translation_m: Vector3<f64>,
    /// Bulge of the skin near the root, m.
    pub bulge_m: f64,
    /// Displacement of each marker along the skin normal, standard deviation, m.
    pub skin_m: f64,
    /// Common displacement of all fixed targets, m.
    pub fixed_m: Vector3<f64>,
    /// Displacement of each fixed target along each axis, standard deviation, m.
    pub fixed_each_m: f64,
    /// Relative increase of the focal length in flight.
    pub flight_scale: f64,
    /// Principal point in flight, px.
    pub principal_px: Vector2<f64>,
    /// Relative refraction of a ray away from the window normal.
    pub refraction: f64,
    /// Smooth bend of the rays along the image in flight: amplitude, px, phase and direction, rad.
    pub rays: (f64, f64, f64),
    /// Bow of the panes in flight, 1/m.
    pub bow_per_m: f64,
    /// Bending in the wing's plane at the tip, aft, m.
    pub in_plane_m: f64,
    /// Deflection of the aileron that some markers sit on, rad.
    pub aileron_rad: f64,
    /// Amplitude of the first mode at the tip, m, and its frequency, Hz.
    pub vibration: (f64, f64),
    /// Amplitude of the camera's vibration, rad, and its frequency, Hz.
    pub shake: (f64, f64),
    /// Readout time from the first to the last row, s.
    pub readout_s: f64,
    /// Displacement of the entrance pupil along the optical axis, m.
    pub pupil_m: f64,
    /// Tilt of the survey's vertical about both horizontal axes, rad.
    pub tilt_rad: Vector2<f64>,
    /// Twist at the position of the aileron's torque, rad.
    pub torque_rad: f64,
    /// Relative step of the stiffness at 40 % of the length.
    pub step: f64,
    /// Kink in the slope at 33 % of the length, rad.
    pub kink_rad: f64,
    /// Fraction of the root moment relieved by an engine.
    pub engine: f64,
    /// How the wing is built.
    pub structure: Structure,
    /// Twist of the tip at the ground frame against the survey, nose up positive, rad.
    pub ground_twist_rad: f64,
    /// Length of the wing inboard of the root that bends with the moment of the root, m.
    pub inboard_m: f64,
    /// Rotation of the root that goes with the load, rad, and place of its pivot outboard of the root, m.
    pub root_gives: (f64, f64),
    /// Outboard error of the stated root, m.
    pub root_error_m: f64,
    /// Rotation of a joint at 80 % of the length that goes with the load, rad.
    pub joint_rad: f64,
    /// What happens to the camera since the ground frame.
    pub camera: CameraMotion,
    /// What the installation states too surely.
    pub claims: Claims,
}

/// One wing with its sampled effects.
pub struct Aircraft {
    pub truth: Truth,
    pub effects: Effects,
    /// Marker displacements along the skin normal, m.
    skin_m: Vec<f64>,
    /// Displacements of the fixed targets, m.
    fixed_m: Vec<Vector3<f64>>,
    /// Markers that sit on the aileron.
    pub on_aileron: Vec<usize>,
    /// The part of both displacements that is common to all flights, at full size.
    repeated: (Vec<f64>, Vec<Vector3<f64>>),
}

/// State of the wing at an observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WingState {
    Survey,
    Ground,
    /// Deflection of the tip, m, and fuel on board.
    Flight {
        deflection_m: f64,
        fuel: f64,
    },
}

/// Deflection of a cantilever's first mode, relative to the tip.
fn mode(e: f64) -> f64 {
    e * e * (3.0 - e) / 2.0
}

impl Aircraft {
    pub fn new(rng: &mut StdRng, truth: Truth, effects: Effects) -> Self {
        let skin_m: Vec<f64> = truth
            .stations
            .iter()
            .map(|_| effects.skin_m * normal(rng))
            .collect();
        let fixed = |_: &Vector3<f64>| effects.fixed_m + normal3(rng) * effects.fixed_each_m;
        let fixed_m: Vec<Vector3<f64>> = truth.fixed_m.iter().map(fixed).collect();
        let aft = |station: &(usize, &(f64, f64, f64))| {
            station.1.0 > 0.6 && station.1.2 * truth.wing.side > 0.0
        };
        let on_aileron = truth
            .stations
            .iter()
            .enumerate()
            .filter(aft)
            .map(|(k, _)| k)
            .collect();
        let repeated = (skin_m.clone(), fixed_m.clone());
        Self {
            truth,
            effects,
            skin_m,
            fixed_m,
            on_aileron,
            repeated,
        }
    }

    /// Starts another flight of the same aircraft with the flight-specific `effects`; half the variance of skin and fixed-target
    /// displacements is common to all flights.
    pub fn start_next_flight(&mut self, rng: &mut StdRng, effects: Effects) {
        self.effects = Effects {
            ground_bend_m: self.effects.ground_bend_m,
            pupil_m: self.effects.pupil_m,
            tilt_rad: self.effects.tilt_rad,
            ..effects
        };
        let half = 0.5f64.sqrt();
        let skin = self
            .repeated
            .0
            .iter()
            .map(|by| half * (by + effects.skin_m * normal(rng)));
        self.skin_m = skin.collect();
        let marks = self
            .repeated
            .1
            .iter()
            .map(|by| (by + normal3(rng) * effects.fixed_each_m) * half);
        self.fixed_m = marks.collect();
    }

    /// Curvature of the bending moment in flight, before scaling to a deflection.
    fn curvature(&self, fuel: f64) -> Vec<f64> {
        let wing = self.truth.wing;
        let mut curvature = wing.curvature(fuel);
        let root = curvature[0];
        for (i, k) in curvature.iter_mut().enumerate() {
            let e = i as f64 / STEPS as f64;
            let stiffness = wing.chord(e).powf(wing.power);
            *k -= self.effects.engine * root * (1.0 - e / ENGINE).max(0.0) / stiffness;
            *k *= if e > 0.4 {
                1.0 + self.effects.step
            } else {
                1.0
            };
        }
        curvature
    }

    /// Curvature in a state, 1/m.
    pub(super) fn bent_curvature(&self, when: WingState) -> Vec<f64> {
        let wing = self.truth.wing;
        match when {
            WingState::Survey => vec![0.0; STEPS + 1],
            WingState::Ground => self.bend_to_rise(wing.weight(), self.effects.ground_bend_m),
            WingState::Flight { deflection_m, fuel } => {
                let mut curvature = self.bend_to_rise(self.curvature(fuel), deflection_m);
                let per_rad = STEPS as f64 / wing.length_m;
                curvature[STEPS / 3] += self.effects.kink_rad * per_rad;
                curvature[(JOINT * STEPS as f64) as usize] +=
                    self.effects.joint_rad * self.load(when) * per_rad;
                curvature
            }
        }
    }

    /// Axis in space in a state.
    pub(super) fn axis(&self, when: WingState) -> SpaceAxis {
        self.truth
            .wing
            .bend_in_space(&self.bent_curvature(when), self.scale(when), |e| {
                self.twist_rad(e, when)
            })
    }

    fn scale(&self, when: WingState) -> f64 {
        if let WingState::Flight { .. } = when {
            self.truth.setup.thermal.map_or(1.0, |t| t.scale())
        } else {
            1.0
        }
    }

    /// Scales a curvature to the given rise of the tip.
    fn bend_to_rise(&self, curvature: Vec<f64>, rise_m: f64) -> Vec<f64> {
        let wing = self.truth.wing;
        let level = wing.bend(&curvature, 0.0, 1.0).y[STEPS];
        let rise = |factor: f64| wing.bend(&curvature, factor, 1.0).y[STEPS] - level;
        let mut factor = 1e-4 * rise_m / rise(1e-4);
        for _ in 0..30 {
            let slope = (rise(factor + 1e-7) - rise(factor - 1e-7)) / 2e-7;
            factor -= (rise(factor) - rise_m) / slope;
        }
        curvature.iter().map(|k| factor * k).collect()
    }

    /// Twist of a section, nose up positive, rad.
    fn twist_rad(&self, e: f64, when: WingState) -> f64 {
        let wing = self.truth.wing;
        let deflection_m = match when {
            WingState::Flight { deflection_m, .. } => deflection_m,
            WingState::Ground => return self.effects.ground_twist_rad * e,
            WingState::Survey => return 0.0,
        };
        let compliance = |e: f64| {
            let part = |k: usize| wing.chord(e * (k as f64 + 0.5) / 50.0).powf(-wing.power);
            e * (0..50).map(part).sum::<f64>()
        };
        let torque = self.effects.torque_rad * compliance(e.min(AILERON)) / compliance(AILERON);
        wing.twist_at(deflection_m)(e) + torque
    }

    /// Change of the curvature since the ground frame at fractions of the length, 1/m.
    pub fn curvature_per_m(&self, when: WingState, shares: &[f64]) -> Vec<f64> {
        let (flight, ground) = (
            self.bent_curvature(when),
            self.bent_curvature(WingState::Ground),
        );
        shares
            .iter()
            .map(|&share| value_at(&flight, share) - value_at(&ground, share))
            .collect()
    }

    /// True positions of markers, then fixed targets, in the levelled survey frame, m.
    pub fn points(&self, when: WingState) -> Vec<Vector3<f64>> {
        let frame = self.truth.setup.wing_frame();
        self.points_in_wing_frame(when)
            .iter()
            .map(|p| frame.survey_point(p))
            .collect()
    }

    fn points_in_wing_frame(&self, when: WingState) -> Vec<Vector3<f64>> {
        let flight = matches!(when, WingState::Flight { .. });
        let axis = self.axis(when);
        let mut points: Vec<_> = (0..self.truth.stations.len())
            .map(|k| {
                let still = self.point_on_section(k, &axis, when);
                if flight {
                    self.move_root(&self.give_at_root(&still, when))
                } else {
                    still
                }
            })
            .collect();
        let moved = |(p, by): (&Vector3<f64>, &Vector3<f64>)| {
            p + if flight { *by } else { Vector3::zeros() }
        };
        points.extend(self.truth.fixed_m.iter().zip(&self.fixed_m).map(moved));
        points
    }

    /// Position of a marker on its section, with the root at rest.
    fn point_on_section(&self, marker: usize, axis: &SpaceAxis, when: WingState) -> Vector3<f64> {
        let flight = matches!(when, WingState::Flight { .. });
        let (e, mut n, z) = self.truth.stations[marker];
        let Wing { side, length_m, .. } = self.truth.wing;
        let chord_m = self.truth.axis_z_m() - self.truth.root_m().z;
        let scale = self.scale(when);
        let mut in_plane = 0.0;
        if flight {
            n += self.skin_m[marker] + self.effects.bulge_m * (-((e - 0.2) / 0.1).powi(2)).exp();
            if self.on_aileron.contains(&marker) {
                n -= HINGE_M * self.effects.aileron_rad.sin();
            }
            in_plane = self.effects.in_plane_m * side;
        }
        let (point, section) = axis.at(self.truth.wing.split_at_winglet(e).0);
        let arm = section * self.truth.wing.arm_m(e, n, z - chord_m) * scale;
        // Sections rotate with the axis in the wing's plane.
        let slope = in_plane * 1.5 * e * (2.0 - e) / length_m;
        let moved = Vector3::new(-arm.z * slope, 0.0, chord_m + in_plane * mode(e));
        self.truth.root_m() + point + arm + moved
    }

    fn move_root(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let root_m = self.truth.root_m();
        let turned = Rotation3::new(self.effects.root_rotation_rad) * (point - root_m);
        root_m + turned + self.effects.root_translation_m
    }

    /// True deflections of all markers relative to survey, ground frame and root tangent, m.
    pub fn deflections_m(&self, when: WingState) -> Vec<[f64; 3]> {
        let (survey, ground) = (
            self.points_in_wing_frame(WingState::Survey),
            self.points_in_wing_frame(WingState::Ground),
        );
        let one = |(k, flight): (usize, Vector3<f64>)| {
            let carried = self.move_root(&ground[k]);
            [
                flight.y - survey[k].y,
                flight.y - ground[k].y,
                flight.y - carried.y,
            ]
        };
        self.points_in_wing_frame(when)
            .into_iter()
            .take(self.truth.stations.len())
            .enumerate()
            .map(one)
            .collect()
    }

    /// The survey as a total station would report it, with the sampled errors of its vertical and of the entrance pupil.
    pub fn surveyed(&self, rng: &mut StdRng, sigma_m: f64) -> Setup {
        let mut setup = self.truth.surveyed(rng, sigma_m, sigma_m);
        setup.projection_centre_sigma_m = TAPE_M;
        setup.root_offset_m += self.effects.root_error_m;
        for &marker in self
            .on_aileron
            .iter()
            .filter(|_| self.effects.aileron_rad != 0.0)
        {
            setup.markers[marker].part = Some("aileron".into());
        }
        for marker in setup.markers.iter_mut().filter(|m| m.fixed) {
            marker.flight_motion_m = fixed_target::FLIGHT_MOTION_M;
        }
        let axis = self.truth.camera_from_survey.inverse() * Vector3::z();
        setup.projection_centre_m -= axis * self.effects.pupil_m;
        let tilt = Rotation3::new(Vector3::new(
            self.effects.tilt_rad.x,
            self.effects.tilt_rad.y,
            0.0,
        ));
        for marker in &mut setup.markers {
            marker.position_m = tilt * marker.position_m;
        }
        setup.projection_centre_m = tilt * setup.projection_centre_m;
        setup
    }

    /// Ground frame: observations of all markers and targets, and the rotation into the survey frame.
    pub fn orientation(&self, rng: &mut StdRng, sigma_px: f64) -> Orientation {
        let mut orientation = self.truth.orientation(rng, sigma_px, true);
        let pixels = self
            .truth
            .pixels(&self.points(WingState::Ground), Vector3::zeros());
        for (sight, pixel) in orientation.ground.iter_mut().zip(pixels) {
            sight.pixel = pixel + super::normal2(rng) * sigma_px;
        }
        let tilt = Rotation3::new(Vector3::new(
            self.effects.tilt_rad.x,
            self.effects.tilt_rad.y,
            0.0,
        ));
        orientation.camera_from_survey *= tilt.inverse();
        orientation
    }

    /// Observes one frame: `mount` and `shift` of the mounting; vibrations at random phases.
    pub fn frame(
        &self,
        rng: &mut StdRng,
        when: WingState,
        (mount_rad, shift_m): (Vector3<f64>, Vector3<f64>),
        sigma_px: f64,
    ) -> Vec<Observation> {
        let mut lens = self.lens_in_flight();
        if self.effects.camera.stabilised_px > 0.0 {
            let jump = super::normal2(rng) * self.effects.camera.stabilised_px;
            (lens.cx, lens.cy) = (lens.cx + jump.x, lens.cy + jump.y);
        }
        let phases = [normal(rng) * 10.0, normal(rng) * 10.0];
        let turn = Rotation3::new(mount_rad) * self.truth.camera_from_survey;
        let centre = self.truth.setup.projection_centre_m + shift_m;
        let points = self.points(when);
        let columns = points.iter().map(|point| {
            lens.project(&(turn * (point - centre)))
                .expect("before the camera")
                .x
        });
        let ends = columns.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
        let shown = |k: usize, time_s: f64| {
            let deflected = self.vibrated(k, &points[k], time_s, phases[0]);
            let seen =
                self.shaken(time_s, phases[1]) * turn * self.refracted(&(deflected - centre));
            let pixel = lens.project(&seen).expect("before the camera");
            let (amplitude_px, phase, direction) = self.effects.rays;
            let wave = (5.0 * (pixel.x - ends.0) / (ends.1 - ends.0) + phase).sin();
            pixel + Vector2::new(direction.cos(), direction.sin()) * (amplitude_px * wave)
        };
        let mut seen = vec![];
        for marker in 0..points.len() {
            let height = f64::from(self.truth.setup.lens.height);
            let row_s = |v: f64| (v / height - 0.5) * self.effects.readout_s;
            let time_s = row_s(shown(marker, 0.0).y);
            let pixel = shown(marker, time_s) + super::normal2(rng) * sigma_px;
            let covariance_px2 = nalgebra::Matrix2::identity() * sigma_px * sigma_px;
            seen.push(Observation {
                marker,
                pixel,
                covariance_px2,
            });
        }
        seen
    }

    fn lens_in_flight(&self) -> Lens {
        let Lens { fx, fy, cx, cy, .. } = self.truth.setup.lens;
        let more = 1.0 + self.effects.flight_scale;
        let [x, y] = self.effects.principal_px.into();
        Lens {
            fx: fx * more,
            fy: fy * more,
            cx: cx + x,
            cy: cy + y,
            ..self.truth.setup.lens
        }
    }

    fn vibrated(
        &self,
        marker: usize,
        point: &Vector3<f64>,
        time_s: f64,
        phase: f64,
    ) -> Vector3<f64> {
        let Some(&(e, ..)) = self.truth.stations.get(marker) else {
            return *point;
        };
        let (amplitude, hertz) = self.effects.vibration;
        // Counted from the instant of the middle row, to which the truth refers.
        let displacement = |t: f64| amplitude * (std::f64::consts::TAU * hertz * t + phase).sin();
        point + Vector3::z() * ((displacement(time_s) - displacement(0.0)) * mode(e))
    }

    fn shaken(&self, time_s: f64, phase: f64) -> Rotation3<f64> {
        let (amplitude, hertz) = self.effects.shake;
        let displacement = |t: f64| amplitude * (std::f64::consts::TAU * hertz * t + phase).sin();
        Rotation3::new(Vector3::x() * (displacement(time_s) - displacement(0.0)))
    }

    /// A direction in the survey frame as seen by the camera in the cabin.
    fn refracted(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        let share = self.effects.refraction + self.effects.bow_per_m * BOW_M;
        let (sin, cos) = (WINDOW.0.sin(), WINDOW.0.cos());
        let in_wing = Vector3::new(cos * WINDOW.1.cos(), WINDOW.1.sin(), sin * WINDOW.1.cos());
        let frame = self.truth.setup.wing_frame();
        let normal = Unit::new_normalize(frame.wing_from_survey.inverse() * in_wing);
        let along = direction.dot(&normal);
        normal.into_inner() * along + (direction - normal.into_inner() * along) * (1.0 + share)
    }
}

impl Wing {
    /// Curvature under a load proportional to the chord, as weight is: another shape than that of lift.
    fn weight(&self) -> Vec<f64> {
        let (h, mut q, mut m) = (1.0 / STEPS as f64, 0.0, 0.0);
        let mut curvature = vec![0.0; STEPS + 1];
        for i in (0..STEPS).rev() {
            let chord = self.chord(i as f64 * h);
            m += h * (q + 0.5 * h * chord);
            q += h * chord;
            curvature[i] = m / chord.powf(self.power);
        }
        curvature
    }
}
