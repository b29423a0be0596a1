//! The iteration: Gauss's steps, corrected by what the steps behind show; where two of them lead up (Chamberlain et al. 1982),
//! shortened and at last damped.

use nalgebra::{DMatrix, DVector};

use super::error::EstimationError;
use super::fit::Fit;
use super::hessian_correction;
use super::problem::{GroupPoint, Linearised, Point, Problem};
use super::secants::Secants;
use super::state::{State, residual_change};
use super::system::System;

/// The usual flight takes some twenty; one of a short wing whose frames all lack markers in glare took more than sixty.
const MAX_ITERATIONS: usize = 400;
/// Squared length of the last step in standard deviations, and of the unclosed conditions.
const CONVERGED: f64 = 1e-10;
/// The same where steps follow those behind: the last one is no measure of what it leaves.
const CONVERGED_WITH_SECANTS: f64 = 1e-12;
/// The same for a solution that only decides what the next one looks like: the last step is a tenth
/// of a standard deviation, what it leaves is a hundredth.
const CONVERGED_ROUGHLY: f64 = 1e-2;
/// Where little tells two unknowns apart, rounding of the sum of squares may turn down the last steps for ever, and hundreds
/// of frames creep along a valley that bends. After so many iterations a solution is taken from which the undamped step is a
/// thousandth of a standard deviation, after more of them a hundredth and at last a tenth, which is half a percent of a
/// variance: a damped one may be as short on its way along a valley.
const LATE_TOLERANCES: [(usize, f64); 3] = [(60, 1e-6), (120, 1e-4), (180, 1e-2)];
/// A step that leads up is tried again at such a share of its length: it points down, and what is left out of the second
/// derivatives makes it too long. Damping would turn it away from what little tells, and creep.
const DEFAULT_STEP_FACTOR: f64 = 0.25;
/// The same at least and at most, where a parabola tells it.
const STEP_FACTOR_BOUNDS: (f64, f64) = (0.1, 0.5);
/// Damping beyond which nothing leads down.
const MAX_DAMPING: f64 = 1e12;
/// Share of a step below which its direction is no longer believed, and it is damped.
const MIN_STEP_FRACTION: f64 = 0.01;
/// Where the groups' own parameters alone have more to gain than such a share of what a whole step gains, they settle first:
/// only then is the global right side the gradient of what is left.
const UNSETTLED_FRACTION: f64 = 0.1;

/// Minimises the problem. `linearise` gives a block's conditions at a point.
pub fn solve(
    problem: &Problem,
    linearise: impl Fn(&Point) -> Result<Linearised, EstimationError>,
) -> Result<Fit, EstimationError> {
    solve_groups(problem, |at, blocks| {
        let point = |(block, observed)| Point {
            group: at.group,
            block,
            global: at.global,
            local: at.local,
            observed,
        };
        blocks.clear();
        for b in at.observed.iter().enumerate() {
            blocks.push(linearise(&point(b))?);
        }
        Ok(())
    })
}

/// As [`solve`], for models whose blocks share work: `linearise` gives all blocks of a group. It may
/// find those of another point in the list, with the same columns and sizes, and write over them.
pub fn solve_groups(
    problem: &Problem,
    linearise: impl Fn(&GroupPoint, &mut Vec<Linearised>) -> Result<(), EstimationError>,
) -> Result<Fit, EstimationError> {
    solve_with_options(problem, &SolveOptions::default(), linearise)
}

/// How far a solution is carried, and what is known before.
#[derive(Clone, Copy, Debug, Default)]
pub struct SolveOptions<'a> {
    /// Stop within a hundredth of a standard deviation.
    pub rough: bool,
    /// Residuals of an earlier solution to start from, where its blocks are the same.
    pub residuals: Option<&'a Fit>,
}

/// As [`solve_groups`], on a given course.
pub fn solve_with_options(
    problem: &Problem,
    course: &SolveOptions,
    linearise: impl Fn(&GroupPoint, &mut Vec<Linearised>) -> Result<(), EstimationError>,
) -> Result<Fit, EstimationError> {
    let mut way = GaussNewton::new(problem, course, linearise)?;
    for iteration in 1..=MAX_ITERATIONS {
        if way.iterate(iteration)? {
            let second = if course.rough { None } else { way.corrected_hessian()? };
            return way.system.into_fit(problem, way.state, iteration, second);
        }
    }
    Err(EstimationError::NoConvergence { iterations: MAX_ITERATIONS })
}

/// A solution on its way.
struct GaussNewton<'a, L> {
    problem: &'a Problem,
    linearise: L,
    converged: f64,
    state: State,
    /// Room for the next one.
    next: State,
    /// At the state.
    system: System,
    damping: f64,
    /// Share of the next step that is gone.
    length: f64,
    relaxation: Relaxation,
    secants: Secants,
    /// Whether the last step was of the groups' own parameters alone.
    groups_alone: bool,
    /// Where a whole step led up from, and the sum of squares that the next one must not pass.
    astray: Option<(State, f64)>,
}

impl<'a, L> GaussNewton<'a, L>
where
    L: Fn(&GroupPoint, &mut Vec<Linearised>) -> Result<(), EstimationError>,
{
    fn new(problem: &'a Problem, course: &SolveOptions, linearise: L) -> Result<Self, EstimationError> {
        let state = State::initial(problem, course.residuals);
        let mut system = System::new(problem)?;
        system.assemble(problem, &state, &linearise)?;
        Ok(Self {
            problem,
            linearise,
            converged: if course.rough {
                CONVERGED_ROUGHLY
            } else if system.several_own {
                CONVERGED_WITH_SECANTS
            } else {
                CONVERGED
            },
            next: state.clone(),
            state,
            system,
            damping: 0.0,
            length: 1.0,
            relaxation: Relaxation::default(),
            secants: Secants::default(),
            groups_alone: false,
            astray: None,
        })
    }

    /// One iteration. Whether the state is the solution.
    fn iterate(&mut self, iteration: usize) -> Result<bool, EstimationError> {
        let usual = self.system.global_step(self.problem, self.damping)?;
        let undamped = if self.damping > 0.0 { &self.system.global_step(self.problem, 0.0)? } else { &usual };
        let gain = undamped.dot(&self.system.right);
        let late = LATE_TOLERANCES.into_iter().rfind(|(after, _)| iteration > *after).map(|(_, enough)| enough);
        if late.is_some_and(|enough| self.system.unclosed.max(gain) <= enough) {
            return Ok(true);
        }
        let step = self.choose_step(usual, gain)?;
        let slope = step.dot(&self.system.right);
        self.system.apply_step(self.problem, &self.state, &step, &mut self.next);
        let changed = residual_change(self.problem, &self.state, &self.next);
        let moved = step.dot(&(&self.system.normal * &step)) + changed;
        // By what a whole step would move.
        let settled = !self.groups_alone && moved <= self.converged * self.length * self.length;
        let (here, slack) = (self.system.settled_omega(), self.system.omega_tolerance());
        let limit = self.astray.as_ref().map_or(here + slack, |(_, limit)| *limit);
        let tried = self.system.assemble(self.problem, &self.next, &self.linearise);
        let exists = tried.is_ok() && self.system.omega.is_finite();
        if exists && (self.system.settled_omega() <= limit || settled && self.astray.is_none()) {
            std::mem::swap(&mut self.state, &mut self.next);
            self.astray = None;
            if !self.groups_alone {
                self.length = 1.0;
                self.damping = if self.damping < 1e-6 { 0.0 } else { self.damping * 0.1 };
            }
            return Ok(settled && self.system.unclosed <= self.converged);
        }
        let is_plain = self.damping == 0.0 && self.length == 1.0 && self.secants.is_empty();
        if exists && is_plain && self.astray.is_none() && !self.groups_alone {
            self.relaxation = Relaxation::default();
            // A valley that bends: the next step may lead back to its floor, and farther down (the watchdog technique).
            std::mem::swap(&mut self.state, &mut self.next);
            self.astray = Some((self.next.clone(), limit));
            return Ok(false);
        }
        let risen = exists.then(|| self.system.settled_omega() - here);
        let error = || tried.err().unwrap_or(EstimationError::NoConvergence { iterations: iteration });
        if self.shorten_step(slope, risen) > MAX_DAMPING {
            return Err(error());
        }
        self.system.assemble(self.problem, &self.state, &self.linearise)?;
        Ok(false)
    }

    /// The next step, of which the usual one would lower the sum of squares by `gain`.
    fn choose_step(&mut self, usual: DVector<f64>, gain: f64) -> Result<DVector<f64>, EstimationError> {
        self.groups_alone =
            !self.groups_alone && self.system.unsettled > (UNSETTLED_FRACTION * gain).max(self.converged);
        if self.groups_alone {
            return Ok(usual * 0.0);
        }
        if self.damping > 0.0 {
            // A damped step says nothing of others.
            return Ok(usual);
        }
        // Where conditions hold observations, the right side is not the gradient.
        if !self.system.several_own {
            return Ok(self.relaxation.scale_step(usual, &self.system.normal, self.length));
        }
        Ok(self.secants.next_step(&self.system, self.problem, &self.state.global)? * self.length)
    }

    /// Where the steps showed that the normal matrix is not near it, and amplitudes of many groups are behind that.
    fn corrected_hessian(&self) -> Result<Option<DMatrix<f64>>, EstimationError> {
        let Some(start) = self.secants.max_deviation_direction(&self.system.normal) else { return Ok(None) };
        hessian_correction::half_hessian(&self.system, self.problem, &self.state, start, &self.linearise)
            .map(Some)
    }

    /// Goes back behind a step that led up, and makes the next one Gauss's where it was none, else shorter: by the parabola through
    /// both ends with the slope at the first, and at last by damping, which it returns. `risen`: by what the sum of squares rose, where it exists.
    fn shorten_step(&mut self, slope: f64, risen: Option<f64>) -> f64 {
        let was_astray = self.astray.take().map(|(before, _)| self.state = before).is_some();
        if self.groups_alone && !was_astray {
            return self.damping;
        }
        if !was_astray && self.length == 1.0 && !self.secants.is_empty() {
            // What steps farther away showed does not hold here: Gauss's step instead.
            self.secants.clear();
            return self.damping;
        }
        self.relaxation = Relaxation::default();
        let bent = risen
            .filter(|_| self.system.several_own)
            .map(|risen| risen + 2.0 * slope)
            .filter(|bent| *bent > 0.0);
        let shorter = bent.map_or(DEFAULT_STEP_FACTOR, |bent| (slope / bent).clamp(STEP_FACTOR_BOUNDS.0, STEP_FACTOR_BOUNDS.1));
        if self.damping == 0.0 && shorter * self.length >= MIN_STEP_FRACTION {
            self.length *= shorter;
        } else {
            self.secants.clear();
            self.damping = if self.damping == 0.0 { 1e-3 } else { self.damping * 10.0 };
            self.length = 1.0;
        }
        self.damping
    }
}

/// Steps that repeat themselves, turning back or not, are too long or too short by a factor that two of them tell
/// (Aitken's; for vectors Irons and Tuck 1969). Where little tells two unknowns apart, as principal point and
/// rotation, what Gauss's method leaves out of the second derivatives is as large as what it takes.
#[derive(Default)]
struct Relaxation {
    /// The last step before its factor, and the factor.
    last: Option<(DVector<f64>, f64)>,
}

impl Relaxation {
    /// Steps count as repeated where the cosine between them, in standard deviations, is larger than this.
    const MIN_COSINE: f64 = 0.9;
    /// Factors beyond these are no longer told by two steps.
    const FACTOR_BOUNDS: (f64, f64) = (0.3, 10.0);

    /// A step by its factor; the first one, and the first one after one that led up, by `length`.
    fn scale_step(&mut self, step: DVector<f64>, normal: &DMatrix<f64>, length: f64) -> DVector<f64> {
        let factor = self.last.as_ref().map_or(length, |(last, factor)| {
            let weighted = normal * &step;
            let (both, own) = (last.dot(&weighted), step.dot(&weighted));
            let before = last.dot(&(normal * last));
            let alike = both.abs() > Self::MIN_COSINE * (own * before).sqrt();
            if alike { (factor / (1.0 - both / before)).clamp(Self::FACTOR_BOUNDS.0, Self::FACTOR_BOUNDS.1) } else { 1.0 }
        });
        let scaled = &step * factor;
        self.last = Some((step, factor));
        scaled
    }
}
