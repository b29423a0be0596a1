//! An independent wing for the adjustment tests: Euler-Bernoulli cantilever with tapered stiffness under a fuel-relieved
//! lift, dihedral, crowned skin, twist, thermal shrinkage. It shares no code and no shape functions with the fitted model.

use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};
use rand::Rng;
use rand::rngs::StdRng;
use wingd::measure::adjust::Observation;
use wingd::measure::geometry::Lens;
use wingd::measure::setup::{
    Orientation, Setup, SetupUncertainty, Shape, SkinHeight, SurveyMarker, Thermal, TorsionPair,
};

mod aircraft;
mod camera_motion;
mod fleet;
mod sections;
mod structure;
mod swing;

pub use super::statistics::{median, rms};
pub use fleet::{random_wing, remounted};

pub use super::random::{normal, normal2, normal3, rng};
pub use aircraft::{Aircraft, Effects, WingState};
pub use camera_motion::{CameraMotion, Claims};
use structure::SpaceAxis;
pub use structure::Structure;
pub use swing::{ModeShape, SecondMode};

const STEPS: usize = 2000;

/// Properties of the beam.
#[derive(Clone, Copy, Debug)]
pub struct Wing {
    pub length_m: f64,
    pub taper: f64,
    /// Exponent of the stiffness as a power of the chord.
    pub power: f64,
    /// Fuel weight as a fraction of the lift, and its spanwise extent.
    pub fuel: f64,
    pub fuel_reach: f64,
    /// Lift decreases linearly outboard by this fraction, in addition to the ellipse.
    pub skew: f64,
    pub dihedral_rad: f64,
    pub twist_tip_rad: f64,
    pub twist_power: f64,
    pub crown_per_m: f64,
    pub skin_root_m: f64,
    pub skin_tip_m: f64,
    /// +1 right wing, -1 left wing.
    pub side: f64,
    /// Deviations from a straight, tapered wing.
    pub structure: Structure,
}

impl Default for Wing {
    fn default() -> Self {
        Self {
            length_m: 32.5,
            taper: 0.28,
            power: 3.6,
            fuel: 0.25,
            fuel_reach: 0.7,
            skew: 0.1,
            dihedral_rad: 0.078,
            twist_tip_rad: 0.045,
            twist_power: 1.4,
            crown_per_m: 0.028,
            skin_root_m: 0.48,
            skin_tip_m: 0.14,
            side: 1.0,
            structure: Structure::default(),
        }
    }
}

pub struct Truth {
    pub setup: Setup,
    pub camera_from_survey: Rotation3<f64>,
    /// Survey frame, error free.
    pub ground_m: Vec<Vector3<f64>>,
    wing: Wing,
    stations: Vec<(f64, f64, f64)>,
    /// Wing frame, error free.
    fixed_m: Vec<Vector3<f64>>,
}

/// Marker layout: (arc length / length, chordwise Z on the axis' frame). Irregular across the
/// chord, as between doors, flaps and walkways.
fn layout(count: usize) -> Vec<(f64, f64)> {
    const Z: [f64; 10] = [0.9, -0.85, 1.0, -1.2, 1.35, -1.6, 1.8, -1.3, 1.5, -1.6];
    let mut list: Vec<(f64, f64)> = (0..count - 2)
        .map(|i| {
            let t = i as f64 / (count - 3) as f64;
            let narrow = if t > 0.5 { 1.2 - 0.75 * (t - 0.5) } else { 1.0 };
            (
                0.19 + 0.79 * t.powf(0.9),
                Z[i % 10] * if i < 10 { 1.0 } else { narrow * 0.85 },
            )
        })
        .collect();
    list.push((0.925, -0.75));
    list.push((0.915, 0.9));
    list
}

struct BentAxis {
    x: Vec<f64>,
    y: Vec<f64>,
    theta: Vec<f64>,
}

impl Wing {
    /// Bending moment over stiffness for unit load, at STEPS + 1 stations, with the current fuel.
    fn curvature(&self, fuel: f64) -> Vec<f64> {
        let h = 1.0 / STEPS as f64;
        let chord = |e: f64| self.chord(e);
        let load = |e: f64| {
            let lift = (1.0 - e * e).max(0.0).sqrt() * (1.0 - self.skew * e);
            lift - if e < self.fuel_reach {
                fuel * 1.4 * chord(e)
            } else {
                0.0
            }
        };
        let (mut q, mut m) = (0.0, 0.0);
        let mut k = vec![0.0; STEPS + 1];
        for i in (0..STEPS).rev() {
            let e = i as f64 * h;
            m += h * (q + 0.5 * h * load(e + 0.5 * h));
            q += h * load(e + 0.5 * h);
            k[i] = m / chord(e).powf(self.power);
        }
        k
    }

    fn ground_slope(&self, e: f64) -> f64 {
        // Skin rises with the dihedral; the axis lies below it by the skin height.
        let (at, turn) = self.structure.dihedral_break;
        let broken = if e > at { turn } else { 0.0 };
        broken
            + (self.dihedral_rad.tan() - (self.skin_tip_m - self.skin_root_m) / self.length_m * 1.0
                + 0.01 * e)
                .atan()
    }

    fn bend(&self, curvature: &[f64], factor: f64, scale: f64) -> BentAxis {
        let h = self.length_m / STEPS as f64;
        let mut b = BentAxis {
            x: vec![0.0],
            y: vec![0.0],
            theta: vec![self.ground_slope(0.0)],
        };
        let mut bending = 0.0;
        for i in 0..STEPS {
            let t0 = b.theta[i];
            bending += 0.5 * h * factor * (curvature[i] + curvature[i + 1]);
            let t1 = self.ground_slope((i + 1) as f64 / STEPS as f64) + bending;
            let mid = 0.5 * (t0 + t1);
            b.x.push(b.x[i] + scale * h * mid.cos());
            b.y.push(b.y[i] + scale * h * mid.sin());
            b.theta.push(t1);
        }
        b
    }
}

fn value_at(v: &[f64], e: f64) -> f64 {
    let p = (e * STEPS as f64).clamp(0.0, STEPS as f64 - 1e-9);
    let k = p as usize;
    v[k] + (p - k as f64) * (v[k + 1] - v[k])
}

impl Truth {
    pub fn new(wing: Wing, count: usize) -> Self {
        let span_heading = 1.17f64;
        let span = Vector2::new(span_heading.cos(), span_heading.sin());
        let centre = Vector3::new(35.2, 18.7, 4.4);
        let lens = Lens {
            fy: 7795.0,
            k1: -0.05,
            k2: 0.09,
            k3: -0.02,
            p1: -3e-4,
            p2: 2e-4,
            ..Lens::pinhole(4000, 3000, 7800.0, 1986.0, 1513.0)
        };
        let setup = Setup {
            name: "truth".into(),
            lens,
            projection_centre_m: centre,
            projection_centre_sigma_m: 0.002,
            mount_repeatability_px: 10.0,
            span_direction: span,
            flow_direction: None,
            configured_side: None,
            root_offset_m: 0.55 * wing.structure.size,
            axis_chord_offset_m: Some(0.1),
            breaks: vec![],
            skin_height: Some(SkinHeight {
                root_m: wing.skin_root_m,
                tip_m: wing.skin_tip_m,
                tip_span_m: wing.length_m,
            }),
            uncertainty: SetupUncertainty::from_drawings(),
            thermal: Some(Thermal {
                expansion_per_k: 23e-6,
                expansion_sigma_per_k: None,
                ground_temperature_c: 15.0,
                flight_temperature_c: -55.0,
                flight_temperature_sigma_k: None,
            }),
            torsion: vec![],
            markers: vec![],
            window: None,
        };
        let mut truth = Self {
            setup,
            camera_from_survey: Rotation3::identity(),
            ground_m: vec![],
            wing,
            stations: vec![],
            fixed_m: vec![],
        };
        truth.place_markers(count);
        truth.point_camera();
        truth
    }

    fn place_markers(&mut self, count: usize) {
        let w = self.wing;
        let size = w.structure.size;
        for (e, z) in layout(count) {
            let z = z * w.side * size;
            // The skin at a section: above the axis, lower towards the edges.
            let n = w.skin_root_m + (w.skin_tip_m - w.skin_root_m) * e
                - w.crown_per_m * (z - 0.1 * w.side * size).powi(2) / (1.0 - (1.0 - w.taper) * e);
            self.stations.push((e, n, z));
        }
        self.stations.extend(w.winglet_stations());
        self.setup.axis_chord_offset_m = Some(self.axis_z_m());
        let points = self.points_on(&w.bend_in_space(&[0.0; STEPS + 1], 1.0, |_| 0.0), 1.0);
        let frame = self.setup.wing_frame();
        self.ground_m = points.iter().map(|p| frame.survey_point(p)).collect();
        let marker = |(i, p): (usize, &Vector3<f64>)| SurveyMarker {
            id: format!("M{:02}", i + 1),
            shape: if i < count / 2 {
                Shape::Quadrant
            } else {
                Shape::Circle
            },
            diameter_m: 0.32,
            position_m: *p,
            sigma_m: 0.002,
            fixed: false,
            flight_motion_m: 0.0,
            part: None,
        };
        self.setup.markers = self.ground_m.iter().enumerate().map(marker).collect();
        self.setup.torsion = vec![TorsionPair {
            name: "tip".into(),
            leading: count - 2,
            trailing: count - 1,
        }];
    }

    /// Adds targets fixed to the cabin, at most four: 3 m outboard in the corners of the frame, surveyed to 2 mm.
    pub fn with_fixed_targets(mut self, count: usize) -> Self {
        let frame = self.setup.wing_frame();
        for (k, (y, z)) in [(0.35, -0.6), (0.35, 0.6), (-0.45, 0.62), (-0.45, -0.62)]
            .iter()
            .take(count)
            .enumerate()
        {
            let point = Vector3::new(3.0, *y, *z);
            self.fixed_m.push(point);
            self.ground_m.push(frame.survey_point(&point));
            self.setup.markers.push(SurveyMarker {
                id: format!("F{}", k + 1),
                shape: Shape::Quadrant,
                diameter_m: 0.06,
                position_m: frame.survey_point(&point),
                sigma_m: 0.002,
                fixed: true,
                flight_motion_m: 0.0,
                part: None,
            });
        }
        self
    }

    /// Camera frame: x along Z of a right wing (aft), y down, z outboard, pitched a little; ahead of the wing, z towards its middle
    /// and a wider lens.
    fn point_camera(&mut self) {
        let frame = self.setup.wing_frame();
        let ahead_m = self.wing.structure.ahead_m;
        let pitch = -0.02f64;
        let (s, c) = pitch.sin_cos();
        let mut camera_from_wing = Matrix3::new(0.0, 0.0, 1.0, s, -c, 0.0, c, s, 0.0);
        if ahead_m > 0.0 {
            let forward =
                Vector3::new(0.6 * self.wing.length_m, 0.0, ahead_m * self.wing.side).normalize();
            let right = (-Vector3::y()).cross(&forward);
            camera_from_wing = Matrix3::from_rows(&[
                right.transpose(),
                -Vector3::y().transpose(),
                forward.transpose(),
            ]);
            (self.setup.lens.fx, self.setup.lens.fy) = (4200.0, 4198.0);
        }
        let m = camera_from_wing * frame.wing_from_survey.matrix();
        self.camera_from_survey = Rotation3::from_matrix_unchecked(m);
    }

    /// Curvature of the unit load, and its factor.
    fn load_curvature(&self, tip_deflection_m: f64, fuel: f64) -> (Vec<f64>, f64) {
        let w = self.wing;
        let curvature = w.curvature(fuel);
        let straight = w.bend(&curvature, 0.0, 1.0);
        let tip = |factor: f64| {
            w.bend(&curvature, factor, 1.0).y[STEPS] - straight.y[STEPS] - tip_deflection_m
        };
        let trial = tip(1e-4) + tip_deflection_m;
        let (mut f0, mut f1) = (0.0, 1e-4 * tip_deflection_m / trial);
        for _ in 0..30 {
            let (a, b) = (tip(f0), tip(f1));
            if (b - a).abs() < 1e-14 {
                break;
            }
            (f0, f1) = (f1, f1 - b * (f1 - f0) / (b - a));
        }
        (curvature, f1)
    }

    /// Change of the curvature in flight at fractions of the length, 1/m.
    pub fn curvature_per_m(&self, tip_deflection_m: f64, fuel: f64, shares: &[f64]) -> Vec<f64> {
        let (curvature, factor) = self.load_curvature(tip_deflection_m, fuel);
        shares
            .iter()
            .map(|share| factor * value_at(&curvature, *share))
            .collect()
    }

    /// Bending stiffness at a fraction of the length, relative to the root.
    pub fn stiffness_share(&self, share: f64) -> f64 {
        self.wing.chord(share).powf(self.wing.power)
    }

    /// Distance from the bending root to the tip, m.
    pub fn length_m(&self) -> f64 {
        self.wing.length_m
    }

    /// Arc length of a marker's section as a fraction of the wing length.
    pub fn relative_arc_length(&self, marker: usize) -> f64 {
        self.stations[marker].0
    }

    /// Survey-frame positions in flight. `fuel`: current fraction of the fuel.
    pub fn positions_in_flight(&self, tip_deflection_m: f64, fuel: f64) -> Vec<Vector3<f64>> {
        let w = self.wing;
        let scale = self.setup.thermal.map_or(1.0, |t| t.scale());
        let (curvature, f1) = self.load_curvature(tip_deflection_m, fuel);
        let curvature: Vec<f64> = curvature.iter().map(|k| f1 * k).collect();
        let frame = self.setup.wing_frame();
        let mut carried = self.points_on(
            &w.bend_in_space(&curvature, scale, w.twist_at(tip_deflection_m)),
            scale,
        );
        carried.extend(&self.fixed_m);
        carried.iter().map(|p| frame.survey_point(p)).collect()
    }

    /// Twist of the section midway between the torsion pair, nose up positive, rad.
    pub fn pair_twist_rad(&self, tip_deflection_m: f64) -> f64 {
        let pair = &self.setup.torsion[0];
        let eta = 0.5 * (self.stations[pair.leading].0 + self.stations[pair.trailing].0);
        tip_deflection_m / 2.5 * self.wing.twist_tip_rad * eta.powf(self.wing.twist_power)
    }

    pub fn fuel(&self) -> f64 {
        self.wing.fuel
    }

    pub fn pixels(&self, points_m: &[Vector3<f64>], mount_rad: Vector3<f64>) -> Vec<Vector2<f64>> {
        let rotation = Rotation3::new(mount_rad) * self.camera_from_survey;
        let one = |p: &Vector3<f64>| {
            self.setup
                .lens
                .project(&(rotation * (p - self.setup.projection_centre_m)))
                .unwrap()
        };
        points_m.iter().map(one).collect()
    }

    /// The survey as a total station would report it: noise on markers and projection centre.
    pub fn surveyed(&self, rng: &mut StdRng, sigma_m: f64, centre_sigma_m: f64) -> Setup {
        let mut setup = self.setup.clone();
        for m in &mut setup.markers {
            m.position_m += normal3(rng) * sigma_m;
            m.sigma_m = sigma_m;
        }
        setup.projection_centre_m += normal3(rng) * centre_sigma_m;
        setup.projection_centre_sigma_m = centre_sigma_m;
        setup
    }

    /// Orientation as written by `wingd orient`.
    pub fn orientation(&self, rng: &mut StdRng, sigma_px: f64, with_sights: bool) -> Orientation {
        let sight = |(marker, p): (usize, Vector2<f64>)| {
            let pixel = p + normal2(rng) * sigma_px;
            Observation {
                marker,
                pixel,
                covariance_px2: Matrix2::identity() * sigma_px * sigma_px,
            }
        };
        let pixels = self.pixels(&self.ground_m, Vector3::zeros());
        let ground: Vec<_> = pixels.into_iter().enumerate().map(sight).collect();
        Orientation {
            camera_from_survey: self.camera_from_survey,
            covariance_rad2: Some(Matrix3::identity() * 1e-9),
            ground: if with_sights { ground } else { vec![] },
            templates: vec![],
        }
    }

    pub fn observations(
        &self,
        rng: &mut StdRng,
        points_m: &[Vector3<f64>],
        mount_rad: Vector3<f64>,
        sigma_px: f64,
    ) -> Vec<Observation> {
        let one = |(marker, p): (usize, Vector2<f64>)| Observation {
            marker,
            pixel: p + normal2(rng) * sigma_px,
            covariance_px2: Matrix2::identity() * sigma_px * sigma_px,
        };
        self.pixels(points_m, mount_rad)
            .into_iter()
            .enumerate()
            .map(one)
            .collect()
    }
}
