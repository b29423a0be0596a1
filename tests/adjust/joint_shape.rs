//! The joint covariance of stations, frames and flights compared with sampled errors. Wings, loads, sides, mountings, survey
//! and images are sampled again in every run.

use super::aircraft::{NOISE_PX, SURVEY_M, SetUp, combined_effects};
use crate::common::beam_truth::{
    Aircraft, Effects, Truth, WingState, normal, normal3, random_wing, remounted, rms, rng,
};
use crate::common::shape_difference::{CommonErrors, difference_from, minus};
use crate::common::statistics::{draws, honest_range};
use nalgebra::{DMatrix, DVector, Rotation2, SymmetricEigen, Vector3};
use rand::Rng;
use rand::rngs::StdRng;
use wingd::measure::adjust::{
    self, FrameShape, JointShape, Observation, Options, SigmaKind, StationChoice,
};
use wingd::measure::setup::{Orientation, Setup, SetupUncertainty, SkinHeight, Width};

const STATIONS: [f64; 10] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0];
/// Smallest variance of a combination of standardised functions that is tested: below it the family of beams, which differs
/// from that of the truth, is no longer exact.
const MIN_MODE_VARIANCE: f64 = 1e-3;

/// Shift of the camera between two mountings and its rotation from frame to frame, standard deviations: drawn, and stated.
const SHIFT_M: f64 = 0.002;
const DRIFT_RAD: f64 = 1e-4;
/// Ratio of the drift in pitch, about the camera's X, to that about the other axes, as the adjustment takes it.
const PITCH_FACTOR: f64 = 1.3;

fn options() -> Options {
    Options {
        sigma: SigmaKind::Prior,
        snooping_alpha: 0.0,
        ..Options::default()
    }
}

fn stations() -> StationChoice {
    StationChoice::Fractions(STATIONS.to_vec())
}

/// One wing with its installation.
struct Drawn {
    truth: Truth,
    setup: Setup,
    orientation: Orientation,
}

/// Frames of one flight, with their tip deflections (m) and fuel.
struct DrawnFlight {
    loads: Vec<(f64, f64)>,
    frames: Vec<Vec<Observation>>,
}

impl Drawn {
    fn new(rng: &mut StdRng) -> Self {
        let truth = Truth::new(random_wing(rng), 21);
        let mut setup = truth.surveyed(rng, 0.002, 0.002);
        setup.uncertainty = setup
            .uncertainty
            .with_width(Width::MountShift, SHIFT_M)
            .with_width(Width::MountDrift, DRIFT_RAD);
        let orientation = truth.orientation(rng, 0.05, true);
        Self {
            truth,
            setup,
            orientation,
        }
    }

    fn fly(&self, rng: &mut StdRng, frames: usize) -> DrawnFlight {
        let mount = remounted(rng, &self.truth.setup);
        let shift_m = normal3(rng) * SHIFT_M;
        // Flights begin with different fuel and weight; the deflection falls as fuel is burnt.
        let (tanked, tip_m, drop_m) = (
            rng.random_range(0.15..0.4),
            rng.random_range(2.4..3.2),
            rng.random_range(0.6..1.2),
        );
        let load = |k: usize| {
            let burnt = k as f64 / frames.max(2) as f64;
            (tip_m - drop_m * burnt, tanked * (1.0 - burnt))
        };
        let loads: Vec<(f64, f64)> = (0..frames).map(load).collect();
        let observe = |&(tip_m, fuel): &(f64, f64)| {
            let seen_from = |p: &Vector3<f64>| p - shift_m;
            let points: Vec<_> = self
                .truth
                .positions_in_flight(tip_m, fuel)
                .iter()
                .map(seen_from)
                .collect();
            let mount = mount
                + normal3(rng).component_mul(&Vector3::new(PITCH_FACTOR, 1.0, 1.0)) * DRIFT_RAD;
            self.truth.observations(rng, &points, mount, 0.05)
        };
        DrawnFlight {
            frames: loads.iter().map(observe).collect(),
            loads,
        }
    }

    fn joint_shape(&self, flight: &DrawnFlight) -> JointShape {
        adjust::solve_flight_shape(
            &self.setup,
            &self.orientation,
            &flight.frames,
            &options(),
            &stations(),
        )
        .unwrap()
    }

    /// Errors of displacement, slope and twist of all stations, and their indices among the functions.
    fn errors(
        &self,
        shape: &JointShape,
        frame: &FrameShape,
        (tip_m, fuel): (f64, f64),
    ) -> (DVector<f64>, Vec<usize>) {
        let etas: Vec<f64> = shape
            .arcs_m
            .iter()
            .map(|arc_m| arc_m / self.truth.length_m())
            .collect();
        let (mut errors, mut rows) = (vec![], vec![]);
        for (s, (moved, slope, twist)) in self
            .truth
            .section_motions(&etas, tip_m, fuel)
            .into_iter()
            .enumerate()
        {
            for (f, truth) in [(2, moved.z), (3, slope), (4, twist)] {
                rows.push(shape.station_function(f, s));
                errors.push(frame.values[shape.station_function(f, s)] - truth);
            }
        }
        (errors.into(), rows)
    }
}

/// Fraction of the stiffness that a wrong computation has in excess outboard of 60 % of the length.
const STIFFNESS_EXCESS: f64 = 0.2;
const STIFF_FROM: f64 = 0.6;

impl Drawn {
    /// Displacement, slope and twist of the stations by a computation that is right, or too stiff outboard.
    fn computation(
        &self,
        shape: &JointShape,
        (tip_m, fuel): (f64, f64),
        is_stiff: bool,
    ) -> DVector<f64> {
        let count = 400;
        let etas: Vec<f64> = (0..=count)
            .map(|k| f64::from(k) / f64::from(count))
            .collect();
        let motions = self.truth.section_motions(&etas, tip_m, fuel);
        let bend = motions[(STIFF_FROM * f64::from(count)) as usize].1;
        let missing = |k: usize| match is_stiff && etas[k] > STIFF_FROM {
            true => (motions[k].1 - bend) * STIFFNESS_EXCESS / (1.0 + STIFFNESS_EXCESS),
            false => 0.0,
        };
        let mut predicted = DVector::from_element(shape.marker_function(0), f64::NAN);
        for (s, arc_m) in shape.arcs_m.iter().enumerate() {
            let k = (arc_m / self.truth.length_m() * f64::from(count)).round() as usize;
            let step_m = self.truth.length_m() / f64::from(count);
            let lower_m: f64 = (0..k).map(|k| missing(k) * step_m).sum();
            let (moved, slope, twist) = motions[k];
            for (f, value) in [(2, moved.z - lower_m), (3, slope - missing(k)), (4, twist)] {
                predicted[shape.station_function(f, s)] = value;
            }
        }
        predicted
    }

    /// Probabilities of the test against a right computation and against one that is too stiff outboard.
    fn tested(&self, shape: &JointShape, frame: usize, load: (f64, f64)) -> [f64; 2] {
        [false, true].map(|is_stiff| {
            let predicted = self.computation(shape, load, is_stiff);
            let mean = shape.mean(&[frame]);
            let functions: Vec<usize> = (0..predicted.len())
                .filter(|k| !predicted[*k].is_nan())
                .collect();
            difference_from(&mean, &predicted).probability(&functions)
        })
    }
}

/// Fractions of the tests that reject at 5 %.
fn rejection_rates(tests: &[[f64; 2]]) -> [f64; 2] {
    [0, 1].map(|k| tests.iter().filter(|p| p[k] < 0.05).count() as f64 / tests.len() as f64)
}

/// Chi-square over degrees of freedom of errors with this factor of their covariance, over the combinations that it has.
fn chi_square(errors: &DVector<f64>, factor: &DMatrix<f64>) -> (f64, usize) {
    let sigmas = DVector::from_iterator(factor.nrows(), factor.row_iter().map(|row| row.norm()));
    let scaled = DMatrix::from_fn(factor.nrows(), factor.ncols(), |i, j| {
        factor[(i, j)] / sigmas[i]
    });
    let SymmetricEigen {
        eigenvectors,
        eigenvalues,
    } = SymmetricEigen::new(&scaled * scaled.transpose());
    let along = eigenvectors.tr_mul(&errors.component_div(&sigmas));
    let modes = (0..eigenvalues.len()).filter(|k| eigenvalues[*k] > MIN_MODE_VARIANCE);
    modes.fold((0.0, 0), |(sum, count), k| {
        (sum + along[k].powi(2) / eigenvalues[k], count + 1)
    })
}

/// Factor of the joint covariance of several frames of one flight (rows of the frames one below the other).
fn joint_factor(frames: &[FrameShape], rows: &[usize]) -> DMatrix<f64> {
    let common = frames[0].factors[0].ncols() + frames[0].factors[1].ncols();
    let own: usize = frames.iter().map(|f| f.factors[2].ncols()).sum();
    let mut factor = DMatrix::zeros(frames.len() * rows.len(), common + own);
    let mut column = common;
    for (k, frame) in frames.iter().enumerate() {
        let (first, lasting) = (k * rows.len(), frame.factors[0].ncols());
        for (part, at) in [
            (&frame.factors[0], 0),
            (&frame.factors[1], lasting),
            (&frame.factors[2], column),
        ] {
            factor
                .view_mut((first, at), (rows.len(), part.ncols()))
                .copy_from(&part.select_rows(rows));
        }
        column += frame.factors[2].ncols();
    }
    factor
}

#[test]
fn the_shape_of_a_single_frame_has_an_honest_joint_covariance() {
    let mut rng = rng(401);
    let (mut sum, mut modes) = (0.0, 0);
    let (mut of_each, mut tests) = (vec![], vec![]);
    for _ in 0..500 {
        let drawn = Drawn::new(&mut rng);
        let flight = drawn.fly(&mut rng, 1);
        let shape = adjust::solve_frame_shape(
            &drawn.setup,
            &drawn.orientation,
            &flight.frames[0],
            &options(),
            &stations(),
        )
        .unwrap();
        let frame = &shape.frames[0];
        tests.push(drawn.tested(&shape, 0, flight.loads[0]));
        let (errors, rows) = drawn.errors(&shape, frame, flight.loads[0]);
        let sigmas = frame.sigmas();
        of_each.extend(errors.iter().zip(&rows).map(|(e, row)| e / sigmas[*row]));
        let (chi2, count) = chi_square(&errors, &frame.factors[2].select_rows(&rows));
        sum += chi2;
        modes += count;
    }
    let normalised = sum / modes as f64;
    println!(
        "single: chi-square per combination {normalised:.2} ({modes}), each function {:.2}",
        rms(&of_each)
    );
    assert!((0.8..1.2).contains(&normalised), "{normalised}");
    let [right, stiff] = rejection_rates(&tests);
    println!(
        "single: rejected at 5 %: a right computation {:.1} %, a stiff one {:.1} %",
        1e2 * right,
        1e2 * stiff
    );
    assert!(
        (0.01..0.065).contains(&right) && stiff > 0.95,
        "{right} {stiff}"
    );
}

#[test]
fn the_shapes_of_a_flight_have_an_honest_joint_covariance() {
    let mut rng = rng(402);
    let (mut sum, mut modes) = (0.0, 0);
    let mut tests = vec![];
    for _ in 0..100 {
        let drawn = Drawn::new(&mut rng);
        let flights = [drawn.fly(&mut rng, 5), drawn.fly(&mut rng, 5)];
        let shapes = flights.each_ref().map(|flight| drawn.joint_shape(flight));
        for (shape, flight) in shapes.iter().zip(&flights) {
            let of_frames: Vec<_> = (0..5)
                .map(|k| drawn.errors(shape, &shape.frames[k], flight.loads[k]))
                .collect();
            let errors: Vec<f64> = of_frames
                .iter()
                .flat_map(|(errors, _)| errors.iter().copied())
                .collect();
            let (chi2, count) = chi_square(
                &errors.into(),
                &joint_factor(&shape.frames, &of_frames[0].1),
            );
            sum += chi2;
            modes += count;
            tests.push(drawn.tested(shape, 2, flight.loads[2]));
        }
    }
    let normalised = sum / modes as f64;
    println!("flight: chi-square per combination {normalised:.2} ({modes})");
    assert!((0.8..1.2).contains(&normalised), "{normalised}");
    let [right, stiff] = rejection_rates(&tests);
    println!(
        "flight: rejected at 5 %: a right computation {:.1} %, a stiff one {:.1} %",
        1e2 * right,
        1e2 * stiff
    );
    assert!(
        (0.01..0.065).contains(&right) && stiff > 0.95,
        "{right} {stiff}"
    );
}

/// Errors of the deflections of wing markers in the frames of a flight.
struct FlightErrors {
    shape: JointShape,
    /// For each frame and marker, m.
    errors_m: Vec<Vec<f64>>,
}

/// Aircraft with all effects of flight, dimensions of the drawings and shape of bending drawn from their priors.
struct DrawnAircraft {
    aircraft: Aircraft,
    setup: Setup,
    orientation: Orientation,
}

impl DrawnAircraft {
    fn new(rng: &mut StdRng) -> Self {
        let (truth, effects) = (Truth::new(random_wing(rng), 21), Self::effects(rng));
        let aircraft = Aircraft::new(rng, truth, effects);
        let mut setup = aircraft.surveyed(rng, SURVEY_M);
        setup.uncertainty = SetupUncertainty::DEFAULT;
        let mut draw = |width: Width| setup.uncertainty[width] * normal(rng);
        let [axis, root, chord, direction] = [
            Width::SkinHeight,
            Width::RootOffset,
            Width::ChordOffset,
            Width::SpanDirection,
        ]
        .map(&mut draw);
        let skin = setup.skin_height.unwrap();
        setup.skin_height = Some(SkinHeight {
            root_m: skin.root_m + axis,
            tip_m: skin.tip_m + axis,
            ..skin
        });
        setup.root_offset_m += root;
        setup.axis_chord_offset_m = setup.axis_chord_offset_m.map(|offset| offset + chord);
        setup.span_direction = Rotation2::new(direction) * setup.span_direction;
        let orientation = aircraft.orientation(rng, NOISE_PX);
        Self {
            aircraft,
            setup,
            orientation,
        }
    }

    fn effects(rng: &mut StdRng) -> Effects {
        let engine = normal(rng).abs() * ENGINE_RELIEF;
        Effects {
            step: normal(rng) * STIFFNESS_STEP,
            engine,
            ..combined_effects(rng)
        }
    }

    fn fly(&mut self, rng: &mut StdRng) -> FlightErrors {
        let effects = Effects {
            step: self.aircraft.effects.step,
            engine: self.aircraft.effects.engine,
            ..Self::effects(rng)
        };
        self.aircraft.start_next_flight(rng, effects);
        let (mount, shift) = SetUp::Default.mounting(rng, &self.setup);
        let (high_m, drop_m) = (rng.random_range(2.4..3.2), rng.random_range(0.6..1.2));
        let (fuel, burnt) = (self.aircraft.truth.fuel(), rng.random_range(0.2..0.9));
        let when = |k: usize| {
            let share = k as f64 / 4.0;
            WingState::Flight {
                deflection_m: high_m - drop_m * share,
                fuel: fuel * (1.0 - burnt * share),
            }
        };
        let whens: Vec<WingState> = (0..5).map(when).collect();
        let observe = |when: &WingState| {
            let drift = normal3(rng) * self.setup.uncertainty[Width::MountDrift];
            self.aircraft
                .frame(rng, *when, (mount + drift, shift), NOISE_PX)
        };
        let frames: Vec<_> = whens.iter().map(observe).collect();
        let shape = adjust::solve_flight_shape(
            &self.setup,
            &self.orientation,
            &frames,
            &options(),
            &stations(),
        )
        .unwrap();
        let survey = self.aircraft.points(WingState::Survey);
        let errors = |(when, frame): (&WingState, &FrameShape)| {
            let points = self.aircraft.points(*when);
            let error = |(k, m): (usize, &usize)| {
                frame.values[shape.marker_function(k) + 2] - (points[*m].z - survey[*m].z)
            };
            shape.markers.iter().enumerate().map(error).collect()
        };
        let errors_m = whens.iter().zip(&shape.frames).map(errors).collect();
        FlightErrors { shape, errors_m }
    }
}

/// Standard deviations of changes of the shape of bending beyond tapered beams: step of the stiffness, relief of the root
/// moment by an engine.
const STIFFNESS_STEP: f64 = 0.1;
const ENGINE_RELIEF: f64 = 0.1;

#[test]
fn differences_of_frames_and_of_flights_have_honest_standard_deviations() {
    let mut rng = rng(403);
    let (mut within, mut between) = (vec![], vec![]);
    for _ in 0..draws(40, 120) {
        let mut drawn = DrawnAircraft::new(&mut rng);
        let flights = [drawn.fly(&mut rng), drawn.fly(&mut rng)];
        let tip = flights[0].shape.markers.len() - 1;
        let row = flights[0].shape.marker_function(tip) + 2;
        let error = |(flight, frame): (usize, usize),
                     (other, second): (usize, usize),
                     common: CommonErrors| {
            let mean = |flight: usize, frame: usize| flights[flight].shape.mean(&[frame]);
            let sigma = minus(&mean(flight, frame), &mean(other, second), common).sigmas()[row];
            (flights[flight].errors_m[frame][tip] - flights[other].errors_m[second][tip]) / sigma
        };
        within.push(error((0, 0), (0, 1), CommonErrors::Flight));
        within.push(error((1, 0), (1, 4), CommonErrors::Flight));
        between.push(error((0, 0), (1, 0), CommonErrors::Installation));
    }
    let ratios = [&within, &between].map(|errors| {
        let few = honest_range(errors.len());
        (rms(errors), draws(few, 1.0 / 1.15..1.0 / 0.85))
    });
    println!(
        "differences, sampled over predicted: frames {:.2}, flights {:.2}",
        ratios[0].0, ratios[1].0
    );
    for (ratio, range) in ratios {
        assert!(range.contains(&ratio), "{ratio}");
    }
}

/// Wing swept by 28 degrees: rotation of the section that bends and twists it, against exact geometry.
#[test]
fn streamwise_twist_is_that_of_the_rotated_section() {
    let mut rng = rng(403);
    let mut drawn = Drawn::new(&mut rng);
    let frame = drawn.setup.wing_frame();
    let side = drawn.setup.side().unwrap();
    let aft = if side == wingd::measure::setup::WingSide::Right {
        1.0
    } else {
        -1.0
    };
    let sweep = 28f64.to_radians();
    let flow = frame.wing_from_survey.inverse() * Vector3::new(sweep.sin(), 0.0, aft * sweep.cos());
    drawn.setup.flow_direction = Some(flow.xy());
    let flight = drawn.fly(&mut rng, 1);
    let shape = adjust::solve_frame_shape(
        &drawn.setup,
        &drawn.orientation,
        &flight.frames[0],
        &options(),
        &stations(),
    )
    .unwrap();
    let values = &shape.frames[0].values;
    for s in 0..STATIONS.len() {
        let of = |f: usize| values[shape.station_function(f, s)];
        // To first order, the twist turns about the swept axis and the slope about the chord.
        let first_order = of(4) * sweep.cos() - of(3) * sweep.sin();
        let off = of(5) - first_order;
        println!(
            "{:.1}: slope {:.4} twist {:.4} streamwise {:.4} off {off:.5}",
            STATIONS[s],
            of(3),
            of(4),
            of(5)
        );
        assert!(off.abs() < 0.3 * of(3).abs().powi(2).max(1e-4), "{off}");
    }
}
