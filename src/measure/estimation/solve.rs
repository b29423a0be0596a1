//! The iteration: Gauss's steps, relaxed where they repeat themselves; where two of them lead up (Chamberlain et al. 1982),
//! shortened and at last damped.

use nalgebra::{DMatrix, DVector};

use super::error::EstimationError;
use super::fit::Fit;
use super::problem::{GroupPoint, Linearised, Point, Problem};
use super::system::{State, System, residual_change};

/// The usual flight takes some twenty; one of a short wing whose frames all lack markers in glare took more than sixty.
const MAX_ITERATIONS: usize = 400;
/// Squared length of the last step in standard deviations, and of the unclosed conditions.
const CONVERGED: f64 = 1e-10;
/// The same for a solution that only decides what the next one looks like: the last step is a tenth
/// of a standard deviation, what it leaves is a hundredth.
const ROUGH: f64 = 1e-2;
/// Where little tells two unknowns apart, rounding of the sum of squares may turn down the last steps for ever, and hundreds
/// of frames creep along a valley that bends. After so many iterations a solution is taken from which the undamped step is a
/// thousandth of a standard deviation, after more of them a hundredth and at last a tenth, which is half a percent of a
/// variance: a damped one may be as short on its way along a valley.
const LATE: [(usize, f64); 3] = [(60, 1e-6), (120, 1e-4), (180, 1e-2)];
/// A step that leads up is tried again at such a share of its length: it points down, and what Gauss's method leaves out of the
/// second derivatives makes it too long. Damping would turn it away from what little tells, and creep.
const SHORTER: f64 = 0.25;
/// Share of a step below which its direction is no longer believed, and it is damped.
const SHORTEST: f64 = 0.01;
/// Rise of the sum of squares that a step may cause, over the sum that is still open.
const OPEN_SHARE: f64 = 0.1;
/// Relative rise of the sum of squares that rounding may cause.
const ROUNDING: f64 = 1e-9;

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
    linearise: impl Fn(&GroupPoint, &mut Vec<Linearised>) -> Result<(), EstimationError>,
) -> Result<Fit, EstimationError> {
    let converged = if course.rough { ROUGH } else { CONVERGED };
    let mut state = State::start(problem, course.residuals);
    let mut next = state.clone();
    let mut system = System::new(problem)?;
    system.assemble(problem, &state, &linearise)?;
    let (mut damping, mut length) = (0.0, 1.0);
    let mut relaxation = Relaxation::default();
    // Where a whole step led up from, and the sum of squares that the next one must not pass.
    let mut astray: Option<(State, f64)> = None;
    for iteration in 1..=MAX_ITERATIONS {
        let late = LATE.into_iter().rfind(|(after, _)| iteration > *after).map(|(_, enough)| enough);
        if let Some(enough) = late.filter(|enough| system.unclosed <= *enough) {
            let undamped = system.step(problem, 0.0)?;
            if undamped.dot(&(&system.normal * &undamped)) <= enough {
                return system.finish(problem, state, iteration);
            }
        }
        let step = system.step(problem, damping)?;
        // A damped step says nothing of others.
        let step = if damping > 0.0 { step } else { relaxation.of(step, &system.normal, length) };
        system.moved(problem, &state, &step, &mut next);
        let moved = step.dot(&(&system.normal * &step)) + residual_change(problem, &state, &next);
        // By what a whole step would move.
        let settled = moved <= converged * length * length;
        // The sum of squares holds to first order in the conditions that are still open, and rounding
        // lets it waver far below what a standard deviation can tell.
        let here = system.omega + OPEN_SHARE * system.unclosed + ROUNDING * (1.0 + system.omega);
        let limit = astray.as_ref().map_or(here, |(_, limit)| *limit);
        let tried = system.assemble(problem, &next, &linearise);
        let exists = tried.is_ok() && system.omega.is_finite();
        let led_up = system.omega > limit && (!settled || astray.is_some());
        if exists && led_up && astray.is_none() && damping == 0.0 && length == 1.0 {
            // A valley that bends: the next step may lead back to its floor, and farther down (the watchdog technique).
            relaxation = Relaxation::default();
            std::mem::swap(&mut state, &mut next);
            astray = Some((next.clone(), limit));
            continue;
        }
        if !exists || led_up {
            relaxation = Relaxation::default();
            if let Some((before, _)) = astray.take() {
                state = before;
            }
            if damping == 0.0 && SHORTER * length >= SHORTEST {
                length *= SHORTER;
            } else {
                (damping, length) = (if damping == 0.0 { 1e-3 } else { damping * 10.0 }, 1.0);
            }
            if damping > 1e12 {
                return Err(tried.err().unwrap_or(EstimationError::NoConvergence { iterations: iteration }));
            }
            system.assemble(problem, &state, &linearise)?;
            continue;
        }
        std::mem::swap(&mut state, &mut next);
        astray = None;
        length = 1.0;
        if settled && system.unclosed <= converged {
            return system.finish(problem, state, iteration);
        }
        damping = if damping < 1e-6 { 0.0 } else { damping * 0.1 };
    }
    Err(EstimationError::NoConvergence { iterations: MAX_ITERATIONS })
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

    /// A step by its factor; the first one, and the first one after one that led up, by `length`.
    fn of(&mut self, step: DVector<f64>, normal: &DMatrix<f64>, length: f64) -> DVector<f64> {
        let factor = self.last.as_ref().map_or(length, |(last, factor)| {
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
