//! The profile method reproduces the figures of a correct implementation of the paper (docs/model.md), and shows
//! its hidden bias.
#![allow(clippy::needless_range_loop)]

use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};
use rand::{Rng, SeedableRng, rngs::StdRng};
use wingd::measure::adjust::profile::{arc_length, correlations_with_distances};
use wingd::measure::adjust::{
    self, AdjustError, Estimate, GlobalTest, Observation, Options, SigmaKind, Solution,
};
use wingd::measure::geometry::Lens;
use wingd::measure::setup::{
    Orientation, Setup, SetupUncertainty, Shape, SurveyMarker, Thermal, TorsionPair,
};

/// The paper's estimate, 1/m.
const PAPER_A: f64 = 0.002_189_57;
const PIXEL_SIGMA: f64 = 5.0;

/// A wing with known truth: survey, and the image of every marker.
struct Case {
    setup: Setup,
    orientation: Orientation,
    observations: Vec<Observation>,
    /// Wing frame (X outboard, Y up, Z), in flight, m.
    flight: Vec<Vector3<f64>>,
}

impl Case {
    /// From (ground, flight) pairs in the wing frame; survey frame: x = X, y = -Z, z = Y.
    fn new(points: &[(Vector3<f64>, Vector3<f64>)]) -> Self {
        let (sin, cos) = (-4.0f64).to_radians().sin_cos();
        let camera_from_survey = Rotation3::from_matrix_unchecked(Matrix3::new(
            0.0, -1.0, 0.0, sin, 0.0, -cos, cos, 0.0, sin,
        ));
        let lens = Lens {
            k1: -0.12,
            k2: 0.05,
            p1: 4e-4,
            ..Lens::pinhole(4000, 3000, 7800.0, 1986.0, 1513.0)
        };
        let survey = |p: &Vector3<f64>| Vector3::new(p.x, -p.z, p.y);
        let marker = |(k, (ground, _)): (usize, &(Vector3<f64>, Vector3<f64>))| SurveyMarker {
            id: format!("P{k:02}"),
            shape: Shape::Circle,
            diameter_m: 0.3,
            position_m: survey(ground),
            sigma_m: 0.005,
            fixed: false,
            flight_motion_m: 0.0,
            part: None,
        };
        let observe = |(marker, (_, flight)): (usize, &(Vector3<f64>, Vector3<f64>))| Observation {
            marker,
            pixel: lens
                .project(&(camera_from_survey * survey(flight)))
                .unwrap(),
            covariance_px2: Matrix2::identity() * PIXEL_SIGMA * PIXEL_SIGMA,
        };
        let setup = Setup {
            name: "paper".into(),
            lens,
            projection_centre_m: Vector3::zeros(),
            projection_centre_sigma_m: 0.0001,
            mount_repeatability_px: 10.0,
            span_direction: Vector2::new(1.0, 0.0),
            flow_direction: None,
            configured_side: None,
            root_offset_m: 0.0,
            axis_chord_offset_m: None,
            breaks: vec![],
            skin_height: None,
            uncertainty: SetupUncertainty::from_drawings(),
            thermal: None,
            torsion: vec![],
            markers: points.iter().enumerate().map(marker).collect(),
            window: None,
        };
        let orientation = Orientation::from_rotation(camera_from_survey);
        let observations = points.iter().enumerate().map(observe).collect();
        Self {
            setup,
            orientation,
            observations,
            flight: points.iter().map(|p| p.1).collect(),
        }
    }

    /// The paper's own model: a level line on the ground, a parabola in flight.
    fn parabola(a: f64, markers: usize) -> Self {
        Self::new(&parabola_points(a, markers, 1.0, 0.03))
    }

    /// Solves without data snooping, so that every marker has its numbers.
    fn solve(&self, sigma: SigmaKind) -> Solution {
        let options = Options {
            sigma,
            snooping_alpha: 0.0,
            ..Options::default()
        };
        adjust::solve_profile(&self.setup, &self.orientation, &self.observations, &options).unwrap()
    }

    fn noisy(&self, rng: &mut StdRng) -> Self {
        let mut noisy = Self {
            setup: self.setup.clone(),
            orientation: self.orientation.clone(),
            observations: self.observations.clone(),
            flight: self.flight.clone(),
        };
        for marker in &mut noisy.setup.markers {
            marker.position_m += Vector3::from_fn(|_, _| gauss(rng)) * marker.sigma_m;
        }
        for observation in &mut noisy.observations {
            observation.pixel += Vector2::from_fn(|_, _| gauss(rng)) * PIXEL_SIGMA;
        }
        noisy
    }
}

/// (ground, flight); spread so that the distances run from 7.88 to 35.41 m as in the paper
/// (for its a).
fn parabola_points(
    a: f64,
    markers: usize,
    scale: f64,
    slope: f64,
) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let point = |k: usize| {
        let x = 7.71 + (35.37 - 7.71) * k as f64 / (markers - 1) as f64;
        let z = if k.is_multiple_of(2) { 0.05 } else { -0.05 } * x;
        let ground_height = -2.0 + slope * x;
        let ground = Vector3::new(arc_length(x, a).length_m / scale, ground_height, z);
        (ground, Vector3::new(x, ground_height + a * x * x, z))
    };
    (0..markers).map(point).collect()
}

fn gauss(rng: &mut StdRng) -> f64 {
    (0..12).map(|_| rng.random_range(-0.5..0.5f64)).sum()
}

fn a_of(solution: &Solution) -> Estimate {
    let a = solution
        .parameters
        .iter()
        .find(|p| p.kind.name() == "a_per_m")
        .unwrap();
    a.values[0]
}

#[test]
fn standard_deviations_and_correlations_are_those_of_the_model_page() {
    for markers in 20..=27 {
        let case = Case::parabola(PAPER_A, markers);
        let solution = case.solve(SigmaKind::Prior);
        let a = a_of(&solution);
        assert!((a.value - PAPER_A).abs() < 1e-12);
        let sigma_a = a.sigma.unwrap();
        // 5.7e-6 to 6.7e-6, as printed: to two digits.
        assert!(
            (5.65e-6..6.75e-6).contains(&sigma_a),
            "{markers}: {sigma_a}"
        );
        let distances: Vec<_> = solution
            .markers
            .iter()
            .map(|m| m.distance_m.unwrap())
            .collect();
        for d in &distances {
            let sigma = d.sigma.unwrap();
            assert!((0.00496..0.00502).contains(&sigma), "{markers}: {sigma}");
        }
        assert!(
            (distances[0].value - 7.88).abs() < 0.02,
            "{}",
            distances[0].value
        );
        assert!(
            (distances[markers - 1].value - 35.41).abs() < 0.02,
            "{}",
            distances[markers - 1].value
        );
        assert_eq!(solution.redundancy, markers - 1);
        let correlations =
            correlations_with_distances(&case.setup, &case.orientation, &case.observations)
                .unwrap();
        assert!(
            correlations.iter().all(|&c| (-0.17..0.0).contains(&c)),
            "{correlations:?}"
        );
        println!(
            "{markers} markers: sigma_a {sigma_a:.3e}, sigma_d {:.3}..{:.3} mm, strongest correlation {:.3}",
            1e3 * distances
                .iter()
                .filter_map(|d| d.sigma)
                .fold(f64::MAX, f64::min),
            1e3 * distances.iter().filter_map(|d| d.sigma).fold(0.0, f64::max),
            correlations.iter().copied().fold(0.0, f64::min),
        );
    }
}

/// The correlation depends on the elevation of the tip: it increases towards the horizon.
#[test]
fn correlation_reaches_the_papers_figure() {
    let strongest = |slope: f64| {
        let case = Case::new(&parabola_points(PAPER_A, 22, 1.0, slope));
        let all = correlations_with_distances(&case.setup, &case.orientation, &case.observations)
            .unwrap();
        all.into_iter().fold(0.0, f64::min)
    };
    let by_slope = [0.03, 0.0, -0.02].map(strongest);
    println!("strongest correlation at ground slopes 0.03, 0, -0.02: {by_slope:.3?}");
    assert!(by_slope[0] > by_slope[1] && by_slope[1] > by_slope[2]);
    // The paper quotes -0.16.
    assert!(by_slope[2] < -0.16 && by_slope[1] > -0.16, "{by_slope:?}");
}

#[test]
fn unbent_and_downward_wings_are_regular() {
    for a in [0.0, 1e-9, -1e-6, -0.0006, 0.004, 0.01] {
        let case = Case::parabola(a, 22);
        let solution = case.solve(SigmaKind::Prior);
        assert!(
            (a_of(&solution).value - a).abs() < 1e-11,
            "{a}: {}",
            a_of(&solution).value
        );
        assert!(a_of(&solution).sigma.unwrap() < 1e-5);
        for (marker, flight) in solution.markers.iter().zip(&case.flight) {
            assert!((marker.distance_m.unwrap().value - flight.xy().norm()).abs() < 1e-8);
            let survey = Vector3::new(flight.x, -flight.z, flight.y);
            assert!((marker.position_m.unwrap() - survey).norm() < 1e-8);
            let deflection = a * flight.x * flight.x;
            assert!((marker.deflection_m.unwrap().value - deflection).abs() < 1e-8);
        }
    }
}

#[test]
fn cold_shortens_the_arc() {
    let thermal = Thermal {
        expansion_per_k: 23.1e-6,
        expansion_sigma_per_k: None,
        ground_temperature_c: 15.0,
        flight_temperature_c: -55.0,
        flight_temperature_sigma_k: None,
    };
    let mut case = Case::new(&parabola_points(PAPER_A, 22, thermal.scale(), 0.03));
    case.setup.thermal = Some(thermal);
    let solution = case.solve(SigmaKind::Prior);
    assert!((a_of(&solution).value - PAPER_A).abs() < 1e-11);
    assert!(solution.variance_factor.unwrap() < 1e-12);
    case.setup.thermal = None;
    let last = |s: &Solution| s.markers[21].distance_m.unwrap().value;
    let wrong = last(&case.solve(SigmaKind::Prior)) - last(&solution);
    assert!((0.045..0.065).contains(&wrong), "{wrong}");
}

#[test]
fn predicted_standard_deviations_are_the_sampled_ones() {
    let mut case = Case::parabola(PAPER_A, 22);
    case.setup.torsion = vec![TorsionPair {
        name: "tip".into(),
        leading: 20,
        trailing: 21,
    }];
    let mut rng = StdRng::seed_from_u64(1);
    let runs = 600;
    let (mut a2, mut d2, mut deflection2, mut t2) = (0.0, [0.0; 22], [0.0; 22], 0.0);
    let mut position2 = [[0.0; 3]; 22];
    let (mut factor, mut rejected) = (0.0, 0);
    let exact = case.solve(SigmaKind::Prior);
    let truth = exact.torsion[0].angle_rad.unwrap();
    for _ in 0..runs {
        let noisy = case.noisy(&mut rng);
        let s = noisy.solve(SigmaKind::Prior);
        a2 += (a_of(&s).value - PAPER_A).powi(2);
        t2 += (s.torsion[0].angle_rad.unwrap().value - truth.value).powi(2);
        for (k, (marker, flight)) in s.markers.iter().zip(&case.flight).enumerate() {
            d2[k] += (marker.distance_m.unwrap().value - flight.xy().norm()).powi(2);
            deflection2[k] +=
                (marker.deflection_m.unwrap().value - PAPER_A * flight.x * flight.x).powi(2);
            let error = marker.position_m.unwrap() - Vector3::new(flight.x, -flight.z, flight.y);
            (0..3).for_each(|c| position2[k][c] += error[c] * error[c]);
        }
        factor += s.variance_factor.unwrap();
        rejected += i32::from(s.global_test == Some(GlobalTest::Rejected));
    }
    let n = f64::from(runs);
    let ratio = |sum: f64, sigma: f64| (sum / n).sqrt() / sigma;
    let check =
        |what: &str, r: f64| assert!((0.9..1.1).contains(&r), "{what}: sampled / predicted {r}");
    check("a", ratio(a2, a_of(&exact).sigma.unwrap()));
    check("torsion", ratio(t2, truth.sigma.unwrap()));
    for k in 0..22 {
        check(
            "distance",
            ratio(d2[k], exact.markers[k].distance_m.unwrap().sigma.unwrap()),
        );
        check(
            "deflection",
            ratio(
                deflection2[k],
                exact.markers[k].deflection_m.unwrap().sigma.unwrap(),
            ),
        );
        for c in 0..3 {
            let predicted = exact.markers[k].covariance_m2.unwrap()[(c, c)].sqrt();
            check("position", ratio(position2[k][c], predicted));
        }
    }
    assert!((factor / n - 1.0).abs() < 0.05, "{}", factor / n);
    // 600 trials at 1 %: 0 to 14 with 99.9 %.
    assert!(rejected <= 14, "{rejected}");
}

#[test]
fn the_papers_torsion() {
    // Deflections 2.33 and 2.16 m at d = 31.65 and 30.94 m, 1.54 m apart on ground (paper, section 4.3).
    let mut points = parabola_points(PAPER_A, 22, 1.0, 0.03);
    let spanwise: f64 = 31.65 - 30.94;
    let chordwise = (1.54f64.powi(2) - spanwise * spanwise).sqrt();
    for (k, d, deflection, z) in [
        (18, 31.65f64, 2.33, -0.5 * chordwise),
        (17, 30.94, 2.16, 0.5 * chordwise),
    ] {
        let (ground_height, a) = (-2.0 + 0.03 * d, PAPER_A);
        let y = ground_height + deflection;
        let x = (d * d - y * y).sqrt();
        points[k] = (
            Vector3::new(arc_length(x, a).length_m, ground_height, z),
            Vector3::new(x, y, z),
        );
    }
    let mut case = Case::new(&points);
    case.setup.torsion = vec![TorsionPair {
        name: "tip".into(),
        leading: 18,
        trailing: 17,
    }];
    let torsion = case.solve(SigmaKind::Prior).torsion[0].clone();
    let angle = torsion.angle_rad.unwrap();
    assert!(
        (angle.value.to_degrees() - 6.3).abs() < 0.05,
        "{}",
        angle.value.to_degrees()
    );
    assert!(torsion.twist_rad.is_none());
    // Bending alone explains 97 mm of the 170 mm: 2.7 degrees remain.
    let bending = 2.0 * PAPER_A * 31.3 * spanwise;
    assert!((bending - 0.097).abs() < 0.001);
    assert!(((0.17 - bending).atan2(1.54).to_degrees() - 2.7).abs() < 0.05);
}

/// A straight, sloping wing on the ground, bent by the same parabola about its ground line with constant arc
/// length.
fn sloped(a: f64, slope: f64) -> Case {
    let length = |x: f64| {
        let n = 2000;
        let h = x / f64::from(n);
        (0..n)
            .map(|k| (slope + 2.0 * a * (f64::from(k) + 0.5) * h).hypot(1.0) * h)
            .sum::<f64>()
    };
    let point = |k: usize| {
        let x = 7.6 + (34.75 - 7.6) * k as f64 / 21.0;
        let z = if k.is_multiple_of(2) { 0.05 } else { -0.05 } * x;
        let ground_x = length(x) / slope.hypot(1.0);
        let ground = Vector3::new(ground_x, -2.0 + slope * ground_x, z);
        (ground, Vector3::new(x, -2.0 + slope * x + a * x * x, z))
    };
    Case::new(&(0..22).map(point).collect::<Vec<_>>())
}

#[test]
fn ground_slope_biases_the_tip_and_the_residuals_do_not_show_it() {
    // Slopes of 1.7, 3.4 and 5.0 degrees; tip at 35 m of arc length.
    for (slope, expected_mm) in [(0.03, 79.6), (0.06, 158.5), (0.0875, 230.3)] {
        let case = sloped(0.0022, slope);
        let solution = case.solve(SigmaKind::Prior);
        let tip = solution.markers[21].distance_m.unwrap();
        let bias_mm = 1e3 * (tip.value - case.flight[21].xy().norm());
        println!(
            "slope {slope}: bias {bias_mm:.1} mm, variance factor {:.3}",
            solution.variance_factor.unwrap()
        );
        assert!((bias_mm - expected_mm).abs() < 0.1, "{slope}: {bias_mm}");
        assert_eq!(solution.global_test, Some(GlobalTest::Passed));
        assert!(1e-3 * bias_mm > 10.0 * tip.sigma.unwrap());
    }
}

#[test]
fn the_papers_tip_deflection_needs_a_longer_wing() {
    // 3.10 m at that a is reached at x = 37.6 m; at d = 35.41 m it is 2.75 m.
    assert!(((3.10 / PAPER_A).sqrt() - 37.6).abs() < 0.05);
    let solution = Case::parabola(PAPER_A, 22).solve(SigmaKind::Prior);
    let deflection = solution.markers[21].deflection_m.unwrap().value;
    assert!((deflection - 2.745).abs() < 0.01, "{deflection}");
}

#[test]
fn an_outlier_is_found_and_named() {
    let mut rng = StdRng::seed_from_u64(4);
    let mut case = Case::parabola(PAPER_A, 22).noisy(&mut rng);
    let detectable = case.solve(SigmaKind::Prior).markers[7]
        .minimal_detectable_bias_px
        .unwrap()
        .y;
    assert!((15.0..40.0).contains(&detectable), "{detectable}");
    case.observations[7].pixel.y += 2.0 * detectable;
    let before = case.solve(SigmaKind::Prior);
    assert_eq!(before.global_test, Some(GlobalTest::Rejected));
    let solution = adjust::solve_profile(
        &case.setup,
        &case.orientation,
        &case.observations,
        &Options::default(),
    )
    .unwrap();
    let unused: Vec<_> = solution.markers.iter().filter(|m| !m.used).collect();
    assert_eq!(unused.len(), 1);
    assert_eq!(unused[0].marker, 7);
    let reason = unused[0].reason.as_ref().unwrap();
    assert!(reason.contains("marker P07 was removed"), "{reason}");
    assert_eq!(
        (solution.global_test, solution.redundancy),
        (Some(GlobalTest::Passed), 20)
    );
}

#[test]
fn too_few_observations_are_refused_with_the_missing_datum_named() {
    let case = Case::parabola(PAPER_A, 22);
    let options = Options::default();
    let error = adjust::solve_profile(
        &case.setup,
        &case.orientation,
        &case.observations[..1],
        &options,
    )
    .unwrap_err();
    assert_eq!(
        error,
        AdjustError::TooFewMarkers {
            found: 1,
            needed: 2
        }
    );
    let mut behind = case.setup.clone();
    behind.span_direction = Vector2::new(-1.0, 0.0);
    let error = adjust::solve_profile(&behind, &case.orientation, &case.observations, &options)
        .unwrap_err();
    assert!(error.to_string().contains("span_direction"), "{error}");
}
