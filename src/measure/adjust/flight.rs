//! The frames of a flight adjusted together (docs/model.md).
//!
//! Shared: the markers on ground, camera and ground rotation, one rotation per mounting, the ratios
//! of the curvature's coefficients. Per frame, local to its group: coefficients of curvature and
//! twist. Until mountings are found, each frame may leave the rotation that all have in common. A
//! frame's curvature may leave the shared shape by a share of its amplitude; that share is found from
//! the data. Frames leave the normal equations by their Schur complement, so the cost is linear in
//! their number.

mod live;
mod setting;

pub use live::Live;

use nalgebra::{DMatrix, DVector, Vector3};

use self::setting::Setting;
use super::gauss_helmert::{Course, Fit, Gradient};
use super::layout::Place;
use super::outcome::Outcome;
use super::scene::Scene;
use super::snooping::{self, Suspect, Target};
use super::unknowns::{Input, LEAST_DRIFT_RAD, by_marker, on_the_wing};
use super::{AdjustError, Estimate, Method, Mounting, Observation, Options, Parameter, Solution, quality};
use crate::measure::robust::median;
use crate::measure::setup::{Orientation, Setup};

/// Terms of the curvature where none are given.
const TERMS: usize = 8;
/// Fewest markers on the wing in one frame.
const FEWEST: usize = 4;
/// Bending below this counts as unbent, 1/m.
const SMALLEST_CURVATURE_PER_M: f64 = 2e-4;
/// Departure of a frame's shape from the shared one, over the usual spread of shapes: to begin with,
/// and bounds.
const DEPARTURE: f64 = 0.03;
const DEPARTURE_BOUNDS: (f64, f64) = (0.002, 1.0);

const DEPARTURE_ROUNDS: usize = 3;
/// Level of the test that finds a remounted camera, for a flight as a whole.
const REMOUNT_ALPHA: f64 = 1e-4;
/// A mounting moves by less than this between two shots, rad (0.1 px at 8000 px).
const STEADY_RAD: f64 = 1.2e-5;
/// A drift so many times what is stated is told.
const DOUBTED_DRIFT: f64 = 3.0;
/// Rounds of data snooping, each removing at most one observation per frame.
const SNOOPING_ROUNDS: usize = 4;

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
    /// As the user or the recorder knows them, one per frame.
    known: Option<&'a [Mounting]>,
    /// Rotation of the mounting and shift of the projection centre per frame in the last solution, rad and m.
    poses: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// Standard deviation of a frame's rotation about its mounting's, rad.
    drift_rad: f64,
}

/// What a frame's departures from the shared shape show of their variance: the weighted square of their residuals and its
/// redundancy (Koch's estimate of one variance component).
fn departure_shown(setting: &Setting, fit: &Fit, frame: usize) -> Option<(f64, f64)> {
    let block = setting.members[frame].len();
    let factor = setting.problem.groups[frame].blocks[block].covariance.clone().cholesky()?;
    let residuals = &fit.groups[frame].blocks[block].residuals;
    let adjusted = factor.solve(&fit.adjusted_covariance(frame, block));
    Some((residuals.dot(&factor.solve(residuals)), residuals.len() as f64 - adjusted.trace()))
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
            let found = on_the_wing(setup, frame);
            if found < FEWEST {
                return Err(AdjustError::TooFewMarkers { found, needed: FEWEST });
            }
        }
        let n = setup.markers.len();
        let known = options.mountings.as_deref();
        if known.is_some_and(|list| list.len() != observations.len()) {
            return Err(AdjustError::Input("there must be one mounting for every frame".into()));
        }
        Ok(Self {
            known,
            input: Input { setup, orientation, scene, options, flight: vec![None; n] },
            used: vec![vec![true; n]; frames.len()],
            ground_used: vec![true; n],
            amplitudes: vec![0.005; frames.len()],
            poses: vec![(Vector3::zeros(), Vector3::zeros()); frames.len()],
            frames,
            departure: DEPARTURE,
            mountings: None,
            drift_rad: stated_drift(setup),
        })
    }
}

impl Flight<'_> {
    /// A rough solution, near enough for the decisions that follow from it.
    fn solve(&mut self, from: Option<&Fit>) -> Result<(Setting, Fit), AdjustError> {
        let setting = self.setting(from);
        let fit = setting.solve(self.input.scene, &Course { rough: true, residuals: from })?;
        for (frame, layout) in setting.layouts.iter().enumerate() {
            let local = &fit.groups[frame].local;
            self.amplitudes[frame] = local[0].abs().max(SMALLEST_CURVATURE_PER_M);
            let pose = layout.values(&fit.global, local).pose;
            self.poses[frame] = (pose.mount_rad, pose.shift_m);
        }
        Ok((setting, fit))
    }

    /// Sets the departure from the shared shape to what its own residuals show (Koch's estimate of
    /// one variance component). The last change waits for the caller's next solution.
    fn tune_departure(
        &mut self,
        mut last: (Setting, Fit),
        rounds: usize,
    ) -> Result<(Setting, Fit), AdjustError> {
        for round in 1..=rounds {
            let (setting, fit) = &last;
            let (mut omega, mut redundancy) = (0.0, 0.0);
            for frame in 0..self.frames.len() {
                let Some(shown) = departure_shown(setting, fit, frame) else { continue };
                omega += shown.0;
                redundancy += shown.1;
            }
            if redundancy < 0.5 {
                break;
            }
            let factor = (omega / redundancy).sqrt();
            let next = (self.departure * factor).clamp(DEPARTURE_BOUNDS.0, DEPARTURE_BOUNDS.1);
            let settled = (next / self.departure).ln().abs() < 0.3;
            self.departure = next;
            let settled = self.tune_drift(setting, fit) && settled;
            if settled || round == rounds {
                break;
            }
            last = self.solve(Some(&last.1))?;
        }
        Ok(last)
    }

    /// Sets the drift to what the rotations within each mounting show, not below what is stated. Yaw and roll
    /// tell it well; pitch, which one frame hardly tells from bending, is taken to creep somewhat more. The stated
    /// drift counts as one observation. Whether it changed little.
    fn tune_drift(&mut self, setting: &Setting, fit: &Fit) -> bool {
        if self.mountings.is_none() {
            return true;
        }
        let stated = stated_drift(self.input.setup);
        let (mut omega, mut redundancy) = ((stated / self.drift_rad).powi(2), 1.0);
        for frame in 0..self.frames.len() {
            let Some((gradient, value)) = own_rotation(setting, fit, frame) else { continue };
            let covariance = fit.covariance_of(frame, &gradient);
            let Some(weight) = self.drift_covariance().try_inverse() else { continue };
            omega += value.dot(&(weight * value));
            redundancy += 3.0 - (weight * covariance.fixed_view::<3, 3>(0, 0)).trace();
        }
        let loosest = self.input.setup.mount_repeatability_px.max(1e-3) / self.input.setup.lens.focal_px();
        let next = self.drift_rad * (omega / redundancy.max(0.5)).sqrt();
        let next = next.clamp(stated, loosest.max(stated));
        let settled = (next / self.drift_rad).ln().abs() < 0.3;
        self.drift_rad = next;
        settled
    }

    /// Splits the flight where the rotation changes by more than chance **and** by more than it does elsewhere: a remount
    /// stands out among the steps from frame to frame. Where all steps are alike, large or small, the frames are of one
    /// mounting that turns by as much as they show: to take two that hardly differ for equal costs more than it gains.
    /// Where the mountings are known, they are what counts.
    fn find_mountings(&mut self, setting: &Setting, fit: &Fit) {
        if let Some(known) = self.known_mountings() {
            self.mountings = Some(known);
            self.drift_rad = self.drift_rad.max(self.spread());
            return;
        }
        let frames = self.frames.len();
        let steps: Vec<f64> = (1..frames).map(|f| rotation_distance(setting, fit, f - 1, f)).collect();
        let usual = (median(steps.clone()).unwrap_or(0.0) / chi_square_limit(3.0, 0.5)).max(1.0);
        let limit = usual * chi_square_limit(3.0, REMOUNT_ALPHA / frames as f64);
        let mut list = vec![0; frames];
        for frame in 1..frames {
            list[frame] = list[frame - 1] + usize::from(steps[frame - 1] > limit);
        }
        self.mountings = Some(list);
        self.drift_rad = self.drift_rad.max(self.spread());
    }

    /// The mountings that the user or the recorder knows, numbered in the frames' order.
    fn known_mountings(&self) -> Option<Vec<usize>> {
        let known = self.known.as_ref()?;
        let mut seen: Vec<Mounting> = vec![];
        let number = |mounting: &Mounting| {
            seen.iter().position(|m| m == mounting).unwrap_or_else(|| {
                seen.push(*mounting);
                seen.len() - 1
            })
        };
        Some(known.iter().map(number).collect())
    }

    /// Whether a mounting is known to be that of the ground frames.
    fn stayed(&self, mounting: usize) -> bool {
        let known = self.known.zip(self.mountings.as_deref());
        known.is_some_and(|(known, numbers)| {
            known.iter().zip(numbers).any(|(k, n)| *n == mounting && *k == Mounting::OfTheGround)
        })
    }

    /// Root mean square of the rotations about their mountings' means, each axis, rad.
    fn spread(&self) -> f64 {
        let off = |f: usize| (self.poses[f].0 - self.mean_pose(self.mounting(f)).0).norm_squared();
        let frames = self.frames.len();
        ((0..frames).map(off).sum::<f64>() / (3 * frames.max(1)) as f64).sqrt()
    }

    /// Everything takes part but what was removed.
    fn use_all_but(&mut self, removed: &[(usize, Suspect)]) {
        self.used.iter_mut().for_each(|frame| frame.fill(true));
        self.ground_used.fill(true);
        removed.iter().for_each(|(group, suspect)| self.remove(*group, suspect));
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

    /// Images that were tested while a wrong surveyed position was still in are tested again without it.
    fn snoop_again(&mut self, (setting, fit, mut removed): Snooped) -> Result<Snooped, AdjustError> {
        let last = removed.iter().rposition(|(_, s)| s.target == Target::Survey);
        let early = |(k, (_, s)): &(usize, &(usize, Suspect))| {
            last.is_some_and(|l| *k <= l) && s.target == Target::Flight
        };
        if !removed.iter().enumerate().any(|r| early(&r)) {
            return Ok((setting, fit, removed));
        }
        removed.retain(|(_, s)| s.target != Target::Flight);
        self.use_all_but(&removed);
        let next = self.solve(Some(&fit))?;
        let (setting, fit, mut found) = self.snoop(next)?;
        removed.append(&mut found);
        Ok((setting, fit, removed))
    }

    /// Backward step: each marker that was taken out as a whole, the least suspect first, is put back
    /// and tested with all the others out; it stays if it fits.
    fn readmit(
        &mut self,
        mut last: (Setting, Fit),
        removed: &mut Vec<(usize, Suspect)>,
    ) -> Result<(Setting, Fit), AdjustError> {
        let ground = self.frames.len();
        let mut queue: Vec<_> = removed.iter().filter(|(_, s)| s.target != Target::Flight).copied().collect();
        queue.sort_by(|(_, a), (_, b)| a.w.abs().total_cmp(&b.w.abs()));
        for suspect in queue {
            let others: Vec<_> = removed.iter().filter(|r| **r != suspect).copied().collect();
            self.use_all_but(&others);
            let with = self.solve(Some(&last.1))?;
            let blocks =
                with.0.ground_members.iter().enumerate().filter(|(_, m)| m.marker == suspect.1.marker);
            let (problem, options) = (&with.0.problem, self.input.options);
            if snooping::worst_of(problem, &with.1, ground, blocks, options).is_some() {
                self.use_all_but(removed);
            } else {
                *removed = others;
                last = with;
            }
        }
        Ok(last)
    }
}

/// Drift of one mounting as stated, not 0.
fn stated_drift(setup: &Setup) -> f64 {
    setup.uncertainty.mount_drift_rad.max(LEAST_DRIFT_RAD)
}

/// A frame's rotation about what its mounting's frames have in common, and the gradient that picks it.
fn own_rotation(setting: &Setting, fit: &Fit, frame: usize) -> Option<(Gradient, Vector3<f64>)> {
    let Place::Local(first) = setting.layouts[frame].mount else { return None };
    let mut gradient = Gradient::empty(vec![], setting.layouts[frame].local, 3);
    (0..3).for_each(|k| gradient.local[(first + k, k)] = 1.0);
    Some((gradient, fit.groups[frame].local.fixed_rows::<3>(first).into_owned()))
}

fn chi_square_limit(freedom: f64, alpha: f64) -> f64 {
    use statrs::distribution::{ChiSquared, ContinuousCDF};
    ChiSquared::new(freedom).map_or(f64::INFINITY, |law| law.inverse_cdf(1.0 - alpha))
}

/// Squared difference of two frames' rotations in its standard deviations.
fn rotation_distance(setting: &Setting, fit: &Fit, a: usize, b: usize) -> f64 {
    let part = |frame: usize| {
        let (gradient, value) = own_rotation(setting, fit, frame)?;
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
    let last = flight.solve(None)?;
    let snooped = flight.snoop(last)?;
    let (setting, fit, mut removed) = flight.snoop_again(snooped)?;
    let (setting, fit) = flight.tune_departure((setting, fit), 1)?;
    flight.find_mountings(&setting, &fit);
    let last = flight.solve(Some(&fit))?;
    let last = flight.readmit(last, &mut removed)?;
    let (_, rough) = flight.tune_departure(last, DEPARTURE_ROUNDS)?;
    let setting = flight.setting(Some(&rough));
    let fit = setting.solve(&scene, &Course { rough: false, residuals: Some(&rough) })?;
    Ok(dress(&flight, &setting, &fit, &removed))
}

fn dress(flight: &Flight, setting: &Setting, fit: &Fit, removed: &[(usize, Suspect)]) -> Vec<Solution> {
    let one = |frame: usize| dress_frame(flight, setting, fit, removed, frame, flight_remarks(flight, frame));
    (0..flight.frames.len()).map(one).collect()
}

/// One frame's part of a fit, with what was removed from it or from all frames.
fn dress_frame(
    flight: &Flight,
    setting: &Setting,
    fit: &Fit,
    removed: &[(usize, Suspect)],
    frame: usize,
    mut remarks: Vec<String>,
) -> Solution {
    let (setup, options) = (flight.input.setup, flight.input.options);
    let test = quality::global_test(fit.omega, fit.redundancy, options.global_alpha);
    let posterior = quality::is_posterior(options.sigma, test);
    let factor = fit.variance_factor();
    let scale = if posterior { factor.map_or(1.0, f64::sqrt) } else { 1.0 };
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
    parameters.push(outcome.axis_raise());
    let unmeasured = |value: f64| vec![Estimate { value, sigma: None }];
    parameters.push(Parameter { name: "shape_departure", values: unmeasured(flight.departure) });
    parameters.push(Parameter { name: "mount_drift_rad", values: unmeasured(flight.drift_rad) });
    let mut markers = outcome.markers();
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
}

fn flight_remarks(flight: &Flight, frame: usize) -> Vec<String> {
    let mountings = flight.mountings.as_deref().unwrap_or(&[]);
    let count = mountings.iter().max().map_or(0, |m| m + 1);
    let own = mountings.get(frame).map_or(0, |m| m + 1);
    let by = if flight.known.is_some() { "as stated" } else { "by evidence" };
    let mut remarks = vec![format!(
        "adjusted with {} frames in {count} mounting(s), {by}, this one in mounting {own}; shapes depart from the shared one by {:.1} % of the usual spread",
        flight.frames.len(),
        1e2 * flight.departure
    )];
    let stated = stated_drift(flight.input.setup);
    if flight.drift_rad > DOUBTED_DRIFT * stated.max(STEADY_RAD) {
        remarks.push(format!(
            "the camera turned by {:.3} mrad from frame to frame within its mountings, {:.3} are stated \
             (camera.mount_drift_mrad): {}",
            1e3 * flight.drift_rad,
            1e3 * stated,
            if flight.known.is_some() { "was it remounted within one of them?" } else { "look at its mount" }
        ));
    }
    remarks
}
