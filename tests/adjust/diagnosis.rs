//! Errors of an installation are diagnosed: the true cause comes first or second, and sound installations are not accused.

use crate::common::statistics::draws;
use crate::common::synthetic::{Conditions, World, rng};
use rand::Rng;
use rand::rngs::StdRng;
use wingd::measure::identify::{Cause, Diagnosis, diagnose_ground, diagnose_observations};
use wingd::measure::observation::Observation;
use wingd::measure::setup::{Setup, Shape};

const GROUND: Conditions = Conditions {
    noise_px: 0.05,
    hidden: 0.1,
    false_ones: 1,
    mount_px: 0.0,
    deflection_m: (0.0, 0.0),
};

/// A sound world with markers of different diameters.
fn world(seed: u64) -> (World, StdRng) {
    let mut random = rng(seed ^ 0xd1a6);
    let mut world = World::random(seed, &GROUND);
    world
        .setup
        .markers
        .iter_mut()
        .for_each(|m| m.diameter_m = random.random_range(0.28..0.40));
    (world, random)
}

const KINDS: [&str; 11] = [
    "scale of image",
    "projection centre",
    "scale of survey",
    "survey coordinate",
    "bend",
    "principal point",
    "exchanged names",
    "mirrored axes",
    "units",
    "axes",
    "axes of marks",
];

/// Lowers the survey by the bend of a cantilever with `size` at the tip, m.
fn bend_survey(sound: &Setup, wrong: &mut Setup, size: f64) {
    let frame = sound.wing_frame();
    let tip = sound
        .wing_markers()
        .iter()
        .map(|(_, p)| p.x)
        .fold(0.0, f64::max)
        + 0.5;
    for marker in &mut wrong.markers {
        let along = frame.wing_point(&marker.position_m).x - sound.root_offset_m;
        let x = (along / (tip - sound.root_offset_m)).max(0.0);
        marker.position_m.z -= size * (3.0 * x * x - x * x * x) / 2.0;
    }
}

/// Scales all lengths of a survey.
fn scale_lengths(wrong: &mut Setup, factor: f64) {
    wrong
        .markers
        .iter_mut()
        .for_each(|m| m.position_m *= factor);
    wrong.projection_centre_m *= factor;
}

/// Makes a gross error of axes, units or marks, and returns the causes that name it.
fn with_gross_error(wrong: &mut Setup, kind: usize, random: &mut StdRng) -> Vec<Cause> {
    match KINDS[kind] {
        "mirrored axes" => {
            let axis = random.random_range(0..3);
            wrong
                .markers
                .iter_mut()
                .for_each(|m| m.position_m[axis] *= -1.0);
            wrong.projection_centre_m[axis] *= -1.0;
            vec![Cause::Mirrored]
        }
        "units" if random.random() => {
            scale_lengths(wrong, 1.0 / 0.3048);
            vec![Cause::SurveyScale]
        }
        "units" => {
            wrong
                .markers
                .iter_mut()
                .for_each(|m| m.diameter_m /= 0.0254);
            vec![Cause::SurveyScale]
        }
        "axes" => {
            let (a, b, order) = [(0, 1, 2), (1, 2, 1), (0, 2, 5)][random.random_range(0..3usize)];
            for marker in &mut wrong.markers {
                let p = &mut marker.position_m;
                (p[a], p[b]) = (p[b], p[a]);
            }
            vec![Cause::Axes(8 * order)]
        }
        _ => (0..9).map(Cause::MarkAxes).collect(),
    }
}

/// A setup with an error of `size` of the kind's unit, and the causes that name it; of a marker only if it is visible.
fn with_error(
    sound: &Setup,
    visible: &[usize],
    kind: usize,
    size: f64,
    random: &mut StdRng,
) -> (Setup, Vec<Cause>) {
    let mut wrong = sound.clone();
    let choose = |random: &mut StdRng, shape: Option<Shape>| {
        let of: Vec<usize> = visible
            .iter()
            .copied()
            .filter(|k| shape.is_none_or(|s| sound.markers[*k].shape == s))
            .collect();
        of[random.random_range(0..of.len())]
    };
    let causes = match KINDS[kind] {
        "scale of image" => {
            (wrong.lens.fx, wrong.lens.fy) =
                (wrong.lens.fx * (-size).exp(), wrong.lens.fy * (-size).exp());
            vec![Cause::ImageScale]
        }
        "projection centre" => {
            let axis = random.random_range(0..3);
            wrong.projection_centre_m[axis] -= size;
            vec![Cause::Centre(Some(axis)), Cause::Centre(None)]
        }
        "scale of survey" => {
            scale_lengths(&mut wrong, size.exp());
            vec![Cause::SurveyScale]
        }
        "survey coordinate" => {
            let (marker, axis) = (choose(random, None), random.random_range(0..3));
            wrong.markers[marker].position_m[axis] -= size;
            (0..3).map(|axis| Cause::Point(marker, axis)).collect()
        }
        "bend" => {
            bend_survey(sound, &mut wrong, size);
            vec![Cause::Bend]
        }
        "principal point" => {
            wrong.lens.cx -= size;
            vec![Cause::PrincipalPoint]
        }
        "exchanged names" => {
            let (a, b) = (
                choose(random, Some(Shape::Quadrant)),
                choose(random, Some(Shape::Circle)),
            );
            let place = wrong.markers[a].position_m;
            wrong.markers[a].position_m = wrong.markers[b].position_m;
            wrong.markers[b].position_m = place;
            vec![Cause::Exchange(a, b), Cause::Exchange(b, a)]
        }
        _ => with_gross_error(&mut wrong, kind, random),
    };
    (wrong, causes)
}

/// The diagnosis of a world's ground frame with another setup.
fn diagnose(world: &World, setup: &Setup, seed: u64, by_marks: bool) -> Option<Diagnosis> {
    let view = world.ground_view(seed, &GROUND);
    if !by_marks {
        return diagnose_ground(setup, std::slice::from_ref(&view.detections));
    }
    let height = f64::from(setup.lens.height);
    let marks = view
        .centres_px
        .iter()
        .enumerate()
        .filter_map(|(marker, p)| {
            let pixel = nalgebra::Vector2::new(p.as_ref()?.x, height - 1.0 - p.as_ref()?.y);
            Some(Observation {
                marker,
                pixel,
                covariance_px2: nalgebra::Matrix2::identity(),
            })
        });
    let marks: Vec<Observation> = marks.collect();
    diagnose_observations(setup, None, &marks, &[])
}

/// The standard deviation with which a cause's size is estimated.
fn sigma_of(found: &Diagnosis, causes: &[Cause]) -> Option<f64> {
    found
        .ranking
        .iter()
        .find(|e| causes.contains(&e.cause))
        .and_then(|e| e.size.first()?.sigma)
}

/// Number of errors named and of all, and the number of sound installations accused.
fn count(seeds: std::ops::Range<u64>) -> (usize, usize, usize) {
    let (mut named, mut of, mut accused) = (0, 0, 0);
    let mut tally = [(0, 0); KINDS.len()];
    for seed in seeds {
        let (world, mut random) = world(seed);
        let sound = diagnose(&world, &world.setup, seed, false);
        if let Some(text) = sound.as_ref().and_then(Diagnosis::text) {
            accused += 1;
            eprintln!("seed {seed}: sound, accused: {text}");
        }
        let view = world.ground_view(seed, &GROUND);
        let visible: Vec<usize> = view.truth.iter().copied().flatten().collect();
        let kind = seed as usize % KINDS.len();
        let times = random.random_range(2.0..20.0) * if random.random() { 1.0 } else { -1.0 };
        let mut choice = random.clone();
        // A first error of a guessed size gives the standard deviation of the kind.
        let guess = if kind == 3 { 0.1 } else { 0.0 };
        let (first, causes) = with_error(&world.setup, &visible, kind, guess, &mut choice.clone());
        let sigma = if kind < 6 {
            diagnose(&world, &first, seed, false)
                .and_then(|d| sigma_of(&d, &causes))
                .unwrap_or(0.01)
        } else {
            1.0
        };
        let (wrong, causes) = with_error(&world.setup, &visible, kind, times * sigma, &mut choice);
        let found = diagnose(&world, &wrong, seed, kind == 10);
        let best: Vec<_> = found
            .iter()
            .flat_map(|d| d.causes().iter().take(2))
            .collect();
        let is_named = best.iter().any(|e| causes.contains(&e.cause));
        if !is_named {
            let names: Vec<_> = found
                .iter()
                .flat_map(|d| d.ranking.iter().take(3))
                .map(|e| (e.cause, e.decrease))
                .collect();
            eprintln!(
                "seed {seed}: {} of {times:.1} sigma ({sigma:.2e}), found {names:?}",
                KINDS[kind]
            );
        }
        of += 1;
        named += usize::from(is_named);
        tally[kind].0 += usize::from(is_named);
        tally[kind].1 += 1;
    }
    KINDS
        .iter()
        .zip(tally)
        .for_each(|(kind, (named, of))| eprintln!("{kind}: {named} of {of}"));
    eprintln!("named {named} of {of}, accused {accused}");
    (named, of, accused)
}

#[test]
fn errors_are_named_and_sound_installations_are_not_accused() {
    let (named, of, accused) = count(0..22);
    assert!(
        10 * named >= 8 * of && accused <= 1,
        "{named} of {of}, accused {accused}"
    );
}

/// Number of pairs of errors of which both are named, and of all: one of the camera, and one marker's coordinate.
fn count_pairs(seeds: std::ops::Range<u64>) -> (usize, usize) {
    let (mut both, mut of) = (0, 0);
    for seed in seeds {
        let (world, mut random) = world(seed);
        let view = world.ground_view(seed, &GROUND);
        let visible: Vec<usize> = view.truth.iter().copied().flatten().collect();
        let (kind, size) = [(0, 0.02), (1, 0.08)][seed as usize % 2];
        let (wrong, causes) = with_error(&world.setup, &visible, kind, size, &mut random);
        let sign = if random.random() { 1.0 } else { -1.0 };
        let (wrong, points) = with_error(
            &wrong,
            &visible,
            3,
            sign * random.random_range(0.1..0.3),
            &mut random,
        );
        let found = diagnose(&world, &wrong, seed, false);
        let named: Vec<Cause> = found
            .iter()
            .flat_map(|d| d.causes().iter().chain(&d.further))
            .map(|e| e.cause)
            .collect();
        let is_named = [&causes, &points]
            .iter()
            .all(|all| named.iter().any(|cause| all.contains(cause)));
        both += usize::from(is_named);
        of += 1;
        if !is_named {
            eprintln!(
                "seed {seed}: {causes:?} and {:?}, found {named:?}",
                points.first()
            );
        }
    }
    eprintln!("two errors: both named {both} of {of}");
    (both, of)
}

#[test]
fn two_errors_are_both_named() {
    let (both, of) = count_pairs(300..draws(305, 315));
    assert!(5 * both >= 4 * of, "{both} of {of}");
}

#[test]
#[ignore = "takes minutes; the full table"]
fn errors_are_named_in_most_of_200_installations() {
    let (named, of, accused) = count(0..200);
    assert!(
        100 * named >= 85 * of && 100 * accused <= 2 * of,
        "{named} of {of}, accused {accused}"
    );
}
