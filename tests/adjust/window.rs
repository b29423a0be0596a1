//! Window panes, compared with rays traced face by face here, without any code under test.

use nalgebra::{Matrix2, Rotation3, Vector2, Vector3};
use rand::Rng;
use rand::rngs::StdRng;
use wingd::measure::adjust::{self, Observation, Options, Solution};
use wingd::measure::environment::Plate;
use wingd::measure::geometry::Lens;
use wingd::measure::setup::{Air, Orientation, Pane, Setup, SetupUncertainty, Width, Window};

use crate::common::beam_truth::{Truth, normal, normal2, random_wing, remounted, rms, rng};

/// A face: plane (a point and its normal) or sphere (centre and radius), with the index behind it.
enum Face {
    Plane {
        at_m: Vector3<f64>,
        normal: Vector3<f64>,
        behind: f64,
    },
    Sphere {
        centre_m: Vector3<f64>,
        radius_m: f64,
        outwards: f64,
        behind: f64,
    },
}

/// Traces a ray through all faces, from the origin in air of index `index`; Snell's law for the tangential part.
fn trace_ray(faces: &[Face], mut index: f64, ray: Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let (mut p, mut d) = (Vector3::zeros(), ray);
    for face in faces {
        let (normal, behind) = match face {
            Face::Plane {
                at_m,
                normal,
                behind,
            } => {
                p += d * ((at_m - p).dot(normal) / d.dot(normal));
                (*normal, *behind)
            }
            Face::Sphere {
                centre_m,
                radius_m,
                outwards,
                behind,
            } => {
                let off = p - centre_m;
                let (half, rest) = (d.dot(&off), off.norm_squared() - radius_m * radius_m);
                p += d * (-half + outwards * (half * half - rest).sqrt());
                ((p - centre_m) * *outwards / *radius_m, *behind)
            }
        };
        let tangential = (d - normal * d.dot(&normal)) * (index / behind);
        d = tangential + normal * (1.0 - tangential.norm_squared()).sqrt();
        index = behind;
    }
    (p, d)
}

/// Two panes of acrylic, 8.5 and 6 mm, 7 mm apart, as in the renderer.
fn two_panes(normal: Vector3<f64>, distance_m: f64, outside: f64) -> Vec<Face> {
    let plane = |depth: f64, behind: f64| Face::Plane {
        at_m: normal * (distance_m + depth),
        normal,
        behind,
    };
    vec![
        plane(0.0, 1.49),
        plane(0.0085, 1.0),
        plane(0.0155, 1.49),
        plane(0.0215, outside),
    ]
}

/// One pane of 14.5 mm, its inner face bowed outwards.
fn bowed(normal: Vector3<f64>, radius_m: f64) -> Vec<Face> {
    let centre_m = normal * (0.15 - radius_m);
    let sphere = |radius: f64, behind| Face::Sphere {
        centre_m,
        radius_m: radius.abs(),
        outwards: radius.signum(),
        behind,
    };
    vec![sphere(radius_m, 1.49), sphere(radius_m + 0.0145, 1.0)]
}

fn pane() -> Pane {
    Pane {
        thickness_m: 0.0145,
        thickness_sigma_m: 0.9e-3,
        index: 1.49,
        index_sigma: 0.01,
        normal_sigma_rad: 1f64.to_radians(),
        bow_radius_m: None,
        bow_sigma: 0.0,
        distance_m: 0.15,
        same_on_ground: false,
    }
}

fn distance_to_line(point: &Vector3<f64>, (from, direction): &(Vector3<f64>, Vector3<f64>)) -> f64 {
    (point - from).cross(direction).norm()
}

fn random_ray(rng: &mut StdRng) -> Vector3<f64> {
    Vector3::new(
        rng.random_range(-0.27..0.27),
        rng.random_range(-0.2..0.2),
        1.0,
    )
    .normalize()
}

fn tilted() -> Vector3<f64> {
    Vector3::new(0.10, 0.16, 0.982).normalize()
}

#[test]
fn a_plate_is_the_panes_traced_face_by_face() {
    let plate = Plate {
        normal: tilted(),
        pane: pane(),
    };
    let (mut rng, mut worst, mut thin) = (rng(5), 0f64, 0f64);
    for _ in 0..1000 {
        let ray = random_ray(&mut rng);
        let distance = rng.random_range(0.05..0.4);
        let truth = trace_ray(&two_panes(plate.normal, distance, 1.0), 1.0, ray);
        let (from, direction) = plate.outside_ray(&ray);
        worst = worst
            .max((direction - truth.1).norm())
            .max(distance_to_line(&from, &truth));
        // Thinner air outside: refraction gives the direction, this check the position.
        let truth = trace_ray(&two_panes(plate.normal, distance, 0.9998), 1.0, ray);
        thin = thin.max(distance_to_line(&from, &truth));
        let far = truth.0 + truth.1 * rng.random_range(6.0..40.0);
        let seen = plate.apparent_point(&far).normalize();
        let (from, direction) = plate.outside_ray(&seen);
        worst = worst.max(distance_to_line(&far, &(from, direction)) / far.norm());
    }
    println!("worst {worst:.1e}; in thin air {:.3} mm", 1e3 * thin);
    assert!(worst < 1e-12 && thin < 0.05e-3, "{worst:e} {thin:e}");
}

#[test]
fn a_bowed_pane_is_traced_like_spheres_about_their_centres() {
    let (normal, mut rng) = (tilted(), rng(6));
    for radius_m in [2.0, 10.0, 300.0, -10.0] {
        let plate = Plate {
            normal,
            pane: Pane {
                bow_radius_m: Some(radius_m),
                ..pane()
            },
        };
        let faces = bowed(normal, radius_m);
        let (mut worst, mut bends, mut shift) = (0f64, 0f64, 0f64);
        for _ in 0..300 {
            let ray = random_ray(&mut rng);
            let truth = trace_ray(&faces, 1.0, ray);
            let (from, direction) = plate.outside_ray(&ray);
            worst = worst
                .max((direction - truth.1).norm())
                .max(distance_to_line(&from, &truth));
            bends = bends.max((direction - ray).norm());
            let plane = Plate {
                normal,
                pane: pane(),
            }
            .outside_ray(&ray)
            .0;
            shift = shift.max((from - plane).cross(&ray).norm());
        }
        println!(
            "radius {radius_m} m: turns a ray by {:.4} px, moves it by {shift:.1e} m",
            7800.0 * bends
        );
        assert!(worst < 1e-9, "{radius_m}: {worst:e}");
    }
}

#[test]
fn a_very_large_radius_is_a_plane() {
    let (normal, mut rng) = (tilted(), rng(7));
    let flat = Plate {
        normal,
        pane: pane(),
    };
    let nearly = Plate {
        normal,
        pane: Pane {
            bow_radius_m: Some(1e6),
            ..pane()
        },
    };
    for _ in 0..100 {
        let ray = random_ray(&mut rng);
        let ((a, d), (b, e)) = (flat.outside_ray(&ray), nearly.outside_ray(&ray));
        // (n - 1) t tan i / (n r), i up to 25 degrees.
        assert!((d - e).norm() < 5e-9 && distance_to_line(&a, &(b, e)) < 1e-8);
    }
}

/// Pixel of a point behind the panes: the ray is aimed iteratively at the point.
fn pixel_through(
    lens: &Lens,
    turn: &Rotation3<f64>,
    faces: Option<Vec<Face>>,
    p: &Vector3<f64>,
) -> Vector2<f64> {
    let point = turn * p;
    let mut aimed = point;
    if let Some(faces) = faces {
        for _ in 0..30 {
            let (from, direction) = trace_ray(&faces, 1.0, aimed.normalize());
            let miss = (point - from) - direction * (point - from).dot(&direction);
            aimed += miss;
        }
    }
    lens.project(&aimed).unwrap()
}

/// A setup that describes a window tilted by 11 degrees relative to the camera axis.
fn described_setup(setup: &Setup, normal: Vector3<f64>, pane: Pane) -> Setup {
    let air = Air {
        temperature_c: 15.0,
        pressure_hpa: 1013.25,
        humidity: 0.0,
        co2_ppm: 420.0,
    };
    let window = Window {
        normal: Some(normal),
        cabin: air,
        outside: air,
        wavelength_nm: 550.0,
        pane: Some(pane),
    };
    Setup {
        window: Some(window),
        ..setup.clone()
    }
}

#[derive(Default)]
struct Errors {
    deflection: Vec<f64>,
    normalised: Vec<f64>,
    tip_sigma: Vec<f64>,
}

impl Errors {
    fn add(&mut self, truth: &Truth, flight: &[Vector3<f64>], solution: &Solution) {
        for m in &solution.markers {
            let Some(deflection) = m.deflection_m else {
                continue;
            };
            let error = deflection.value - (flight[m.marker].z - truth.ground_m[m.marker].z);
            self.deflection.push(error);
            self.normalised.push(error / deflection.sigma.unwrap());
            if m.marker + 1 == flight.len() {
                self.tip_sigma.push(deflection.sigma.unwrap());
            }
        }
    }

    fn print(&self, what: &str) {
        let (deflection, normalised) = (1e3 * rms(&self.deflection), rms(&self.normalised));
        let sigma = 1e3 * rms(&self.tip_sigma);
        println!(
            "{what}: deflection {deflection:.2} mm rms, normalised {normalised:.2}, tip's sigma {sigma:.2} mm"
        );
    }
}

struct SampledWindow {
    truth: Truth,
    setup: Setup,
    normal: Vector3<f64>,
    orientation: Orientation,
    flight: Vec<Vector3<f64>>,
    frame: Vec<Observation>,
}

const DETECTION_PX: f64 = 0.05;

/// A wing seen through panes in flight, and optionally on the ground; plane, or one bowed in flight.
fn sample_window(rng: &mut StdRng, on_ground: bool, radius_m: Option<f64>) -> SampledWindow {
    let truth = Truth::new(random_wing(rng), 22);
    let setup = truth.surveyed(rng, 0.002, 0.002);
    let normal = truth.camera_from_survey.inverse() * tilted();
    let remount = remounted(rng, &setup);
    let mut project_all =
        |points: &[Vector3<f64>], turn: &Rotation3<f64>, panes: bool| -> Vec<Vector2<f64>> {
            let through =
                |n| radius_m.map_or_else(|| two_panes(n, 0.15, 1.0), |radius| bowed(n, radius));
            let centre = truth.setup.projection_centre_m;
            let pixel = |p: &Vector3<f64>| {
                pixel_through(
                    &setup.lens,
                    turn,
                    panes.then(|| through(turn * normal)),
                    &(p - centre),
                )
            };
            points
                .iter()
                .map(|p| pixel(p) + normal2(rng) * DETECTION_PX)
                .collect()
        };
    let covariance_px2 = Matrix2::identity() * DETECTION_PX * DETECTION_PX;
    let ground = project_all(&truth.ground_m, &truth.camera_from_survey, on_ground);
    let flight = truth.positions_in_flight(2.0, truth.fuel());
    let mount = Rotation3::new(remount);
    let seen = project_all(&flight, &(mount * truth.camera_from_survey), true);
    let sight = |(marker, pixel)| Observation {
        marker,
        pixel,
        covariance_px2,
    };
    let orientation = Orientation {
        camera_from_survey: truth.camera_from_survey,
        covariance_rad2: None,
        ground: ground.into_iter().enumerate().map(sight).collect(),
        templates: vec![],
    };
    let frame = seen
        .into_iter()
        .enumerate()
        .map(|(marker, pixel)| Observation {
            marker,
            pixel,
            covariance_px2,
        })
        .collect();
    SampledWindow {
        truth,
        setup,
        normal,
        orientation,
        flight,
        frame,
    }
}

/// An exact survey, and the default mounting.
const SHIFTED: SetupUncertainty = SetupUncertainty::from_drawings()
    .with_width(Width::MountShift, 0.002)
    .with_width(Width::MountDrift, 2e-5);

const WINGS: usize = 30;

fn fleet(
    seed: u64,
    on_ground: bool,
    radius_m: Option<f64>,
    describe: impl Fn(&mut StdRng, &SampledWindow) -> Setup,
) -> Errors {
    let mut rng = rng(seed);
    let mut errors = Errors::default();
    for _ in 0..WINGS {
        let drawn = sample_window(&mut rng, on_ground, radius_m);
        let setup = describe(&mut rng, &drawn);
        let solution = adjust::solve_spatial(
            &setup,
            &drawn.orientation,
            &drawn.frame,
            &Options::default(),
        )
        .unwrap();
        errors.add(&drawn.truth, &drawn.flight, &solution);
    }
    errors
}

#[test]
fn panes_in_flight_only_cause_no_error_if_they_are_described() {
    let without = fleet(21, false, None, |_, d| d.setup.clone());
    without.print("in flight only, not described");
    let with = fleet(21, false, None, |_, d| {
        described_setup(&d.setup, d.normal, pane())
    });
    with.print("in flight only, described");
    // The shift by a pane also shifts the projection centre: the remount prior covers undescribed panes.
    for (what, priors) in [
        ("remount shift", SHIFTED),
        ("all defaults", SetupUncertainty::DEFAULT),
    ] {
        let shifted = fleet(21, false, None, |_, d| Setup {
            uncertainty: priors,
            ..d.setup.clone()
        });
        shifted.print(&format!("in flight only, not described, {what}"));
        assert!(
            (0.6..1.5).contains(&rms(&shifted.normalised)),
            "{what}: {}",
            rms(&shifted.normalised)
        );
    }
    assert!(
        rms(&without.deflection) > 0.015,
        "the panes do nothing here"
    );
    assert!(rms(&with.deflection) < 0.004, "{}", rms(&with.deflection));
    assert!(
        (0.4..1.3).contains(&rms(&with.normalised)),
        "{}",
        rms(&with.normalised)
    );
}

#[test]
fn panes_on_the_ground_too_are_in_sigma() {
    let same = Pane {
        same_on_ground: true,
        ..pane()
    };
    let without = fleet(22, true, None, |_, d| d.setup.clone());
    without.print("on ground too, not described");
    let with = fleet(22, true, None, |_, d| {
        described_setup(&d.setup, d.normal, same)
    });
    with.print("on ground too, described");
    assert!(rms(&with.deflection) < 0.004 && (0.6..1.3).contains(&rms(&with.normalised)));
}

#[test]
fn a_bow_under_cabin_pressure_is_in_sigma() {
    for radius in [30.0, 10.0] {
        let fleet = |what: &str, bow_radius_m, bow_sigma| {
            let pane = Pane {
                bow_radius_m,
                bow_sigma,
                ..pane()
            };
            let errors = fleet(25, false, Some(radius), move |_, d| {
                described_setup(&d.setup, d.normal, pane)
            });
            errors.print(&format!("bowed to {radius} m, described {what}"));
            errors
        };
        let flat = fleet("as plane", None, 0.0);
        let unknown = fleet("as nothing", None, 1.0);
        let known = fleet("as it is, without error", Some(radius), 0.0);
        let loose = fleet("as it is, to a quarter", Some(radius), 0.25);
        let wrong = fleet(
            "with a radius 1.25 times too large",
            Some(1.25 * radius),
            0.25,
        );
        // A bow matters, also if the widths that it contradicts are widened.
        assert!(rms(&flat.deflection) > 1.5 * rms(&known.deflection));
        // A known bow causes no error; one known to 25 % is covered by its sigma.
        assert!(rms(&known.deflection) < 0.004, "{}", rms(&known.deflection));
        // 30 m is the default bow radius of panes; 10 m is three times that bow.
        let unstated = if radius < 30.0 { 2.0 } else { 1.3 };
        assert!(
            (0.5..unstated).contains(&rms(&unknown.normalised)),
            "{}",
            rms(&unknown.normalised)
        );
        for errors in [known, loose, wrong] {
            assert!(
                (0.4..1.3).contains(&rms(&errors.normalised)),
                "{}",
                rms(&errors.normalised)
            );
        }
    }
}

#[test]
fn an_error_of_the_pane_description_is_covered_by_its_sigma() {
    let wrong = |rng: &mut StdRng, d: &SampledWindow| {
        let p = pane();
        let tilt = Vector3::new(normal(rng), normal(rng), normal(rng)) * p.normal_sigma_rad;
        let configured = Pane {
            thickness_m: p.thickness_m + p.thickness_sigma_m * normal(rng),
            index: p.index + p.index_sigma * normal(rng),
            ..p
        };
        described_setup(&d.setup, Rotation3::new(tilt) * d.normal, configured)
    };
    let within_sigma = fleet(23, false, None, wrong);
    within_sigma.print("in flight only, described within the configured sigma");
    let without_sigma = fleet(23, false, None, |rng, d| {
        let mut setup = wrong(rng, d);
        let pane = setup.window.as_mut().unwrap().pane.as_mut().unwrap();
        (
            pane.thickness_sigma_m,
            pane.index_sigma,
            pane.normal_sigma_rad,
        ) = (0.0, 0.0, 0.0);
        setup
    });
    without_sigma.print("in flight only, described with sigma 0");
    assert!(
        (0.5..1.3).contains(&rms(&within_sigma.normalised)),
        "{}",
        rms(&within_sigma.normalised)
    );
    assert!(rms(&without_sigma.normalised) > 1.2 * rms(&within_sigma.normalised));
}

#[test]
fn flights_and_profiles_use_the_panes() {
    let mut rng = rng(24);
    let (mut flights, mut with, mut without) = (Errors::default(), vec![], vec![]);
    for _ in 0..6 {
        let drawn = sample_window(&mut rng, false, None);
        let setup = described_setup(&drawn.setup, drawn.normal, pane());
        let frames = vec![drawn.frame.clone(); 2];
        for solution in
            adjust::solve_flight(&setup, &drawn.orientation, &frames, &Options::default()).unwrap()
        {
            flights.add(&drawn.truth, &drawn.flight, &solution);
        }
        // The error of the paper's method exceeds that of the panes, so the shift itself is tested: the same
        // pixels as without panes must give the same wing.
        let centre = drawn.truth.setup.projection_centre_m;
        let turn = &drawn.truth.camera_from_survey;
        let solve = |setup: &Setup, panes: bool| {
            let faces = || panes.then(|| two_panes(turn * drawn.normal, 0.15, 1.0));
            let pixel = |p: &Vector3<f64>| pixel_through(&setup.lens, turn, faces(), &(p - centre));
            let covariance_px2 = Matrix2::identity();
            let sight = |(marker, pixel)| Observation {
                marker,
                pixel,
                covariance_px2,
            };
            let frame: Vec<_> = drawn
                .flight
                .iter()
                .map(pixel)
                .enumerate()
                .map(sight)
                .collect();
            let options = Options {
                snooping_alpha: 1e-12,
                ..Options::default()
            };
            let solution =
                adjust::solve_profile(setup, &drawn.orientation, &frame, &options).unwrap();
            solution
                .markers
                .iter()
                .map(|m| m.deflection_m.unwrap().value)
                .collect::<Vec<_>>()
        };
        let clear = solve(&drawn.truth.setup, false);
        let seen = solve(
            &described_setup(&drawn.truth.setup, drawn.normal, pane()),
            true,
        );
        let ignored = solve(&drawn.truth.setup, true);
        with.extend(clear.iter().zip(&seen).map(|(a, b)| a - b));
        without.extend(clear.iter().zip(&ignored).map(|(a, b)| a - b));
    }
    flights.print("flights of two frames, described");
    println!(
        "profile: {:.3} mm, not described {:.1} mm",
        1e3 * rms(&with),
        1e3 * rms(&without)
    );
    assert!(rms(&flights.deflection) < 0.004 && (0.25..1.3).contains(&rms(&flights.normalised)));
    assert!(
        rms(&with) < 1e-4 && rms(&without) > 1e-3,
        "{:e} {:e}",
        rms(&with),
        rms(&without)
    );
}
