//! The frames of a flight adjusted together (docs/model.md).
//!
//! Shared: the markers on ground, camera and ground rotation, one rotation per mounting, the ratios
//! of the curvature's coefficients. Per frame, local to its group: coefficients of curvature and
//! twist. A frame's curvature may leave the shared shape by a share of its amplitude; that share is
//! found from the data. Frames leave the normal equations by their Schur complement, so the cost is
//! linear in their number.

use nalgebra::{DMatrix, DVector, Vector3};

use super::beam::MAX_TWIST_TERMS;
use super::gauss_helmert::{Block, Course, Fit, Group, GroupPoint, Linearised, Problem, solve_from};
use super::layout::{Layout, Place, Rows, Seen, Survey};
use super::model_error::image_covariance;
use super::outcome::{Member, Outcome};
use super::scene::Scene;
use super::snooping::{self, Suspect, Target};
use super::spatial::{self, Columns, Input, by_marker};
use super::{AdjustError, Estimate, Method, Observation, Options, Solution, quality};
use crate::measure::setup::{Orientation, Setup, Thermal};

/// Terms of the curvature.
const TERMS: usize = 8;
/// Fewest markers in one frame.
const FEWEST: usize = 4;
/// Bending below this counts as unbent, 1/m.
const SMALLEST_CURVATURE_PER_M: f64 = 2e-4;
/// Departure of a frame's shape from the shared one, over the usual spread of shapes: to begin with,
/// and bounds.
const DEPARTURE: f64 = 0.03;
const DEPARTURE_BOUNDS: (f64, f64) = (0.006, 1.0);
const DEPARTURE_ROUNDS: usize = 3;
/// Level of the test that finds a remounted camera between two frames.
const REMOUNT_ALPHA: f64 = 1e-4;
/// A mounting moves by less than this between two shots, rad (0.1 px at 8000 px).
const STEADY_RAD: f64 = 1.2e-5;
/// Rounds of data snooping, each removing at most one observation per frame.
const SNOOPING_ROUNDS: usize = 4;

const MISSING_RATIO: &str =
    "the shape of bending cannot be determined; markers along the whole span are needed";
const MISSING_MOUNT: &str =
    "the mounting's rotation cannot be determined; give camera.mount_repeatability_px";
const MISSING_GROUND: &str = "a marker on ground is not determined";

/// A solution and what data snooping took out of it: (group, suspect).
type Snooped = (Setting, Fit, Vec<(usize, Suspect)>);

/// Which mounting each frame belongs to; `None`: each frame has a rotation of its own.
type Mountings = Option<Vec<usize>>;

struct Flight<'a> {
    input: Input<'a>,
    frames: Vec<Vec<Option<&'a Observation>>>,
    /// Per frame and marker.
    used: Vec<Vec<bool>>,
    ground_used: Vec<bool>,
    amplitudes: Vec<f64>,
    departure: f64,
    mountings: Mountings,
}

/// A flight set up for the engine.
struct Setting {
    layouts: Vec<Layout>,
    members: Vec<Vec<Member>>,
    ground_members: Vec<Member>,
    problem: Problem,
    ratios: usize,
}

impl<'a> Flight<'a> {
    fn new(
        setup: &'a Setup,
        orientation: &'a Orientation,
        scene: &'a Scene,
        observations: &'a [Vec<Observation>],
        options: &'a Options,
    ) -> Result<Self, AdjustError> {
        let frames = observations.iter().map(|o| by_marker(setup, o)).collect::<Result<Vec<_>, _>>()?;
        for frame in &frames {
            let found = frame.iter().flatten().count();
            if found < FEWEST {
                return Err(AdjustError::TooFewMarkers { found, needed: FEWEST });
            }
        }
        let n = setup.markers.len();
        Ok(Self {
            input: Input { setup, orientation, scene, options, flight: vec![None; n] },
            used: vec![vec![true; n]; frames.len()],
            ground_used: vec![true; n],
            amplitudes: vec![0.005; frames.len()],
            frames,
            departure: DEPARTURE,
            mountings: None,
        })
    }

    fn setting(&self, from: Option<&Fit>) -> Setting {
        let mut columns = Columns::default();
        let terms = self.input.options.curvature_terms.map_or(TERMS, |t| t.clamp(2, TERMS));
        let twist_terms = self.input.options.twist_terms.min(MAX_TWIST_TERMS);
        let common = spatial::common(&self.input, &mut columns);
        let mut priors = common.priors;
        let ratios = columns.take(terms - 1, MISSING_RATIO);
        for k in 1..terms {
            priors.push(super::gauss_helmert::Prior::scalar(ratios + k - 1, 0.0, spatial::ratio_sigma(k)));
        }
        let own_mount = self.mountings.is_none();
        let count = self.mountings.as_ref().map_or(0, |m| m.iter().max().map_or(0, |m| m + 1));
        let mounts = columns.take(3 * count, MISSING_MOUNT);
        priors.extend((0..count).map(|m| spatial::mount_prior(&self.input, mounts + 3 * m)));
        let head = columns.missing.len();
        let markers = &self.input.setup.markers;
        let survey = columns.take(3 * markers.len(), MISSING_GROUND);
        let local = terms + twist_terms + if own_mount { 3 } else { 0 };
        let layout = |frame: usize| Layout {
            curvature: Place::Local(0),
            curvature_terms: terms,
            twist: Place::Local(terms),
            twist_terms,
            mount: match &self.mountings {
                None => Place::Local(terms + twist_terms),
                Some(list) => Place::Global(mounts + 3 * list[frame]),
            },
            ground: common.ground.map(Place::Global),
            centre: common.centre.map(Place::Global),
            scale: common.scale.map(Place::Global),
            axis: Place::Global(common.axis),
            nominal_scale: self.input.setup.thermal.as_ref().map_or(1.0, Thermal::scale),
            survey: Survey::Global(survey),
            head,
            local,
        };
        let layouts: Vec<Layout> = (0..self.frames.len()).map(layout).collect();
        let mut start = DVector::zeros(columns.missing.len());
        for (k, station) in self.input.scene.ground.stations.iter().enumerate() {
            start.rows_mut(survey + 3 * k, 3).copy_from(&station.surveyed_m);
        }
        if let Some(fit) = from {
            let (shared, tail) = (ratios + terms - 1, 3 * markers.len());
            start.rows_mut(0, shared).copy_from(&fit.global.rows(0, shared));
            start.rows_mut(survey, tail).copy_from(&fit.global.rows(fit.global.len() - tail, tail));
        }
        let mut groups = vec![];
        let mut members = vec![];
        for (frame, layout) in layouts.iter().enumerate() {
            let (group, list) = self.frame_group(frame, layout, from);
            groups.push(group);
            members.push(list);
        }
        let (ground, ground_members) = self.ground_group();
        groups.push(ground);
        let problem = Problem { start, missing: columns.missing, priors, groups };
        Setting { layouts, members, ground_members, problem, ratios }
    }

    /// One frame: the images, and last the tie of its curvature to the shared shape.
    fn frame_group(&self, frame: usize, layout: &Layout, from: Option<&Fit>) -> (Group, Vec<Member>) {
        let mut members = vec![];
        let mut blocks = vec![];
        for (marker, seen) in self.frames[frame].iter().enumerate() {
            if let Some(seen) = seen.filter(|_| self.used[frame][marker]) {
                members.push(Member { marker, flight: Some(0), ground: None });
                blocks.push(image_block(seen));
            }
        }
        let n = layout.curvature_terms;
        let spread = self.departure * self.amplitudes[frame];
        let sigma = DVector::from_fn(n - 1, |k, _| (spread * spatial::ratio_sigma(k + 1)).powi(2));
        blocks.push(Block { observed: DVector::zeros(n - 1), covariance: DMatrix::from_diagonal(&sigma) });
        let mut local = DVector::zeros(layout.local);
        if let Some(fit) = from {
            let old = &fit.groups[frame].local;
            for k in 0..local.len().min(old.len()) {
                local[k] = old[k];
            }
        }
        let mut priors: Vec<_> = spatial::twist_priors(n, layout.twist_terms).collect();
        if let Place::Local(first) = layout.mount {
            priors.push(spatial::mount_prior(&self.input, first));
        }
        (Group { local, priors, blocks }, members)
    }

    /// Survey and ground frame.
    fn ground_group(&self) -> (Group, Vec<Member>) {
        let mut members = vec![];
        let mut blocks = vec![];
        for (marker, surveyed) in self.input.setup.markers.iter().enumerate() {
            let sight = self.input.scene.ground_sights[marker].as_ref().filter(|_| self.ground_used[marker]);
            let station = self.input.scene.ground.stations[marker].surveyed_m;
            let mut observed = station.as_slice().to_vec();
            observed.extend(sight.iter().flat_map(|s| [s.pixel.x, s.pixel.y]));
            let mut covariance = DMatrix::identity(observed.len(), observed.len()) * surveyed.sigma_m.powi(2);
            if let Some(sight) = sight {
                covariance.fixed_view_mut::<2, 2>(3, 3).copy_from(&image_covariance(&sight.covariance_px2));
            }
            members.push(Member { marker, flight: None, ground: sight.map(|_| 3) });
            blocks.push(Block { observed: DVector::from_vec(observed), covariance });
        }
        (Group { local: DVector::zeros(0), priors: vec![], blocks }, members)
    }
}

fn image_block(seen: &Observation) -> Block {
    Block {
        observed: DVector::from_column_slice(seen.pixel.as_slice()),
        covariance: DMatrix::from_column_slice(2, 2, image_covariance(&seen.covariance_px2).as_slice()),
    }
}

impl Setting {
    fn linearise(&self, scene: &Scene, at: &GroupPoint) -> Result<Vec<Linearised>, AdjustError> {
        match self.layouts.get(at.group) {
            Some(layout) => self.frame(scene, layout, at),
            None => self.ground(scene, at),
        }
    }

    fn frame(&self, scene: &Scene, layout: &Layout, at: &GroupPoint) -> Result<Vec<Linearised>, AdjustError> {
        let values = layout.values(at.global, at.local);
        let sections = scene.grid.bend(&values.bending());
        let mut blocks = Vec::with_capacity(at.observed.len());
        for (member, observed) in self.members[at.group].iter().zip(at.observed) {
            let mut rows = Rows::new(layout, member.marker, 2, 2);
            let seen = Seen {
                marker: member.marker,
                section: &sections[member.marker],
                values: &values,
                ground_m: layout.on_ground(member.marker, at.global, observed),
                observed,
                observation: 0,
            };
            rows.flight(0, &seen, scene)?;
            blocks.push(rows.finish());
        }
        blocks.extend(at.observed.last().map(|departure| self.shape(layout, at, departure)));
        Ok(blocks)
    }

    /// c_k = r_k c_0 + departure.
    fn shape(&self, layout: &Layout, at: &GroupPoint, departure: &DVector<f64>) -> Linearised {
        let n = layout.curvature_terms - 1;
        let amplitude = at.local[0];
        let mut local = DMatrix::zeros(n, layout.local);
        for k in 0..n {
            local[(k, 0)] = -at.global[self.ratios + k];
            local[(k, k + 1)] = 1.0;
        }
        Linearised {
            misclosure: DVector::from_fn(n, |k, _| {
                at.local[k + 1] - at.global[self.ratios + k] * amplitude - departure[k]
            }),
            columns: (self.ratios..self.ratios + n).collect(),
            global: DMatrix::identity(n, n) * -amplitude,
            local,
            observations: -DMatrix::identity(n, n),
        }
    }

    fn ground(&self, scene: &Scene, at: &GroupPoint) -> Result<Vec<Linearised>, AdjustError> {
        let Some(frame) = self.layouts.first() else { return Ok(vec![]) };
        // The ground frame knows neither bending nor mounting.
        let layout =
            Layout { local: 0, curvature_terms: 0, twist_terms: 0, mount: Place::Global(0), ..*frame };
        let values = layout.values(at.global, at.local);
        let flat = scene.grid.bend(&values.bending());
        let block = |(member, observed): (&Member, &DVector<f64>)| {
            let sights = member.ground.map_or(0, |_| 2);
            let mut rows = Rows::new(&layout, member.marker, 3 + sights, 3 + sights);
            let ground_m = layout.on_ground(member.marker, at.global, observed);
            rows.surveyed(0, &ground_m, observed);
            if let Some(observation) = member.ground {
                let (marker, section) = (member.marker, &flat[member.marker]);
                rows.ground(
                    3,
                    &Seen { marker, section, values: &values, ground_m, observed, observation },
                    scene,
                )?;
            }
            Ok(rows.finish())
        };
        self.ground_members.iter().zip(at.observed).map(block).collect()
    }

    fn solve(&self, scene: &Scene, course: &Course) -> Result<Fit, AdjustError> {
        solve_from(&self.problem, course, |at| self.linearise(scene, at))
    }
}

impl Flight<'_> {
    /// A rough solution, near enough for the decisions that follow from it.
    fn solve(&mut self, from: Option<&Fit>) -> Result<(Setting, Fit), AdjustError> {
        let setting = self.setting(from);
        let fit = setting.solve(self.input.scene, &Course { rough: true, residuals: from })?;
        for (amplitude, group) in self.amplitudes.iter_mut().zip(&fit.groups) {
            *amplitude = group.local[0].abs().max(SMALLEST_CURVATURE_PER_M);
        }
        Ok((setting, fit))
    }

    /// Sets the departure from the shared shape to what its own residuals show (Koch's estimate of
    /// one variance component).
    fn tune_departure(&mut self, mut last: (Setting, Fit)) -> Result<(Setting, Fit), AdjustError> {
        for _ in 0..DEPARTURE_ROUNDS {
            let (setting, fit) = &last;
            let (mut omega, mut redundancy) = (0.0, 0.0);
            for frame in 0..self.frames.len() {
                let block = setting.members[frame].len();
                let variance = setting.problem.groups[frame].blocks[block].covariance.diagonal();
                let adjusted = fit.adjusted_covariance(frame, block);
                for k in 0..variance.len() {
                    omega += fit.groups[frame].blocks[block].residuals[k].powi(2) / variance[k];
                    redundancy += 1.0 - adjusted[(k, k)] / variance[k];
                }
            }
            if redundancy < 0.5 {
                break;
            }
            let factor = (omega / redundancy).sqrt();
            let next = (self.departure * factor).clamp(DEPARTURE_BOUNDS.0, DEPARTURE_BOUNDS.1);
            let settled = (next / self.departure).ln().abs() < 0.3;
            self.departure = next;
            last = self.solve(Some(&last.1))?;
            if settled {
                break;
            }
        }
        Ok(last)
    }

    /// Splits the flight where the rotation changes by more than chance.
    fn find_mountings(&mut self, setting: &Setting, fit: &Fit) {
        let limit = chi_square_limit(3.0, REMOUNT_ALPHA);
        let mut list = vec![0];
        let mut first = 0;
        for frame in 1..self.frames.len() {
            if rotation_distance(setting, fit, first, frame) > limit {
                first = frame;
                list.push(list.last().map_or(0, |m| m + 1));
            } else {
                list.push(list.last().copied().unwrap_or(0));
            }
        }
        self.mountings = Some(list);
    }

    /// A wrong image leaves its frame, a wrong surveyed position takes its marker out everywhere.
    fn remove(&mut self, group: usize, suspect: &Suspect) {
        match self.used.get_mut(group) {
            Some(frame) => frame[suspect.marker] = false,
            None => self.ground_used[suspect.marker] = false,
        }
        if suspect.target == Target::Survey {
            self.used.iter_mut().for_each(|frame| frame[suspect.marker] = false);
        }
    }

    /// Removes at most one observation per frame and round; returns what was removed.
    fn snoop(&mut self, mut last: (Setting, Fit)) -> Result<Snooped, AdjustError> {
        let mut removed = vec![];
        let options = self.input.options;
        for _ in 0..SNOOPING_ROUNDS {
            let mut found = vec![];
            for (frame, members) in last.0.members.iter().enumerate() {
                let enough = members.len() > FEWEST + 1;
                let suspect = snooping::worst(&last.0.problem, &last.1, frame, members, options);
                found.extend(suspect.filter(|_| enough).map(|s| (frame, s)));
            }
            let ground = self.frames.len();
            let suspect = snooping::worst(&last.0.problem, &last.1, ground, &last.0.ground_members, options);
            found.extend(suspect.map(|s| (ground, s)));
            let most = found.iter().fold(0.0, |m: f64, (_, s)| m.max(s.w.abs()));
            // A blunder pulls at its neighbours in all frames: only the worst go at once.
            found.retain(|(_, s)| s.w.abs() > 0.7 * most);
            if found.is_empty() {
                break;
            }
            for (group, suspect) in &found {
                self.remove(*group, suspect);
            }
            removed.append(&mut found);
            last = self.solve(Some(&last.1))?;
        }
        Ok((last.0, last.1, removed))
    }
}

fn chi_square_limit(freedom: f64, alpha: f64) -> f64 {
    use statrs::distribution::{ChiSquared, ContinuousCDF};
    ChiSquared::new(freedom).map_or(f64::INFINITY, |law| law.inverse_cdf(1.0 - alpha))
}

/// Squared difference of two frames' rotations in its standard deviations.
fn rotation_distance(setting: &Setting, fit: &Fit, a: usize, b: usize) -> f64 {
    let part = |frame: usize| {
        let Place::Local(first) = setting.layouts[frame].mount else { return None };
        let mut gradient = super::gauss_helmert::Gradient {
            global: DMatrix::zeros(3, fit.global.len()),
            local: DMatrix::zeros(3, setting.layouts[frame].local),
            observed: vec![],
        };
        for k in 0..3 {
            gradient.local[(k, first + k)] = 1.0;
        }
        let value = fit.groups[frame].local.fixed_rows::<3>(first).into_owned();
        Some((fit.propagate(frame, &gradient), value))
    };
    let (Some((pa, va)), Some((pb, vb))) = (part(a), part(b)) else { return 0.0 };
    let total = &pa.total - &pb.total;
    let covariance = &total * &fit.covariance * total.transpose()
        + &pa.own
        + &pb.own
        + DMatrix::identity(3, 3) * STEADY_RAD.powi(2);
    let difference: Vector3<f64> = va - vb;
    let difference = DVector::from_column_slice(difference.as_slice());
    covariance.cholesky().map_or(0.0, |c| difference.dot(&c.solve(&difference)))
}

/// The rigid-section beam, all frames together; one solution per frame.
pub(super) fn solve(
    setup: &Setup,
    orientation: &Orientation,
    frames: &[Vec<Observation>],
    options: &Options,
) -> Result<Vec<Solution>, AdjustError> {
    if frames.is_empty() {
        return Ok(vec![]);
    }
    let scene = Scene::new(setup, orientation)?;
    let mut flight = Flight::new(setup, orientation, &scene, frames, options)?;
    let (_, first) = flight.solve(None)?;
    let last = flight.solve(Some(&first))?;
    let (setting, fit, removed) = flight.snoop(last)?;
    let (setting, fit) = flight.tune_departure((setting, fit))?;
    flight.find_mountings(&setting, &fit);
    let last = flight.solve(Some(&fit))?;
    let (_, rough) = flight.tune_departure(last)?;
    let setting = flight.setting(Some(&rough));
    let fit = setting.solve(&scene, &Course { rough: false, residuals: Some(&rough) })?;
    Ok(dress(&flight, &setting, &fit, &removed))
}

fn dress(flight: &Flight, setting: &Setting, fit: &Fit, removed: &[(usize, Suspect)]) -> Vec<Solution> {
    let (setup, options) = (flight.input.setup, flight.input.options);
    let test = quality::global_test(fit.omega, fit.redundancy, options.global_alpha);
    let posterior = quality::is_posterior(options.sigma, test);
    let factor = fit.variance_factor();
    let scale = if posterior { factor.map_or(1.0, f64::sqrt) } else { 1.0 };
    let one = |frame: usize| {
        let outcome = Outcome::new(
            setup,
            flight.input.scene,
            &setting.layouts[frame],
            &setting.problem,
            fit,
            frame,
            &setting.members[frame],
            options,
            scale,
        );
        let (curve, parabola, a) = outcome.curve();
        let (mut parameters, correlation, pitch) = outcome.parameters(&parabola, a);
        parameters.push(super::Parameter {
            name: "shape_departure",
            values: vec![Estimate { value: flight.departure, sigma: None }],
        });
        let mut markers = outcome.markers();
        let mut remarks = flight_remarks(flight, frame);
        let everywhere = |s: &Suspect| s.target == Target::Survey;
        for (_, suspect) in removed.iter().filter(|(group, s)| *group == frame || everywhere(s)) {
            let sentence = suspect.sentence(setup, options);
            markers[suspect.marker].reason = Some(sentence.clone());
            remarks.push(sentence);
        }
        Solution {
            method: Method::Flight,
            variance_factor: factor,
            redundancy: fit.redundancy,
            global_test: test,
            posterior,
            parameters,
            correlation,
            pitch_bending_correlation: pitch,
            markers,
            torsion: outcome.torsion(),
            curve,
            variance_components: vec![],
            remarks,
            iterations: fit.iterations,
        }
    };
    (0..flight.frames.len()).map(one).collect()
}

fn flight_remarks(flight: &Flight, frame: usize) -> Vec<String> {
    let mountings = flight.mountings.as_deref().unwrap_or(&[]);
    let count = mountings.iter().max().map_or(0, |m| m + 1);
    let own = mountings.get(frame).map_or(0, |m| m + 1);
    vec![format!(
        "adjusted with {} frames in {count} mounting(s), this one in mounting {own}; shapes depart from the shared one by {:.1} % of the usual spread",
        flight.frames.len(),
        1e2 * flight.departure
    )]
}
