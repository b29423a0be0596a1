//! Random wings and cameras with known truth, independent of the models under test: a tapered
//! cantilever under a fuel-relieved load, its curvature integrated numerically.

use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};
use rand::Rng;
use rand::rngs::StdRng;
use wingd::measure::detect::Detection;
use wingd::measure::geometry::Lens;
use wingd::measure::setup::{Setup, SetupUncertainty, Shape, SkinHeight, SurveyMarker, Thermal};

use super::attitude::camera_from_angles;
use super::disc_image::image_of_disc;
pub use super::random::{normal, normal3, rng};

const STATIONS: usize = 400;

/// Parameters of a case.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    pub noise_px: f64,
    /// Fraction of hidden markers.
    pub hidden: f64,
    /// Number of false detections.
    pub false_ones: usize,
    pub mount_px: f64,
    pub deflection_m: (f64, f64),
}

/// A wing, a camera and their known configuration.
pub struct World {
    pub setup: Setup,
    pub camera_from_survey: Rotation3<f64>,
    /// True projection centre and markers on the ground, survey frame, m.
    pub true_centre_m: Vector3<f64>,
    wing_from_survey: Rotation3<f64>,
    ground: Vec<Vector3<f64>>,
    wing: Wing,
    mount: Rotation3<f64>,
}

/// The true wing in the wing frame.
struct Wing {
    length_m: f64,
    root_x: f64,
    dihedral: f64,
    rise: f64,
    crown: f64,
    incidence: f64,
    washout: f64,
    taper: f64,
    power: f64,
    relief: f64,
    twist_per_deflection: f64,
    twist_power: f64,
    skin_root: f64,
    skin_tip: f64,
    height: f64,
    z_axis: f64,
}

/// A frame: detections and, per detection, its true marker.
pub struct View {
    pub detections: Vec<Detection>,
    pub truth: Vec<Option<usize>>,
    /// Image of the centre of each marker.
    pub centres_px: Vec<Option<Vector2<f64>>>,
    pub visible: Vec<bool>,
}

impl Wing {
    fn random(rng: &mut StdRng) -> Self {
        Self {
            length_m: rng.random_range(18.0..36.0),
            root_x: rng.random_range(0.3..0.9),
            dihedral: rng.random_range(0.02..0.1),
            rise: rng.random_range(0.0..0.0008),
            crown: rng.random_range(-0.05..-0.01),
            incidence: rng.random_range(-0.04..0.04),
            washout: rng.random_range(-0.04..0.02),
            taper: rng.random_range(0.5..0.75),
            power: rng.random_range(2.5..4.0),
            relief: rng.random_range(0.0..0.35),
            twist_per_deflection: rng.random_range(-0.02..0.02),
            twist_power: rng.random_range(1.0..2.0),
            skin_root: rng.random_range(0.3..0.6),
            skin_tip: rng.random_range(0.05..0.2),
            height: rng.random_range(1.4..2.4),
            z_axis: rng.random_range(-0.3..0.3),
        }
    }

    fn skin_height(&self, x: f64) -> f64 {
        self.skin_root + (self.skin_tip - self.skin_root) * (x - self.root_x) / self.length_m
    }

    fn skin(&self, x: f64, z: f64) -> f64 {
        let fraction = (x - self.root_x) / self.length_m;
        -self.height
            + self.dihedral * x
            + self.rise * x * x
            + (self.incidence + self.washout * fraction) * z
            + self.crown * (1.0 + 0.8 * fraction) * z * z
    }

    fn normal(&self, x: f64, z: f64) -> Vector3<f64> {
        let h = 1e-4;
        let dx = (self.skin(x + h, z) - self.skin(x - h, z)) / (2.0 * h);
        let dz = (self.skin(x, z + h) - self.skin(x, z - h)) / (2.0 * h);
        Vector3::new(-dx, 1.0, -dz).normalize()
    }

    fn axis(&self, x: f64) -> f64 {
        self.skin(x, self.z_axis) - self.skin_height(x)
    }

    /// Curvature per station over the arc, for a load of size 1.
    fn curvature(&self) -> Vec<f64> {
        let load = |x: f64| (1.0 - x * x).max(0.0).sqrt() - if x < 0.7 { self.relief } else { 0.0 };
        let d = 1.0 / STATIONS as f64;
        let (mut shear, mut moment) = (0.0, 0.0);
        let mut curvature = vec![0.0; STATIONS + 1];
        for i in (0..=STATIONS).rev() {
            let x = i as f64 * d;
            shear += load(x) * d;
            moment += shear * d;
            curvature[i] = moment / (1.0 - self.taper * x).powf(self.power);
        }
        curvature
    }

    /// Axis and slope per station, on the ground (amplitude 0) or bent, with thermal scale.
    fn stations(&self, amplitude: f64, scale: f64) -> (f64, Vec<(Vector2<f64>, f64)>) {
        let curvature = self.curvature();
        let tip_x = self.root_x + self.length_m;
        // Arc length on the ground, then equal steps of it.
        let fine = 4000;
        let dx = (tip_x - self.root_x) / fine as f64;
        let arc: f64 = (0..fine)
            .map(|i| {
                let x = self.root_x + dx * i as f64;
                dx.hypot(self.axis(x + dx) - self.axis(x))
            })
            .sum();
        let ds = arc / STATIONS as f64;
        let mut x_ground = self.root_x;
        let mut p = Vector2::new(self.root_x, self.axis(self.root_x));
        let mut added = 0.0;
        let mut stations = Vec::new();
        for c in &curvature {
            let slope = ((self.axis(x_ground + 1e-4) - self.axis(x_ground - 1e-4)) / 2e-4).atan();
            stations.push((p, slope + added));
            let mid = slope + added + 0.5 * ds * amplitude * c;
            p += Vector2::new(mid.cos(), mid.sin()) * ds * scale;
            x_ground += slope.cos() * ds;
            added += ds * amplitude * c;
        }
        (arc, stations)
    }

    /// Amplitude for a tip deflection.
    fn amplitude(&self, deflection_m: f64) -> f64 {
        let (arc, _) = self.stations(0.0, 1.0);
        let ds = arc / STATIONS as f64;
        let (mut slope, mut deflection) = (0.0, 0.0);
        for c in self.curvature() {
            deflection += slope * ds;
            slope += c * ds;
        }
        deflection_m / deflection
    }

    /// Markers and normals in flight, wing frame.
    fn bend(
        &self,
        ground: &[Vector3<f64>],
        deflection_m: f64,
        scale: f64,
    ) -> Vec<(Vector3<f64>, Vector3<f64>)> {
        let amplitude = self.amplitude(deflection_m);
        let (arc, flat) = self.stations(0.0, 1.0);
        let (_, bent) = self.stations(amplitude, scale);
        let twist_tip = self.twist_per_deflection * deflection_m;
        ground
            .iter()
            .map(|g| {
                let target = Vector2::new(g.x, g.y);
                let along = |at: usize| {
                    let (p, slope) = flat[at];
                    (target - p).dot(&Vector2::new(slope.cos(), slope.sin()))
                };
                let at = (0..=STATIONS)
                    .min_by(|a, b| along(*a).abs().total_cmp(&along(*b).abs()))
                    .unwrap();
                let s = (at as f64 / STATIONS as f64 + along(at) / arc).clamp(0.0, 1.0);
                let twist = twist_tip * s.powf(self.twist_power);
                let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), bent[at].1)
                    * Rotation3::from_axis_angle(&Vector3::x_axis(), -twist)
                    * Rotation3::from_axis_angle(&Vector3::z_axis(), -flat[at].1);
                let axis = |p: Vector2<f64>| Vector3::new(p.x, p.y, self.z_axis);
                let p = axis(bent[at].0) + turn * (g - axis(flat[at].0)) * scale;
                (p, turn * self.normal(g.x, g.z))
            })
            .collect()
    }
}

impl World {
    /// A wing with 14 to 24 markers; even seeds give right wings.
    pub fn random(seed: u64, conditions: &Conditions) -> Self {
        let mut rng = rng(seed);
        let rng = &mut rng;
        let wing = Wing::random(rng);
        let side = if seed.is_multiple_of(2) { 1.0 } else { -1.0 };
        let count = rng.random_range(14..25usize);
        let first = wing.root_x + rng.random_range(4.0..6.5);
        let last = wing.root_x + wing.length_m * 0.98;
        let ground: Vec<Vector3<f64>> = (0..count)
            .map(|k| {
                let t = k as f64 / (count - 1) as f64;
                let x = (first + (last - first) * t + rng.random_range(-0.2..0.2)).min(last);
                let half = 1.9 - 1.1 * t;
                let z = side * if k % 2 == 0 { half } else { -half } * rng.random_range(0.7..1.0);
                Vector3::new(x, wing.skin(x, z), z)
            })
            .collect();
        let heading: f64 = rng.random_range(-3.1..3.1);
        let span = Vector2::new(heading.cos(), heading.sin());
        let true_centre_m = Vector3::new(
            rng.random_range(-50.0..50.0),
            rng.random_range(-50.0..50.0),
            rng.random_range(2.0..6.0),
        );
        let lens = random_lens(rng);
        let focal = lens.fx;
        let frame = wingd::measure::geometry::WingFrame::new(true_centre_m, span);
        let elevation = |p: &Vector3<f64>| (p.y / p.x).atan();
        let lowest = ground.iter().map(elevation).fold(f64::MAX, f64::min);
        let highest = ground.iter().map(elevation).fold(f64::MIN, f64::max) + 0.06;
        let camera_from_wing = camera_from_angles(
            0.5 * (lowest + highest),
            rng.random_range(-0.02..0.02),
            rng.random_range(-0.06..0.06),
        );
        let camera_from_survey = camera_from_wing * frame.wing_from_survey;
        let surveyed =
            |p: &Vector3<f64>, rng: &mut StdRng| frame.survey_point(p) + normal3(rng) * 0.002;
        let markers = ground
            .iter()
            .enumerate()
            .map(|(k, p)| SurveyMarker {
                id: format!("M{:02}", k + 1),
                shape: if 2 * k < count {
                    Shape::Quadrant
                } else {
                    Shape::Circle
                },
                diameter_m: if 2 * k < count { 0.32 } else { 0.36 },
                position_m: surveyed(p, rng),
                sigma_m: 0.002,
                fixed: false,
                flight_motion_m: 0.0,
                part: None,
            })
            .collect();
        let centre = true_centre_m + normal3(rng) * 0.002;
        let setup = setup(&wing, lens, centre, span, markers);
        let direction = rng.random_range(0.0..std::f64::consts::TAU);
        let turn = conditions.mount_px / focal;
        let roll = normal(rng) * 0.1 * turn;
        let mount = Rotation3::new(Vector3::new(
            turn * direction.cos(),
            turn * direction.sin(),
            roll,
        ));
        Self {
            setup,
            camera_from_survey,
            true_centre_m,
            wing_from_survey: frame.wing_from_survey,
            ground,
            wing,
            mount,
        }
    }

    /// A frame on the ground, before remounting.
    pub fn ground_view(&self, seed: u64, conditions: &Conditions) -> View {
        let placed: Vec<_> = self
            .ground
            .iter()
            .map(|g| (*g, self.wing.normal(g.x, g.z)))
            .collect();
        self.view(&placed, &Rotation3::identity(), seed, conditions)
    }

    /// A frame in flight, with the camera remounted.
    pub fn flight_view(&self, deflection_m: f64, seed: u64, conditions: &Conditions) -> View {
        let scale = self.setup.thermal.map_or(1.0, |t| t.scale());
        let placed = self.wing.bend(&self.ground, deflection_m, scale);
        self.view(&placed, &self.mount, seed, conditions)
    }

    fn view(
        &self,
        placed: &[(Vector3<f64>, Vector3<f64>)],
        mount: &Rotation3<f64>,
        seed: u64,
        conditions: &Conditions,
    ) -> View {
        let sizes = SizeErrors::draw(&mut rng(seed ^ 0x517e));
        let mut rng = rng(seed ^ 0x5eed);
        let rng = &mut rng;
        let lens = &self.setup.lens;
        let rotation = mount * self.camera_from_survey * self.wing_from_survey.inverse();
        let mut view = View {
            detections: vec![],
            truth: vec![],
            centres_px: vec![],
            visible: vec![],
        };
        for (j, (p, n)) in placed.iter().enumerate() {
            let marker = &self.setup.markers[j];
            let image = image_of_disc(
                lens,
                &(rotation * p),
                &(rotation * n),
                0.5 * marker.diameter_m,
            );
            let hidden = rng.random::<f64>() < conditions.hidden;
            let (noise_u, noise_v) = (normal(rng), normal(rng));
            view.centres_px.push(image.map(|i| i.point));
            let inside = image.is_some_and(|i| lens.contains(&i.point));
            view.visible.push(inside && !hidden);
            let (Some(image), true) = (image, inside && !hidden) else {
                continue;
            };
            let centre = if marker.shape == Shape::Circle {
                image.centre
            } else {
                image.point
            };
            view.detections.push(Detection {
                shape: marker.shape,
                centre_px: centre + Vector2::new(noise_u, noise_v) * conditions.noise_px,
                covariance_px2: (Matrix2::identity() * conditions.noise_px.powi(2)).into(),
                semi_major_px: image.major + sizes.error_px(marker.shape, image.major, normal(rng)),
                semi_minor_px: (image.minor + 0.2 * normal(rng)).max(1.0),
                angle_rad: image.angle,
                fit_rms: 2.0,
                contrast: 150.0,
                marker: None,
            });
            view.truth.push(Some(j));
        }
        add_false_detections(&mut view, rng, conditions, lens);
        view
    }
}

/// Errors of sizes that are common to the markers of a frame, as measured in rendered frames: an edge, that of quadrants, px,
/// and a relative one of prints.
struct SizeErrors {
    edge_px: f64,
    quadrant_px: f64,
    print: f64,
}

impl SizeErrors {
    fn draw(rng: &mut StdRng) -> Self {
        Self {
            edge_px: 0.3 * normal(rng),
            quadrant_px: 2.0 * normal(rng),
            print: 0.003 * normal(rng),
        }
    }

    fn error_px(&self, shape: Shape, major_px: f64, own: f64) -> f64 {
        let common_px = self.edge_px + major_px * self.print;
        match shape {
            Shape::Circle => common_px + own * 0.2_f64.hypot(0.003 * major_px),
            Shape::Quadrant | Shape::Point => {
                common_px + self.quadrant_px + own * 1.7_f64.hypot(0.003 * major_px)
            }
        }
    }
}

/// A lens for 30 m of wing, with some distortion.
fn random_lens(rng: &mut StdRng) -> Lens {
    let focal = rng.random_range(6800.0..8200.0);
    Lens {
        fy: focal * rng.random_range(0.999..1.001),
        k1: rng.random_range(-0.1..0.1),
        k2: rng.random_range(-0.1..0.1),
        p1: rng.random_range(-5e-4..5e-4),
        p2: rng.random_range(-5e-4..5e-4),
        ..Lens::pinhole(
            4000,
            3000,
            focal,
            rng.random_range(1950.0..2050.0),
            rng.random_range(1450.0..1550.0),
        )
    }
}

/// Adds false detections: half of them anywhere, half near a marker and similar to it.
fn add_false_detections(view: &mut View, rng: &mut StdRng, conditions: &Conditions, lens: &Lens) {
    let real = view.detections.clone();
    for k in 0..conditions.false_ones {
        let Some(like) = real.get(rng.random_range(0..real.len().max(1))) else {
            return;
        };
        let centre = if k % 2 == 0 {
            Vector2::new(
                rng.random_range(0.0..f64::from(lens.width)),
                rng.random_range(0.0..f64::from(lens.height)),
            )
        } else {
            // Two paint marks do not overlap.
            let (along, across) = (rng.random_range(-3.0..3.0), rng.random_range(1.5..4.0));
            let sign = if rng.random::<bool>() { 1.0 } else { -1.0 };
            like.centre_px
                + Vector2::new(
                    along * like.semi_major_px,
                    sign * across * 2.0 * like.semi_minor_px,
                )
        };
        let at = rng.random_range(0..=view.detections.len());
        view.detections.insert(
            at,
            Detection {
                centre_px: centre,
                ..like.clone()
            },
        );
        view.truth.insert(at, None);
    }
}

fn setup(
    wing: &Wing,
    lens: Lens,
    centre: Vector3<f64>,
    span: Vector2<f64>,
    markers: Vec<SurveyMarker>,
) -> Setup {
    Setup {
        name: "synthetic".into(),
        lens,
        projection_centre_m: centre,
        projection_centre_sigma_m: 0.002,
        mount_repeatability_px: 10.0,
        span_direction: span,
        flow_direction: None,
        configured_side: None,
        root_offset_m: wing.root_x,
        axis_chord_offset_m: Some(wing.z_axis),
        breaks: vec![],
        skin_height: Some(SkinHeight {
            root_m: wing.skin_root,
            tip_m: wing.skin_tip,
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
        markers,
        window: None,
    }
}
