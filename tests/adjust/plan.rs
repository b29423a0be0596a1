//! Precision predicted by `plan`, compared with deflections sampled on wings that differ from the model.

use crate::common::beam_truth::{Truth, Wing, normal, random_wing, remounted, rms, rng};
use wingd::measure::adjust::{self, Options, SigmaKind};
use wingd::measure::plan::{self, InstallationPlan, PlanOptions};

const PIXEL_SIGMA: f64 = 0.1;

fn planned(options: &PlanOptions) -> InstallationPlan {
    let truth = Truth::new(Wing::default(), 21);
    let orientation = truth.orientation(&mut rng(1), PIXEL_SIGMA, true);
    plan::plan_installation(&truth.setup, Some(&orientation), options).unwrap()
}

#[test]
fn worse_images_give_worse_positions() {
    let sigma = |pixel_sigma| {
        let plan = planned(&PlanOptions {
            pixel_sigma,
            ..PlanOptions::default()
        });
        let tip = plan
            .markers
            .iter()
            .max_by(|a, b| a.span_m.total_cmp(&b.span_m))
            .unwrap()
            .sigma
            .unwrap();
        (
            tip.deflection_m,
            tip.span_m,
            plan.prediction.unwrap().expected.sigma_tip_deflection_m,
        )
    };
    let (fine, coarse) = (sigma(0.1), sigma(1.0));
    assert!(
        coarse.0 > fine.0 && coarse.1 > fine.1 && coarse.2 > fine.2,
        "{fine:?} {coarse:?}"
    );
}

#[test]
fn the_camera_may_be_planned_without_an_orientation() {
    let plan = plan::plan_installation(
        &Truth::new(Wing::default(), 21).setup,
        None,
        &PlanOptions::default(),
    )
    .unwrap();
    assert!(plan.prediction.is_some(), "{:?}", plan.remarks);
}

#[test]
fn predicted_standard_deviations_are_those_of_sampled_errors() {
    let mut rng = rng(31);
    let (mut deflection, mut span) = (vec![], vec![]);
    let options = Options {
        sigma: SigmaKind::Prior,
        snooping_alpha: 0.0,
        ..Options::default()
    };
    for _ in 0..220 {
        let truth = Truth::new(random_wing(&mut rng), 21);
        let tip_deflection_m = 2.4 + 0.4 * normal(&mut rng).clamp(-2.0, 2.0);
        let setup = truth.surveyed(&mut rng, 0.002, 0.002);
        let orientation = truth.orientation(&mut rng, PIXEL_SIGMA, true);
        let wanted = PlanOptions {
            tip_deflection_m,
            pixel_sigma: PIXEL_SIGMA,
            ..PlanOptions::default()
        };
        let predicted = plan::plan_installation(&setup, Some(&orientation), &wanted)
            .unwrap()
            .prediction
            .unwrap();
        let flight = truth.positions_in_flight(tip_deflection_m, truth.fuel());
        let mount = remounted(&mut rng, &truth.setup);
        let seen = truth.observations(&mut rng, &flight, mount, PIXEL_SIGMA);
        let s = adjust::solve_spatial(&setup, &orientation, &seen, &options).unwrap();
        let outboard = setup.span_direction;
        for p in &predicted.markers {
            let m = &s.markers[p.marker];
            let risen = flight[m.marker].z - truth.ground_m[m.marker].z;
            deflection.push((m.deflection_m.unwrap().value - risen) / p.deflection_m);
            let off = m.position_m.unwrap() - flight[m.marker];
            span.push((off.x * outboard.x + off.y * outboard.y) / p.span_m);
        }
    }
    println!(
        "sampled over planned: deflection {:.2}, along the span {:.2}",
        rms(&deflection),
        rms(&span)
    );
    for ratio in [rms(&deflection), rms(&span)] {
        assert!((0.8..1.25).contains(&ratio), "{ratio}");
    }
}

/// Image coordinates twice as noisy as configured, the survey as configured: Koch's components recover both.
#[test]
fn variance_components_of_the_spatial_method_are_recovered() {
    let mut rng = rng(32);
    let (mut image, mut survey) = (vec![], vec![]);
    for _ in 0..60 {
        let truth = Truth::new(random_wing(&mut rng), 21);
        let setup = truth.surveyed(&mut rng, 0.002, 0.002);
        let mut orientation = truth.orientation(&mut rng, PIXEL_SIGMA, true);
        orientation
            .ground
            .iter_mut()
            .for_each(|g| g.covariance_px2 /= 4.0);
        let flight = truth.positions_in_flight(2.4, truth.fuel());
        let mount = remounted(&mut rng, &setup);
        let mut seen = truth.observations(&mut rng, &flight, mount, PIXEL_SIGMA);
        seen.iter_mut().for_each(|o| o.covariance_px2 /= 4.0);
        let options = Options {
            variance_components: true,
            snooping_alpha: 0.0,
            ..Options::default()
        };
        let s = adjust::solve_spatial(&setup, &orientation, &seen, &options).unwrap();
        let of = |name| {
            s.variance_components
                .iter()
                .find(|c| c.group == name)
                .unwrap()
                .factor
                .unwrap()
        };
        image.push(of("image"));
        survey.push(of("survey"));
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    println!(
        "components: image {:.2} (true 4), survey {:.2} (true 1)",
        mean(&image),
        mean(&survey)
    );
    assert!((mean(&image) - 4.0).abs() < 0.8 && (mean(&survey) - 1.0).abs() < 0.2);
}
