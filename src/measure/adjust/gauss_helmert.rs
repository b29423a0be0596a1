//! The Gauss-Helmert engine on which every adjustment stands.
//!
//! Conditions `f(x, d, l + v) = 0` between global parameters `x`, parameters `d` local to a group
//! (a marker's distance, a frame's amplitude) and observations `l` with residuals `v`; minimised
//! is `v' Q^-1 v` plus the priors' share (Koch, *Parameter Estimation and Hypothesis Testing in
//! Linear Models*; Niemeier, *Ausgleichungsrechnung*). Work goes block by block: `(B Q B')^-1` is as
//! large as one block, a group's local parameters leave by their Schur complement, so the cost is
//! linear in the number of groups.
//!
//! ```text
//! linearised:   A dx + L dd + B v + w = 0      w = f(x, d, l0) + B (l - l0)
//! M = B Q B'    N = sum A' M^-1 A - (A' M^-1 L)(L' M^-1 L)^-1(L' M^-1 A) + priors
//! v = -Q B' M^-1 (A dx + L dd + w)
//! ```
//!
//! How to use it: fill a [`Problem`], give [`solve`] a closure that returns a [`Linearised`] block
//! at a [`Point`], and read the [`Fit`]; [`Fit::propagate`] carries covariance to any function of
//! parameters, local parameters and adjusted observations.

mod fit;
mod linear;
mod stack;
mod system;

pub use fit::{BlockFit, Fit, Gradient, GroupFit, Propagated};

use nalgebra::{DMatrix, DVector};

use self::system::{State, System, residual_change};
use super::AdjustError;

/// The usual flight takes some twenty; one of a short wing whose frames all lack markers in glare took more than sixty.
const MAX_ITERATIONS: usize = 400;
/// Squared length of the last step in standard deviations, and of the unclosed conditions.
const CONVERGED: f64 = 1e-10;
/// The same for a solution that only decides what the next one looks like: the last step is a tenth
/// of a standard deviation, what it leaves is a hundredth.
const ROUGH: f64 = 1e-2;
/// Where little tells two unknowns apart, rounding of the sum of squares may turn down the last steps for ever. After so
/// many iterations a solution is taken from which the undamped step is a thousandth of a standard deviation: a damped one
/// may be as short on its way along a valley.
const LATE: (usize, f64) = (60, 1e-6);
/// Rise of the sum of squares that a step may cause, over the sum that is still open.
const OPEN_SHARE: f64 = 0.1;
/// Relative rise of the sum of squares that rounding may cause.
const ROUNDING: f64 = 1e-9;

/// Correlated observations that enter conditions together.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// As observed.
    pub observed: DVector<f64>,
    /// Their covariance, a priori.
    pub covariance: DMatrix<f64>,
}

/// Blocks that share local parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Start of the local parameters; may be empty.
    pub local: DVector<f64>,
    /// Priors on them; columns count from the group's first local parameter.
    pub priors: Vec<Prior>,
    /// The observations.
    pub blocks: Vec<Block>,
}

/// Knowledge about parameters from elsewhere: a pseudo-observation.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    /// What it is, for a person.
    pub name: &'static str,
    /// Which parameters.
    pub columns: Vec<usize>,
    /// Their expected values.
    pub mean: DVector<f64>,
    /// Covariance of the expectation.
    pub covariance: DMatrix<f64>,
}

impl Prior {
    /// A prior on one parameter.
    pub fn scalar(name: &'static str, column: usize, mean: f64, sigma: f64) -> Self {
        let covariance = DMatrix::from_element(1, 1, sigma * sigma);
        Self { mean: DVector::from_element(1, mean), ..Self::centred(name, column, covariance) }
    }

    /// A prior on the parameters from `first` on, which are expected to be 0.
    pub fn centred(name: &'static str, first: usize, covariance: DMatrix<f64>) -> Self {
        let count = covariance.nrows();
        Self { name, columns: (first..first + count).collect(), mean: DVector::zeros(count), covariance }
    }

    /// The same on parameters so many columns farther.
    pub fn moved(mut self, by: usize) -> Self {
        self.columns.iter_mut().for_each(|column| *column += by);
        self
    }
}

/// Knowledge about all global parameters together, as an earlier solution left it.
#[derive(Clone, Debug, PartialEq)]
pub struct Known {
    /// Their expected values.
    pub mean: DVector<f64>,
    /// Inverse of the expectation's covariance.
    pub information: DMatrix<f64>,
}

/// One least-squares problem.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// Start of the global parameters.
    pub start: DVector<f64>,
    /// Per global parameter: what is missing where it cannot be determined (ends the sentence
    /// "the adjustment has no unique solution: …").
    pub missing: Vec<&'static str>,
    /// Priors on global parameters.
    pub priors: Vec<Prior>,
    /// What else is known of all of them.
    pub known: Option<Known>,
    /// The groups.
    pub groups: Vec<Group>,
}

/// Where a block is linearised.
#[derive(Clone, Copy, Debug)]
pub struct Point<'a> {
    /// Index of the group.
    pub group: usize,
    /// Index of the block in its group.
    pub block: usize,
    /// Global parameters.
    pub global: &'a DVector<f64>,
    /// The group's local parameters.
    pub local: &'a DVector<f64>,
    /// Adjusted observations of the block.
    pub observed: &'a DVector<f64>,
}

/// Where a whole group is linearised.
#[derive(Clone, Copy, Debug)]
pub struct GroupPoint<'a> {
    /// Index of the group.
    pub group: usize,
    /// Global parameters.
    pub global: &'a DVector<f64>,
    /// The group's local parameters.
    pub local: &'a DVector<f64>,
    /// Adjusted observations, per block.
    pub observed: &'a [DVector<f64>],
}

/// A block's conditions at a point, with their derivatives.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearised {
    /// Value of the conditions, 0 when they hold.
    pub misclosure: DVector<f64>,
    /// Global parameters that the block depends on, each once.
    pub columns: Vec<usize>,
    /// d condition / d those parameters (conditions x columns).
    pub global: DMatrix<f64>,
    /// d condition / d local parameters (conditions x local).
    pub local: DMatrix<f64>,
    /// d condition / d observations (conditions x observations).
    pub observations: DMatrix<f64>,
}

impl Linearised {
    /// Conditions that depend on nothing yet.
    pub fn empty(conditions: usize, columns: Vec<usize>, local: usize, observations: usize) -> Self {
        Self {
            misclosure: DVector::zeros(conditions),
            global: DMatrix::zeros(conditions, columns.len()),
            local: DMatrix::zeros(conditions, local),
            observations: DMatrix::zeros(conditions, observations),
            columns,
        }
    }
}

/// Minimises the problem. `linearise` gives a block's conditions at a point.
pub fn solve(
    problem: &Problem,
    linearise: impl Fn(&Point) -> Result<Linearised, AdjustError>,
) -> Result<Fit, AdjustError> {
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
    linearise: impl Fn(&GroupPoint, &mut Vec<Linearised>) -> Result<(), AdjustError>,
) -> Result<Fit, AdjustError> {
    solve_from(problem, &Course::default(), linearise)
}

/// How far a solution is carried, and what is known before.
#[derive(Clone, Copy, Debug, Default)]
pub struct Course<'a> {
    /// Stop within a hundredth of a standard deviation.
    pub rough: bool,
    /// Residuals of an earlier solution to start from, where its blocks are the same.
    pub residuals: Option<&'a Fit>,
}

/// As [`solve_groups`], on a given course.
pub fn solve_from(
    problem: &Problem,
    course: &Course,
    linearise: impl Fn(&GroupPoint, &mut Vec<Linearised>) -> Result<(), AdjustError>,
) -> Result<Fit, AdjustError> {
    let converged = if course.rough { ROUGH } else { CONVERGED };
    let mut state = State::start(problem, course.residuals);
    let mut next = state.clone();
    let mut system = System::new(problem)?;
    system.assemble(problem, &state, &linearise)?;
    let mut damping = 0.0;
    let mut relaxation = Relaxation::default();
    for iteration in 1..=MAX_ITERATIONS {
        if !course.rough && iteration > LATE.0 && system.unclosed <= LATE.1 {
            let undamped = system.step(problem, 0.0)?;
            if undamped.dot(&(&system.normal * &undamped)) <= LATE.1 {
                return system.finish(problem, state, iteration);
            }
        }
        let step = system.step(problem, damping)?;
        let step = relaxation.of(step, &system.normal, damping);
        system.moved(problem, &state, &step, &mut next);
        let moved = step.dot(&(&system.normal * &step)) + residual_change(problem, &state, &next);
        let settled = moved <= converged;
        // The sum of squares holds to first order in the conditions that are still open, and rounding
        // lets it waver far below what a standard deviation can tell.
        let limit = system.omega + OPEN_SHARE * system.unclosed + ROUNDING * (1.0 + system.omega);
        let tried = system.assemble(problem, &next, &linearise);
        if tried.is_err() || !system.omega.is_finite() || (system.omega > limit && !settled) {
            damping = if damping == 0.0 { 1e-3 } else { damping * 10.0 };
            if damping > 1e12 {
                return Err(tried.err().unwrap_or(AdjustError::NoConvergence { iterations: iteration }));
            }
            system.assemble(problem, &state, &linearise)?;
            continue;
        }
        std::mem::swap(&mut state, &mut next);
        if settled && system.unclosed <= converged {
            return system.finish(problem, state, iteration);
        }
        damping = if damping < 1e-6 { 0.0 } else { damping * 0.1 };
    }
    Err(AdjustError::NoConvergence { iterations: MAX_ITERATIONS })
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
    const ALIKE: f64 = 0.9;
    /// Factors beyond these are no longer told by two steps.
    const BOUNDS: (f64, f64) = (0.3, 10.0);

    fn of(&mut self, step: DVector<f64>, normal: &DMatrix<f64>, damping: f64) -> DVector<f64> {
        if damping > 0.0 {
            self.last = None;
            return step;
        }
        let factor = self.last.as_ref().map_or(1.0, |(last, factor)| {
            let weighted = normal * &step;
            let (both, own) = (last.dot(&weighted), step.dot(&weighted));
            let before = last.dot(&(normal * last));
            let alike = both.abs() > Self::ALIKE * (own * before).sqrt();
            if alike { (factor / (1.0 - both / before)).clamp(Self::BOUNDS.0, Self::BOUNDS.1) } else { 1.0 }
        });
        let scaled = &step * factor;
        self.last = Some((step, factor));
        scaled
    }
}

#[cfg(test)]
mod tests;
