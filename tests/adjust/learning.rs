//! Promise: what several flights of an aircraft taught narrows a single frame of a later one to what its mounting leaves,
//! and its standard deviations hold; nothing is counted twice, and what has changed is noticed.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rand::Rng;
use rand::rngs::StdRng;
use wingd::measure::adjust::flight_prior::{FlightPrior, ReducedNormals};
use wingd::measure::adjust::{self, GlobalTest, Live, Mounting, Observation, Options, Solution};
use wingd::measure::setup::{Orientation, Setup};

use crate::aircraft::{NOISE_PX, SURVEY_M, SetUp, Shown, all_together};
use crate::common::beam_truth::{Aircraft, When, median, normal3, rms, rng};

const FRAMES: usize = 5;

/// An aircraft with its installation.
struct Drawn {
    aircraft: Aircraft,
    setup: Setup,
    orientation: Orientation,
    set_up: SetUp,
    /// Of the last frame.
    now: When,
}

/// One flight as seen.
struct Flown {
    seen: Vec<Vec<Observation>>,
}

impl Drawn {
    fn new(rng: &mut StdRng, set_up: SetUp) -> Self {
        let effects = all_together(rng);
        let truth = set_up.truth(rng);
        let aircraft = Aircraft::new(rng, truth, effects);
        let mut setup = aircraft.surveyed(rng, SURVEY_M);
        setup.uncertainty = set_up.widths();
        let orientation = aircraft.orientation(rng, NOISE_PX);
        Self { aircraft, setup, orientation, set_up, now: When::Survey }
    }

    /// A flight with fuel, deflection, mounting and all that is its own drawn anew.
    fn flies(&mut self, rng: &mut StdRng, frames: usize) -> Flown {
        let effects = all_together(rng);
        self.aircraft.flies_again(rng, effects);
        let (mount, shift) = self.set_up.mounting(rng, &self.setup);
        let fuel = self.aircraft.truth.fuel() * rng.random_range(0.7..1.0);
        let heavy = rng.random_range(0.9..1.1);
        let when = |k: usize| {
            let share = k as f64 / (FRAMES - 1) as f64;
            When::Flight { deflection_m: heavy * (3.2 - 1.2 * share), fuel: fuel * (1.0 - 0.24 * share) }
        };
        let first = if frames == 1 { rng.random_range(0..FRAMES) } else { 0 };
        let whens: Vec<When> = (first..first + frames).map(when).collect();
        let frame = |rng: &mut StdRng, when: &When| {
            let drift = normal3(rng) * self.setup.uncertainty.mount_drift_rad;
            self.aircraft.frame(rng, *when, (mount + drift, shift), NOISE_PX)
        };
        let seen = whens.iter().map(|when| frame(rng, when)).collect();
        self.now = whens[whens.len() - 1];
        Flown { seen }
    }

    fn options(&self, frames: usize, taught: Option<FlightPrior>) -> Options {
        let mounting =
            if self.set_up == SetUp::Stayed { Mounting::OfTheGround } else { Mounting::Numbered(0) };
        let taught = taught.map(Arc::new);
        Options { mountings: Some(vec![mounting; frames]), flight_prior: taught, ..Options::default() }
    }

    fn learn(&self, flown: &Flown, taught: Option<FlightPrior>) -> Option<ReducedNormals> {
        let options = self.options(flown.seen.len(), taught);
        adjust::learn(&self.setup, &self.orientation, &flown.seen, &options).ok().map(|lesson| lesson.normals)
    }

    /// Of each flight, linearised beside what the others told, as `wingd learn` does.
    fn lessons(&self, flights: &[Flown]) -> Vec<ReducedNormals> {
        let mut all: Vec<ReducedNormals> = vec![];
        for flown in flights {
            let taught = together(&all, &self.setup);
            all.extend(self.learn(flown, taught));
        }
        for k in 0..all.len() {
            let others: Vec<_> =
                all.iter().enumerate().filter(|(j, _)| *j != k).map(|(_, l)| l.clone()).collect();
            if let Some(again) = self.learn(&flights[k], together(&others, &self.setup)) {
                all[k] = again;
            }
        }
        all
    }

    fn single(&self, seen: &[Observation], taught: Option<FlightPrior>) -> Solution {
        adjust::spatial(&self.setup, &self.orientation, seen, &self.options(1, taught)).unwrap()
    }
}

fn together(lessons: &[ReducedNormals], setup: &Setup) -> Option<FlightPrior> {
    FlightPrior::of(&lessons.iter().collect::<Vec<_>>(), setup).unwrap()
}

/// The largest standard deviation of a deflection against survey, ground frame and root, m, if flights had told all that lasts
/// without error: what is left is the frame's own.
fn bound_m(drawn: &Drawn, of: &ReducedNormals, seen: &[Observation]) -> [f64; 3] {
    let n = of.unknowns.len();
    let held =
        ReducedNormals { normal: DMatrix::identity(n, n) * 1e14, right: DVector::zeros(n), ..of.clone() };
    // Nothing is tested: where the unknowns lie does not matter for what is left.
    let options = Options {
        snooping_alpha: 0.0,
        global_alpha: 0.0,
        ..drawn.options(1, together(&[held], &drawn.setup))
    };
    let solution = adjust::spatial(&drawn.setup, &drawn.orientation, seen, &options).unwrap();
    let mut shown = Shown::default();
    shown.add(&drawn.aircraft, drawn.now, &solution, &drawn.setup);
    shown.tip_sigmas_m.map(|sigmas| sigmas[0])
}

fn budgets(all: &[Solution]) -> Vec<(&'static str, f64)> {
    let mut sum: Vec<(&'static str, f64)> = vec![];
    for share in all.iter().filter_map(|s| s.budget.as_ref()).flat_map(|b| &b.shares) {
        match sum.iter_mut().find(|(source, _)| *source == share.source) {
            Some((_, total)) => *total += share.share / all.len() as f64,
            None => sum.push((share.source, share.share / all.len() as f64)),
        }
    }
    sum.sort_by(|a, b| b.1.total_cmp(&a.1));
    sum.into_iter().map(|(source, share)| (source, (100.0 * share).round())).filter(|s| s.1 > 0.0).collect()
}

fn said(name: &str, shown: &Shown) {
    println!(
        "{name}: deflections {:.2?}, twist {:.2}, moment {:.2}, sigmas of the tip {:.1?} mm, passed {:.0} %",
        shown.deflections.each_ref().map(|deflections| rms(deflections)),
        rms(&shown.twist),
        rms(&shown.moments),
        shown.tip_sigmas_m.each_ref().map(|sigmas| 1e3 * median(sigmas)),
        100.0 * shown.passed.iter().sum::<f64>() / shown.passed.len() as f64
    );
}

fn median_mm(sigmas_m: &[Vec<f64>; 3]) -> [f64; 3] {
    sigmas_m.each_ref().map(|sigmas| 1e3 * median(sigmas))
}

/// The markers of one wing err together: 0.6 to 1.4 is 0.7 to 1.3 with the spread of 24 wings, 1 / sqrt(2 x 24) of it.
#[test]
fn five_flights_narrow_a_single_frame_to_what_its_mounting_leaves() {
    let mut rng = rng(8200);
    let (mut alone, mut taught, mut bounds_m) =
        (Shown::default(), Shown::default(), <[Vec<f64>; 3]>::default());
    for _ in 0..24 {
        let mut drawn = Drawn::new(&mut rng, SetUp::Default);
        let flights: Vec<Flown> = (0..5).map(|_| drawn.flies(&mut rng, FRAMES)).collect();
        let lessons = drawn.lessons(&flights);
        assert_eq!(lessons.len(), 5);
        let last = &drawn.flies(&mut rng, 1).seen[0];
        let bound = bound_m(&drawn, &lessons[0], last);
        bounds_m.iter_mut().zip(bound).for_each(|(all, one)| all.push(one));
        for (shown, taught) in [(&mut alone, None), (&mut taught, together(&lessons, &drawn.setup))] {
            shown.add(&drawn.aircraft, drawn.now, &drawn.single(last, taught), &drawn.setup);
        }
    }
    said("alone", &alone);
    said("taught", &taught);
    let bounds_mm = median_mm(&bounds_m);
    println!("bound: {bounds_mm:.1?} mm");
    let (alone_mm, taught_mm) = (median_mm(&alone.tip_sigmas_m), median_mm(&taught.tip_sigmas_m));
    // Against ground frame and root; the survey's own bend stays with the first. The root's motion, which is each flight's own,
    // stays with the ground frame's.
    for (k, share) in [(1, 0.75), (2, 0.65)] {
        assert!(taught_mm[k] < share * alone_mm[k], "{taught_mm:?} of {alone_mm:?}");
        assert!(taught_mm[k] < 1.15 * bounds_mm[k], "{taught_mm:?} of {bounds_mm:?}");
    }
    for deflections in &taught.deflections {
        let ratio = rms(deflections);
        assert!((0.6..1.4).contains(&ratio), "{ratio}");
    }
    assert!(rms(&taught.twist) < 1.4 && rms(&taught.moments) < 1.4);
}

/// Rows by so much lower that the wing's ends are bent in the picture by some pixels, as a pane does.
fn through_other_panes(seen: &[Observation]) -> Vec<Observation> {
    let off = |o: &Observation| 12e-6 * (o.pixel.x - 2000.0).powi(2);
    let other = |o: &Observation| Observation { pixel: o.pixel + nalgebra::Vector2::new(0.0, off(o)), ..*o };
    seen.iter().map(other).collect()
}

/// The tenth marker of the survey some centimetres from where it was.
fn with_another_marker(seen: &[Observation]) -> Vec<Observation> {
    let moved =
        |o: &Observation| if o.marker == 9 { nalgebra::Vector2::new(3.0, 9.0) } else { nalgebra::zero() };
    seen.iter().map(|o| Observation { pixel: o.pixel + moved(o), ..*o }).collect()
}

fn says(solutions: &[Solution], words: &str) -> bool {
    solutions.iter().all(|s| s.remarks.iter().any(|remark| remark.contains(words)))
}

/// What earlier flights taught contradicts it, or the global test rejects.
fn is_noticed(solutions: &[Solution]) -> bool {
    says(solutions, "contradicts this") || solutions.iter().all(|s| s.global_test == GlobalTest::Rejected)
}

/// Of eight aircraft whose installation changed after three flights: single frames and flights.
#[test]
fn what_changed_since_flights_taught_is_noticed() {
    let (mut alone, mut together_seen, mut taught_nothing, mut replaced, mut falsely) = (0, 0, 0, 0, 0);
    for seed in 8300..8308 {
        let mut rng = rng(seed);
        let mut drawn = Drawn::new(&mut rng, SetUp::Default);
        let flights: Vec<Flown> = (0..3).map(|_| drawn.flies(&mut rng, FRAMES)).collect();
        let taught = together(&drawn.lessons(&flights), &drawn.setup).unwrap();
        let last = drawn.flies(&mut rng, FRAMES);
        let flight = |seen: &[Vec<Observation>]| {
            let options = drawn.options(FRAMES, Some(taught.clone()));
            adjust::flight(&drawn.setup, &drawn.orientation, seen, &options).unwrap()
        };
        let single = |seen: &[Observation]| [drawn.single(seen, Some(taught.clone()))];
        falsely += usize::from(is_noticed(&single(&last.seen[0])) || is_noticed(&flight(&last.seen)));
        let panes = Flown { seen: last.seen.iter().map(|seen| through_other_panes(seen)).collect() };
        alone += usize::from(is_noticed(&single(&panes.seen[0])));
        together_seen += usize::from(is_noticed(&flight(&panes.seen)));
        taught_nothing += usize::from(drawn.learn(&panes, Some(taught.clone())).is_none());
        let other: Vec<_> = last.seen.iter().map(|seen| with_another_marker(seen)).collect();
        let left_out = "marker M10 was left out";
        replaced += usize::from(says(&single(&other[0]), left_out) && says(&flight(&other), left_out));
    }
    println!(
        "other panes: noticed in {alone} frames, {together_seen} flights of 8, {taught_nothing} taught nothing; another marker: \
         {replaced} of 8; nothing changed: {falsely}"
    );
    assert!(
        alone >= 6 && together_seen >= 7 && taught_nothing >= 7,
        "{alone} {together_seen} {taught_nothing}"
    );
    assert!(replaced == 8 && falsely == 0, "{replaced} {falsely}");
}

#[test]
fn live_mode_begins_with_what_flights_taught() {
    let mut rng = rng(8400);
    let mut drawn = Drawn::new(&mut rng, SetUp::Default);
    let flights: Vec<Flown> = (0..3).map(|_| drawn.flies(&mut rng, FRAMES)).collect();
    let taught = together(&drawn.lessons(&flights), &drawn.setup);
    let last = drawn.flies(&mut rng, FRAMES);
    let tip = |taught: Option<FlightPrior>| -> Vec<f64> {
        let options = drawn.options(1, taught);
        let mut live = Live::begin(drawn.setup.clone(), drawn.orientation.clone(), options).unwrap();
        let sigma = |seen: &Vec<Observation>| {
            let solution = live.frame(seen, 10.0).unwrap();
            solution.markers.iter().filter_map(|m| m.deflection_root_m?.sigma).fold(0.0, f64::max)
        };
        last.seen.iter().map(sigma).collect()
    };
    let (alone, beside) = (tip(None), tip(taught));
    println!("live, sigma of the tip: {alone:.4?} alone, {beside:.4?} beside");
    assert!(beside[0] < 0.75 * alone[0] && beside[4] < alone[4]);
}

/// `WINGS=40 SEED=1 SET_UP=Default` to taste.
#[test]
#[ignore = "a minute; the table of docs/adjustment/learning.md"]
fn table_of_what_flights_teach() {
    let word = |name: &str| std::env::var(name).unwrap_or_default();
    let number = |name: &str, usual: usize| word(name).parse().unwrap_or(usual);
    let wanted = word("SET_UP");
    for set_up in
        crate::aircraft::SET_UPS.into_iter().filter(|s| wanted.is_empty() || format!("{s:?}") == wanted)
    {
        let mut rng = rng(number("SEED", 8100) as u64);
        let mut shown: [Shown; 5] = Default::default();
        let mut solved: [Vec<Solution>; 5] = Default::default();
        let mut bounds_m: [Vec<f64>; 3] = Default::default();
        let mut refused = 0;
        for _ in 0..number("WINGS", 40) {
            let mut drawn = Drawn::new(&mut rng, set_up);
            let flights: Vec<Flown> = (0..5).map(|_| drawn.flies(&mut rng, FRAMES)).collect();
            let lessons = drawn.lessons(&flights);
            refused += 5 - lessons.len();
            let last = drawn.flies(&mut rng, 1);
            let of = |n: usize| together(&lessons[..n.min(lessons.len())], &drawn.setup);
            let taught = [None, of(1), of(2), of(3), of(5)];
            let bound = bound_m(&drawn, &lessons[0], &last.seen[0]);
            bounds_m.iter_mut().zip(bound).for_each(|(all, one)| all.push(one));
            for (k, taught) in taught.into_iter().enumerate() {
                let solution = drawn.single(&last.seen[0], taught);
                shown[k].add(&drawn.aircraft, drawn.now, &solution, &drawn.setup);
                solved[k].push(solution);
            }
        }
        println!("{set_up:?}, {refused} flights taught nothing");
        for (k, name) in ["alone", "1 flight", "2", "3", "5"].iter().enumerate() {
            said(name, &shown[k]);
            let doubted =
                solved[k].iter().filter(|s| s.remarks.iter().any(|r| r.contains("contradicts"))).count();
            let out = solved[k].iter().filter(|s| s.remarks.iter().any(|r| r.contains("left out"))).count();
            println!("    {:?}, contradicted {doubted}, with markers left out {out}", budgets(&solved[k]));
        }
        println!("bound: {:.1?} mm", bounds_m.map(|all| 1e3 * median(&all)));
    }
}
