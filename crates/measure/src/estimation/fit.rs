//! The solution of a problem, and propagation of its covariance to functions of the unknowns.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::linear::{add_scaled, dot_product};
use super::problem::{InformationPrior, Linearised};

/// Solution of one block.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockFit {
    /// Adjusted minus observed.
    pub residuals: DVector<f64>,
    /// Conditions with their derivatives at the solution.
    pub linearised: Linearised,
    /// `Q B' M^-1`: minus the derivative of the residuals with respect to the conditions.
    pub(super) gain: DMatrix<f64>,
    /// `Q - Q B' M^-1 B Q`: covariance of the adjusted observations for given parameters.
    pub(super) conditional: DMatrix<f64>,
}

/// Solution of one group.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupFit {
    pub local: DVector<f64>,
    /// Derivative of the local parameters with respect to the global ones, at the minimum.
    pub sensitivity: DMatrix<f64>,
    /// Covariance of the local parameters for given global parameters.
    pub conditional: DMatrix<f64>,
    /// Covariance of local with global parameters (local x global).
    pub(super) cross: DMatrix<f64>,
    /// Covariance of the local parameters.
    pub covariance: DMatrix<f64>,
    pub blocks: Vec<BlockFit>,
}

/// Solution of a [`Problem`].
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    pub global: DVector<f64>,
    /// Covariance of the global parameters, a priori (variance factor 1).
    pub covariance: DMatrix<f64>,
    /// Derivative of the global parameters with respect to the right side of the normal equations.
    pub(super) response: DMatrix<f64>,
    /// Inverse of the covariance: the normal matrix, if that is close to the second derivatives.
    pub information: DMatrix<f64>,
    pub groups: Vec<GroupFit>,
    /// Weighted sum of squared residuals, priors included.
    pub omega: f64,
    /// Contribution of the priors to `omega`.
    pub omega_priors: f64,
    /// Conditions and priors minus parameters.
    pub redundancy: usize,
    /// Iterations until convergence.
    pub iterations: usize,
}

/// Derivatives of functions of the unknowns of one group, one column per function.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradient {
    /// Global parameters on which the functions depend, each once.
    pub columns: Vec<usize>,
    /// Derivatives with respect to these global parameters (columns x functions).
    pub global: DMatrix<f64>,
    /// Derivatives with respect to the group's local parameters (local x functions).
    pub local: DMatrix<f64>,
    /// Derivatives with respect to adjusted observations: (block, observations x functions).
    pub observed: Vec<(usize, DMatrix<f64>)>,
}

impl Gradient {
    /// Creates functions with derivatives 0.
    pub fn empty(columns: Vec<usize>, local: usize, functions: usize) -> Self {
        Self {
            global: DMatrix::zeros(columns.len(), functions),
            local: DMatrix::zeros(local, functions),
            observed: vec![],
            columns,
        }
    }

    fn function_count(&self) -> usize {
        self.global.ncols()
    }

    /// Returns these functions, followed by some global parameters as functions of their own.
    pub fn with_parameters(&self, parameters: &[usize]) -> Self {
        let mut columns = self.columns.clone();
        columns.extend(
            parameters
                .iter()
                .filter(|column| !self.columns.contains(column)),
        );
        let count = self.function_count() + parameters.len();
        let mut global = self.global.clone().resize(columns.len(), count, 0.0);
        for (row, column) in columns.iter().enumerate() {
            let function = parameters.iter().position(|parameter| parameter == column);
            function
                .into_iter()
                .for_each(|k| global[(row, self.function_count() + k)] = 1.0);
        }
        let widen = |m: &DMatrix<f64>| m.clone().resize_horizontally(count, 0.0);
        let observed = self
            .observed
            .iter()
            .map(|(block, by)| (*block, widen(by)))
            .collect();
        Self {
            columns,
            global,
            local: widen(&self.local),
            observed,
        }
    }

    /// Returns a single function.
    pub fn single_function(&self, index: usize) -> Self {
        let column = |m: &DMatrix<f64>| m.columns(index, 1).into_owned();
        let observed = self.observed.iter().map(|(block, by)| (*block, column(by)));
        Self {
            columns: self.columns.clone(),
            global: column(&self.global),
            local: column(&self.local),
            observed: observed.collect(),
        }
    }
}

/// Covariance of functions in two parts: `total Qxx total' + own`. Functions of different groups have the covariance
/// `total_1 Qxx total_2'`.
#[derive(Clone, Debug, PartialEq)]
pub struct PropagatedCovariance {
    /// Total derivative with respect to the global parameters.
    pub total: DMatrix<f64>,
    /// Covariance for given global parameters.
    pub own: DMatrix<f64>,
}

impl Fit {
    /// Returns the a-posteriori variance factor; `None` at redundancy 0.
    pub fn variance_factor(&self) -> Option<f64> {
        (self.redundancy > 0).then(|| self.omega / self.redundancy as f64)
    }

    /// Returns the solution's information about the global parameters, as a prior for another problem.
    pub fn information_prior(&self) -> InformationPrior {
        let conditions = self.global.len();
        InformationPrior {
            mean: self.global.clone(),
            information: self.information.clone(),
            conditions,
        }
    }

    /// Replaces adjusted observations by the parameters on which they depend. Returns functions of parameters alone and the
    /// covariance of the remaining noise.
    pub(super) fn eliminate_observations<'a>(
        &self,
        group: usize,
        gradient: &'a Gradient,
    ) -> (Cow<'a, Gradient>, DMatrix<f64>) {
        let functions = gradient.function_count();
        let mut own = DMatrix::zeros(functions, functions);
        if gradient.observed.is_empty() {
            return (Cow::Borrowed(gradient), own);
        }
        let mut by = Gradient {
            observed: vec![],
            ..gradient.clone()
        };
        for (index, derivative) in &gradient.observed {
            let block = &self.groups[group].blocks[*index];
            let lin = &block.linearised;
            let answer = small_product(&block.gain, derivative);
            for (k, column) in lin.columns.iter().enumerate() {
                let at = by
                    .columns
                    .iter()
                    .position(|c| c == column)
                    .unwrap_or_else(|| {
                        by.columns.push(*column);
                        by.global.resize_vertically_mut(by.columns.len(), 0.0);
                        by.columns.len() - 1
                    });
                for f in 0..functions {
                    by.global[(at, f)] -= lin.global.column(k).dot(&answer.column(f));
                }
            }
            for k in 0..lin.local.ncols() {
                for f in 0..functions {
                    by.local[(k, f)] -= lin.local.column(k).dot(&answer.column(f));
                }
            }
            own += small_product(derivative, &small_product(&block.conditional, derivative));
        }
        (Cow::Owned(by), own)
    }

    /// Splits functions of one group into their dependence on the global parameters and their own noise.
    pub fn propagate(&self, group: usize, gradient: &Gradient) -> PropagatedCovariance {
        let (by, mut own) = self.eliminate_observations(group, gradient);
        if by.local.nrows() > 0 {
            own += by.local.transpose() * (&self.groups[group].conditional * &by.local);
        }
        PropagatedCovariance {
            total: self.total_derivative(group, &by),
            own,
        }
    }

    /// Derivative of functions of parameters alone with respect to the global ones, on which the local ones depend.
    fn total_derivative(&self, group: usize, by: &Gradient) -> DMatrix<f64> {
        let mut total = DMatrix::zeros(by.function_count(), self.global.len());
        for (k, &column) in by.columns.iter().enumerate() {
            (0..by.function_count()).for_each(|f| total[(f, column)] += by.global[(k, f)]);
        }
        if by.local.nrows() > 0 {
            total += by.local.transpose() * &self.groups[group].sensitivity;
        }
        total
    }

    /// Returns a factor `F` of the covariance of functions of one group for given global parameters: `own = F F'` of
    /// [`Fit::propagate`] (functions x any number of independent sources). Also returns the total derivative with respect
    /// to the global parameters.
    pub fn propagate_factors(
        &self,
        group: usize,
        gradient: &Gradient,
    ) -> (DMatrix<f64>, DMatrix<f64>) {
        let (by, _) = self.eliminate_observations(group, gradient);
        let total = self.total_derivative(group, &by);
        let fit = &self.groups[group];
        let mut parts = vec![by.local.tr_mul(&symmetric_root(&fit.conditional))];
        for (index, derivative) in &gradient.observed {
            parts.push(derivative.tr_mul(&symmetric_root(&fit.blocks[*index].conditional)));
        }
        let columns: Vec<_> = parts.iter().flat_map(|part| part.column_iter()).collect();
        let own = match columns.is_empty() {
            true => DMatrix::zeros(gradient.function_count(), 0),
            false => DMatrix::from_columns(&columns),
        };
        (total, own)
    }

    /// Returns the covariance of functions of one group.
    pub fn function_covariance(&self, group: usize, gradient: &Gradient) -> DMatrix<f64> {
        let (by, mut covariance) = self.eliminate_observations(group, gradient);
        let mut common = SharedCovariance::new(self, group, &by);
        for f in 0..by.function_count() {
            common.set_function(f);
            for g in 0..=f {
                let both = common.covariance_with(g);
                covariance[(f, g)] += both;
                if g < f {
                    covariance[(g, f)] += both;
                }
            }
        }
        covariance
    }

    /// Returns the variances of functions of one group.
    pub fn function_variances(&self, group: usize, gradient: &Gradient) -> Vec<f64> {
        let (by, own) = self.eliminate_observations(group, gradient);
        let mut common = SharedCovariance::new(self, group, &by);
        let one = |f: usize| {
            common.set_function(f);
            own[(f, f)] + common.covariance_with(f)
        };
        (0..by.function_count()).map(one).collect()
    }

    /// Returns the covariance of a block's adjusted observations, a priori.
    pub fn adjusted_covariance(&self, group: usize, block: usize) -> DMatrix<f64> {
        let block = &self.groups[group].blocks[block];
        let lin = &block.linearised;
        let gain = block.gain.transpose();
        let by = Gradient {
            columns: lin.columns.clone(),
            global: small_product(&lin.global, &gain),
            local: small_product(&lin.local, &gain),
            observed: vec![],
        };
        self.function_covariance(group, &by) + &block.conditional
    }
}

/// Computes the symmetric root of a positive semidefinite matrix.
pub fn symmetric_root(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    if matrix.is_empty() {
        return matrix.clone();
    }
    let SymmetricEigen {
        eigenvectors,
        eigenvalues,
    } = SymmetricEigen::new(matrix.clone());
    &eigenvectors
        * DMatrix::from_diagonal(&eigenvalues.map(|l| l.max(0.0).sqrt()))
        * eigenvectors.transpose()
}

/// Covariance of functions through the parameters that they share.
struct SharedCovariance<'a> {
    by: &'a Gradient,
    /// Covariance of the gradient's global columns.
    shared: Vec<f64>,
    /// Covariance of the local parameters with the global columns.
    cross: Vec<f64>,
    local: &'a [f64],
    /// Covariance of the current function with the global columns.
    with_global: Vec<f64>,
    with_local: Vec<f64>,
}

impl<'a> SharedCovariance<'a> {
    fn new(fit: &'a Fit, group: usize, by: &'a Gradient) -> Self {
        let (q, p, n) = (by.local.nrows(), fit.global.len(), by.columns.len());
        let group = &fit.groups[group];
        let mut shared = Vec::with_capacity(n * n);
        let mut cross = Vec::with_capacity(n * q);
        for &column in &by.columns {
            let covariance = &fit.covariance.as_slice()[column * p..(column + 1) * p];
            shared.extend(by.columns.iter().map(|&c| covariance[c]));
            cross.extend_from_slice(&group.cross.as_slice()[column * q..(column + 1) * q]);
        }
        let local = if q > 0 {
            group.covariance.as_slice()
        } else {
            &[]
        };
        Self {
            by,
            shared,
            cross,
            local,
            with_global: vec![0.0; n],
            with_local: vec![0.0; q],
        }
    }

    /// Selects a function and computes its covariance with the parameters.
    fn set_function(&mut self, f: usize) {
        let (n, q) = (self.with_global.len(), self.with_local.len());
        self.with_global.fill(0.0);
        self.with_local.fill(0.0);
        let local = self.by.local.column(f);
        for (k, &derivative) in self.by.global.column(f).iter().enumerate() {
            let cross = &self.cross[k * q..(k + 1) * q];
            self.with_global[k] += dot_product(cross, local.as_slice());
            if derivative != 0.0 {
                add_scaled(
                    &mut self.with_global,
                    derivative,
                    &self.shared[k * n..(k + 1) * n],
                );
                add_scaled(&mut self.with_local, derivative, cross);
            }
        }
        for (k, &derivative) in local.iter().enumerate().filter(|(_, d)| **d != 0.0) {
            add_scaled(
                &mut self.with_local,
                derivative,
                &self.local[k * q..(k + 1) * q],
            );
        }
    }

    /// Returns the covariance of the selected function with another one.
    fn covariance_with(&self, g: usize) -> f64 {
        dot_product(self.by.global.column(g).as_slice(), &self.with_global)
            + dot_product(self.by.local.column(g).as_slice(), &self.with_local)
    }
}

/// Returns `a' b`, for matrices too small for a library's product.
fn small_product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let n = a.nrows().max(1);
    let mut out = DMatrix::zeros(a.ncols(), b.ncols());
    for (column, b) in out
        .as_mut_slice()
        .chunks_exact_mut(a.ncols().max(1))
        .zip(b.as_slice().chunks_exact(n))
    {
        for (target, a) in column.iter_mut().zip(a.as_slice().chunks_exact(n)) {
            *target = dot_product(a, b);
        }
    }
    out
}
