//! The iteration: Gauss's steps, corrected by previous steps; if two of them increase the sum of squares (Chamberlain et
//! al. 1982), shortened and finally damped.

use nalgebra::{DMatrix, DVector};

use super::error::{EstimationError, EstimationResult};
use super::fit::Fit;
use super::hessian_correction;
use super::problem::{BlockPoint, GroupPoint, Linearised, Problem};
use super::secants::Secants;
use super::state::{EstimationState, residual_change};
use super::system::NormalEquations;

/// Maximum number of iterations. A typical flight takes about 20; a flight of a short wing, without markers in glare in all
/// frames, took more than 60.
const MAX_ITERATIONS: usize = 400;
/// Squared length, in standard deviations, of the last step and of the unclosed conditions at convergence.
const CONVERGED: f64 = 1e-10;
/// Squared length at convergence with quasi-Newton steps, for which the last step does not measure the remaining one.
const CONVERGED_WITH_SECANTS: f64 = 1e-12;
/// Squared length at convergence of a rough solution that only prepares the next problem: the last step is 0.1 standard
/// deviations, the remaining one 0.01.
const CONVERGED_ROUGHLY: f64 = 1e-2;
/// Iterations, and the squared length of an undamped step that is accepted after them: 0.001, 0.01 and 0.1 standard
/// deviations. If two unknowns are poorly separable, rounding of the sum of squares may reject the last steps for ever, and
/// hundreds of frames creep along a bent valley. The last limit is 0.5 % of a variance. A damped step may be as short
/// within a valley, so it does not count.
const LATE_TOLERANCES: [(usize, f64); 3] = [(60, 1e-6), (120, 1e-4), (180, 1e-2)];
/// Factor by which a step that increased the sum of squares is shortened: it points down and is too long because of the
/// neglected second derivatives. Damping would turn it away from poorly determined directions, and creep.
const DEFAULT_STEP_FACTOR: f64 = 0.25;
/// Bounds of the factor if a parabola determines it.
const STEP_FACTOR_BOUNDS: (f64, f64) = (0.1, 0.5);
/// Damping beyond which no step decreases the sum of squares.
const MAX_DAMPING: f64 = 1e12;
/// Fraction of a step below which it is damped instead of shortened again.
const MIN_STEP_FRACTION: f64 = 0.01;
/// Fraction of the gain of a full step. If the groups' own parameters alone gain more, they settle first: only then is the
/// global right side the gradient of the remaining sum.
const UNSETTLED_FRACTION: f64 = 0.1;

/// Minimises the problem; `linearise` returns a block's conditions at a point.
///
/// # Errors
/// Returns an error if the problem is singular, does not converge or is not finite, or the error of `linearise`.
pub fn solve(
    problem: &Problem,
    linearise: impl Fn(&BlockPoint) -> EstimationResult<Linearised>,
) -> EstimationResult<Fit> {
    solve_groups(problem, &SolveOptions::default(), |at, blocks| {
        let point = |(block, observed)| BlockPoint {
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

/// Options of the iteration: required precision and start.
#[derive(Clone, Debug, Default)]
pub struct SolveOptions {
    /// Stop within 0.01 standard deviations.
    pub rough: bool,
    /// Residuals of an earlier solution, by group and block: the start of groups and blocks with equal sizes.
    pub residuals: Vec<Vec<DVector<f64>>>,
}

/// Minimises a problem whose blocks share work: `linearise` returns all blocks of a group. The list that it gets may
/// contain the blocks of another point, with equal columns and sizes, to be overwritten.
///
/// # Errors
/// Returns an error if [`solve`] would.
pub fn solve_groups(
    problem: &Problem,
    options: &SolveOptions,
    linearise: impl Fn(&GroupPoint, &mut Vec<Linearised>) -> EstimationResult<()>,
) -> EstimationResult<Fit> {
    let mut solver = GaussNewton::new(problem, options, linearise)?;
    for iteration in 1..=MAX_ITERATIONS {
        if solver.iterate(iteration)? {
            let second = if options.rough {
                None
            } else {
                solver.corrected_hessian()?
            };
            return solver
                .system
                .into_fit(problem, solver.state, iteration, second);
        }
    }
    Err(EstimationError::NoConvergence {
        iterations: MAX_ITERATIONS,
    })
}

/// Gauss-Newton iteration in progress.
struct GaussNewton<'a, L> {
    problem: &'a Problem,
    linearise: L,
    converged: f64,
    state: EstimationState,
    /// Buffer for the next state.
    next: EstimationState,
    /// Equations at the current state.
    system: NormalEquations,
    damping: f64,
    /// Factor on the length of the next step.
    length: f64,
    relaxation: Relaxation,
    secants: Secants,
    /// Whether the last step changed the groups' own parameters alone.
    groups_alone: bool,
    /// State before a step that increased the sum of squares, and the limit for the step after it.
    uphill: Option<(EstimationState, f64)>,
}

impl<'a, L> GaussNewton<'a, L>
where
    L: Fn(&GroupPoint, &mut Vec<Linearised>) -> EstimationResult<()>,
{
    fn new(problem: &'a Problem, options: &SolveOptions, linearise: L) -> EstimationResult<Self> {
        let state = EstimationState::initial(problem, &options.residuals);
        let mut system = NormalEquations::new(problem)?;
        system.assemble(problem, &state, &linearise)?;
        Ok(Self {
            problem,
            linearise,
            converged: if options.rough {
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
            uphill: None,
        })
    }

    /// Performs one iteration and returns true if the state is the solution.
    fn iterate(&mut self, iteration: usize) -> EstimationResult<bool> {
        let plain = self.system.global_step(self.problem, self.damping)?;
        let undamped = if self.damping > 0.0 {
            &self.system.global_step(self.problem, 0.0)?
        } else {
            &plain
        };
        let gain = undamped.dot(&self.system.right);
        let late = LATE_TOLERANCES
            .into_iter()
            .rfind(|(after, _)| iteration > *after)
            .map(|(_, enough)| enough);
        if late.is_some_and(|enough| self.system.unclosed.max(gain) <= enough) {
            return Ok(true);
        }
        let step = self.choose_step(plain, gain)?;
        let slope = step.dot(&self.system.right);
        self.system
            .apply_step(self.problem, &self.state, &step, &mut self.next);
        let changed = residual_change(self.problem, &self.state, &self.next);
        let moved = step.dot(&(&self.system.normal * &step)) + changed;
        // Compared with the length of a full step.
        let settled = !self.groups_alone && moved <= self.converged * self.length * self.length;
        let (here, slack) = (self.system.settled_omega(), self.system.omega_tolerance());
        let limit = self
            .uphill
            .as_ref()
            .map_or(here + slack, |(_, limit)| *limit);
        let tried = self
            .system
            .assemble(self.problem, &self.next, &self.linearise);
        let exists = tried.is_ok() && self.system.omega.is_finite();
        if exists && (self.system.settled_omega() <= limit || settled && self.uphill.is_none()) {
            std::mem::swap(&mut self.state, &mut self.next);
            self.uphill = None;
            if !self.groups_alone {
                self.length = 1.0;
                self.damping = if self.damping < 1e-6 {
                    0.0
                } else {
                    self.damping * 0.1
                };
            }
            return Ok(settled && self.system.unclosed <= self.converged);
        }
        let is_plain = self.damping == 0.0 && self.length == 1.0 && self.secants.is_empty();
        if exists && is_plain && self.uphill.is_none() && !self.groups_alone {
            self.relaxation = Relaxation::default();
            // In a bent valley the next step may lead back to its floor, and farther down (watchdog technique).
            std::mem::swap(&mut self.state, &mut self.next);
            self.uphill = Some((self.next.clone(), limit));
            return Ok(false);
        }
        let risen = exists.then(|| self.system.settled_omega() - here);
        let error = || {
            tried.err().unwrap_or(EstimationError::NoConvergence {
                iterations: iteration,
            })
        };
        if self.shorten_step(slope, risen) > MAX_DAMPING {
            return Err(error());
        }
        self.system
            .assemble(self.problem, &self.state, &self.linearise)?;
        Ok(false)
    }

    /// Chooses the next step; Gauss's step, `plain`, would lower the sum of squares by `gain`.
    fn choose_step(&mut self, plain: DVector<f64>, gain: f64) -> EstimationResult<DVector<f64>> {
        self.groups_alone = !self.groups_alone
            && self.system.unsettled > (UNSETTLED_FRACTION * gain).max(self.converged);
        if self.groups_alone {
            return Ok(plain * 0.0);
        }
        if self.damping > 0.0 {
            // A damped step contains no information about others.
            return Ok(plain);
        }
        // Quasi-Newton steps need the gradient, which the right side is not if conditions are between observations.
        if !self.system.several_own {
            return Ok(self
                .relaxation
                .scale_step(plain, &self.system.normal, self.length));
        }
        Ok(self
            .secants
            .next_step(&self.system, self.problem, &self.state.global)?
            * self.length)
    }

    /// Returns the corrected second derivatives if previous steps deviated from the normal matrix, which amplitudes of many
    /// groups cause.
    fn corrected_hessian(&self) -> EstimationResult<Option<DMatrix<f64>>> {
        let Some(start) = self.secants.max_deviation_direction(&self.system.normal) else {
            return Ok(None);
        };
        hessian_correction::half_hessian(
            &self.system,
            self.problem,
            &self.state,
            start,
            &self.linearise,
        )
        .map(Some)
    }

    /// Returns to the state before a step that increased the sum of squares. The next step is Gauss's if this one was not,
    /// or else shorter: by the parabola through both ends with the slope at the first, and finally by damping. `risen`:
    /// increase of the sum of squares, if it exists. Returns the damping.
    fn shorten_step(&mut self, slope: f64, risen: Option<f64>) -> f64 {
        let was_uphill = self
            .uphill
            .take()
            .map(|(before, _)| self.state = before)
            .is_some();
        if self.groups_alone && !was_uphill {
            return self.damping;
        }
        if !was_uphill && self.length == 1.0 && !self.secants.is_empty() {
            // Second derivatives from earlier points are not valid here: take Gauss's step instead.
            self.secants.clear();
            return self.damping;
        }
        self.relaxation = Relaxation::default();
        let curvature = risen
            .filter(|_| self.system.several_own)
            .map(|risen| risen + 2.0 * slope)
            .filter(|curvature| *curvature > 0.0);
        let shorter = curvature.map_or(DEFAULT_STEP_FACTOR, |curvature| {
            (slope / curvature).clamp(STEP_FACTOR_BOUNDS.0, STEP_FACTOR_BOUNDS.1)
        });
        if self.damping == 0.0 && shorter * self.length >= MIN_STEP_FRACTION {
            self.length *= shorter;
        } else {
            self.secants.clear();
            self.damping = if self.damping == 0.0 {
                1e-3
            } else {
                self.damping * 10.0
            };
            self.length = 1.0;
        }
        self.damping
    }
}

/// Over- or under-relaxation of steps that repeat themselves, estimated from two of them (Aitken; for vectors Irons and
/// Tuck 1969). If two unknowns are poorly separable (principal point and rotation), the second derivatives that Gauss's
/// method neglects are as large as the others.
#[derive(Default)]
struct Relaxation {
    /// Last step before scaling, and its factor.
    last: Option<(DVector<f64>, f64)>,
}

impl Relaxation {
    /// Smallest cosine between two steps, in standard deviations, that count as repeated.
    const MIN_COSINE: f64 = 0.9;
    /// Bounds of the factor; two steps do not determine larger or smaller ones.
    const FACTOR_BOUNDS: (f64, f64) = (0.3, 10.0);

    /// Returns the step times its factor; the first step, also after one that increased the sum of squares, times `length`.
    fn scale_step(
        &mut self,
        step: DVector<f64>,
        normal: &DMatrix<f64>,
        length: f64,
    ) -> DVector<f64> {
        let factor = self.last.as_ref().map_or(length, |(last, factor)| {
            let weighted = normal * &step;
            let (both, own) = (last.dot(&weighted), step.dot(&weighted));
            let before = last.dot(&(normal * last));
            // Rounding has no direction.
            let repeated =
                before > f64::EPSILON && both.abs() > Self::MIN_COSINE * (own * before).sqrt();
            if repeated {
                (factor / (1.0 - both / before)).clamp(Self::FACTOR_BOUNDS.0, Self::FACTOR_BOUNDS.1)
            } else {
                1.0
            }
        });
        let scaled = &step * factor;
        self.last = Some((step, factor));
        scaled
    }
}
