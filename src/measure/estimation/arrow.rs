//! Few shared parameters and many groups with as few of their own, thousands of points: normal equations of fixed sizes
//! (bundle adjustment; Triggs et al. 2000).
//!
//! Every point is one observation of two coordinates in one group: the normal equations are an arrow of small blocks, and
//! the groups' own parameters leave by their Schur complement. Steps are damped (Levenberg and Marquardt) until the sum of
//! squares falls; at the end no damping is left in the covariance. What a group has for itself may be anything that a
//! step moves, a rotation for instance.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

type Square<const N: usize> = SMatrix<f64, N, N>;

/// Steps at most, so that an adjustment that creeps ends too.
const MAX_ITERATIONS: usize = 500;
/// Fall of the sum of squares that a full step still promises, below which it is at the end: a step of a
/// thousandth of a standard deviation.
const CONVERGED: f64 = 1e-6;
/// The same where rounding or a long flat valley ends the steps before: a tenth of a standard deviation.
const NEARLY_CONVERGED: f64 = 1e-2;
/// What rounding may take from a sum of squares: where nothing else is left of it, shared parameters and groups' own are
/// one.
const ROUNDING: f64 = 1e-12;
/// Levenberg's and Marquardt's damping, a share of the normal matrix' diagonal: to begin with, and its bounds, far below
/// and above what changes a step in double precision.
const FIRST_DAMPING: f64 = 1e-4;
/// See [`FIRST_DAMPING`].
const MIN_DAMPING: f64 = 1e-12;
/// See [`FIRST_DAMPING`].
const MAX_DAMPING: f64 = 1e12;

/// Knowledge of a shared parameter from elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct ScalarPrior {
    /// Which.
    pub index: usize,
    /// Its expected value.
    pub mean: f64,
    /// Standard deviation of the expectation.
    pub sigma: f64,
}

/// A model of `G` shared parameters and groups of `L` own ones.
pub trait Model<const G: usize, const L: usize> {
    /// What a group has for itself.
    type Own: Clone;

    /// Adds all points, group after group; `None` where one has no image.
    fn add_observations(
        &self,
        global: &SVector<f64, G>,
        own: &[Self::Own],
        equations: &mut Equations<G, L>,
    ) -> Option<()>;

    /// A group's own after a step.
    fn apply_step(own: &Self::Own, step: &SVector<f64, L>) -> Self::Own;
}

/// One point's derivatives, weight and observed less computed.
pub struct Row<const G: usize, const L: usize> {
    /// By the shared parameters.
    pub by_global: SMatrix<f64, 2, G>,
    /// By the group's own.
    pub by_own: SMatrix<f64, 2, L>,
    /// Inverse of its covariance.
    pub weight: Matrix2<f64>,
    /// Observed less computed.
    pub residual: Vector2<f64>,
}

struct GroupEquations<const G: usize, const L: usize> {
    own: Square<L>,
    cross: SMatrix<f64, G, L>,
    right: SVector<f64, L>,
}

/// Normal equations under construction.
pub struct Equations<const G: usize, const L: usize> {
    global: Square<G>,
    right: SVector<f64, G>,
    groups: Vec<GroupEquations<G, L>>,
    omega: f64,
    points: usize,
}

/// A solution.
#[derive(Clone, Debug)]
pub struct Solution<const G: usize, Own> {
    /// Shared parameters.
    pub global: SVector<f64, G>,
    /// The groups' own.
    pub own: Vec<Own>,
    /// Of the shared parameters, a priori; 0 where held.
    pub covariance: Square<G>,
    /// Weighted sum of squares, priors included.
    pub omega: f64,
    /// Observations and priors less unknowns.
    pub redundancy: usize,
}

impl<const G: usize, Own> Solution<G, Own> {
    /// Of the unit weight, a posteriori.
    pub fn variance_factor(&self) -> f64 {
        self.omega / self.redundancy as f64
    }
}

/// Minimises the sum of squares from a start; `None` where no step leads further down, a point has no image, or something
/// stays undetermined. `held`: parameters that keep their start, whose priors do not count.
pub fn solve_arrow<const G: usize, const L: usize, M: Model<G, L>>(
    model: &M,
    priors: &[ScalarPrior],
    held: &[bool; G],
    global: SVector<f64, G>,
    own: &[M::Own],
) -> Option<Solution<G, M::Own>> {
    let priors: Vec<_> = priors.iter().filter(|p| !held[p.index]).copied().collect();
    let (mut global, mut own) = (global, own.to_vec());
    let mut equations = Equations::assemble(model, &priors, &global, &own)?;
    let mut damping = FIRST_DAMPING;
    for _ in 0..MAX_ITERATIONS {
        let tried = equations.step(damping, held).and_then(|(step, own_steps)| {
            let next: Vec<_> = own.iter().zip(&own_steps).map(|(o, s)| M::apply_step(o, s)).collect();
            let at = Equations::assemble(model, &priors, &(global + step), &next)
                .filter(|n| n.omega <= equations.omega * (1.0 + ROUNDING))?;
            Some((global + step, next, at))
        });
        match tried {
            Some(next) => {
                (global, own, equations) = next;
                damping = (damping * 0.1).max(MIN_DAMPING);
            }
            None if damping < MAX_DAMPING => damping *= 10.0,
            None => break,
        }
        if equations.predicted_decrease(held).is_some_and(|p| p < CONVERGED) {
            return equations.build_solution(global, own, held, priors.len());
        }
    }
    let near = equations.predicted_decrease(held).is_some_and(|p| p < NEARLY_CONVERGED);
    near.then(|| equations.build_solution(global, own, held, priors.len())).flatten()
}

impl<const G: usize, const L: usize> Equations<G, L> {
    fn assemble<M: Model<G, L>>(
        model: &M,
        priors: &[ScalarPrior],
        global: &SVector<f64, G>,
        own: &[M::Own],
    ) -> Option<Self> {
        let mut all =
            Self { global: Square::zeros(), right: SVector::zeros(), groups: vec![], omega: 0.0, points: 0 };
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

    /// Adds a group with its points; `None` where one has no image.
    pub fn add_group(&mut self, rows: impl Iterator<Item = Option<Row<G, L>>>) -> Option<()> {
        let mut group =
            GroupEquations { own: Square::zeros(), cross: SMatrix::zeros(), right: SVector::zeros() };
        for row in rows {
            let Row { by_global, by_own, weight, residual } = row?;
            let (weighted, turned) = (by_global.transpose() * weight, by_own.transpose() * weight);
            self.global += weighted * by_global;
            self.right += weighted * residual;
            group.cross += weighted * by_own;
            group.own += turned * by_own;
            group.right += turned * residual;
            self.omega += residual.dot(&(weight * residual));
            self.points += 1;
        }
        self.groups.push(group);
        Some(())
    }

    /// Normal equations of the shared parameters alone.
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

    fn step(&self, damping: f64, held: &[bool; G]) -> Option<(SVector<f64, G>, Vec<SVector<f64, L>>)> {
        let (matrix, right) = self.reduced_equations(damping)?;
        let step = scaled_inverse(&mask_matrix(matrix, held))? * mask_vector(right, held);
        let back = |group: &GroupEquations<G, L>| {
            Some(group.damped_matrix(damping).cholesky()?.solve(&(group.right - group.cross.transpose() * step)))
        };
        Some((step, self.groups.iter().map(back).collect::<Option<_>>()?))
    }

    /// By how much an undamped step would lessen the sum of squares.
    fn predicted_decrease(&self, held: &[bool; G]) -> Option<f64> {
        let (step, own_steps) = self.step(0.0, held)?;
        let own: f64 = self.groups.iter().zip(&own_steps).map(|(group, step)| group.right.dot(step)).sum();
        Some(mask_vector(self.right, held).dot(&step) + own)
    }

    fn build_solution<Own>(
        &self,
        global: SVector<f64, G>,
        own: Vec<Own>,
        held: &[bool; G],
        priors: usize,
    ) -> Option<Solution<G, Own>> {
        let covariance = scaled_inverse(&mask_matrix(self.reduced_equations(0.0)?.0, held))?;
        let free = |k: usize| if held[k] { 0.0 } else { 1.0 };
        let covariance = Square::from_fn(|i, j| covariance[(i, j)] * free(i) * free(j));
        let unknowns = held.iter().filter(|h| !**h).count() + L * self.groups.len();
        let redundancy = (2 * self.points + priors).checked_sub(unknowns).filter(|r| *r > 0)?;
        Some(Solution { global, own, covariance, omega: self.omega, redundancy })
    }
}

impl<const G: usize, const L: usize> GroupEquations<G, L> {
    fn damped_matrix(&self, damping: f64) -> Square<L> {
        let mut own = self.own;
        (0..L).for_each(|k| own[(k, k)] *= 1.0 + damping);
        own
    }
}

fn mask_matrix<const G: usize>(mut matrix: Square<G>, held: &[bool; G]) -> Square<G> {
    for k in (0..G).filter(|k| held[*k]) {
        matrix.row_mut(k).fill(0.0);
        matrix.column_mut(k).fill(0.0);
        matrix[(k, k)] = 1.0;
    }
    matrix
}

fn mask_vector<const G: usize>(mut right: SVector<f64, G>, held: &[bool; G]) -> SVector<f64, G> {
    (0..G).filter(|k| held[*k]).for_each(|k| right[k] = 0.0);
    right
}

/// Of a symmetric matrix whose parameters have very different units.
fn scaled_inverse<const G: usize>(matrix: &Square<G>) -> Option<Square<G>> {
    let scale = matrix.diagonal().map(|d| d.sqrt().recip());
    let scales = scale * scale.transpose();
    let scaled = matrix.component_mul(&scales).cholesky()?;
    Some(scaled.inverse().component_mul(&scales))
}
