//! Least squares for a few shared parameters and many groups with a few parameters of their own, for thousands of points:
//! normal equations of fixed sizes (bundle adjustment; Triggs et al. 2000).
//!
//! Every point is one observation of two coordinates in one group: the normal equations are an arrow of small blocks, and
//! the groups' own parameters are eliminated by their Schur complement. Steps are damped (Levenberg and Marquardt) until
//! the sum of squares falls; the covariance is computed without damping. A group's own parameters may be anything that a
//! step can change, for example a rotation.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

type Square<const N: usize> = SMatrix<f64, N, N>;

/// Maximum number of steps, so that a slowly creeping adjustment ends too.
const MAX_ITERATIONS: usize = 500;
/// Predicted decrease of the sum of squares by a full step below which the iteration has converged: a step of 0.001
/// standard deviations.
const CONVERGED: f64 = 1e-6;
/// Predicted decrease that is accepted if rounding or a long flat valley ends the steps early: a step of 0.1 standard
/// deviations.
const NEARLY_CONVERGED: f64 = 1e-2;
/// Relative rounding error of a sum of squares. If nothing else is left of it, shared and own parameters are inseparable.
const ROUNDING: f64 = 1e-12;
/// First damping of Levenberg and Marquardt, as a fraction of the normal matrix' diagonal.
const FIRST_DAMPING: f64 = 1e-4;
/// Lower bound of the damping, far below anything that changes a step in double precision.
const MIN_DAMPING: f64 = 1e-12;
/// Upper bound of the damping, beyond which no step changes anything in double precision.
const MAX_DAMPING: f64 = 1e12;

/// A prior on one shared parameter.
#[derive(Clone, Copy, Debug)]
pub struct ScalarPrior {
    /// Index of the parameter.
    pub index: usize,
    /// Expected value.
    pub mean: f64,
    /// Standard deviation of the expected value.
    pub sigma: f64,
}

/// A model of `G` shared parameters and of groups with `L` parameters of their own.
pub trait ArrowModel<const G: usize, const L: usize> {
    /// Parameters of one group.
    type Own: Clone;

    /// Adds the observations of all points, group after group. Returns `None` if a point has no image.
    fn add_observations(
        &self,
        global: &SVector<f64, G>,
        own: &[Self::Own],
        equations: &mut ArrowEquations<G, L>,
    ) -> Option<()>;

    /// Returns a group's parameters after a step.
    fn apply_step(own: &Self::Own, step: &SVector<f64, L>) -> Self::Own;
}

/// A point's derivatives, weight and residual.
pub struct LinearisedPoint<const G: usize, const L: usize> {
    /// Derivatives with respect to the shared parameters.
    pub by_global: SMatrix<f64, 2, G>,
    /// Derivatives with respect to the group's own parameters.
    pub by_own: SMatrix<f64, 2, L>,
    /// Inverse of the observation's covariance.
    pub weight: Matrix2<f64>,
    /// Observed minus computed.
    pub residual: Vector2<f64>,
}

struct GroupEquations<const G: usize, const L: usize> {
    own: Square<L>,
    cross: SMatrix<f64, G, L>,
    right: SVector<f64, L>,
}

/// Normal equations under construction.
pub struct ArrowEquations<const G: usize, const L: usize> {
    global: Square<G>,
    right: SVector<f64, G>,
    groups: Vec<GroupEquations<G, L>>,
    omega: f64,
    points: usize,
}

/// Solution of an arrow-shaped problem.
#[derive(Clone, Debug)]
pub struct ArrowSolution<const G: usize, Own> {
    pub global: SVector<f64, G>,
    /// Parameters of each group.
    pub own: Vec<Own>,
    /// Covariance of the shared parameters, a priori; 0 for fixed ones.
    pub covariance: Square<G>,
    /// Weighted sum of squares, priors included.
    pub omega: f64,
    /// Observations and priors minus unknowns.
    pub redundancy: usize,
}

impl<const G: usize, Own> ArrowSolution<G, Own> {
    /// Returns the a-posteriori variance of unit weight.
    pub fn variance_factor(&self) -> f64 {
        self.omega / self.redundancy as f64
    }
}

/// Minimises the sum of squares from a start. Parameters marked in `fixed` keep their start, and their priors are ignored.
/// Returns `None` if no step decreases the sum, a point has no image, or a parameter stays undetermined.
pub fn solve_arrow<const G: usize, const L: usize, M: ArrowModel<G, L>>(
    model: &M,
    priors: &[ScalarPrior],
    fixed: &[bool; G],
    global: SVector<f64, G>,
    own: &[M::Own],
) -> Option<ArrowSolution<G, M::Own>> {
    let priors: Vec<_> = priors.iter().filter(|p| !fixed[p.index]).copied().collect();
    let (mut global, mut own) = (global, own.to_vec());
    let mut equations = ArrowEquations::assemble(model, &priors, &global, &own)?;
    let mut damping = FIRST_DAMPING;
    for _ in 0..MAX_ITERATIONS {
        let trial = equations.step(damping, fixed).and_then(|(step, own_steps)| {
            let next: Vec<_> = own.iter().zip(&own_steps).map(|(o, s)| M::apply_step(o, s)).collect();
            let at = ArrowEquations::assemble(model, &priors, &(global + step), &next)
                .filter(|n| n.omega <= equations.omega * (1.0 + ROUNDING))?;
            Some((global + step, next, at))
        });
        match trial {
            Some(next) => {
                (global, own, equations) = next;
                damping = (damping * 0.1).max(MIN_DAMPING);
            }
            None if damping < MAX_DAMPING => damping *= 10.0,
            None => break,
        }
        if equations.predicted_decrease(fixed).is_some_and(|p| p < CONVERGED) {
            return equations.build_solution(global, own, fixed, priors.len());
        }
    }
    let near = equations.predicted_decrease(fixed).is_some_and(|p| p < NEARLY_CONVERGED);
    near.then(|| equations.build_solution(global, own, fixed, priors.len())).flatten()
}

impl<const G: usize, const L: usize> ArrowEquations<G, L> {
    fn assemble<M: ArrowModel<G, L>>(
        model: &M,
        priors: &[ScalarPrior],
        global: &SVector<f64, G>,
        own: &[M::Own],
    ) -> Option<Self> {
        let mut all = Self { global: Square::zeros(), right: SVector::zeros(), groups: vec![], omega: 0.0, points: 0 };
        model.add_observations(global, own, &mut all)?;
        for prior in priors {
            let weight = prior.sigma.powi(-2);
            let off = prior.mean - global[prior.index];
            all.global[(prior.index, prior.index)] += weight;
            all.right[prior.index] += weight * off;
            all.omega += weight * off * off;
        }
        all.omega.is_finite().then_some(all)
    }

    /// Adds a group with its points. Returns `None` if a point has no image.
    pub fn add_group(&mut self, rows: impl Iterator<Item = Option<LinearisedPoint<G, L>>>) -> Option<()> {
        let mut group = GroupEquations { own: Square::zeros(), cross: SMatrix::zeros(), right: SVector::zeros() };
        for row in rows {
            let LinearisedPoint { by_global, by_own, weight, residual } = row?;
            let (weighted, by_own_weighted) = (by_global.transpose() * weight, by_own.transpose() * weight);
            self.global += weighted * by_global;
            self.right += weighted * residual;
            group.cross += weighted * by_own;
            group.own += by_own_weighted * by_own;
            group.right += by_own_weighted * residual;
            self.omega += residual.dot(&(weight * residual));
            self.points += 1;
        }
        self.groups.push(group);
        Some(())
    }

    /// Returns the normal equations of the shared parameters alone.
    fn reduced_equations(&self, damping: f64) -> Option<(Square<G>, SVector<f64, G>)> {
        let mut matrix = self.global;
        (0..G).for_each(|k| matrix[(k, k)] *= 1.0 + damping + ROUNDING);
        let mut right = self.right;
        for group in &self.groups {
            let solved = group.damped_matrix(damping).cholesky()?;
            matrix -= group.cross * solved.solve(&group.cross.transpose());
            right -= group.cross * solved.solve(&group.right);
        }
        Some((matrix, right))
    }

    fn step(&self, damping: f64, fixed: &[bool; G]) -> Option<(SVector<f64, G>, Vec<SVector<f64, L>>)> {
        let (matrix, right) = self.reduced_equations(damping)?;
        let step = scaled_inverse(&mask_matrix(matrix, fixed))? * mask_vector(right, fixed);
        let back = |group: &GroupEquations<G, L>| {
            Some(group.damped_matrix(damping).cholesky()?.solve(&(group.right - group.cross.transpose() * step)))
        };
        Some((step, self.groups.iter().map(back).collect::<Option<_>>()?))
    }

    /// Returns the decrease of the sum of squares that an undamped step promises.
    fn predicted_decrease(&self, fixed: &[bool; G]) -> Option<f64> {
        let (step, own_steps) = self.step(0.0, fixed)?;
        let own: f64 = self.groups.iter().zip(&own_steps).map(|(group, step)| group.right.dot(step)).sum();
        Some(mask_vector(self.right, fixed).dot(&step) + own)
    }

    fn build_solution<Own>(
        &self,
        global: SVector<f64, G>,
        own: Vec<Own>,
        fixed: &[bool; G],
        priors: usize,
    ) -> Option<ArrowSolution<G, Own>> {
        let covariance = scaled_inverse(&mask_matrix(self.reduced_equations(0.0)?.0, fixed))?;
        let free = |k: usize| if fixed[k] { 0.0 } else { 1.0 };
        let covariance = Square::from_fn(|i, j| covariance[(i, j)] * free(i) * free(j));
        let unknowns = fixed.iter().filter(|h| !**h).count() + L * self.groups.len();
        let redundancy = (2 * self.points + priors).checked_sub(unknowns).filter(|r| *r > 0)?;
        Some(ArrowSolution { global, own, covariance, omega: self.omega, redundancy })
    }
}

impl<const G: usize, const L: usize> GroupEquations<G, L> {
    fn damped_matrix(&self, damping: f64) -> Square<L> {
        let mut own = self.own;
        (0..L).for_each(|k| own[(k, k)] *= 1.0 + damping);
        own
    }
}

fn mask_matrix<const G: usize>(mut matrix: Square<G>, fixed: &[bool; G]) -> Square<G> {
    for k in (0..G).filter(|k| fixed[*k]) {
        matrix.row_mut(k).fill(0.0);
        matrix.column_mut(k).fill(0.0);
        matrix[(k, k)] = 1.0;
    }
    matrix
}

fn mask_vector<const G: usize>(mut right: SVector<f64, G>, fixed: &[bool; G]) -> SVector<f64, G> {
    (0..G).filter(|k| fixed[*k]).for_each(|k| right[k] = 0.0);
    right
}

/// Inverts a symmetric matrix whose parameters have very different units.
fn scaled_inverse<const G: usize>(matrix: &Square<G>) -> Option<Square<G>> {
    let scale = matrix.diagonal().map(|d| d.sqrt().recip());
    let scales = scale * scale.transpose();
    let scaled = matrix.component_mul(&scales).cholesky()?;
    Some(scaled.inverse().component_mul(&scales))
}
