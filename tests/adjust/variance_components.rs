//! Variance components of image and survey on simulated wings with known true standard deviations,
//! and the results if the observations do not determine them.

use crate::common::beam_truth::{Truth, normal2, random_wing, remounted, rms, rng};
use nalgebra::{Matrix2, Vector3};
use rand::rngs::StdRng;
use wingd::measure::adjust::profile::arc_length;
use wingd::measure::adjust::{self, Observation, Options, Solution};
use wingd::measure::setup::{Orientation, Setup};

/// True over configured standard deviation.
const IMAGE: f64 = 0.5;
const SURVEY: f64 = 2.0;

fn options() -> Options {
    Options {
        variance_components: true,
        snooping_alpha: 0.0,
        ..Options::default()
    }
}

/// Errors of the logarithms of the components over their standard deviations.
#[derive(Default)]
struct Errors {
    image: Vec<f64>,
    survey: Vec<f64>,
    sigma: Vec<f64>,
    held: usize,
}

impl Errors {
    fn add(&mut self, solution: &Solution) {
        for (name, truth) in [("image", IMAGE * IMAGE), ("survey", SURVEY * SURVEY)] {
            let component = solution
                .variance_components
                .iter()
                .find(|c| c.group == name)
                .unwrap();
            let Some(factor) = component.factor else {
                self.held += 1;
                let reported = solution
                    .remarks
                    .iter()
                    .any(|r| r.contains(&format!("component of {name}")));
                assert!(
                    reported,
                    "{:?} {:?}",
                    solution.remarks, solution.variance_components
                );
                continue;
            };
            assert!(factor > 0.0);
            let sigma = component.sigma_factor.unwrap() / factor;
            let list = if name == "image" {
                &mut self.image
            } else {
                &mut self.survey
            };
            list.push((factor / truth).ln() / sigma);
            self.sigma.push(sigma);
        }
    }

    fn check(&self, method: &str, runs: usize) {
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        for (name, list) in [("image", &self.image), ("survey", &self.survey)] {
            println!(
                "{method}, {name}: mean {:.2}, rms {:.2} of {}",
                mean(list),
                rms(list),
                list.len()
            );
        }
        println!(
            "{method}: relative standard deviation {:.2}, fixed {}",
            mean(&self.sigma),
            self.held
        );
        assert!(
            self.held * 20 <= 2 * runs,
            "fixed {} of {}",
            self.held,
            2 * runs
        );
        for list in [&self.image, &self.survey] {
            assert!(mean(list).abs() < 0.35 && (0.75..1.3).contains(&rms(list)));
        }
    }
}

/// The wing of the profile method: a level line, bent into a parabola.
fn parabola(
    rng: &mut StdRng,
    markers: usize,
    image_px: f64,
) -> (Setup, Orientation, Vec<Observation>) {
    let truth = Truth::new(Default::default(), 21);
    let mut setup = truth.setup.clone();
    setup.thermal = None;
    setup.torsion.clear();
    let frame = setup.wing_frame();
    let (a, template) = (0.0022, setup.markers[0].clone());
    setup.markers.clear();
    let mut flight = vec![];
    for k in 0..markers {
        let x = 6.0 + 28.0 * k as f64 / (markers - 1) as f64;
        let z = if k % 2 == 0 { 0.8 } else { -0.8 };
        let ground = Vector3::new(setup.root_offset_m + arc_length(x, a).length_m, -2.0, z);
        flight.push(frame.survey_point(&Vector3::new(
            setup.root_offset_m + x,
            -2.0 + a * x * x,
            z,
        )));
        let position_m = frame.survey_point(&ground)
            + crate::common::beam_truth::normal3(rng) * (0.005 * SURVEY);
        let id = format!("P{k:02}");
        setup.markers.push(wingd::measure::setup::SurveyMarker {
            id,
            position_m,
            sigma_m: 0.005,
            ..template.clone()
        });
    }
    let observe = |(marker, pixel)| Observation {
        marker,
        pixel: pixel + normal2(rng) * (image_px * IMAGE),
        covariance_px2: Matrix2::identity() * image_px * image_px,
    };
    let seen = truth
        .pixels(&flight, Vector3::zeros())
        .into_iter()
        .enumerate()
        .map(observe)
        .collect();
    (
        setup,
        truth.orientation(&mut crate::common::beam_truth::rng(1), 0.0, false),
        seen,
    )
}

#[test]
fn components_of_the_profile_method_agree_within_their_standard_deviations() {
    let mut rng = rng(41);
    let (mut errors, runs) = (Errors::default(), 200);
    for _ in 0..runs {
        let (setup, orientation, seen) = parabola(&mut rng, 120, 12.0);
        errors.add(&adjust::solve_profile(&setup, &orientation, &seen, &options()).unwrap());
    }
    errors.check("profile", runs);
}

#[test]
fn components_of_the_spatial_method_agree_within_their_standard_deviations() {
    let mut rng = rng(42);
    let (mut errors, runs) = (Errors::default(), 100);
    for _ in 0..runs {
        let truth = Truth::new(random_wing(&mut rng), 21);
        let mut setup = truth.surveyed(&mut rng, 0.002 * SURVEY, 0.002);
        setup.markers.iter_mut().for_each(|m| m.sigma_m = 0.002);
        let mut orientation = truth.orientation(&mut rng, 0.1 * IMAGE, true);
        orientation
            .ground
            .iter_mut()
            .for_each(|g| g.covariance_px2 /= IMAGE * IMAGE);
        let flight = truth.positions_in_flight(2.4, truth.fuel());
        let mount = remounted(&mut rng, &setup);
        let mut seen = truth.observations(&mut rng, &flight, mount, 0.1 * IMAGE);
        seen.iter_mut()
            .for_each(|o| o.covariance_px2 /= IMAGE * IMAGE);
        errors.add(&adjust::solve_spatial(&setup, &orientation, &seen, &options()).unwrap());
    }
    errors.check("spatial", runs);
}

/// Detector images with a survey of millimetre precision: the profile's one condition per marker determines
/// the survey component only.
#[test]
fn a_component_without_evidence_is_reported_and_keeps_its_configured_value() {
    let mut rng = rng(43);
    let mut survey = vec![];
    for _ in 0..50 {
        let (setup, orientation, seen) = parabola(&mut rng, 21, 0.02);
        let s = adjust::solve_profile(&setup, &orientation, &seen, &options()).unwrap();
        let of = |name| {
            s.variance_components
                .iter()
                .find(|c| c.group == name)
                .unwrap()
        };
        assert!(of("image").factor.is_none() && of("image").redundancy < 0.1);
        let survey_component = of("survey");
        let factor = survey_component
            .factor
            .unwrap_or_else(|| panic!("{:?} {:?}", s.remarks, s.variance_components));
        survey.push(
            (factor / (SURVEY * SURVEY)).ln() / (survey_component.sigma_factor.unwrap() / factor),
        );
        let sentences: Vec<_> = s
            .remarks
            .iter()
            .filter(|r| r.contains("variance component"))
            .collect();
        assert_eq!(sentences.len(), 1, "{:?}", s.remarks);
        assert!(
            sentences[0].contains("of image cannot be estimated")
                && sentences[0].contains("stay as given")
        );
    }
    assert!((0.7..1.4).contains(&rms(&survey)), "{}", rms(&survey));
}

/// Two or three markers: no evidence for any component, but still a result.
#[test]
fn too_few_markers_leave_all_components_as_configured() {
    for markers in [2, 3] {
        let (setup, orientation, seen) = parabola(&mut rng(44), markers, 5.0);
        let s = adjust::solve_profile(&setup, &orientation, &seen, &options()).unwrap();
        assert!(s.variance_components.iter().any(|c| c.factor.is_none()));
        assert!(s.markers.iter().all(|m| m.deflection_m.is_some()));
    }
}
