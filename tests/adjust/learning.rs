//! Promise: the prior from several flights reduces the sigma of a later single frame to the contribution of its mounting; errors
//! are consistent with sigma, no flight counts twice, and changes of the installation are detected.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector, Vector3};
use rand::Rng;
use rand::rngs::StdRng;
use wingd::measure::adjust::flight_prior::{FlightPrior, ReducedNormals};
use wingd::measure::adjust::{
    self, GlobalTest, LiveAdjustment, Mounting, Observation, Options, Solution,
};
use wingd::measure::setup::{Orientation, Setup, Width};

use crate::aircraft::{EffectErrors, NOISE_PX, SURVEY_M, SetUp, combined_effects, set_widths};
use crate::common::beam_truth::{Aircraft, Structure, WingState, median, normal3, rms, rng};

pub const FRAMES: usize = 5;

/// An aircraft with its installation.
pub struct SampledAircraft {
    pub aircraft: Aircraft,
    pub setup: Setup,
    orientation: Orientation,
    set_up: SetUp,
    /// Mounting of the last frame.
    pub now: WingState,
}

/// Difference of a flight from the others of an installation.
#[derive(Clone, Copy, Debug, Default)]
pub struct Difference {
    /// Relative increase of the load.
    pub load: f64,
    /// Torque of the ailerons in addition, as the twist at their place, rad.
    pub torque_rad: f64,
    /// Shift of the camera to another seat, m.
    pub seat_m: f64,
}

/// Observations of one flight.
pub struct SampledFlight {
    pub seen: Vec<Vec<Observation>>,
}

impl SampledAircraft {
    pub fn new(rng: &mut StdRng, set_up: SetUp) -> Self {
        let effects = combined_effects(rng);
        let truth = set_up.truth(rng, Structure::default());
        let aircraft = Aircraft::new(rng, truth, effects);
        let mut setup = aircraft.surveyed(rng, SURVEY_M);
        setup.uncertainty = set_up.priors(setup.reach_m());
        set_widths(&mut setup);
        let orientation = aircraft.orientation(rng, NOISE_PX);
        Self {
            aircraft,
            setup,
            orientation,
            set_up,
            now: WingState::Survey,
        }
    }

    /// Samples a flight with new fuel, deflection, mounting and other flight-specific effects.
    pub fn sample_flight(&mut self, rng: &mut StdRng, frames: usize) -> SampledFlight {
        self.sample_other_flight(rng, frames, &Difference::default())
    }

    /// Samples a flight that differs from the others.
    pub fn sample_other_flight(
        &mut self,
        rng: &mut StdRng,
        frames: usize,
        other: &Difference,
    ) -> SampledFlight {
        let effects = combined_effects(rng);
        self.aircraft.start_next_flight(rng, effects);
        self.aircraft.effects.torque_rad += other.torque_rad;
        let (mount, shift) = self.set_up.mounting(rng, &self.setup);
        let shift = shift
            + if other.seat_m > 0.0 {
                normal3(rng).normalize() * other.seat_m
            } else {
                Vector3::zeros()
            };
        let fuel = self.aircraft.truth.fuel() * rng.random_range(0.7..1.0);
        let heavy = rng.random_range(0.9..1.1) * (1.0 + other.load);
        let when = |k: usize| {
            let share = k as f64 / (FRAMES - 1) as f64;
            WingState::Flight {
                deflection_m: heavy * (3.2 - 1.2 * share),
                fuel: fuel * (1.0 - 0.24 * share),
            }
        };
        let first = if frames == 1 {
            rng.random_range(0..FRAMES)
        } else {
            0
        };
        let whens: Vec<WingState> = (first..first + frames).map(when).collect();
        let frame = |rng: &mut StdRng, when: &WingState| {
            let drift = normal3(rng) * self.setup.uncertainty[Width::MountDrift];
            self.aircraft
                .frame(rng, *when, (mount + drift, shift), NOISE_PX)
        };
        let seen = whens.iter().map(|when| frame(rng, when)).collect();
        self.now = whens[whens.len() - 1];
        SampledFlight { seen }
    }

    fn options(&self, frames: usize, prior: Option<FlightPrior>) -> Options {
        let mounting = if self.set_up == SetUp::Stayed {
            Mounting::Ground
        } else {
            Mounting::Numbered(0)
        };
        let prior = prior.map(Arc::new);
        Options {
            mountings: Some(vec![mounting; frames]),
            flight_prior: prior,
            ..Options::default()
        }
    }

    fn learn(&self, flown: &SampledFlight, prior: Option<FlightPrior>) -> Option<ReducedNormals> {
        let options = self.options(flown.seen.len(), prior);
        adjust::learn_from_flight(&self.setup, &self.orientation, &flown.seen, &options)
            .ok()
            .map(|flight| flight.normals)
    }

    /// Reduced normal equations of each flight, linearised at the joint solution of the others, as `wingd learn` does.
    pub fn flight_normals(&self, flights: &[SampledFlight]) -> Vec<ReducedNormals> {
        let mut all: Vec<ReducedNormals> = vec![];
        for flown in flights {
            let prior = combine_flights(&all, &self.setup);
            all.extend(self.learn(flown, prior));
        }
        for k in 0..all.len() {
            let others: Vec<_> = all
                .iter()
                .enumerate()
                .filter(|(j, _)| *j != k)
                .map(|(_, l)| l.clone())
                .collect();
            if let Some(again) = self.learn(&flights[k], combine_flights(&others, &self.setup)) {
                all[k] = again;
            }
        }
        all
    }

    pub fn solve_flight(
        &self,
        seen: &[Vec<Observation>],
        prior: Option<FlightPrior>,
    ) -> Vec<Solution> {
        let options = self.options(seen.len(), prior);
        adjust::solve_flight(&self.setup, &self.orientation, seen, &options).unwrap()
    }

    pub fn solve_single_frame(&self, seen: &[Observation], prior: Option<FlightPrior>) -> Solution {
        adjust::solve_spatial(
            &self.setup,
            &self.orientation,
            seen,
            &self.options(1, prior),
        )
        .unwrap()
    }
}

pub fn combine_flights(
    normals_of_flights: &[ReducedNormals],
    setup: &Setup,
) -> Option<FlightPrior> {
    FlightPrior::from_flights(&normals_of_flights.iter().collect::<Vec<_>>(), setup).unwrap()
}

/// Largest deflection sigma relative to survey, ground frame and root, m, if all flight-invariant parameters were known: the
/// remaining uncertainty is specific to the frame.
pub fn bound_m(drawn: &SampledAircraft, of: &ReducedNormals, seen: &[Observation]) -> [f64; 3] {
    let n = of.unknowns.len();
    let held = ReducedNormals {
        normal: DMatrix::identity(n, n) * 1e14,
        right: DVector::zeros(n),
        ..of.clone()
    };
    // Nothing is tested: the remaining variance does not depend on the values of the unknowns.
    let options = Options {
        snooping_alpha: 0.0,
        global_alpha: 0.0,
        ..drawn.options(1, combine_flights(&[held], &drawn.setup))
    };
    let solution = adjust::solve_spatial(&drawn.setup, &drawn.orientation, seen, &options).unwrap();
    let mut shown = EffectErrors::default();
    shown.add(&drawn.aircraft, drawn.now, &solution, &drawn.setup);
    shown.tip_sigmas_m.map(|sigmas| sigmas[0])
}

pub fn print_errors(name: &str, shown: &EffectErrors) {
    println!(
        "{name}: deflections {:.2?}, twist {:.2}, moment {:.2}, sigmas of the tip {:.1?} mm, passed {:.0} %",
        shown
            .deflections
            .each_ref()
            .map(|deflections| rms(deflections)),
        rms(&shown.twist),
        rms(&shown.moments),
        shown
            .tip_sigmas_m
            .each_ref()
            .map(|sigmas| 1e3 * median(sigmas)),
        100.0 * shown.passed.iter().sum::<f64>() / shown.passed.len() as f64
    );
}

fn median_mm(sigmas_m: &[Vec<f64>; 3]) -> [f64; 3] {
    sigmas_m.each_ref().map(|sigmas| 1e3 * median(sigmas))
}

/// Errors of the markers of one wing are correlated: 0.6 to 1.4 is 0.7 to 1.3 plus the scatter of 24 wings, 1 / sqrt(2 x 24).
#[test]
fn five_flights_reduce_a_single_frames_sigma_to_that_of_its_mounting() {
    let mut rng = rng(8200);
    let (mut alone, mut prior, mut bounds_m) = (
        EffectErrors::default(),
        EffectErrors::default(),
        <[Vec<f64>; 3]>::default(),
    );
    let mut refused = 0;
    for _ in 0..24 {
        let mut drawn = SampledAircraft::new(&mut rng, SetUp::Default);
        let flights: Vec<SampledFlight> = (0..5)
            .map(|_| drawn.sample_flight(&mut rng, FRAMES))
            .collect();
        let normals_of_flights = drawn.flight_normals(&flights);
        refused += 5 - normals_of_flights.len();
        let last = &drawn.sample_flight(&mut rng, 1).seen[0];
        let bound = bound_m(&drawn, &normals_of_flights[0], last);
        bounds_m
            .iter_mut()
            .zip(bound)
            .for_each(|(all, one)| all.push(one));
        for (shown, prior) in [
            (&mut alone, None),
            (
                &mut prior,
                combine_flights(&normals_of_flights, &drawn.setup),
            ),
        ] {
            shown.add(
                &drawn.aircraft,
                drawn.now,
                &drawn.solve_single_frame(last, prior),
                &drawn.setup,
            );
        }
    }
    print_errors("alone", &alone);
    print_errors("with the prior", &prior);
    // A dozen widths are tested at 1e-3 in each flight: more than four of 120 in one run of 40.
    println!("flights refused: {refused} of 120");
    assert!(refused <= 4, "{refused}");
    let bounds_mm = median_mm(&bounds_m);
    println!("bound: {bounds_mm:.1?} mm");
    let (alone_mm, prior_mm) = (
        median_mm(&alone.tip_sigmas_m),
        median_mm(&prior.tip_sigmas_m),
    );
    // Relative to ground frame and root; the survey's bending remains in the first. The root motion, different in each flight,
    // remains in that relative to the ground frame.
    for (k, share) in [(1, 0.75), (2, 0.65)] {
        assert!(
            prior_mm[k] < share * alone_mm[k],
            "{prior_mm:?} of {alone_mm:?}"
        );
        assert!(
            prior_mm[k] < 1.15 * bounds_mm[k],
            "{prior_mm:?} of {bounds_mm:?}"
        );
    }
    for deflections in &prior.deflections {
        let ratio = rms(deflections);
        assert!((0.6..1.4).contains(&ratio), "{ratio}");
    }
    assert!(rms(&prior.twist) < 1.4 && rms(&prior.moments) < 1.4);
}

/// Lowers rows so that the wing's ends are bent by some pixels in the image, as a pane does.
fn through_other_panes(seen: &[Observation]) -> Vec<Observation> {
    let off = |o: &Observation| 12e-6 * (o.pixel.x - 2000.0).powi(2);
    let other = |o: &Observation| Observation {
        pixel: o.pixel + nalgebra::Vector2::new(0.0, off(o)),
        ..*o
    };
    seen.iter().map(other).collect()
}

/// Displaces the tenth marker by some centimetres.
fn with_another_marker(seen: &[Observation]) -> Vec<Observation> {
    let moved = |o: &Observation| {
        if o.marker == 9 {
            nalgebra::Vector2::new(3.0, 9.0)
        } else {
            nalgebra::zero()
        }
    };
    seen.iter()
        .map(|o| Observation {
            pixel: o.pixel + moved(o),
            ..*o
        })
        .collect()
}

fn have_remark(solutions: &[Solution], words: &str) -> bool {
    solutions
        .iter()
        .all(|s| s.remarks.iter().any(|remark| remark.contains(words)))
}

/// Whether the flight prior or a stated width is contradicted or the global test rejects.
fn is_noticed(solutions: &[Solution]) -> bool {
    let is_contradicted = ["is inconsistent", "is contradicted"]
        .iter()
        .any(|words| have_remark(solutions, words));
    is_contradicted
        || solutions
            .iter()
            .all(|s| s.global_test == Some(GlobalTest::Rejected))
}

/// Counts single frames and flights of eight aircraft whose installation changed after three flights.
#[test]
fn changes_since_the_flights_of_the_prior_are_noticed() {
    let (mut alone, mut together_seen, mut contributed_nothing, mut replaced, mut falsely) =
        (0, 0, 0, 0, 0);
    for seed in 8300..8308 {
        let mut rng = rng(seed);
        let mut drawn = SampledAircraft::new(&mut rng, SetUp::Default);
        let flights: Vec<SampledFlight> = (0..3)
            .map(|_| drawn.sample_flight(&mut rng, FRAMES))
            .collect();
        let prior = combine_flights(&drawn.flight_normals(&flights), &drawn.setup).unwrap();
        let last = drawn.sample_flight(&mut rng, FRAMES);
        let flight = |seen: &[Vec<Observation>]| drawn.solve_flight(seen, Some(prior.clone()));
        let single = |seen: &[Observation]| [drawn.solve_single_frame(seen, Some(prior.clone()))];
        falsely +=
            usize::from(is_noticed(&single(&last.seen[0])) || is_noticed(&flight(&last.seen)));
        let panes = SampledFlight {
            seen: last
                .seen
                .iter()
                .map(|seen| through_other_panes(seen))
                .collect(),
        };
        alone += usize::from(is_noticed(&single(&panes.seen[0])));
        together_seen += usize::from(is_noticed(&flight(&panes.seen)));
        contributed_nothing += usize::from(drawn.learn(&panes, Some(prior.clone())).is_none());
        let other: Vec<_> = last
            .seen
            .iter()
            .map(|seen| with_another_marker(seen))
            .collect();
        let left_out = "marker M10 was removed";
        replaced += usize::from(
            have_remark(&single(&other[0]), left_out) && have_remark(&flight(&other), left_out),
        );
    }
    println!(
        "other panes: noticed in {alone} frames, {together_seen} flights of 8, {contributed_nothing} prior nothing; another marker: \
         {replaced} of 8; nothing changed: {falsely}"
    );
    assert!(
        alone >= 6 && together_seen >= 7 && contributed_nothing >= 7,
        "{alone} {together_seen} {contributed_nothing}"
    );
    assert!(replaced == 8 && falsely == 0, "{replaced} {falsely}");
}

#[test]
fn live_mode_begins_with_the_flight_prior() {
    let mut rng = rng(8400);
    let mut drawn = SampledAircraft::new(&mut rng, SetUp::Default);
    let flights: Vec<SampledFlight> = (0..3)
        .map(|_| drawn.sample_flight(&mut rng, FRAMES))
        .collect();
    let prior = combine_flights(&drawn.flight_normals(&flights), &drawn.setup);
    let last = drawn.sample_flight(&mut rng, FRAMES);
    let tip = |prior: Option<FlightPrior>| -> Vec<f64> {
        let options = drawn.options(1, prior);
        let mut live =
            LiveAdjustment::new(drawn.setup.clone(), drawn.orientation.clone(), options).unwrap();
        let sigma = |seen: &Vec<Observation>| {
            let solution = live.adjust_frame(seen, 10.0).unwrap();
            solution
                .markers
                .iter()
                .filter_map(|m| m.deflection_root_m?.sigma)
                .fold(0.0, f64::max)
        };
        last.seen.iter().map(sigma).collect()
    };
    let (alone, with_prior) = (tip(None), tip(prior));
    println!("live, sigma of the tip: {alone:.4?} alone, {with_prior:.4?} with the prior");
    assert!(with_prior[0] < 0.75 * alone[0] && with_prior[4] < alone[4]);
}
