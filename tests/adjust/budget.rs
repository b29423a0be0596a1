//! Promise: the uncertainty budget of a result matches the effect of errors of each source, and `plan` predicts it.

use nalgebra::{SMatrix, Vector3};
use rand::rngs::StdRng;
use wingd::measure::adjust::{
    self, DeflectionReference, Observation, Options, SigmaKind, Solution, VarianceBudget,
    VarianceShare,
};
use wingd::measure::geometry::BROWN;
use wingd::measure::plan::{self, PlanOptions};
use wingd::measure::setup::{Orientation, Setup, SetupUncertainty, SkinHeight, Width};

use crate::aircraft::BULGE;
use crate::common::beam_truth::{
    Aircraft, Effects, Truth, Wing, WingState, normal, normal2, normal3, rms, rng,
};
use crate::common::statistics::{draws, honest_range};

const NOISE_PX: f64 = 0.05;
const SURVEY_M: f64 = 0.002;
/// Standard deviations of fx, fy, cx, cy, in px, and of the distortion, which is fixed.
const LENS_SIGMA: [f64; BROWN] = [2.0, 2.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
/// Contributions below this fraction are not tested.
const MIN_FRACTION: f64 = 0.002;

/// Input of an adjustment.
#[derive(Clone)]
struct AdjustmentInput {
    setup: Setup,
    orientation: Orientation,
    seen: Vec<Observation>,
}

fn options() -> Options {
    Options {
        sigma: SigmaKind::Prior,
        snooping_alpha: 0.0,
        curvature_terms: Some(8),
        ..Options::default()
    }
}

impl AdjustmentInput {
    /// Creates input without any error.
    fn exact(aircraft: &Aircraft) -> Self {
        let mut rng = rng(1);
        let mut setup = aircraft.surveyed(&mut rng, 0.0);
        setup.markers.iter_mut().for_each(|m| m.sigma_m = SURVEY_M);
        setup.uncertainty = SetupUncertainty::DEFAULT;
        setup.uncertainty[Width::Readout] = 0.0;
        let mut orientation = aircraft.orientation(&mut rng, 0.0);
        let variance = NOISE_PX * NOISE_PX;
        let covariance_px2 = nalgebra::Matrix2::identity() * variance;
        orientation
            .ground
            .iter_mut()
            .for_each(|g| g.covariance_px2 = covariance_px2);
        setup.uncertainty.lens = Some(SMatrix::from_diagonal(&LENS_SIGMA.map(|s| s * s).into()));
        setup.thermal.as_mut().unwrap().flight_temperature_sigma_k = Some(15.0);
        let mut seen = aircraft.frame(
            &mut rng,
            state_of(aircraft),
            (Vector3::zeros(), Vector3::zeros()),
            0.0,
        );
        seen.iter_mut()
            .for_each(|o| o.covariance_px2 = covariance_px2);
        Self {
            setup,
            orientation,
            seen,
        }
    }

    fn solve(&self) -> Solution {
        adjust::solve_spatial(&self.setup, &self.orientation, &self.seen, &options()).unwrap()
    }

    /// Observes the frame again, of an aircraft with effects.
    fn observe(&mut self, aircraft: &Aircraft, mounting: (Vector3<f64>, Vector3<f64>)) {
        let covariance_px2 = self.seen[0].covariance_px2;
        self.seen = aircraft.frame(&mut rng(1), state_of(aircraft), mounting, 0.0);
        self.seen
            .iter_mut()
            .for_each(|o| o.covariance_px2 = covariance_px2);
        let pixels = aircraft.orientation(&mut rng(1), 0.0).ground;
        self.orientation
            .ground
            .iter_mut()
            .zip(pixels)
            .for_each(|(g, p)| g.pixel = p.pixel);
    }
}

fn state_of(aircraft: &Aircraft) -> WingState {
    WingState::Flight {
        deflection_m: 2.9,
        fuel: aircraft.truth.fuel(),
    }
}

fn truth() -> Truth {
    Truth::new(Wing::default(), 21).with_fixed_targets(2)
}

/// Creates an aircraft with only these effects.
fn aircraft_with(effects: Effects) -> Aircraft {
    Aircraft::new(&mut rng(2), truth(), effects)
}

/// Applies an error of one source; returns the changed aircraft if the error is in the aircraft.
type SourceError = fn(&mut AdjustmentInput, &mut StdRng) -> Option<Aircraft>;

fn effects(given: &mut AdjustmentInput, effects: Effects) -> Option<Aircraft> {
    let aircraft = aircraft_with(effects);
    given.observe(&aircraft, Default::default());
    Some(aircraft)
}

/// One error of each source, with its configured standard deviation.
const SOURCES: [(&str, SourceError); 17] = [
    ("image", |given, rng| {
        given
            .seen
            .iter_mut()
            .for_each(|o| o.pixel += normal2(rng) * NOISE_PX);
        None
    }),
    ("ground frame", |given, rng| {
        given
            .orientation
            .ground
            .iter_mut()
            .for_each(|g| g.pixel += normal2(rng) * NOISE_PX);
        None
    }),
    ("survey", |given, rng| {
        given
            .setup
            .markers
            .iter_mut()
            .for_each(|m| m.position_m += normal3(rng) * SURVEY_M);
        None
    }),
    ("axis", |given, rng| {
        let sigma = given.setup.uncertainty[Width::SkinHeight];
        let (mean, slope) = (normal(rng) * sigma, normal(rng) * 0.2 * sigma);
        let skin = given.setup.skin_height.unwrap();
        given.setup.skin_height = Some(SkinHeight {
            root_m: skin.root_m + mean - slope,
            tip_m: skin.tip_m + mean + slope,
            ..skin
        });
        None
    }),
    ("root", |given, rng| {
        given.setup.root_offset_m += normal(rng) * given.setup.uncertainty[Width::RootOffset];
        None
    }),
    ("chord offset", |given, rng| {
        let offset = given.setup.axis_chord_offset_m.unwrap();
        let by = normal(rng) * given.setup.uncertainty[Width::ChordOffset];
        given.setup.axis_chord_offset_m = Some(offset + by);
        None
    }),
    ("span direction", |given, rng| {
        let (sin, cos) = (normal(rng) * given.setup.uncertainty[Width::SpanDirection]).sin_cos();
        given.setup.span_direction =
            nalgebra::Matrix2::new(cos, -sin, sin, cos) * given.setup.span_direction;
        None
    }),
    ("temperature", |given, rng| {
        let thermal = given.setup.thermal.as_mut().unwrap();
        thermal.flight_temperature_c += normal(rng) * thermal.flight_temperature_sigma_k.unwrap();
        None
    }),
    ("lens", |given, rng| {
        let by = LENS_SIGMA.map(|sigma| sigma * normal(rng));
        given.setup.lens = given.setup.lens.with_changes(&by.into());
        None
    }),
    ("projection centre", |given, rng| {
        given.setup.projection_centre_m += normal3(rng) * given.setup.projection_centre_sigma_m;
        None
    }),
    ("mounting", |given, rng| {
        let turn = given.setup.mount_repeatability_px / given.setup.lens.focal_px();
        let mounting = (
            normal3(rng) * turn,
            normal3(rng) * given.setup.uncertainty[Width::MountShift],
        );
        given.observe(&aircraft_with(Effects::default()), mounting);
        None
    }),
    ("ground bend", |given, rng| {
        let ground_bend_m = normal(rng) * given.setup.uncertainty[Width::GroundBend];
        effects(
            given,
            Effects {
                ground_bend_m,
                ..Effects::default()
            },
        )
    }),
    ("skin", |given, rng| {
        let skin_m = given.setup.uncertainty[Width::SkinMotion];
        // Bulges near the root are the part of the source that most affects the tip.
        let bulge_m = BULGE * skin_m * normal(rng);
        let aircraft = Aircraft::new(
            rng,
            truth(),
            Effects {
                skin_m,
                bulge_m,
                ..Effects::default()
            },
        );
        given.observe(&aircraft, Default::default());
        Some(aircraft)
    }),
    ("fixed targets", |given, rng| {
        let fixed_each_m = given.setup.markers.last().unwrap().flight_motion_m;
        let aircraft = Aircraft::new(
            rng,
            truth(),
            Effects {
                fixed_each_m,
                ..Effects::default()
            },
        );
        given.observe(&aircraft, Default::default());
        Some(aircraft)
    }),
    ("root motion", |given, rng| {
        let width = given.setup.uncertainty;
        let root_rotation_rad = normal3(rng) * width[Width::RootRotation];
        let root_translation_m = normal3(rng) * width[Width::RootTranslation];
        effects(
            given,
            Effects {
                root_rotation_rad,
                root_translation_m,
                ..Effects::default()
            },
        )
    }),
    ("camera in flight", |given, rng| {
        let width = given.setup.uncertainty;
        let (flight_scale, principal_px) = (
            normal(rng) * width[Width::FlightScale],
            normal2(rng) * width[Width::PrincipalPoint],
        );
        effects(
            given,
            Effects {
                flight_scale,
                principal_px,
                ..Effects::default()
            },
        )
    }),
    ("vertical", |given, rng| {
        let tilt_rad = normal2(rng) * given.setup.uncertainty[Width::Vertical];
        let aircraft = aircraft_with(Effects {
            tilt_rad,
            ..Effects::default()
        });
        let tilted = aircraft.surveyed(&mut rng.clone(), 0.0);
        for (marker, tilted) in given.setup.markers.iter_mut().zip(tilted.markers) {
            marker.position_m = tilted.position_m;
        }
        given.setup.projection_centre_m = tilted.projection_centre_m;
        given.orientation.camera_from_survey = aircraft.orientation(rng, 0.0).camera_from_survey;
        None
    }),
];

/// Errors of the deflection that the budget belongs to, relative to the true aircraft.
fn error_m(solution: &Solution, budget: &VarianceBudget, aircraft: &Aircraft) -> f64 {
    let truth_m =
        aircraft.deflections_m(state_of(aircraft))[budget.marker][budget.reference as usize];
    solution.markers[budget.marker]
        .deflection_against(budget.reference)
        .unwrap()
        .value
        - truth_m
}

#[test]
fn each_contribution_is_the_effect_of_errors_of_its_source() {
    let still = aircraft_with(Effects::default());
    let exact = AdjustmentInput::exact(&still);
    let nominal = exact.solve();
    let budget = nominal.budget.clone().unwrap();
    let sigma = nominal.markers[budget.marker]
        .deflection_against(budget.reference)
        .unwrap()
        .sigma
        .unwrap();
    println!(
        "sigma {:.2} mm, {:?}: {:.3?}",
        1e3 * sigma,
        budget.reference,
        budget.shares
    );
    // Model error for this wing without any other error.
    let nominal_m = error_m(&nominal, &budget, &still);
    let (mut rng, mut drawn) = (rng(52), 0.0);
    for (source, draw) in SOURCES {
        let Some(share) = budget.shares.iter().find(|one| one.source == source) else {
            panic!("{source} is not in the budget")
        };
        let count = draws(30, 100);
        let errors = (0..count).map(|_| {
            let mut given = exact.clone();
            let aircraft = draw(&mut given, &mut rng);
            error_m(&given.solve(), &budget, aircraft.as_ref().unwrap_or(&still)) - nominal_m
        });
        let ratio = rms(&errors.collect::<Vec<_>>()) / (sigma * share.share.sqrt());
        println!(
            "{source}: share {:.4}, sampled over predicted {ratio:.2}",
            share.share
        );
        drawn += share.share;
        if share.share > MIN_FRACTION {
            assert!(
                draws(honest_range(count), 0.75..1.3).contains(&ratio),
                "{source}: {ratio}"
            );
        }
    }
    println!("tested: {drawn:.3} of the variance");
}

fn sum(shares: &[VarianceShare]) -> f64 {
    shares.iter().map(|one| one.share).sum()
}

fn fraction_of(shares: &[VarianceShare], source: &str) -> f64 {
    shares
        .iter()
        .find(|one| one.source == source)
        .map_or(0.0, |one| one.share)
}

/// Checks for a frame, a flight, live frames and the profile that contributions sum to 1 and propagate to the reported sigma.
#[test]
fn contributions_add_up_with_every_method() {
    let exact = AdjustmentInput::exact(&aircraft_with(Effects::default()));
    let frames: Vec<Vec<Observation>> = (0..4).map(|_| exact.seen.clone()).collect();
    let mut solved =
        adjust::solve_flight(&exact.setup, &exact.orientation, &frames, &options()).unwrap();
    let mut live =
        adjust::LiveAdjustment::new(exact.setup.clone(), exact.orientation.clone(), options())
            .unwrap();
    solved.extend((0..4).map(|_| live.adjust_frame(&exact.seen, 0.1).unwrap()));
    solved.push(exact.solve());
    solved.push(
        adjust::solve_profile(&exact.setup, &exact.orientation, &exact.seen, &options()).unwrap(),
    );
    for solution in &solved {
        let budget = solution.budget.as_ref().unwrap();
        println!("{:?}: {:.3?}", budget.reference, budget.shares);
        assert!((sum(&budget.shares) - 1.0).abs() < 1e-9);
        assert!(
            budget
                .shares
                .iter()
                .all(|one| (0.0..=1.0).contains(&one.share))
        );
        let shown = solution.markers[budget.marker]
            .deflection_against(budget.reference)
            .unwrap()
            .sigma
            .unwrap();
        let known = budget.shares.iter().filter_map(|one| one.sigma_if_known_m);
        assert!(known.into_iter().all(|known| known <= shown * (1.0 + 1e-9)));
        for reference in [
            DeflectionReference::Survey,
            DeflectionReference::Ground,
            DeflectionReference::Root,
        ] {
            let other = solution.markers[budget.marker]
                .deflection_against(reference)
                .and_then(|deflection| deflection.sigma);
            assert!(
                other.is_none_or(|other| shown <= other / 0.99),
                "{reference:?} is more precise"
            );
        }
    }
    let last = solved[7].budget.as_ref().unwrap();
    assert!(
        fraction_of(&last.shares, "survey") > 0.0
            && fraction_of(&last.shares, "earlier frames") > 0.0
    );
    // The contribution of the mounting shift keeps its name from frame to frame.
    let alone = fraction_of(&solved[8].budget.as_ref().unwrap().shares, "mounting");
    assert!(
        fraction_of(&last.shares, "mounting") > 0.5 * alone,
        "{alone}"
    );
}

#[test]
fn plan_predicts_the_contributions_of_the_adjustment() {
    let exact = AdjustmentInput::exact(&aircraft_with(Effects::default()));
    let wanted = PlanOptions {
        tip_deflection_m: 2.9,
        pixel_sigma: NOISE_PX,
        ..PlanOptions::default()
    };
    let planned = plan::plan_installation(&exact.setup, Some(&exact.orientation), &wanted)
        .unwrap()
        .prediction
        .unwrap();
    let default = Options {
        curvature_terms: None,
        ..options()
    };
    let adjusted =
        adjust::solve_spatial(&exact.setup, &exact.orientation, &exact.seen, &default).unwrap();
    let budget = adjusted.budget.unwrap();
    assert_eq!(planned.tip.as_ref().unwrap().reference, budget.reference);
    for one in &budget.shares {
        let there = fraction_of(&planned.budget, &one.source);
        println!("{}: {:.3}, planned {there:.3}", one.source, one.share);
        // The simulated frame bends by one term of the curvature, so small contributions differ.
        let allowed = if one.share > 0.1 {
            0.1 * one.share
        } else {
            0.02
        };
        assert!((one.share - there).abs() < allowed, "{}", one.source);
    }
    assert!((sum(&planned.budget) - 1.0).abs() < 1e-9);
}

type SetKnown = fn(&mut Setup);

/// Compares "if known" of a contribution with a simulated plan in which the source is known.
#[test]
fn variance_if_known_is_that_of_another_adjustment() {
    let exact = AdjustmentInput::exact(&aircraft_with(Effects::default()));
    let solution = exact.solve();
    let budget = solution.budget.unwrap();
    let known: [(&str, SetKnown); 4] = [
        ("root", |s| s.uncertainty[Width::RootOffset] = 0.0),
        ("chord offset", |s| s.uncertainty[Width::ChordOffset] = 0.0),
        ("in-plane", |s| s.uncertainty[Width::InPlane] = 0.0),
        ("skin", |s| s.uncertainty[Width::SkinMotion] = 0.0),
    ];
    for (source, know) in known {
        let mut given = exact.clone();
        know(&mut given.setup);
        let there = given.solve().markers[budget.marker]
            .deflection_against(budget.reference)
            .unwrap()
            .sigma
            .unwrap();
        let predicted = budget
            .shares
            .iter()
            .find(|one| one.source == source)
            .unwrap()
            .sigma_if_known_m
            .unwrap();
        println!(
            "{source}: {:.3} mm, adjusted again {:.3} mm",
            1e3 * predicted,
            1e3 * there
        );
        assert!((predicted / there - 1.0).abs() < 0.02, "{source}");
    }
}
