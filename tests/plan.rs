//! `plan` on a real installation: more information never hurts, and what is drawn is what was computed.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use wingd::installation::{self, Installation};
use wingd::measure::plan::{self, Optics, Plan, PlanOptions};
use wingd::report::plan_figure;

fn installation() -> Installation {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dev/installation");
    installation::load(&directory).unwrap()
}

fn planned(options: &PlanOptions) -> Plan {
    let installation = installation();
    plan::plan(&installation.setup, installation.orientation.as_ref(), options).unwrap()
}

#[test]
fn the_field_of_view_is_the_cameras() {
    let mut installation = installation();
    installation.setup.lens = wingd::measure::geometry::Lens::pinhole(4000, 3000, 7800.0, 1999.5, 1499.5);
    let plan = plan::plan(&installation.setup, None, &PlanOptions::default()).unwrap();
    assert!((plan.field_of_view_deg[0] - 28.76).abs() < 0.005, "{:?}", plan.field_of_view_deg);
}

#[test]
fn a_marker_less_never_helps_and_one_more_never_hurts() {
    let plan = planned(&PlanOptions::default());
    let prediction = plan.prediction.as_ref().unwrap_or_else(|| panic!("{:?}", plan.remarks));
    let before = prediction.expected;
    println!("{before:?}");
    assert!(before.sigma_tip_lift_m > 0.0005 && before.sigma_tip_lift_m < 0.5);
    assert_eq!(prediction.changes.len(), prediction.markers.len() + 1);
    for change in &prediction.changes {
        let after = change.expected.unwrap_or_else(|| panic!("{:?}", change.without));
        // The ground shape is smoothed over all markers, so that the models differ by a per mille.
        let ratio = after.sigma_mean_lift_m / before.sigma_mean_lift_m;
        println!("{:?} at {:.2} m: {ratio:.4}", change.without, change.span_m);
        match change.without {
            Some(_) => assert!(ratio > 0.995, "{:?}: {ratio}", change.without),
            None => assert!(ratio < 1.005, "one more: {ratio}"),
        }
    }
}

#[test]
fn worse_images_give_worse_positions() {
    let sigma = |pixel_sigma| {
        let plan = planned(&PlanOptions { pixel_sigma, ..PlanOptions::default() });
        let tip = plan.markers.iter().max_by(|a, b| a.span_m.total_cmp(&b.span_m)).unwrap().sigma.unwrap();
        (tip.lift_m, tip.span_m, plan.prediction.unwrap().expected.sigma_tip_lift_m)
    };
    let (fine, coarse) = (sigma(0.1), sigma(1.0));
    assert!(coarse.0 > fine.0 && coarse.1 > fine.1 && coarse.2 > fine.2, "{fine:?} {coarse:?}");
}

#[test]
fn the_camera_may_be_planned_without_an_orientation() {
    let installation = installation();
    let plan = plan::plan(&installation.setup, None, &PlanOptions::default()).unwrap();
    assert!(plan.markers.iter().all(|m| m.visible), "{:?}", plan.remarks);
    assert!(plan.prediction.is_some(), "{:?}", plan.remarks);
}

#[test]
fn json_and_figure_hold_the_plan() {
    let optics =
        Optics { focal_length_mm: 12.0, f_number: 4.0, pixel_pitch_um: 1.54, circle_of_confusion_um: None };
    let plan = planned(&PlanOptions { optics: Some(optics), ..PlanOptions::default() });
    let json = serde_json::to_value(&plan).unwrap();
    assert!((json["optics"]["airy_px"].as_f64().unwrap() - 3.5).abs() < 0.05);
    assert_eq!(json["markers"].as_array().unwrap().len(), plan.markers.len());
    let figure = plan_figure::figure(&plan);
    assert!(figure.starts_with("<svg") && figure.ends_with("</svg>") && !figure.contains("NaN"));
    assert_eq!(figure.matches("<polyline").count(), 4, "lift, twist, two footprints");
}
