//! Promise: markers displaced together have one cause instead of several outliers: the cause is named or the test rejects;
//! removals do not make the test pass, and fixed targets do not outvote each other.

use nalgebra::Vector3;
use wingd::measure::adjust::{self, GlobalTest, Mounting, Observation, Options, Solution};
use wingd::measure::setup::{Setup, SetupUncertainty, Width};

use crate::aircraft::proven_to_stay;
use crate::common::beam_truth::{
    Aircraft, Effects, Truth, WingState, normal3, random_wing, remounted, rms, rng,
};

const WINGS: usize = 12;

/// A solved frame, with the normalised errors of its deflections relative to the ground frame.
struct Solved {
    solution: Solution,
    errors: Vec<f64>,
}

impl Solved {
    fn has_remark(&self, words: &str) -> bool {
        self.solution
            .remarks
            .iter()
            .any(|remark| remark.contains(words))
    }

    fn excluded_count(&self) -> usize {
        self.solution.markers.iter().filter(|m| !m.used).count()
    }
}

fn solved(seed: u64, fixed: usize, effects: Effects, state: impl Fn(&mut Setup)) -> Vec<Solved> {
    let mut rng = rng(seed);
    let one = |_| {
        let truth = Truth::new(random_wing(&mut rng), 21).with_fixed_targets(fixed);
        let aircraft = Aircraft::new(&mut rng, truth, effects);
        let mut setup = aircraft.surveyed(&mut rng, 0.002);
        setup.uncertainty = proven_to_stay(SetupUncertainty::DEFAULT);
        state(&mut setup);
        let orientation = aircraft.orientation(&mut rng, 0.05);
        let when = WingState::Flight {
            deflection_m: 2.9,
            fuel: aircraft.truth.fuel(),
        };
        let mount = if fixed > 0 {
            remounted(&mut rng, &setup)
        } else {
            normal3(&mut rng) * 5e-5
        };
        let seen = aircraft.frame(&mut rng, when, (mount, Vector3::zeros()), 0.05);
        let mounting = if fixed > 0 {
            Mounting::Numbered(0)
        } else {
            Mounting::Ground
        };
        let options = Options {
            mountings: Some(vec![mounting]),
            ..Options::default()
        };
        let solution = adjust::solve_spatial(&setup, &orientation, &seen, &options).unwrap();
        let truth = aircraft.deflections_m(when);
        let error = |m: &adjust::MarkerSolution| {
            let deflection = m.deflection_ground_m?;
            Some((deflection.value - truth.get(m.marker)?[1]) / deflection.sigma?)
        };
        let errors = solution
            .markers
            .iter()
            .filter(|m| m.used)
            .filter_map(error)
            .collect();
        Solved { solution, errors }
    };
    (0..WINGS).map(one).collect()
}

/// Displaces each marker by 1 mm where 0.3 mm are allowed: all markers are outliers, without a common cause.
#[test]
fn many_removals_do_not_make_the_global_test_pass() {
    let frames = solved(
        7301,
        0,
        Effects {
            skin_m: 1e-3,
            ..Effects::default()
        },
        |_| (),
    );
    let bought =
        |s: &&Solved| s.excluded_count() > 2 && s.solution.global_test == Some(GlobalTest::Passed);
    let silent = |s: &&Solved| bought(s) && !s.has_remark("are jointly");
    let errors: Vec<f64> = frames.iter().flat_map(|s| s.errors.clone()).collect();
    println!(
        "skin moved by 1 mm: {} frames with three or more out, normalised {:.2}",
        frames.iter().filter(|s| s.excluded_count() > 2).count(),
        rms(&errors)
    );
    assert_eq!(frames.iter().filter(silent).count(), 0);
    assert!((0.4..2.0).contains(&rms(&errors)), "{}", rms(&errors));
}

/// An aileron turned by 1.5 degrees and not declared in the survey, with a well-known wing.
#[test]
fn an_undeclared_moving_part_is_named_or_rejected() {
    let effects = Effects {
        aileron_rad: 0.026,
        ..Effects::default()
    };
    let frames = solved(7302, 0, effects, |setup| {
        setup.markers.iter_mut().for_each(|m| m.part = None);
        setup.uncertainty[Width::Torque] = 0.0;
    });
    let reported = |s: &&Solved| {
        s.has_remark("are jointly") || s.solution.global_test == Some(GlobalTest::Rejected)
    };
    let errors: Vec<f64> = frames.iter().flat_map(|s| s.errors.clone()).collect();
    let count = frames.iter().filter(reported).count();
    println!(
        "an undeclared aileron: reported in {count} of {WINGS}, normalised {:.2}",
        rms(&errors)
    );
    assert!(
        rms(&errors) > 0.4 && (count == WINGS || rms(&errors) < 2.0),
        "{count}, {}",
        rms(&errors)
    );
}

/// One of four fixed targets moved by 5 mm.
#[test]
fn contradictory_fixed_targets_are_all_kept_with_larger_sigmas() {
    let mut reported = 0;
    let mut errors = vec![];
    for frame in solved(
        7303,
        4,
        Effects {
            fixed_each_m: 4e-3,
            ..Effects::default()
        },
        |_| (),
    ) {
        assert!(
            frame.solution.markers.iter().rev().take(4).all(|m| m.used),
            "a fixed target is excluded"
        );
        reported += usize::from(frame.has_remark("the fixed targets contradict each other"));
        errors.extend(frame.errors);
    }
    println!(
        "fixed targets moved by 4 mm each: reported in {reported} of {WINGS}, normalised {:.2}",
        rms(&errors)
    );
    assert!(
        reported > WINGS / 2 && (0.4..2.0).contains(&rms(&errors)),
        "{reported} {}",
        rms(&errors)
    );
}

/// Each prior, alone, increases the sigma if it is not fixed.
#[test]
fn each_prior_increases_the_sigma() {
    let priors = [
        ("scale", Width::FlightScale),
        ("principal point", Width::PrincipalPoint),
        ("root's turn", Width::RootRotation),
        ("root's shift", Width::RootTranslation),
    ];
    let sigma = |width: Option<Width>| {
        let held = solved(7304, 0, Effects::default(), |setup| {
            setup.uncertainty = setup
                .uncertainty
                .with_flight_effects(&SetupUncertainty::from_drawings());
            width
                .into_iter()
                .for_each(|width| setup.uncertainty[width] = SetupUncertainty::DEFAULT[width]);
        });
        held[0]
            .solution
            .markers
            .iter()
            .filter_map(|m| m.deflection_root_m?.sigma)
            .fold(0.0, f64::max)
    };
    let held = sigma(None);
    for (name, width) in priors {
        let wide = sigma(Some(width));
        println!("{name}: {:.3} mm after {:.3} mm", 1e3 * wide, 1e3 * held);
        assert!(wide > 1.005 * held, "{name}: {wide} {held}");
    }
}

/// Solves frames with only this effect, undeclared in survey.csv, camera not remounted; `spoil` changes the images of the first
/// frame. Returns them with the normalised errors of the deflections relative to the ground frame.
fn solved_frames(
    seed: u64,
    count: usize,
    (effects, uncertainty): (Effects, SetupUncertainty),
    spoil: impl Fn(&mut [Observation]),
) -> (Vec<Solution>, Vec<f64>) {
    let mut rng = rng(seed);
    let truth = Truth::new(random_wing(&mut rng), 21);
    let aircraft = Aircraft::new(&mut rng, truth, effects);
    let mut setup = aircraft.surveyed(&mut rng, 0.002);
    setup.uncertainty = proven_to_stay(uncertainty);
    setup.markers.iter_mut().for_each(|m| m.part = None);
    let orientation = aircraft.orientation(&mut rng, 0.05);
    let fuel = aircraft.truth.fuel();
    let when = |k: usize| WingState::Flight {
        deflection_m: 3.0 - 0.2 * k as f64,
        fuel,
    };
    let mut seen: Vec<_> = (0..count)
        .map(|k| {
            let when = when(k);
            let mount = normal3(&mut rng) * 2e-5;
            aircraft.frame(&mut rng, when, (mount, Vector3::zeros()), 0.05)
        })
        .collect();
    spoil(&mut seen[0]);
    let options = Options {
        mountings: Some(vec![Mounting::Ground; count]),
        ..Options::default()
    };
    let solutions = match count {
        1 => vec![adjust::solve_spatial(&setup, &orientation, &seen[0], &options).unwrap()],
        _ => adjust::solve_flight(&setup, &orientation, &seen, &options).unwrap(),
    };
    let of_frame = |(k, solution): (usize, &Solution)| -> Vec<f64> {
        let truth = aircraft.deflections_m(when(k));
        let error = |m: &adjust::MarkerSolution| {
            let deflection = m.deflection_ground_m?;
            Some((deflection.value - truth.get(m.marker)?[1]) / deflection.sigma?)
        };
        solution
            .markers
            .iter()
            .filter(|m| m.used)
            .filter_map(error)
            .collect()
    };
    let errors = solutions.iter().enumerate().flat_map(of_frame).collect();
    (solutions, errors)
}

fn frames_of(
    seed: u64,
    count: usize,
    of: (Effects, SetupUncertainty),
    spoil: impl Fn(&mut [Observation]),
) -> Vec<Solution> {
    solved_frames(seed, count, of, spoil).0
}

/// The same aileron in all frames of a flight: each frame names the cause, or the test rejects, or deflections keep their sigma; no
/// cause is named in flights without a fault.
#[test]
fn a_displacement_common_to_the_frames_of_a_flight_is_named() {
    let width = SetupUncertainty::DEFAULT.with_width(Width::Torque, 0.0);
    let flights = |effects: Effects| {
        (7330..7342).map(move |seed| solved_frames(seed, 4, (effects, width), |_| ()))
    };
    let named = |solutions: &[Solution]| {
        solutions.iter().all(|s| {
            s.remarks
                .iter()
                .any(|remark| remark.contains("are jointly"))
        })
    };
    let (mut reported, mut caused, mut errors, mut unreported) = (0, 0, vec![], vec![]);
    for (solutions, of_deflections) in flights(Effects {
        aileron_rad: 0.026,
        ..Effects::default()
    }) {
        caused += usize::from(named(&solutions));
        errors.extend(&of_deflections);
        match named(&solutions) || solutions[0].global_test == Some(GlobalTest::Rejected) {
            true => reported += 1,
            false => unreported.extend(of_deflections),
        }
    }
    let clean = flights(Effects::default())
        .filter(|(solutions, _)| named(solutions))
        .count();
    let (all, silent) = (
        rms(&errors),
        if unreported.is_empty() {
            0.0
        } else {
            rms(&unreported)
        },
    );
    println!(
        "aileron: reported in {reported} of 12, named in {caused}, normalised {all:.2}, unreported {silent:.2}; nothing: {clean}"
    );
    assert!(
        caused >= 6 && all < 2.0 && silent < 2.0,
        "{caused} {all} {silent}"
    );
    assert_eq!(clean, 0);
}

/// Five images displaced by 1.5 px, alternately up and down: no common cause, and no gross error.
#[test]
fn the_global_test_includes_excluded_markers_if_there_are_many() {
    const OFF: [usize; 5] = [2, 6, 10, 14, 18];
    let mut met = 0;
    for seed in 7310..7314 {
        for count in [1, 3] {
            let solve = |by_px: f64| {
                let spoil = |seen: &mut [Observation]| {
                    let signs = [1.0, -1.0].into_iter().cycle();
                    OFF.iter()
                        .zip(signs)
                        .for_each(|(k, sign)| seen[*k].pixel.y += sign * by_px);
                };
                let uncertainty = SetupUncertainty::DEFAULT
                    .with_flight_effects(&SetupUncertainty::from_drawings());
                frames_of(seed, count, (Effects::default(), uncertainty), spoil).swap_remove(0)
            };
            let (clean, spoilt) = (solve(0.0), solve(1.5));
            let sigma = |s: &Solution| {
                s.markers
                    .iter()
                    .filter_map(|m| m.deflection_ground_m?.sigma)
                    .fold(0.0, f64::max)
            };
            let out = spoilt.markers.iter().filter(|m| !m.used).count();
            let says = spoilt
                .remarks
                .iter()
                .any(|r| r.contains("the global test and the standard deviations include"));
            println!(
                "{count} frames: {out} out, {:?}, {says}, sigma {:.1}",
                spoilt.global_test,
                sigma(&spoilt) / sigma(&clean)
            );
            assert_eq!(clean.global_test, Some(GlobalTest::Passed));
            if says {
                met += 1;
                assert_eq!(spoilt.global_test, Some(GlobalTest::Rejected));
                assert!(
                    sigma(&spoilt) > 1.5 * sigma(&clean),
                    "{} {}",
                    sigma(&spoilt),
                    sigma(&clean)
                );
            }
        }
    }
    assert!(met >= 4, "{met} of 8");
}

/// Skin displaced by six times the default: reported if the residual scatter exceeds 1.5 times the default, and never
/// if nothing moves or the prior is configured.
#[test]
fn a_flight_reports_motion_that_exceeds_its_default() {
    const FLIGHTS: u64 = 24;
    let says = |effects: Effects, width: SetupUncertainty, word: &str| {
        let flights = (7320..7320 + FLIGHTS)
            .map(|seed| frames_of(seed, 5, (effects, width), |_| ()))
            .inspect(|f| {
                println!(
                    "{:?} {}",
                    f[0].global_test,
                    f[0].remarks
                        .iter()
                        .filter(|r| r.contains("was removed"))
                        .count()
                )
            });
        flights
            .filter(|flight| flight[0].remarks.iter().any(|r| r.contains(word)))
            .count()
    };
    let skin = Effects {
        skin_m: 1.8e-3,
        ..Effects::default()
    };
    let (moved, held) = (
        says(skin, SetupUncertainty::DEFAULT, "skin moved"),
        says(
            skin,
            SetupUncertainty::DEFAULT.without_frame_scaling(),
            "skin moved",
        ),
    );
    let still = says(Effects::default(), SetupUncertainty::DEFAULT, "(default");
    println!(
        "skin: reported in {moved} of {FLIGHTS}, with a fixed prior in {held}; nothing: {still}"
    );
    // 30 of 48: a factor of 1.8 is estimated as 1.5, from which on it is reported, or less in the others.
    assert!(
        2 * moved > FLIGHTS as usize && held == 0 && still == 0,
        "{moved} {held} {still}"
    );
}
