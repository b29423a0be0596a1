//! Promise: an image at another scale than the ground frame (refocus, zoom, stabiliser crop, resizing), or with four fixed
//! targets at another aspect, has honest standard deviations, or its result is doubtful and names the cause.

use nalgebra::{Matrix2, Vector2};
use wingd::measure::adjust::{self, DeflectionReference, Mounting, Observation, Options, Solution};
use wingd::measure::setup::{SetupUncertainty, Shape, Width};

use crate::aircraft::{SURVEY_M, combined_effects};
use crate::common::beam_truth::{
    Aircraft, Effects, Structure, Truth, WingState, normal2, normal3, random_wing, remounted, rms,
    rng,
};
use crate::common::statistics::draws;

/// Change of the image since the ground frame: factors along u and v about the middle of the image.
#[derive(Clone, Copy, Debug)]
struct Change {
    scale: f64,
    aspect: f64,
}

/// Sampled markers.
#[derive(Clone, Copy, Debug)]
enum Markers {
    Decals,
    Points,
    Fixed(usize),
}

/// Results of one call.
struct Outcome {
    solutions: Vec<Solution>,
    /// Normalised errors of the reported deflections of the markers, per frame.
    errors: Vec<Vec<f64>>,
}

impl Outcome {
    fn rms(&self) -> f64 {
        let usable = self.errors.iter().zip(&self.solutions);
        let all: Vec<f64> = usable
            .filter(|(_, solution)| !is_doubtful(solution))
            .flat_map(|(errors, _)| errors.clone())
            .collect();
        rms(&all)
    }
}

fn is_doubtful(solution: &Solution) -> bool {
    solution.doubt.is_some()
}

/// Solves a frame or a flight of a sampled wing of this length; `changed`: the frames whose images are changed.
fn solved(
    seed: u64,
    frames: usize,
    markers: Markers,
    length_m: f64,
    (change, changed): (Change, &dyn Fn(usize) -> bool),
) -> Outcome {
    let mut rng = rng(seed);
    let structure = Structure {
        size: length_m / 31.0,
        ..Structure::default()
    };
    let size = structure.size;
    let effects = combined_effects(&mut rng);
    let effects = Effects {
        structure,
        ground_bend_m: size * effects.ground_bend_m,
        bulge_m: size * effects.bulge_m,
        skin_m: size * effects.skin_m,
        in_plane_m: size * effects.in_plane_m,
        kink_rad: effects.kink_rad,
        vibration: (size * effects.vibration.0, effects.vibration.1),
        root_translation_m: effects.root_translation_m * size,
        ..effects
    };
    let mut truth = Truth::new(random_wing(&mut rng).built(structure), 21);
    if let Markers::Fixed(count) = markers {
        truth = truth.with_fixed_targets(count);
    }
    let (noise_px, ground_px) = match markers {
        Markers::Points => (0.15, 0.3),
        _ => (0.05, 0.05),
    };
    let aircraft = Aircraft::new(&mut rng, truth, effects);
    let mut setup = aircraft.surveyed(&mut rng, SURVEY_M);
    setup.uncertainty = SetupUncertainty::default_for(setup.reach_m());
    if let Markers::Points = markers {
        setup
            .markers
            .iter_mut()
            .for_each(|marker| marker.shape = Shape::Point);
    }
    let orientation = aircraft.orientation(&mut rng, ground_px);
    let mount = (
        remounted(&mut rng, &setup),
        normal3(&mut rng) * setup.uncertainty[Width::MountShift],
    );
    let middle = Vector2::new(f64::from(setup.lens.width), f64::from(setup.lens.height)) * 0.5;
    let factors = Vector2::new(change.scale, change.scale * change.aspect);
    let whens: Vec<WingState> = (0..frames)
        .map(|k| WingState::Flight {
            deflection_m: (2.9 - 0.25 * k as f64) * size,
            fuel: aircraft.truth.fuel() * (1.0 - 0.06 * k as f64),
        })
        .collect();
    let seen: Vec<Vec<Observation>> = whens
        .iter()
        .enumerate()
        .map(|(k, when)| {
            let factors = if changed(k) {
                factors
            } else {
                Vector2::repeat(1.0)
            };
            let drift = normal3(&mut rng) * setup.uncertainty[Width::MountDrift];
            let mut seen = aircraft.frame(&mut rng, *when, (mount.0 + drift, mount.1), 0.0);
            for one in &mut seen {
                one.pixel = middle + (one.pixel - middle).component_mul(&factors);
                one.pixel += normal2(&mut rng) * noise_px;
                one.covariance_px2 = Matrix2::identity() * noise_px.powi(2);
            }
            seen
        })
        .collect();
    let options = Options {
        mountings: (frames > 1).then(|| vec![Mounting::Numbered(0); frames]),
        ..Options::default()
    };
    let solutions = match frames {
        1 => adjust::solve_spatial(&setup, &orientation, &seen[0], &options).map(|s| vec![s]),
        _ => adjust::solve_flight(&setup, &orientation, &seen, &options),
    };
    // A frame that has no solution is failed and not usable either.
    let solutions = solutions.unwrap_or_default();
    let errors = whens
        .iter()
        .zip(&solutions)
        .map(|(when, solution)| normalised_errors(&aircraft, *when, solution))
        .collect();
    Outcome { solutions, errors }
}

/// Normalised errors of the reported deflections of all used markers.
fn normalised_errors(aircraft: &Aircraft, when: WingState, solution: &Solution) -> Vec<f64> {
    let reference = solution
        .budget
        .as_ref()
        .map_or(DeflectionReference::Survey, |budget| budget.reference);
    let truth = aircraft.deflections_m(when);
    let error = |marker: &adjust::MarkerSolution| {
        let found = marker.deflection_against(reference)?;
        let truth = truth.get(marker.marker)?[reference as usize];
        Some((found.value - truth) / found.sigma?)
    };
    solution
        .markers
        .iter()
        .filter(|marker| marker.used)
        .filter_map(error)
        .collect()
}

const KINDS: [Markers; 4] = [
    Markers::Decals,
    Markers::Points,
    Markers::Fixed(2),
    Markers::Fixed(4),
];

const CHANGES: [(f64, f64); 10] = [
    (0.98, 1.0),
    (0.99, 1.0),
    (0.995, 1.0),
    (0.997, 1.0),
    (0.998, 1.0),
    (1.001, 1.0),
    (1.003, 1.0),
    (1.01, 1.0),
    (1.04, 1.0),
    (1.0, 0.99),
];

/// Counts of cases: all, those beyond 2.5 and 3.5 sigma among the results that are not doubtful, and doubtful ones.
pub fn count() -> [usize; 4] {
    let [mut cases, mut beyond, mut far, mut doubtful] = [0; 4];
    for (k, (scale, aspect)) in CHANGES.into_iter().enumerate() {
        let change = Change { scale, aspect };
        for frames in [1, 4] {
            // Markers on the wing alone may take another aspect for a bend; four fixed targets separate them.
            let of_kinds = match aspect {
                1.0 => draws(vec![k % KINDS.len()], (0..KINDS.len()).collect()),
                _ => vec![3],
            };
            for kind in of_kinds {
                for (n, length_m) in draws(&[31.0][..], &[31.0, 9.0]).iter().enumerate() {
                    let seed = 52_000 + 1000 * k as u64 + 10 * kind as u64 + n as u64;
                    let outcome = solved(seed, frames, KINDS[kind], *length_m, (change, &|_| true));
                    let error = outcome.rms();
                    println!(
                        "{scale} {aspect}, {frames} frames, {:?}, {length_m} m: {error:.2} sigma, {:?}",
                        KINDS[kind],
                        outcome.solutions.first().map(|s| (
                            s.global_test,
                            &s.counted_causes,
                            &s.doubt
                        )),
                    );
                    cases += 1;
                    beyond += usize::from(error > 2.5);
                    far += usize::from(error > 3.5);
                    doubtful += usize::from(outcome.solutions.iter().all(is_doubtful));
                }
            }
        }
    }
    println!("of {cases}: {beyond} beyond 2.5, {far} beyond 3.5, {doubtful} doubtful");
    [cases, beyond, far, doubtful]
}

#[test]
fn images_of_another_scale_have_honest_deflections_or_are_doubtful() {
    let [cases, beyond, far, doubtful] = count();
    // One case in 24, rounded up: honest errors of one case are alike, and 1 % of them are beyond 2.5.
    assert!(
        beyond <= cases.div_ceil(24) && far == 0,
        "{beyond}, {far} of {cases}"
    );
    // Markers on a wing separate scale from the deflection.
    assert!(4 * doubtful <= cases, "{doubtful} of {cases} doubtful");
}

/// Normalised errors of sound frames and flights, and the numbers of doubtful results, of counted causes and of all.
pub fn count_sound(seeds: u64) -> (Vec<f64>, [usize; 3]) {
    let kinds = [Markers::Decals, Markers::Fixed(2), Markers::Fixed(4)];
    let same = Change {
        scale: 1.0,
        aspect: 1.0,
    };
    let (mut errors, mut counts) = (vec![], [0; 3]);
    for seed in 0..seeds {
        let (frames, kind) = ([1, 4][seed as usize % 2], kinds[seed as usize % 3]);
        let outcome = solved(61_000 + seed, frames, kind, 31.0, (same, &|_| true));
        errors.push(outcome.rms());
        let first = &outcome.solutions[0];
        counts[0] += usize::from(outcome.solutions.iter().any(is_doubtful));
        counts[1] += usize::from(!first.counted_causes.is_empty());
        counts[2] += 1;
        if is_doubtful(first) || !first.counted_causes.is_empty() {
            println!("seed {seed}: {:?} {:?}", first.doubt, first.counted_causes);
        }
    }
    println!(
        "sound: rms {:.2}, doubtful, counted, all: {counts:?}",
        rms(&errors)
    );
    (errors, counts)
}

#[test]
fn sound_images_are_rarely_doubtful() {
    let (errors, [doubtful, _, all]) = count_sound(draws(12, 300));
    assert!(100 * doubtful <= all, "{doubtful} of {all}");
    assert!((0.5..1.4).contains(&rms(&errors)), "{}", rms(&errors));
}

/// Flights of five frames, the second of which has another scale or aspect. Counts of flights: all, those whose usable
/// frames are beyond 2.5 sigma, and those in which a sound frame is doubtful.
pub fn count_one_changed_frame() -> [usize; 3] {
    let mut counts = [0; 3];
    for (k, (scale, aspect)) in CHANGES.into_iter().enumerate() {
        let change = Change { scale, aspect };
        for kind in draws(vec![k % KINDS.len()], (0..KINDS.len()).collect()) {
            let seed = 53_000 + 100 * k as u64 + kind as u64;
            let outcome = solved(seed, 5, KINDS[kind], 31.0, (change, &|frame| frame == 1));
            let doubtful: Vec<bool> = outcome.solutions.iter().map(is_doubtful).collect();
            let each: Vec<f64> = outcome.errors.iter().map(|errors| rms(errors)).collect();
            println!(
                "{scale} {aspect}, {:?}: usable {:.2} sigma, each {each:.2?}, doubtful {doubtful:?}, {:?} {:?}",
                KINDS[kind],
                outcome.rms(),
                outcome
                    .solutions
                    .iter()
                    .map(|s| s.global_test)
                    .collect::<Vec<_>>(),
                outcome
                    .solutions
                    .get(1)
                    .map(|s| (&s.counted_causes, &s.doubt)),
            );
            counts[0] += 1;
            counts[1] += usize::from(outcome.rms() > 2.5);
            let sound = (0..5).filter(|frame| *frame != 1);
            counts[2] += usize::from(
                sound
                    .into_iter()
                    .any(|frame| doubtful.get(frame) != Some(&false)),
            );
        }
    }
    println!("one frame of five: {counts:?}");
    counts
}

#[test]
fn one_frame_of_another_scale_is_doubtful_and_not_its_flight() {
    let [flights, beyond, lost] = count_one_changed_frame();
    // One flight in 24, rounded up: honest errors of one flight are alike, and 1 % of them are beyond 2.5.
    assert!(
        beyond <= flights.div_ceil(24) && lost == 0,
        "{beyond}, {lost} of {flights}"
    );
}
