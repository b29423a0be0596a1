//! What an aircraft does that a laboratory does not (docs/model.md), drawn with exact geometry: what happens to wing,
//! skin, root, marks, survey and camera between survey, ground frame and flight. It shares nothing with the model that is
//! fitted.

use nalgebra::{Rotation3, Unit, Vector2, Vector3};
use rand::rngs::StdRng;
use wingd::measure::adjust::Observation;
use wingd::measure::geometry::Lens;
use wingd::measure::setup::{Orientation, Setup, fixed_mark};

use super::{Bent, STEPS, Truth, Wing, at, normal, normal3};

/// The axis along the chord, wing frame, m.
const AXIS_Z_M: f64 = 0.1;
/// What a tape at a lens gives of its projection centre, m.
const TAPE_M: f64 = 0.010;
/// Where an engine hangs, as a share of the length.
const ENGINE: f64 = 0.33;
/// Where an aileron's torque acts.
const AILERON: f64 = 0.75;
/// From a marker on an aileron to its hinge, m.
const HINGE_M: f64 = 0.3;
/// The window's normal against the span, rad: some 15 degrees forward and 8 degrees down.
const WINDOW: (f64, f64) = (0.26, -0.14);
/// (n - 1) t / n of 14.5 mm of acrylic, m: over the bow's radius, what a ray is turned by.
const BOW_M: f64 = 0.0048;

/// What happens, each by its size; 0: not.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effects {
    /// The wing stood higher at the ground frame than at the survey, at the tip, m.
    pub ground_bend_m: f64,
    /// The root turned against the cabin since the ground frame, about X, Y, Z of the wing frame, rad.
    pub root_rotation_rad: Vector3<f64>,
    /// And moved, m.
    pub root_translation_m: Vector3<f64>,
    /// The skin bulges near the root, m.
    pub bulge_m: f64,
    /// Each marker moves along the skin's normal by as much, standard deviation, m.
    pub skin_m: f64,
    /// All fixed marks move, m.
    pub fixed_m: Vector3<f64>,
    /// Each fixed mark moves by as much along each axis, standard deviation, m.
    pub fixed_each_m: f64,
    /// Share by which the camera constant is larger in flight.
    pub flight_scale: f64,
    /// Principal point in flight, px.
    pub principal_px: Vector2<f64>,
    /// Share by which refraction turns a ray away from the window's normal.
    pub refraction: f64,
    /// Bow of the panes in flight, 1/m.
    pub bow_per_m: f64,
    /// Bending in the wing's plane at the tip, aft, m.
    pub in_plane_m: f64,
    /// Deflection of the aileron that some markers sit on, rad.
    pub aileron_rad: f64,
    /// Amplitude of the first mode at the tip, m, and its frequency, Hz.
    pub vibration: (f64, f64),
    /// Amplitude of the camera's shake, rad, and its frequency, Hz.
    pub shake: (f64, f64),
    /// From the first to the last row, s.
    pub readout_s: f64,
    /// The entrance pupil lies farther along the optical axis than stated, m.
    pub pupil_m: f64,
    /// The survey's vertical is off, about both horizontal axes, rad.
    pub tilt_rad: Vector2<f64>,
    /// Twist where the aileron's torque acts, rad.
    pub torque_rad: f64,
    /// The stiffness changes by this share at two fifths of the length.
    pub step: f64,
    /// Kink in the slope at a third of the length, rad.
    pub kink_rad: f64,
    /// Share of the root's moment that an engine takes off.
    pub engine: f64,
}

/// One wing with what was drawn for it.
pub struct Aircraft {
    pub truth: Truth,
    pub effects: Effects,
    /// Per marker: along the skin's normal, m.
    skin_m: Vec<f64>,
    /// Per fixed mark, m.
    fixed_m: Vec<Vector3<f64>>,
    /// Markers that sit on the aileron.
    pub on_aileron: Vec<usize>,
    /// What of the two comes again in every flight, at full size.
    repeated: (Vec<f64>, Vec<Vector3<f64>>),
}

/// When the wing is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum When {
    Survey,
    Ground,
    /// Deflection of the tip, m, and fuel on board.
    Flight {
        deflection_m: f64,
        fuel: f64,
    },
}

/// Deflection of a cantilever's first mode, over that of its tip.
fn mode(e: f64) -> f64 {
    e * e * (3.0 - e) / 2.0
}

impl Aircraft {
    pub fn new(rng: &mut StdRng, truth: Truth, effects: Effects) -> Self {
        let skin_m: Vec<f64> = truth.stations.iter().map(|_| effects.skin_m * normal(rng)).collect();
        let fixed = |_: &Vector3<f64>| effects.fixed_m + normal3(rng) * effects.fixed_each_m;
        let fixed_m: Vec<Vector3<f64>> = truth.fixed_m.iter().map(fixed).collect();
        let aft =
            |station: &(usize, &(f64, f64, f64))| station.1.0 > 0.6 && station.1.2 * truth.wing.side > 0.0;
        let on_aileron = truth.stations.iter().enumerate().filter(aft).map(|(k, _)| k).collect();
        let repeated = (skin_m.clone(), fixed_m.clone());
        Self { truth, effects, skin_m, fixed_m, on_aileron, repeated }
    }

    /// Another flight of the same aircraft, with what is this flight's own of `effects`; half the variance of what skin and fixed
    /// marks move by is that of every flight.
    pub fn flies_again(&mut self, rng: &mut StdRng, effects: Effects) {
        self.effects = Effects {
            ground_bend_m: self.effects.ground_bend_m,
            pupil_m: self.effects.pupil_m,
            tilt_rad: self.effects.tilt_rad,
            ..effects
        };
        let half = 0.5f64.sqrt();
        let skin = self.repeated.0.iter().map(|by| half * (by + effects.skin_m * normal(rng)));
        self.skin_m = skin.collect();
        let marks = self.repeated.1.iter().map(|by| (by + normal3(rng) * effects.fixed_each_m) * half);
        self.fixed_m = marks.collect();
    }

    /// Bending moment's curvature in flight, before it is scaled to a deflection.
    fn curvature(&self, fuel: f64) -> Vec<f64> {
        let wing = self.truth.wing;
        let mut curvature = wing.curvature(fuel);
        let root = curvature[0];
        for (i, k) in curvature.iter_mut().enumerate() {
            let e = i as f64 / STEPS as f64;
            let stiffness = (1.0 - (1.0 - wing.taper) * e).powf(wing.power);
            *k -= self.effects.engine * root * (1.0 - e / ENGINE).max(0.0) / stiffness;
            *k *= if e > 0.4 { 1.0 + self.effects.step } else { 1.0 };
        }
        curvature
    }

    /// The axis at a time, with its curvature, 1/m.
    fn bent(&self, when: When) -> (Bent, Vec<f64>) {
        let wing = self.truth.wing;
        match when {
            When::Survey => (wing.bend(&[0.0; STEPS + 1], 0.0, 1.0), vec![0.0; STEPS + 1]),
            When::Ground => self.scaled(wing.weight(), self.effects.ground_bend_m, 1.0),
            When::Flight { deflection_m, fuel } => {
                let scale = self.truth.setup.thermal.map_or(1.0, |t| t.scale());
                let (_, mut curvature) = self.scaled(self.curvature(fuel), deflection_m, 1.0);
                curvature[STEPS / 3] += self.effects.kink_rad * STEPS as f64 / wing.length_m;
                (wing.bend(&curvature, 1.0, scale), curvature)
            }
        }
    }

    /// A curvature scaled so that the tip rises by so much.
    fn scaled(&self, curvature: Vec<f64>, rise_m: f64, scale: f64) -> (Bent, Vec<f64>) {
        let wing = self.truth.wing;
        let level = wing.bend(&curvature, 0.0, 1.0).y[STEPS];
        let rise = |factor: f64| wing.bend(&curvature, factor, 1.0).y[STEPS] - level;
        let mut factor = 1e-4 * rise_m / rise(1e-4);
        for _ in 0..30 {
            let slope = (rise(factor + 1e-7) - rise(factor - 1e-7)) / 2e-7;
            factor -= (rise(factor) - rise_m) / slope;
        }
        let scaled: Vec<f64> = curvature.iter().map(|k| factor * k).collect();
        (wing.bend(&scaled, 1.0, scale), scaled)
    }

    /// Twist of a section, nose up positive, rad.
    pub fn twist_rad(&self, e: f64, when: When) -> f64 {
        let When::Flight { deflection_m, .. } = when else { return 0.0 };
        let wing = self.truth.wing;
        let compliance = |e: f64| {
            let part = |k: usize| (1.0 - (1.0 - wing.taper) * e * (k as f64 + 0.5) / 50.0).powf(-wing.power);
            e * (0..50).map(part).sum::<f64>()
        };
        let torque = self.effects.torque_rad * compliance(e.min(AILERON)) / compliance(AILERON);
        deflection_m / 2.5 * wing.twist_tip_rad * e.powf(wing.twist_power) + torque
    }

    /// Twist of the section midway between the torsion pair, rad.
    pub fn pair_twist_rad(&self, when: When) -> f64 {
        let pair = &self.truth.setup.torsion[0];
        let stations = &self.truth.stations;
        self.twist_rad(0.5 * (stations[pair.leading].0 + stations[pair.trailing].0), when)
    }

    /// Change of the curvature since the ground frame at shares of the length, 1/m.
    pub fn curvature_per_m(&self, when: When, shares: &[f64]) -> Vec<f64> {
        let (flight, ground) = (self.bent(when).1, self.bent(When::Ground).1);
        shares.iter().map(|&share| at(&flight, share) - at(&ground, share)).collect()
    }

    /// True places, survey frame as levelled by gravity, markers and then fixed marks, m.
    pub fn points(&self, when: When) -> Vec<Vector3<f64>> {
        let frame = self.truth.setup.wing_frame();
        self.in_wing_frame(when).iter().map(|p| frame.survey_point(p)).collect()
    }

    fn in_wing_frame(&self, when: When) -> Vec<Vector3<f64>> {
        let flight = matches!(when, When::Flight { .. });
        let (bent, _) = self.bent(when);
        let mut points: Vec<_> = (0..self.truth.stations.len())
            .map(|k| {
                let still = self.on_section(k, &bent, when);
                if flight { self.with_root(&still) } else { still }
            })
            .collect();
        let moved = |(p, by): (&Vector3<f64>, &Vector3<f64>)| p + if flight { *by } else { Vector3::zeros() };
        points.extend(self.truth.fixed_m.iter().zip(&self.fixed_m).map(moved));
        points
    }

    fn root_m(&self) -> Vector3<f64> {
        Vector3::new(self.truth.setup.root_offset_m, -1.85, 0.0)
    }

    /// A marker on its section, the root at rest.
    fn on_section(&self, marker: usize, bent: &Bent, when: When) -> Vector3<f64> {
        let flight = matches!(when, When::Flight { .. });
        let (e, n, z) = self.truth.stations[marker];
        let Wing { side, length_m, .. } = self.truth.wing;
        let axis_z = AXIS_Z_M * side;
        let scale = if flight { self.truth.setup.thermal.map_or(1.0, |t| t.scale()) } else { 1.0 };
        let (mut n, z) = (n, z - axis_z);
        let mut in_plane = 0.0;
        if flight {
            n += self.skin_m[marker] + self.effects.bulge_m * (-((e - 0.2) / 0.1).powi(2)).exp();
            if self.on_aileron.contains(&marker) {
                n -= HINGE_M * self.effects.aileron_rad.sin();
            }
            in_plane = self.effects.in_plane_m * side;
        }
        let (theta, phi) = (at(&bent.theta, e), side * self.twist_rad(e, when));
        let (arm_n, arm_z) = (n * phi.cos() - z * phi.sin(), z * phi.cos() + n * phi.sin());
        // Sections turn with the axis in the wing's plane.
        let slope = in_plane * 1.5 * e * (2.0 - e) / length_m;
        let along = at(&bent.x, e) - scale * (arm_n * theta.sin() + arm_z * slope);
        let up = at(&bent.y, e) + scale * arm_n * theta.cos();
        self.root_m() + Vector3::new(along, up, axis_z + scale * arm_z + in_plane * mode(e))
    }

    fn with_root(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let turned = Rotation3::new(self.effects.root_rotation_rad) * (point - self.root_m());
        self.root_m() + turned + self.effects.root_translation_m
    }

    /// True deflections of all markers against the survey, the ground frame, the root's tangent, m.
    pub fn deflections_m(&self, when: When) -> Vec<[f64; 3]> {
        let (survey, ground) = (self.in_wing_frame(When::Survey), self.in_wing_frame(When::Ground));
        let one = |(k, flight): (usize, Vector3<f64>)| {
            let carried = self.with_root(&ground[k]);
            [flight.y - survey[k].y, flight.y - ground[k].y, flight.y - carried.y]
        };
        self.in_wing_frame(when).into_iter().take(self.truth.stations.len()).enumerate().map(one).collect()
    }

    /// The survey as the tachymeter reports it, its vertical and the entrance pupil as far off as drawn.
    pub fn surveyed(&self, rng: &mut StdRng, sigma_m: f64) -> Setup {
        let mut setup = self.truth.surveyed(rng, sigma_m, sigma_m);
        setup.projection_centre_sigma_m = TAPE_M;
        for &marker in self.on_aileron.iter().filter(|_| self.effects.aileron_rad != 0.0) {
            setup.markers[marker].part = Some("aileron".into());
        }
        for marker in setup.markers.iter_mut().filter(|m| m.fixed) {
            marker.flight_motion_m = fixed_mark::FLIGHT_MOTION_M;
        }
        let axis = self.truth.camera_from_survey.inverse() * Vector3::z();
        setup.projection_centre_m -= axis * self.effects.pupil_m;
        let tilt = Rotation3::new(Vector3::new(self.effects.tilt_rad.x, self.effects.tilt_rad.y, 0.0));
        for marker in &mut setup.markers {
            marker.position_m = tilt * marker.position_m;
        }
        setup.projection_centre_m = tilt * setup.projection_centre_m;
        setup
    }

    /// Ground frame: sights of all marks, and the rotation into the survey's frame.
    pub fn orientation(&self, rng: &mut StdRng, sigma_px: f64) -> Orientation {
        let mut orientation = self.truth.orientation(rng, sigma_px, true);
        let pixels = self.truth.pixels(&self.points(When::Ground), Vector3::zeros());
        for (sight, pixel) in orientation.ground.iter_mut().zip(pixels) {
            sight.pixel = pixel + super::normal2(rng) * sigma_px;
        }
        let tilt = Rotation3::new(Vector3::new(self.effects.tilt_rad.x, self.effects.tilt_rad.y, 0.0));
        orientation.camera_from_survey *= tilt.inverse();
        orientation
    }

    /// One frame: `mount` and `shift` of the mounting; vibration and shake at random phases.
    pub fn frame(
        &self,
        rng: &mut StdRng,
        when: When,
        (mount_rad, shift_m): (Vector3<f64>, Vector3<f64>),
        sigma_px: f64,
    ) -> Vec<Observation> {
        let lens = self.lens_in_flight();
        let phases = [normal(rng) * 10.0, normal(rng) * 10.0];
        let turn = Rotation3::new(mount_rad) * self.truth.camera_from_survey;
        let centre = self.truth.setup.projection_centre_m + shift_m;
        let points = self.points(when);
        let shown = |k: usize, time_s: f64| {
            let deflected = self.vibrated(k, &points[k], time_s, phases[0]);
            let seen = self.shaken(time_s, phases[1]) * turn * self.refracted(&(deflected - centre));
            lens.project(&seen).expect("before the camera")
        };
        let mut seen = vec![];
        for marker in 0..points.len() {
            let height = f64::from(self.truth.setup.lens.height);
            let row_s = |v: f64| (v / height - 0.5) * self.effects.readout_s;
            let time_s = row_s(shown(marker, 0.0).y);
            let pixel = shown(marker, time_s) + super::normal2(rng) * sigma_px;
            let covariance_px2 = nalgebra::Matrix2::identity() * sigma_px * sigma_px;
            seen.push(Observation { marker, pixel, covariance_px2 });
        }
        seen
    }

    fn lens_in_flight(&self) -> Lens {
        let Lens { fx, fy, cx, cy, .. } = self.truth.setup.lens;
        let more = 1.0 + self.effects.flight_scale;
        let [x, y] = self.effects.principal_px.into();
        Lens { fx: fx * more, fy: fy * more, cx: cx + x, cy: cy + y, ..self.truth.setup.lens }
    }

    fn vibrated(&self, marker: usize, point: &Vector3<f64>, time_s: f64, phase: f64) -> Vector3<f64> {
        let Some(&(e, ..)) = self.truth.stations.get(marker) else { return *point };
        let (amplitude, hertz) = self.effects.vibration;
        // Counted from the middle row's instant, at which the truth holds.
        let swing = |t: f64| amplitude * (std::f64::consts::TAU * hertz * t + phase).sin();
        point + Vector3::z() * ((swing(time_s) - swing(0.0)) * mode(e))
    }

    fn shaken(&self, time_s: f64, phase: f64) -> Rotation3<f64> {
        let (amplitude, hertz) = self.effects.shake;
        let swing = |t: f64| amplitude * (std::f64::consts::TAU * hertz * t + phase).sin();
        Rotation3::new(Vector3::x() * (swing(time_s) - swing(0.0)))
    }

    /// A direction in the survey frame as the camera in the cabin sees it.
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
    /// Curvature under a load that goes with the chord, as weight does: another shape than lift's.
    fn weight(&self) -> Vec<f64> {
        let (h, mut q, mut m) = (1.0 / STEPS as f64, 0.0, 0.0);
        let mut curvature = vec![0.0; STEPS + 1];
        for i in (0..STEPS).rev() {
            let chord = 1.0 - (1.0 - self.taper) * i as f64 * h;
            m += h * (q + 0.5 * h * chord);
            q += h * chord;
            curvature[i] = m / chord.powf(self.power);
        }
        curvature
    }
}
